"""`import cabinpose`: data without a disk, what lies on one, a model on plain arrays, a report."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import make_sample
import numpy as np
import pytest

import cabinpose
from cabinpose.app.api import SAMPLE
from cabinpose.core.errors import CabinposeError, ConfigError
from cabinpose.core.ports import FrameBatch, PoseBatch
from cabinpose.core.pose import Visibility
from cabinpose.estimate import JointPredictor
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.store import read_manifest
from cabinpose.store.predictions import Predictions, write_predictions
from cabinpose.synth import Frame
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import generate as generate_dataset

ALONE = ("scene.cars=[suv]", "scene.occupancy={driver: 1.0}", "scene.right_hand_drive=0")


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return list(cabinpose.generate(*ALONE, frames=3, seed=4))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("api") / "dataset"
    generate_dataset(SynthConfig.load(None, ALONE), 3, folder, seed=4, workers=1)
    return folder


@pytest.fixture(scope="module")
def model() -> JointPredictor:
    return cabinpose.load_model("in_car", threads=1)


def test_the_package_loads_nothing_before_it_is_asked() -> None:
    code = "import sys, cabinpose; print(sum(name.startswith(('numpy', 'scipy', 'cabinpose.')) for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "0"
    assert set(cabinpose.__all__) <= set(dir(cabinpose))
    with pytest.raises(AttributeError, match="nonsense"):
        _ = cabinpose.nonsense  # type: ignore[attr-defined]


def test_what_is_opened_by_its_kind_is_what_open_gives(dataset: Path, tmp_path: Path, model: JointPredictor) -> None:
    ds = cabinpose.open_dataset(dataset)
    assert ds.equals(cabinpose.open(dataset))  # type: ignore[arg-type]
    assert all(f"units :</span></dt><dd>{unit}" in ds._repr_html_() for unit in ("m", "px"))  # xarray's page of it, in notebooks
    found = model(ds.depth.values, ds.camera_k.values, ds.amplitude.values)
    assert (found.persons, found.model, found.size) == (model.persons, "in_car", (352, 287))
    assert found.draw(ds.amplitude[0].values, frame=0).shape == (2 * 287, 2 * 352, 3)
    names = {name: getattr(found, name) for name in ("persons", "joints", "model", "skeleton")}
    poses = {name: value for name, value in vars(found).items() if name not in {*names, "size"}}
    file = write_predictions(tmp_path / "p.jsonl", Predictions(**poses, **names, frame=ds.frame.values))
    told = cabinpose.open_predictions(file)
    assert type(told) is type(cabinpose.open(file)) is Predictions
    np.testing.assert_array_equal(told.to_dataframe()["u"], found.to_dataframe()["u"])
    for opened in (cabinpose.open_dataset, cabinpose.open_recording, cabinpose.open_predictions):
        with pytest.raises(CabinposeError):
            opened(tmp_path / "nothing.mcap")


def test_generated_frames_are_those_of_a_dataset(frames: list[Frame], dataset: Path) -> None:
    ds = cabinpose.open(dataset)
    for i, frame in enumerate(frames):
        np.testing.assert_allclose(ds["depth"][i].values, frame["depth"], atol=6e-4)  # whole millimetres on disk
        np.testing.assert_allclose(ds["joints_3d"][i].values, frame["joints_3d"], atol=1e-6)
    later = next(cabinpose.generate(*ALONE, frames=1, first=2, seed=4))
    np.testing.assert_array_equal(later["depth"], frames[2]["depth"])


def test_a_model_takes_one_frame_or_many(frames: list[Frame], model: JointPredictor) -> None:
    depth, light = (np.stack([frame[name] for frame in frames]) for name in ("depth", "amplitude"))
    k = frames[0]["camera_k"]
    many, one = model(depth, k, light), model(depth[1], k, light[1])
    assert isinstance(one, PoseBatch)
    assert many.joints_3d.shape == (3, len(model.persons), len(model.joints), 3)
    np.testing.assert_allclose(many.joints_3d[1], one.joints_3d, atol=1e-4)
    truth = np.array([frame["joints_3d"][0] for frame in frames])
    seen = np.array([frame["visibility"][0] == Visibility.VISIBLE for frame in frames])
    assert np.median(np.linalg.norm(many.joints_3d[:, model.persons.index("driver")] - truth, axis=-1)[seen]) < 0.05


def test_wrong_arrays_say_what_is_wrong(frames: list[Frame], model: JointPredictor) -> None:
    depth, light, k = (frames[0][name] for name in ("depth", "amplitude", "camera_k"))
    for call, words in (
        (lambda: model(1000.0 * depth, k, light), "beyond 50"),
        (lambda: model(depth[0], k, light[0]), "no image"),
        (lambda: model(depth, np.eye(4), light), "no camera matrix"),
        (lambda: model(depth, k, light[:-1]), "does not belong to"),
        (lambda: model(depth, k), "amplitudes"),
        (lambda: cabinpose.generate(frames=0), "0 frames"),
        (lambda: cabinpose.generate("scene.cars=[tank]", frames=1), "tank"),
        (lambda: cabinpose.generate("scene.cars=[suv]", frames=1, config=SynthConfig()), "overrides"),
        (lambda: cabinpose.open("nowhere"), "nowhere does not exist"),
        (lambda: cabinpose.open(__file__), "nothing that cabinpose writes"),
    ):
        with pytest.raises(ConfigError, match=words) as caught:
            call()
        assert caught.value.hint


def test_amplitudes_of_another_unit_are_told_once(frames: list[Frame]) -> None:
    model = cabinpose.load_model("in_car", threads=1)
    depth, light, k = (frames[0][name] for name in ("depth", "amplitude", "camera_k"))
    with pytest.warns(UserWarning, match="Scale the amplitudes"):
        model(depth, k, light / 65535.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model(depth, k, light / 65535.0)
        cabinpose.load_model("in_car", threads=1)(depth, k, 3.0 * light)


def test_predictions_are_opened_and_evaluated(dataset: Path, model: JointPredictor, frames: list[Frame], tmp_path: Path) -> None:
    found = [model(frame["depth"], frame["camera_k"], frame["amplitude"]) for frame in frames]
    arrays = [np.stack([getattr(f, name) for f in found]) for name in ("joints_2d", "joints_3d", "score", "presence")]
    predictions = Predictions(
        *arrays,
        frame=np.arange(3),
        persons=model.persons,
        joints=model.joints,
        model="in_car",
        dataset=None,
    )
    path = write_predictions(tmp_path / "found.jsonl", predictions)
    assert isinstance(cabinpose.open(path), Predictions)
    by_file = cabinpose.evaluate_predictions(dataset, path, persons=["driver"])
    for one in ("driver", iter(["driver"])):
        assert cabinpose.evaluate_predictions(dataset, path, persons=one).value("PCKh", "2d") == by_file.value("PCKh", "2d")
    by_model = cabinpose.evaluate_predictions(str(dataset), "in_car", persons=["driver"])
    assert by_model.to_dict()["frames"] == by_file.to_dict()["frames"] == 3
    selection = cabinpose.open(dataset).isel(frame=[0])
    assert cabinpose.evaluate_predictions(selection, model).to_dict()["frames"] == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: cabinpose.generate({"scene": {}}, frames=1), "overrides are texts, such as 'scene.cars=[suv]'"),  # type: ignore[arg-type]
        (lambda: cabinpose.generate("a.b=1", frames=1, config={}), "overrides change files and defaults"),
        (lambda: cabinpose.generate(frames=1, seed=-1), "seed -1 is not a 63-bit natural number"),
        (lambda: cabinpose.generate(frames=1, config={"scene": {"cars": ["tank"]}}), "unknown car 'tank'"),
    ],
)
def test_what_cannot_be_generated_is_told_at_once(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        call()
    assert message in str(caught.value)
    assert caught.value.hint


def test_plain_data_are_a_configuration(frames: list[Frame]) -> None:
    scene = {"cars": ["suv"], "occupancy": {"driver": 1.0}, "right_hand_drive": 0}
    (same,) = cabinpose.generate(frames=1, seed=4, config={"scene": scene})
    np.testing.assert_array_equal(same["depth"], frames[0]["depth"])


def test_any_detector_is_evaluated(dataset: Path) -> None:
    class Truth:
        """Knows the answers of the driver's head, and no more."""

        name, persons, joints = "truth", ("driver",), ("head",)

        def predict(self, frames: FrameBatch) -> PoseBatch:
            head = cabinpose.open(dataset).sel(person=["driver"], joint=["head"]).isel(frame=slice(len(frames["depth"])))
            certain = np.ones(head.visibility.shape, np.float32)
            return PoseBatch(head.joints_2d.values, head.joints_3d.values, certain, certain)

    report = cabinpose.evaluate_predictions(dataset, Truth(), options=EvaluationOptions(hit_m=0.05))
    assert report.value("mAD@d", "3d", threshold=5.0) is not None
    error = report.value("MPJPE", "3d")
    assert report.model == "truth"
    assert error is not None
    assert (error.value, error.samples) == (0.0, 3)


