"""Figures on places and joints by other names are those of a dataset that only ever had these."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.core.errors import PredictionsError
from cabinpose.core.ports import POSE_ARRAYS
from cabinpose.evaluate.offline import common_joints, evaluate
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.store import as_named, write_predictions
from cabinpose.store.predictions import Predictions

OPTIONS = EvaluationOptions(resamples=0)
KEPT = ("neck", "lshoulder", "rshoulder", "lelbow", "relbow")


def _some(predictions: Predictions, persons: tuple[str, ...]) -> Predictions:
    """The answers for some joints and places alone."""
    rows, columns = [predictions.persons.index(p) for p in persons], [predictions.joints.index(j) for j in KEPT]
    chosen = {name: getattr(predictions, name)[:, rows][:, :, columns] for name in POSE_ARRAYS}
    return replace(predictions, **chosen, persons=persons, joints=KEPT)


def test_figures_are_those_of_a_dataset_with_these_joints_alone(dataset: xr.Dataset, predictions: Predictions) -> None:
    places = {"driver": "rear_left", "rear_left": "driver"}
    named = as_named(dataset, places, {joint: joint for joint in KEPT})
    assert common_joints(named, [predictions]) == KEPT
    swapped = predictions.persons.index("driver"), predictions.persons.index("rear_left")
    names = list(predictions.persons)
    names[swapped[0]], names[swapped[1]] = "rear_left", "driver"
    told = replace(predictions, persons=tuple(names))  # who answers for the driver answers for who is called rear_left
    report = evaluate(named, told, OPTIONS, persons=("driver", "rear_left"))
    rows = [dataset["person"].values.tolist().index(place) for place in ("driver", "rear_left")]
    only = dataset.isel(person=rows).sel(joint=list(KEPT)).load()
    wanted = evaluate(only, _some(predictions, ("driver", "rear_left")), OPTIONS)
    assert report.people == wanted.people > 0
    assert {v.metric for v in report.values} >= {"presence precision", "PCKh", "MPJPE"}
    by = [{(v.metric, v.space, v.joints, v.threshold): v.value for v in each.values} for each in (report, wanted)]
    assert by[0].keys() == by[1].keys()
    for key, value in by[0].items():
        np.testing.assert_allclose(value, by[1][key], err_msg=str(key))
    assert any(note.startswith("nobody in the dataset has ") and "head" in note for note in report.notes)


def test_a_model_without_a_labelled_joint_is_refused(dataset: xr.Dataset, predictions: Predictions) -> None:
    named = as_named(dataset, joints={"lfoot": "lfoot"})
    with pytest.raises(PredictionsError, match="nobody in the dataset has a joint that noisy finds") as error:
        common_joints(named, [predictions])
    assert error.value.hint == "its people have: lfoot"


def test_from_the_command_line(
    dataset_folder: Path, predictions: Predictions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "found.jsonl"
    write_predictions(file, predictions)
    command = ["evaluate", str(dataset_folder), "--predictions", str(file), "--json", "--resamples", "0"]

    def run(*more: str) -> int:
        try:
            return int(main([*command, *more]) or 0)
        except SystemExit as done:
            return int(done.code or 0)

    assert run("--places", "driver=rear_left", "--joints", "head=neck", "lelbow=lelbow") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["joints"] == ["neck", "lelbow"]
    for words, said, hint in (
        (("--places", "drivers=driver"), "unknown place 'drivers'", "driver"),
        (("--places", "driver"), "--places: 'driver' names nothing", "standing=driver"),
        (("--joints", "head=neck", "neck=neck"), "two joints are named neck", "a name of its own"),
        (("--joints", "itop"), "unknown set of joints in the dataset 'itop'", "cabinpose"),
    ):
        assert run(*words) == 2
        lines = capsys.readouterr().err.splitlines()
        assert any(line.startswith("error:") and said in line for line in lines)
        assert any(line.startswith("hint:") and hint in line for line in lines)
