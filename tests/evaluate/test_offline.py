"""A dataset against a file or a detector: both give the same report, and what does not fit is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from cabinpose.core import POSE_ARRAYS, told_as
from cabinpose.core.errors import ConfigError, DatasetError, PredictionsError
from cabinpose.core.ports import IMAGES, FrameBatch, PoseBatch, Predictor
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import ANATOMY, CABINPOSE, ITOP, JOINTS, PLUG_IN_GAIT, RIG
from cabinpose.evaluate import offline
from cabinpose.evaluate.offline import (
    check_predictions,
    common_joints,
    common_skeleton,
    evaluate,
    frame_batch,
    predict_dataset,
    truth_of,
)
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.store import points_m
from cabinpose.store.predictions import Predictions

OPTIONS = EvaluationOptions(resamples=0)


class Replay:
    """A detector that answers what a file says, frame after frame; it checks what it is given."""

    def __init__(self, answers: Predictions) -> None:
        self.name, self.persons, self.joints = answers.model, answers.persons, answers.joints
        self._answers, self._next = answers, 0

    def predict(self, frames: FrameBatch) -> PoseBatch:
        count, height, width = frames["depth"].shape
        assert (height, width) == (48, 64)
        assert frames["depth"].dtype == np.float32
        assert frames["amplitude"].shape == frames["depth"].shape
        assert frames["camera_k"].shape == (count, 3, 3)
        assert frames["camera_dist"].shape == (count, 5)
        batch = self._answers.take(self._answers.frame[self._next : self._next + count])
        self._next += count
        return batch


@pytest.mark.parametrize("batch", [2, 16])
def test_a_detector_is_a_file_that_runs(
    dataset: xr.Dataset, predictions: Predictions, monkeypatch: pytest.MonkeyPatch, batch: int
) -> None:
    monkeypatch.setattr(offline, "BATCH", batch)
    replay = Replay(predictions)
    assert isinstance(replay, Predictor)
    done: list[int] = []
    live = evaluate(dataset, replay, OPTIONS, progress=done.append)
    assert done[-1] == 5
    assert repr(live.values) == repr(evaluate(dataset, predictions, OPTIONS).values)


def test_a_detector_of_wrong_shape_is_a_defect(dataset: xr.Dataset, predictions: Predictions) -> None:
    replay = Replay(predictions)
    replay.joints = replay.joints[:-1]
    with pytest.raises(ValueError, match="joints_2d has the shape"):
        evaluate(dataset, replay, OPTIONS)
    with pytest.raises(DatasetError, match="no depth"):
        evaluate(dataset.drop_vars("depth"), Replay(predictions), OPTIONS)


class Looker(Replay):
    """A detector that asks for images, and keeps what it is given."""

    def __init__(self, answers: Predictions, *images: str) -> None:
        super().__init__(answers)
        self.images, self.seen = images, list[FrameBatch]()

    def predict(self, frames: FrameBatch) -> PoseBatch:
        self.seen.append(frames)
        return super().predict(frames)


def test_a_detector_is_given_the_images_that_it_asks_for(dataset: xr.Dataset, predictions: Predictions) -> None:
    """Each is the dataset's variable, and a cloud the one that the dataset computes of its depth."""
    images = [name for name in IMAGES if name in dataset]
    assert {"depth", "amplitude", "confidence", "labels"} <= set(images)
    looker = Looker(predictions, *images, "cloud")
    evaluate(dataset, looker, OPTIONS)
    predict_dataset(dataset, Looker(predictions, "cloud"))
    assert {"depth", "amplitude", "camera_k", "camera_dist", "frame", "sync_ns"} | {*images, "cloud"} == looker.seen[0].keys()
    for name in images:
        np.testing.assert_array_equal(looker.seen[0][name], dataset[name].values)
        assert looker.seen[0][name].dtype == dataset[name].dtype
    np.testing.assert_allclose(looker.seen[0]["cloud"], points_m(dataset).values, rtol=1e-6, atol=1e-7)