def test_what_cannot_be_evaluated_is_told(dataset: Path) -> None:
    with pytest.raises(ConfigError, match="a function is no detector"):
        cabinpose.evaluate_predictions(dataset, lambda frames: frames)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="unknown slot 'pilot'"):
        cabinpose.evaluate_predictions(dataset, "in_car", persons=["pilot"])


def test_the_sample_is_small_and_as_its_script_makes_it() -> None:
    taken = (cabinpose.sample().subject != "").sum("frame")
    assert taken.to_series().to_dict() == {
        "driver": 20, "front_passenger": 20, "rear_left": 0, "rear_center": 0, "rear_right": 0,
    }  # fmt: skip
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*") if path.is_file()) <= 3_200_000
    manifest = read_manifest(SAMPLE)
    assert SynthConfig.parse(dict(manifest.config)) == make_sample.sample_config()
    assert (manifest.seed, manifest.frames) == (make_sample.SEED, make_sample.FRAMES)


def test_the_sample_has_a_name_on_the_command_line(
    run: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless something here has that name."""
    monkeypatch.chdir(tmp_path)
    done = run("info", "sample", "--json")
    assert json.loads(done.out)["frames"] == 20
    Path("sample").mkdir()
    assert "sample holds no dataset" in run("info", "sample").err
