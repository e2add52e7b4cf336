"""A model knows the frames that it was trained on, and `evaluate` says how many of those before it are among them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import small
import sphere_people
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.app.training import generated_frames
from cabinpose.core import ModelError, PredictionsError
from cabinpose.estimate import StoredFrames, load_model
from cabinpose.estimate.data import trained_on
from cabinpose.estimate.export import export_onnx
from cabinpose.estimate.onnx_model import OnnxModel
from cabinpose.estimate.train_config import Machines, Start, TrainConfig
from cabinpose.estimate.training import fit, frame_spec, load_detector
from cabinpose.evaluate import EvaluationOptions, evaluate, predict_dataset, trained_ranges
from cabinpose.store import frame_ranges, in_ranges, open_dataset, read_predictions, write_predictions
from cabinpose.synth import SynthConfig, build_manifest

ONE, QUICK = Machines(1), EvaluationOptions(resamples=0)
SIZE = {"width": small.SIZE[0], "height": small.SIZE[1], "persons": small.PERSONS, "frames_per_part": 3}


def config(method: str = "compact") -> TrainConfig:
    return TrainConfig(method=method, settings=small.TINY[method], epochs=1, batch=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames; read only."""
    return sphere_people.write(tmp_path_factory.mktemp("learnt") / "spheres", sphere_people.manifest(frames=6, **SIZE))


@pytest.fixture(scope="module")
def checkpoint(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a run that learnt from frames 0, 1 and 4, and chose its best epoch by frames 2 and 3."""
    dataset, spec = open_dataset(folder), frame_spec(config())
    training, validation = (StoredFrames(dataset.isel(frame=rows), spec) for rows in ([0, 1, 4], [2, 3]))
    return fit(config(), training, validation, tmp_path_factory.mktemp("run"), machines=ONE)


@pytest.fixture(scope="module")
def model(checkpoint: Path) -> Path:
    made = checkpoint.with_name("model.onnx")
    export_onnx(checkpoint, made, name="spheres", card={})
    return made


def told(dataset: xr.Dataset, model: Any) -> tuple[int, str]:
    caveats = evaluate(dataset, model, QUICK).caveats
    return caveats.trained_on, caveats.coverage


@pytest.mark.slow
def test_frames_that_were_trained_on_are_counted(folder: Path, model: Path) -> None:
    dataset, predictor = open_dataset(folder), load_model(model)
    assert predictor.trained_on == {dataset.attrs["frames_id"]: "0-1 4"}
    assert told(dataset, predictor) == (3, "the model was trained on 3 of these 6 frames: it errs more on new ones")
    assert told(dataset.isel(frame=[1, 2, 5]), predictor)[0] == 1
    assert told(dataset.isel(frame=[2, 3, 5]), predictor) == (0, "")  # those of the validation, and one of neither


def test_a_dataset_that_was_extended_is_known_and_one_of_another_seed_is_another(model: Path, tmp_path: Path) -> None:
    predictor = load_model(model)
    for seed, known in ((7, True), (8, False)):
        manifest = sphere_people.manifest(frames=7, **SIZE, seed=seed, licence="CC-BY-4.0")
        made = open_dataset(sphere_people.write(tmp_path / str(seed), manifest))
        assert trained_ranges(predictor, made) == ("0-1 4" if known else "")


def test_predictions_take_it_along(folder: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset, file, foreign = open_dataset(folder), tmp_path / "found.jsonl", tmp_path / "foreign.jsonl"
    found = predict_dataset(dataset.isel(frame=[0, 2, 3, 4]), load_model(model), dataset_id=dataset.attrs["dataset_id"])
    assert read_predictions(write_predictions(file, found)).trained_on == found.trained_on == "0 4"
    write_predictions(foreign, replace(found, trained_on="", model="foreign"))
    assert "trained_on" not in foreign.read_text()
    arguments = ["evaluate", str(folder), "--predictions", str(file), str(foreign), "--resamples", "0"]
    assert main([*arguments, "--json"]) == 0
    assert [each["caveats"]["trained_on"] for each in json.loads(capsys.readouterr().out)["models"]] == [2, 0]
    assert main([*arguments, "--out", str(tmp_path / "page")]) == 0
    words = "the model was trained on 2 of these 6 frames"
    assert words in capsys.readouterr().out
    assert words in (tmp_path / "page/index.html").read_text()
    file.write_text(file.read_text().replace('"0 4"', '"0 to 4"'))
    with pytest.raises(PredictionsError, match="'trained_on' are no ranges of frames"):
        read_predictions(file)


def test_a_run_that_begins_with_another_has_learnt_from_both(folder: Path, checkpoint: Path, model: Path, tmp_path: Path) -> None:
    dataset = open_dataset(folder)
    rest = StoredFrames(dataset.isel(frame=[3, 5]), frame_spec(config()))
    for before in (checkpoint, model):
        run = tmp_path / before.suffix
        best = fit(config(), rest, rest, run, start=Start(init=before), machines=ONE)
        learnt = load_detector(best).trained_on[dataset.attrs["frames_id"]]
        assert np.flatnonzero(in_ranges(learnt, np.arange(9))).tolist() == [0, 1, 3, 4, 5]


def test_generated_frames_are_those_of_a_dataset_of_the_same_scenes() -> None:
    scenes = SynthConfig.parse({"scene": {"cars": ["suv"]}})
    training, _ = generated_frames(scenes, frame_spec(TrainConfig(method="compact")), 4, seed=5)
    same = build_manifest(scenes, 100, 5)
    assert trained_on(training, 3) == {same.parts_belong_to: "0-11"}
    assert build_manifest(scenes, 100, 6).parts_belong_to != same.parts_belong_to


def test_models_of_before_say_nothing_and_what_is_no_range_is_refused(model: Path, tmp_path: Path) -> None:
    copy = onnx.load(str(model))
    known = json.loads(copy.metadata_props[0].value)
    for said in ({"x": "1-"}, {"x": "9" * 30}, ["0-3"]):
        onnx.helper.set_model_props(copy, {"cabinpose": json.dumps(known | {"trained_on": said})})
        onnx.save(copy, str(tmp_path / "hostile.onnx"))
        with pytest.raises(ModelError, match="does not say what it is"):
            OnnxModel(tmp_path / "hostile.onnx")
    del known["trained_on"]
    onnx.helper.set_model_props(copy, {"cabinpose": json.dumps(known)})
    onnx.save(copy, str(tmp_path / "old.onnx"))
    assert OnnxModel(tmp_path / "old.onnx").trained_on == {}


def test_ranges_hold_the_frames_that_they_were_made_of() -> None:
    rng = np.random.Generator(np.random.Philox(key=3))
    for share in (0.0, 0.1, 0.5, 0.9, 1.0):
        there = rng.random(500) < share
        ranges = frame_ranges(np.flatnonzero(there))
        assert in_ranges(ranges, np.arange(500)).tolist() == there.tolist()
    assert in_ranges("5-9 0-20 7", np.array([0, 8, 20, 21])).tolist() == [True, True, True, False]