def test_an_image_that_the_dataset_lacks_is_told_before_the_first_frame(dataset: xr.Dataset, predictions: Predictions) -> None:
    looker = Looker(predictions, "rgb", "depth", "depth_styled")
    for run in (lambda: evaluate(dataset, looker, OPTIONS), lambda: predict_dataset(dataset, looker)):
        with pytest.raises(DatasetError, match="the dataset has no rgb, depth_styled for noisy to see") as caught:
            run()
        assert caught.value.hint is not None
    assert caught.value.hint.startswith("it has depth, amplitude, confidence, labels, cloud")
    assert not looker.seen
    with pytest.raises(DatasetError, match="the dataset has no rgb") as caught:
        frame_batch(dataset, slice(2), ("rgb",))
    assert caught.value.hint is not None
    assert caught.value.hint.startswith("it has depth, amplitude, confidence, labels, cloud")


def test_chunks_of_a_file(dataset: xr.Dataset, predictions: Predictions, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = evaluate(dataset, predictions, OPTIONS)
    monkeypatch.setattr(offline, "CHUNK", 2)
    assert repr(evaluate(dataset, predictions, OPTIONS).values) == repr(whole.values)


def test_no_image_is_read(dataset: xr.Dataset, predictions: Predictions) -> None:
    without = dataset.drop_vars([n for n in dataset.data_vars if "y" in dataset[n].dims])
    assert repr(evaluate(without, predictions, OPTIONS).values) == repr(evaluate(dataset, predictions, OPTIONS).values)


def test_joints_of_itop_where_the_dataset_has_them(dataset: xr.Dataset) -> None:
    """Held against `itop_joints_3d`, seen by each frame's camera; one outside of the image is absent, and one that is unknown."""
    rng = np.random.default_rng(3)
    frames, people = dataset.sizes["frame"], dataset.sizes["person"]
    points = rng.uniform((-0.3, -0.2, 1.5), (0.3, 0.2, 2.5), (frames, people, 15, 3)).astype(np.float32)
    points[0, 0, 3] = (5.0, 0.0, 2.0)  # beside the image
    points[1, 1, 4] = np.nan
    own = dataset.assign(itop_joints_3d=(("frame", "person", "itop_joint", "xyz"), points)).assign_coords(
        itop_joint=list(ITOP.joints)
    )
    k = dataset["camera_k"].values[:, None]
    seen = (points / points[..., 2:]) @ k.swapaxes(-1, -2)
    found = points + np.float32((0.0, 0.0, 0.05))
    ones = np.ones(points.shape[:-1], np.float32)
    persons = tuple(str(p) for p in dataset["person"].values)
    answers = Predictions(
        seen[..., :2].astype(np.float32), found, ones, ones, frame=dataset["frame"].values.astype(np.int64), persons=persons,
        joints=ITOP.joints, model="itop", skeleton="itop",
    )  # fmt: skip
    assert common_joints(own, [answers]) == ITOP.joints
    without = own.drop_vars([n for n in own.data_vars if "y" in own[n].dims])
    truth = truth_of(without, ITOP)
    np.testing.assert_allclose(truth["joints_2d"].values, seen[..., :2], atol=1e-3)
    assert truth["visibility"].values[0, 0, 3] == Visibility.OUTSIDE_IMAGE
    assert truth["visibility"].values[1, 1, 4] == Visibility.ABSENT
    assert (truth["visibility"].values == Visibility.VISIBLE).sum() == frames * people * 15 - 2
    report = evaluate(without, answers, OPTIONS)
    mean = report.value("MPJPE", "3d")
    assert mean is not None
    assert (mean.value, mean.samples) == (pytest.approx(5.0, abs=1e-4), frames * people * 15 - 2)
    assert (report.skeleton, report.to_dict()["skeleton"]) == ("itop", "itop")
    some = evaluate(without, answers, OPTIONS, joints=("head", "neck"))  # of ITOP's, although we have joints of these names
    assert repr(some.value("MPJPE", "3d", joints="head")) == repr(report.value("MPJPE", "3d", joints="head"))
    with pytest.raises(PredictionsError, match="itop: the dataset has no joints of the set itop") as caught:
        common_joints(dataset, [answers])
    assert caught.value.hint == "it has those of cabinpose"


def test_sets_of_joints_are_not_mixed(dataset: xr.Dataset, predictions: Predictions) -> None:
    assert "skeleton" not in evaluate(dataset, predictions, OPTIONS).to_dict()
    other = replace(predictions, skeleton="itop", joints=("head", "neck"), model="other")
    with pytest.raises(PredictionsError, match="noisy's are of cabinpose, other's are of itop"):
        common_skeleton(dataset, [predictions, other])
    for name in ("itop", "coco"):
        with pytest.raises(PredictionsError, match=f"other: the dataset has no joints of the set {name}"):
            evaluate(dataset, replace(other, skeleton=name), OPTIONS)
    with pytest.raises(PredictionsError, match="no joint torso"):
        common_skeleton(dataset, [replace(predictions, joints=("torso", *predictions.joints[1:]))])
    renamed = dataset.isel(joint=slice(2)).assign_coords(joint=["nose", "chin"])
    with pytest.raises(ConfigError, match="unknown set of joints 'unknown'"):
        common_skeleton(renamed, [replace(predictions, joints=("nose", "chin"))])


def test_whose_joints_they_are_is_noted(dataset: xr.Dataset, predictions: Predictions) -> None:
    ours = dataset.assign_attrs(generator="cabinpose.synth", joint_definition=ANATOMY)
    theirs = dataset.assign_attrs(generator="import ntu")
    assert common_skeleton(ours, [predictions]) == CABINPOSE.subset(common_joints(ours, [predictions]))
    assert common_skeleton(theirs, [predictions]) != common_skeleton(ours, [predictions])
    assert evaluate(ours, predictions, OPTIONS).notes == ()
    report = evaluate(theirs, predictions, OPTIONS)
    assert report.notes[0].startswith("the dataset's joints are those of Kinect's body tracking; the set cabinpose is ")
    assert repr(report.values) == repr(evaluate(ours, predictions, OPTIONS).values)


def test_joints_of_versions_before_are_told_as_the_models(dataset: xr.Dataset, predictions: Predictions) -> None:
    """A model whose joints lie as anatomy has them is held against an older dataset's truth told so, and the report says it."""
    before = dataset.assign_attrs(generator="cabinpose.synth")
    told = told_as(dataset["joints_3d"].values, JOINTS, RIG, CABINPOSE)
    answers = {name: getattr(predictions, name) for name in ("joints_2d", "score", "presence", "frame")}
    exact = Predictions(
        joints_3d=told[:, :, CABINPOSE.indices(predictions.joints)].astype(np.float32), persons=predictions.persons,
        joints=predictions.joints, model="exact", joint_definition=ANATOMY, **answers,
    )  # fmt: skip
    report = evaluate(before, exact, OPTIONS)
    assert any("they were told as those of the set cabinpose" in note for note in report.notes)
    assert report.value("median error", "3d").value == pytest.approx(0.0, abs=1e-4)
    silent = evaluate(before, replace(exact, joint_definition=""), OPTIONS)
    assert silent.value("median error", "3d").value > 0.001


def test_joints_of_plug_in_gait_are_told_as_the_models(dataset: xr.Dataset, predictions: Predictions) -> None:
    """A dataset that says so is told as ours for a model of ours, ours as it for predictions that say so; two are refused."""
    gait = dataset.assign_attrs(generator="cabinpose.align", joint_definition="plug_in_gait")
    anatomy = dataset.assign_attrs(generator="cabinpose.synth", joint_definition=ANATOMY)
    answers = {name: getattr(predictions, name) for name in ("joints_2d", "score", "presence", "frame", "persons", "joints")}
    for truth, of, to, says in ((gait, PLUG_IN_GAIT, CABINPOSE, ANATOMY), (anatomy, CABINPOSE, PLUG_IN_GAIT, "plug_in_gait")):
        told = told_as(dataset["joints_3d"].values, JOINTS, of, to)[:, :, CABINPOSE.indices(predictions.joints)]
        exact = Predictions(joints_3d=told.astype(np.float32), model="exact", joint_definition=says, **answers)
        report = evaluate(truth, exact, OPTIONS)
        assert report.value("median error", "3d").value == pytest.approx(0.0, abs=1e-4)
        assert any(of.definition in note and to.definition in note and "they were told as" in note for note in report.notes)
        assert evaluate(truth, replace(exact, joint_definition=""), OPTIONS).value("MPJPE", "3d").value > 0.1
    before = dataset.assign_attrs(generator="cabinpose.synth", joint_definition="")
    with pytest.raises(PredictionsError, match="no table leads there"):
        common_skeleton(before, [exact])
    with pytest.raises(PredictionsError, match="of different definitions: anatomy, plug_in_gait"):
        common_skeleton(anatomy, [exact, replace(exact, joint_definition=ANATOMY)])


def test_frames_left_out_count_as_missed(dataset: xr.Dataset, predictions: Predictions) -> None:
    some = Predictions(
        *(getattr(predictions, n)[:3] for n in ("joints_2d", "joints_3d", "score", "presence", "frame")),
        predictions.persons, predictions.joints, "some",
    )  # fmt: skip
    empty = evaluate(dataset, some, OPTIONS)
    assert "2 of 5 frames are not in the predictions" in empty.notes[0]
    three = evaluate(dataset.isel(frame=slice(0, 3)), some, OPTIONS)
    for space in ("2d", "3d"):
        all_five, first_three = empty.value("found", space), three.value("found", space)
        assert all_five is not None
        assert first_three is not None
        assert all_five.samples > first_three.samples
        assert all_five.value * all_five.samples == pytest.approx(first_three.value * first_three.samples)


def test_assigned_people_keep_their_errors(dataset: xr.Dataset, predictions: Predictions) -> None:
    """With the people of every frame in another order, the assignment finds them again."""
    truth = dataset.sel(joint=list(predictions.joints), person=list(predictions.persons))["joints_2d"].values
    near = (truth + np.random.default_rng(1).normal(0, 0.2, truth.shape)).astype(np.float32)  # OKS finds no one 4 px off here
    certain = replace(predictions, presence=np.ones_like(predictions.presence), joints_2d=near)
    rng = np.random.default_rng(0)
    order = np.array([rng.permutation(5) for _ in range(5)])
    rows = np.arange(5)[:, None]
    mixed = replace(
        certain, persons=tuple("abcde"), **{n: getattr(certain, n)[rows, order] for n in ("joints_2d", "joints_3d", "score")}
    )
    wanted = evaluate(dataset, certain, OPTIONS)
    for match in ("oks", "distance"):
        found = evaluate(dataset, mixed, replace(OPTIONS, match=match))
        for a, b in zip(wanted.values, found.values, strict=True):
            assert (a.metric, a.samples) == (b.metric, b.samples)
            assert a.value == pytest.approx(b.value, nan_ok=True)
    with pytest.raises(PredictionsError, match="no slot a, b, c, d, e"):
        evaluate(dataset, mixed, OPTIONS)


def test_what_does_not_fit(dataset: xr.Dataset, predictions: Predictions) -> None:
    check_predictions(predictions, dataset, ("ds", "sha256:1"))
    check_predictions(replace(predictions, dataset="ds"), dataset, ("ds", "sha256:1"))
    with pytest.raises(PredictionsError, match="of the dataset 'other'"):
        check_predictions(replace(predictions, dataset="other"), dataset, ("ds", "sha256:1"))
    with pytest.raises(PredictionsError, match="no frame 7") as caught:
        check_predictions(replace(predictions, frame=np.array([0, 1, 2, 3, 7])), dataset)
    assert "from 0 to 4" in str(caught.value.hint)
    with pytest.raises(PredictionsError, match="no joint nose"):
        common_joints(dataset, [replace(predictions, joints=("nose", *predictions.joints[1:]))])
    assert common_joints(dataset, [predictions]) == tuple(n for n in dataset["joint"].values if n in CABINPOSE.sets["upper body"])
    with pytest.raises(PredictionsError, match="no joint in common"):
        common_joints(dataset, [replace(predictions, joints=("head",)), replace(predictions, joints=("neck",))])
    with pytest.raises(PredictionsError, match="no frames"):
        evaluate(dataset.isel(frame=slice(0, 0)), predictions, OPTIONS)


def perfect(dataset: xr.Dataset) -> Predictions:
    two, three = dataset["joints_2d"].values, dataset["joints_3d"].values
    score = np.isfinite(two).all(axis=-1).astype(np.float32)
    persons, joints = (tuple(map(str, dataset[name].values)) for name in ("person", "joint"))
    return Predictions(two, three, score, score, dataset["frame"].values, persons, joints, "perfect")


def test_frames_without_a_head_are_neither_missed_nor_the_worst(dataset: xr.Dataset) -> None:
    """Of heads of people's own size: the curve ends where the table does, at all of the joints that it is over."""
    truth, model = dataset.copy(), perfect(dataset)
    unknown = (truth["joint"] == "head") & (truth["frame"] < 2)
    truth["visibility"] = truth["visibility"].where(~unknown, 0)
    for name in ("joints_2d", "joints_3d"):
        truth[name] = truth[name].where(~unknown)
    report = evaluate(truth, model, EvaluationOptions(head="true", resamples=0))
    value = report.value("PCKh", "2d")
    assert value is not None
    assert value.value == 100.0
    assert report.curves["2d"]["pckh"]["lines"]["All"][-1] == 100.0
    assert report.worst == ()


def test_people_of_other_names_are_matched_or_told(dataset: xr.Dataset) -> None:
    """A method that knows no slots, with names of its own and all places asked for, as the command does."""
    model = perfect(dataset)
    places, model = model.persons, replace(model, persons=tuple(f"p{n}" for n in range(len(model.persons))))
    for match in ("oks", "distance"):
        report = evaluate(dataset, model, EvaluationOptions(match=match, resamples=0), persons=places)
        value = report.value("PCKh", "2d")
        assert value is not None
        assert value.value == 100.0
    with pytest.raises(PredictionsError, match="the dataset has no slot p0") as caught:
        evaluate(dataset, model, EvaluationOptions(resamples=0), persons=places)
    assert "--match oks" in caught.value.hint


def test_a_seat_where_a_model_does_not_look_has_nothing_found(dataset: xr.Dataset) -> None:
    at = (model := perfect(dataset)).persons.index("driver")
    arrays = {name: getattr(model, name)[:, [at]] for name in POSE_ARRAYS}
    driver = replace(model, persons=("driver",), **arrays)
    report = evaluate(dataset, driver, EvaluationOptions(resamples=0), persons=["front_passenger"])
    value = report.value("PCKh", "2d")
    assert value is not None
    assert value.value == 0.0


@pytest.mark.parametrize(("match", "lacks", "other"), [("oks", "joints_2d", "distance"), ("distance", "joints_3d", "oks")])
def test_people_are_not_matched_by_what_nobody_answered(dataset: xr.Dataset, match: Any, lacks: str, other: str) -> None:
    model = perfect(dataset)
    flat = replace(model, **{lacks: np.full_like(getattr(model, lacks), np.nan)})
    with pytest.raises(ConfigError, match="to match people by") as caught:
        evaluate(dataset, flat, EvaluationOptions(match=match, resamples=0))
    assert other in caught.value.hint
