"""Methods that are fitted to arrays: from `train` to a file that answers, with the method that docs/extending.md shows."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small
import sphere_people
import yaml
from numpy.typing import NDArray

from cabinpose.app.cli import main
from cabinpose.app.compare import of_joints, recipe
from cabinpose.core import registry
from cabinpose.core.errors import ConfigError, ExtensionError, ModelError
from cabinpose.estimate.array_model import ArrayModel, write_arrays
from cabinpose.estimate.data import StoredFrames
from cabinpose.estimate.methods import METHODS, ArrayMethod
from cabinpose.estimate.onnx_model import METADATA_KEY, OnnxModel
from cabinpose.estimate.predictor import describe_model, load_model
from cabinpose.estimate.train_config import Start, TrainConfig
from cabinpose.estimate.training import fit, frame_spec
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.predictions import read_predictions

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text("utf-8").split("## A detector")[1]
SETTINGS = {"body": "full", "width": 64, "height": 48, "focal": 51.2, "slots": list(small.PERSONS)}


@pytest.fixture(autouse=True)
def mean_method(extension: Callable[..., None]) -> None:
    """The module of docs/extending.md, in a package of its own."""
    extension("mean_pose", {"methods": {"mean": "MEAN"}}, re.findall(r"```python\n(.*?)```", PAGE, re.S)[0])


@pytest.fixture
def data(tmp_path: Path) -> Path:
    manifest = sphere_people.manifest(frames=8, frames_per_part=8, width=64, height=48, persons=small.PERSONS)
    return sphere_people.write(tmp_path / "spheres", manifest)


@pytest.fixture
def trained_mean(tmp_path: Path) -> Path:
    config = TrainConfig(method="mean", settings=SETTINGS)
    frames = StoredFrames(small.dataset(4), frame_spec(config))
    return fit(config, frames, frames, tmp_path / "run")


def test_from_a_dataset_to_answers_by_the_command_line(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, splits, run = tmp_path / "run.yaml", tmp_path / "splits.yaml", tmp_path / "first"
    config.write_text(yaml.safe_dump({"method": "mean", "settings": SETTINGS}))
    splits.write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S04]}\n")
    train = ["train", str(data), "--config", str(config), "--out", str(run), "--splits", str(splits)]
    assert main([*train, "--json"]) == 0
    model = json.loads(capsys.readouterr().out.strip().splitlines()[-1])["best"]
    assert model == str(run / "best.npz")

    assert main(["models", model, "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert described == json.loads(json.dumps(describe_model(model)))
    assert (described["name"], described["method"], described["card"]["seed"]) == ("first", "mean", 1)
    assert 0 <= described["card"]["val_auc"] <= 100  # of the held-out people

    found = tmp_path / "found.jsonl"
    assert main(["predict", str(data), "--model", model, "--out", str(found)]) == 0
    read, expected = read_predictions(found), load_model(model).predict(frame_batch(open_dataset(data), slice(None)))
    np.testing.assert_allclose(read.joints_3d, expected.joints_3d, atol=1e-5)
    capsys.readouterr()
    assert main(["evaluate", str(data), "--model", model, "--resamples", "0", "--json"]) == 0
    assert main(["live", "--source", str(data), "--model", model, "--predictions", str(tmp_path / "live.jsonl")]) == 0

    for wrong, words in (
        (train, "already holds a trained model"),
        ([*train, "--resume"], "is fitted in one go"),
        (["export", "onnx", model, "--out", str(tmp_path / "m.onnx")], "it is the model already: give it to --model"),
    ):
        capsys.readouterr()
        assert main(wrong) == 2
        assert words in capsys.readouterr().err


def test_another_packages_method_is_listed_and_compared_where_it_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    assert re.search(r"walks,[\s│]*mean\)", capsys.readouterr().out)
    assert "mean" in of_joints()
    assert "mean" not in of_joints(own=True)
    settings = METHODS["mean"].settings(recipe("mean", None, None).settings)
    assert (settings.body, settings.slots, settings.view.width) == ("itop", ("standing",), 96)


def test_a_method_has_the_name_that_it_is_registered_by(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(METHODS["mean"]), "name", "average")
    METHODS._loaded.pop("mean")
    with pytest.raises(ExtensionError, match="the method 'mean' of mean_pose calls itself 'average'"):
        METHODS["mean"]


def test_a_task_that_does_not_exist_is_told_with_its_package(tmp_path: Path) -> None:
    module = tmp_path / "extensions" / "mean_pose.py"
    module.write_text(module.read_text().replace('task = "joints"', 'task = "joint"'))
    with pytest.raises(ExtensionError, match="mean_pose cannot be loaded: TypeError: the task of MeanMethod is none of"):
        METHODS["mean"]


def test_a_file_answers_what_was_fitted(trained_mean: Path) -> None:
    model = load_model(trained_mean)
    assert isinstance(model.model, ArrayModel)
    assert (model.name, model.persons) == ("run", small.PERSONS)
    made = [small.frame(i) for i in range(4)]
    there = np.array([[[[name != ""]] for name in f["subject"]] for f in made])
    camera = model.config.view.to_view(np.where(there, np.stack([f["joints_3d"] for f in made]), np.nan))
    # The mean of u, v and z, seen again as a point.
    expected = model.config.view.from_view(np.nanmean(camera, axis=0))
    batch = frame_batch(small.dataset(2), slice(None))
    np.testing.assert_allclose(model.predict(batch).joints_3d[0], expected, atol=1e-4)


def test_the_same_frames_give_the_same_bytes(trained_mean: Path, tmp_path: Path) -> None:
    model = ArrayModel(trained_mean)
    known = {"name": "run", "card": model.metadata["card"], "joint_definition": model.metadata["joint_definition"]}
    write_arrays(tmp_path / "again.npz", "mean", model.config, model.arrays, **known)
    assert (tmp_path / "again.npz").read_bytes() == trained_mean.read_bytes()
    assert [p.name for p in trained_mean.parent.iterdir()] == ["best.npz"]


def arrays_of(path: Path) -> dict[str, NDArray[Any]]:
    with np.load(path) as file:
        return dict(file)


def told(metadata: NDArray[np.uint8], **changes: Any) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(json.loads(metadata.tobytes()) | changes).encode(), np.uint8)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: {n: v for n, v in a.items() if n != METADATA_KEY}, "another program"),
        (lambda a: a | {METADATA_KEY: told(a[METADATA_KEY], method="nobody")}, "of the method 'nobody', which is not installed"),
        (lambda a: a | {METADATA_KEY: told(a[METADATA_KEY], method="compact", config={})}, "cannot be a model of compact"),
        (lambda a: a | {METADATA_KEY: told(a[METADATA_KEY], config={"width": -1})}, "width"),
        (lambda a: a | {METADATA_KEY: np.frombuffer(b"\xff{", np.uint8)}, "does not say what it is"),
        (lambda a: a | {"joints": a["joints"][:, :3]}, "joints of another skeleton"),
        (lambda a: {METADATA_KEY: a[METADATA_KEY]}, "does not fit mean: 'joints'"),
        (lambda a: a | {"joints": np.array([{}], object)}, "cannot be read"),  # a pickle
    ],
)
def test_foreign_files_are_model_errors(change: Any, words: str, trained_mean: Path, tmp_path: Path) -> None:
    path = tmp_path / "foreign.npz"
    np.savez(path, **change(arrays_of(trained_mean)))
    with pytest.raises(ModelError, match=words) as caught:
        load_model(path)
    assert caught.value.hint


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b[:200] + bytes([b[200] ^ 255]) + b[201:], lambda b: b""]
)
def test_damaged_files_are_model_errors(damage: Any, trained_mean: Path, tmp_path: Path) -> None:
    path = tmp_path / "damaged.npz"
    path.write_bytes(damage(trained_mean.read_bytes()))
    with pytest.raises(ModelError, match="cannot be read") as caught:
        load_model(path)
    assert "again" in caught.value.hint
    with pytest.raises(ModelError, match="no model"):
        load_model(tmp_path / "none.npz")


def test_a_network_is_no_array_model(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OnnxModel, "kind", ArrayMethod)
    with pytest.raises(ModelError, match="cannot be a model of compact"):
        load_model("in_car")


def test_a_model_of_an_extension_that_is_gone(trained_mean: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert METHODS.package("mean") == "mean_pose"
    for cached in ("_installed", "_offers"):
        monkeypatch.setattr(registry, cached, getattr(registry, cached).__wrapped__)
    monkeypatch.setattr(sys, "path", sys.path[1:])
    for opened in (load_model, describe_model):
        with pytest.raises(ModelError, match="of the method 'mean', which is not installed") as caught:
            opened(trained_mean)
        assert "install the package that offers it; installed: compact, paf" in caught.value.hint


def test_a_model_begins_with_nothing(tmp_path: Path, trained_mean: Path) -> None:
    config = TrainConfig(method="mean", settings=SETTINGS)
    frames = StoredFrames(small.dataset(4), frame_spec(config))
    with pytest.raises(ConfigError, match="fitted in one go"):
        fit(config, frames, frames, tmp_path / "other", start=Start(init=trained_mean))
