"""Methods that are fitted to arrays: from `train` to a file that answers, with a method that knows the mean pose alone."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import small
import sphere_people
import yaml
from numpy.typing import NDArray

from cabinpose.app.cli import main
from cabinpose.core.errors import ConfigError, ModelError
from cabinpose.estimate import methods
from cabinpose.estimate.array_model import ArrayModel, ArrayPredictor, write_arrays
from cabinpose.estimate.data import StoredFrames
from cabinpose.estimate.found import Found
from cabinpose.estimate.methods import Method
from cabinpose.estimate.onnx_model import METADATA_KEY
from cabinpose.estimate.predictor import describe_model, load_model
from cabinpose.estimate.settings import ViewSettings
from cabinpose.estimate.training import TrainConfig, fit, frame_spec
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.predictions import read_predictions

SETTINGS = {"width": 64, "height": 48, "focal": 51.2, "slots": list(small.PERSONS)}


class MeanConfig(ViewSettings):
    skeleton: str = "cabinpose"


def mean_pose(settings: MeanConfig, frames: Any, config: TrainConfig, progress: Any) -> dict[str, NDArray[Any]]:
    assert config.method == "mean"
    kept = [frames[i] for i in range(len(frames))]
    progress(1, 1, "the mean")
    return {"joints": np.nanmean([np.where(f.present[:, None, None], f.joints, np.nan) for f in kept], axis=0)}


def find(arrays: Mapping[str, NDArray[Any]], settings: MeanConfig, seen: Mapping[str, NDArray[Any]]) -> Found:
    uvz = np.repeat(arrays["joints"][None].astype(np.float64), len(seen["depth"]), axis=0)
    return Found(uvz[..., :2], settings.view.from_view(uvz), np.ones(uvz.shape[:3]), np.ones(uvz.shape[:3]))


def check(arrays: Mapping[str, NDArray[Any]], settings: MeanConfig) -> None:
    if arrays["joints"].shape != (len(settings.slots), len(settings.joints), 3):
        raise ValueError("joints of another skeleton")


@pytest.fixture(autouse=True)
def mean_method(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(methods.METHODS, "mean", Method("mean", "joints", MeanConfig, fitted="arrays"))
    monkeypatch.setitem(sys.modules, "cabinpose.estimate.mean.fit", SimpleNamespace(fit=mean_pose))  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "cabinpose.estimate.mean.find", SimpleNamespace(find=find, check=check))  # type: ignore[arg-type]


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
        (["export", "--onnx", model, "--out", str(tmp_path / "m.onnx")], "it is the model already: give it to --model"),
    ):
        capsys.readouterr()
        assert main(wrong) == 2
        assert words in capsys.readouterr().err


def test_a_file_answers_what_was_fitted(trained_mean: Path) -> None:
    model = load_model(trained_mean)
    assert isinstance(model, ArrayPredictor)
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
    write_arrays(tmp_path / "again.npz", "mean", model.config, model.arrays, name="run", card=model.metadata["card"])
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
        (lambda a: a | {METADATA_KEY: told(a[METADATA_KEY], method="nobody")}, "unknown method 'nobody'"),
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
    monkeypatch.setitem(methods.METHODS, "compact", replace(methods.METHODS["compact"], fitted="arrays"))
    with pytest.raises(ModelError, match="cannot be a model of compact"):
        load_model("in_car")


def test_a_model_begins_with_nothing(tmp_path: Path, trained_mean: Path) -> None:
    config = TrainConfig(method="mean", settings=SETTINGS)
    frames = StoredFrames(small.dataset(4), frame_spec(config))
    with pytest.raises(ConfigError, match="fitted in one go"):
        fit(config, frames, frames, tmp_path / "other", init=trained_mean)
