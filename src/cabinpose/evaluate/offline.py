"""A dataset against what a model says of it: a predictions file, or a detector that runs now."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import cast

import numpy as np
import xarray as xr

from cabinpose.core import (
    DatasetError,
    FrameBatch,
    PoseBatch,
    PredictionsError,
    Predictor,
    Segmenter,
    Visibility,
    joined,
    unknown_name,
)
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import Report, make_report
from cabinpose.evaluate.samples import Samples, TruthChunk, collect
from cabinpose.evaluate.skeletons import evaluated_skeleton
from cabinpose.store import ClassImages, Predictions, camera_of

_TORSO = "torso"  # only ITOP has it
CHUNK = 512  # frames of joints at a time
BATCH = 16  # frames of images at a time, for a detector

Progress = Callable[[int], None]  # called with the number of frames done


def common_joints(dataset: xr.Dataset, models: Sequence[Predictions | Predictor]) -> tuple[str, ...]:
    """The joints of the dataset, in its order, that all models answer for; `PredictionsError` for one unknown to it.

    Those of ITOP where the dataset has them (`itop_joints_3d`) and all models answer in them.
    """
    known = [str(name) for name in dataset["joint"].values]
    if "itop_joints_3d" in dataset and all(_TORSO in model.joints for model in models):
        known = [str(name) for name in dataset["itop_joint"].values]
    for model in models:
        if unknown := [name for name in model.joints if name not in known]:
            raise PredictionsError(
                f"{model_name(model)}: the dataset has no joint {', '.join(unknown)}", hint=f"its joints are {', '.join(known)}"
            )
    joints = tuple(name for name in known if all(name in model.joints for model in models))
    if not joints:
        raise PredictionsError("the models have no joint in common", hint="evaluate them one by one")
    return joints


def truth_of(dataset: xr.Dataset, joints: Sequence[str]) -> xr.Dataset:
    """joints_2d, joints_3d and visibility of some joints, with sequence and sync_ns; of ITOP's where the torso is among them.

    Those are projected by each frame's camera; what hides them is not known, and those in the image count as visible.
    """
    times = dataset[["sequence", "sync_ns"]]
    if _TORSO not in joints:
        return times.assign(dataset[["joints_2d", "joints_3d", "visibility"]].sel(joint=list(joints)))
    points = dataset["itop_joints_3d"].sel(itop_joint=list(joints)).values
    width, height = int(dataset.attrs["width"]), int(dataset.attrs["height"])
    cameras = [camera_of(dataset.isel(frame=i), width, height) for i in range(len(points))]
    uv = np.stack([camera.project(each) for camera, each in zip(cameras, points, strict=True)])
    inside = np.stack([camera.contains(each) for camera, each in zip(cameras, uv, strict=True)])
    known = np.isfinite(points).all(axis=-1)
    states = np.where(known, np.where(inside, Visibility.VISIBLE, Visibility.OUTSIDE_IMAGE), Visibility.ABSENT)
    dims = ("frame", "person", "joint")
    arrays = {"joints_2d": ((*dims, "uv"), uv.astype(np.float32)), "joints_3d": ((*dims, "xyz"), points)}
    return times.assign(arrays | {"visibility": (dims, states.astype(np.uint8))}).assign_coords(
        person=dataset["person"].values, joint=list(joints)
    )


def model_name(model: Predictions | Predictor | Segmenter) -> str:
    """What reports call a model."""
    return model.model if isinstance(model, Predictions) else model.name


def check_predictions(predictions: Predictions | ClassImages, dataset: xr.Dataset, names: Sequence[str] = ()) -> None:
    """Raise `PredictionsError` where predictions are of other frames, or name another dataset than one of `names`."""
    if predictions.dataset is not None and names and predictions.dataset not in names:
        raise PredictionsError(
            f"{model_name(predictions)}: the predictions are of the dataset '{predictions.dataset}'",
            hint=f"this one is {' or '.join(names)}; give the right dataset, or write `dataset` as null",
        )
    frames = dataset["frame"].values
    wrong = predictions.frame[~np.isin(predictions.frame, frames)]
    if wrong.size:
        raise PredictionsError(
            f"{model_name(predictions)}: the dataset has no frame {', '.join(map(str, wrong[:5].tolist()))}"
            + (f" and {wrong.size - 5} more" if wrong.size > 5 else ""),
            hint=f"its frames are numbered from {frames.min()} to {frames.max()} by the coordinate `frame`",
        )


def shared_places(dataset: xr.Dataset, models: Sequence[Predictions | Predictor]) -> tuple[str, ...]:
    """The dataset's slots that all models answer for; all of them where the models share none."""
    places = [str(name) for name in dataset["person"].values]
    return tuple(place for place in places if all(place in model.persons for model in models)) or tuple(places)


def evaluate(
    dataset: xr.Dataset,
    model: Predictions | Predictor,
    options: EvaluationOptions,
    *,
    joints: Sequence[str] | None = None,
    persons: Sequence[str] | None = None,
    name: str = "",
    progress: Progress | None = None,
) -> Report:
    """The report of one model on a dataset or a selection of it. Frames without an answer count as missed.

    Parameters
    ----------
    dataset
        An open dataset.
    model
        Predictions, or a detector that is run on the dataset's images in batches.
    options
        What counts, thresholds, intervals.
    joints
        Those that are evaluated; default: all that both have.
    persons
        The slots that are evaluated, true and predicted; default: all of them.
    name
        What the report calls the dataset.
    progress
        Called with the number of frames done.

    Returns
    -------
    Report
        Every number with unit, threshold, denominator, sample count and interval.
    """
    samples, notes = samples_of(dataset, model, options, joints=joints, persons=persons, progress=progress)
    return make_report(samples, options, model_name(model), name, notes)


def samples_of(
    dataset: xr.Dataset,
    model: Predictions | Predictor,
    options: EvaluationOptions,
    *,
    joints: Sequence[str] | None = None,
    persons: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> tuple[Samples, tuple[str, ...]]:
    """The errors that `evaluate` reports on, of every person in every frame, and what there is to note; arguments as there."""
    chosen = tuple(joints) if joints is not None else common_joints(dataset, [model])
    predicted = model.persons
    if persons is not None:
        for place in persons:
            if place not in dataset["person"].values:
                raise unknown_name("slot", place, [str(p) for p in dataset["person"].values])
        dataset, predicted = dataset.sel(person=list(persons)), tuple(p for p in model.persons if p in persons)
    true = [str(p) for p in dataset["person"].values]
    chunks = _chunks(dataset, model, chosen, predicted, progress or (lambda _: None))
    samples = collect(chunks, evaluated_skeleton(chosen), true, predicted, options)
    absent = int((~np.isin(samples.frames, model.frame)).sum()) if isinstance(model, Predictions) else 0
    if not absent:
        return samples, ()
    note = f"{absent} of {len(samples.frames)} frames are not in the predictions: all their joints count as missed"
    return samples, (note,)


def _chunks(
    dataset: xr.Dataset, model: Predictions | Predictor, joints: Sequence[str], persons: Sequence[str], progress: Progress
) -> Iterator[tuple[TruthChunk, PoseBatch]]:
    rows, columns = [model.persons.index(name) for name in persons], [model.joints.index(name) for name in joints]
    count = dataset.sizes["frame"]
    step = CHUNK if isinstance(model, Predictions) else BATCH
    truth = truth_of(dataset, joints)
    for start in range(0, count, step):
        part = truth.isel(frame=slice(start, start + step))
        frame, sequence, sync_ns = (part[name].values.astype(np.int64) for name in ("frame", "sequence", "sync_ns"))
        joints_2d, joints_3d, visibility = (part[name].values for name in ("joints_2d", "joints_3d", "visibility"))
        chunk = TruthChunk(frame, joints_2d, joints_3d, visibility, sequence, sync_ns)
        if isinstance(model, Predictions):
            batch = model.take(chunk.frame)
        else:
            batch = model.predict(frame_batch(dataset, slice(start, start + step)))
            _check_shapes(batch, model, len(chunk.frame))
        yield chunk, batch.map(lambda values: values[:, rows][:, :, columns])
        progress(min(start + step, count))


def predict_dataset(
    dataset: xr.Dataset, model: Predictor, *, dataset_id: str | None = None, progress: Progress | None = None
) -> Predictions:
    """What a detector finds in every frame of a dataset or a selection of it, in order.

    Parameters
    ----------
    dataset
        The frames, with depth.
    model
        The detector.
    dataset_id
        What the predictions name their dataset by, see `store.schema.dataset_id`.
    progress
        Called with the number of frames done.

    Returns
    -------
    Predictions
        By the numbers of the frames.
    """
    count, batches = dataset.sizes["frame"], []
    for start in range(0, count, BATCH):
        batches.append(model.predict(frame_batch(dataset, slice(start, start + BATCH))))
        if progress is not None:
            progress(min(start + BATCH, count))
    found = joined(batches)
    return Predictions(
        **vars(found), frame=dataset["frame"].values.astype(np.int64), persons=model.persons, joints=model.joints,
        model=model.name, skeleton=getattr(model, "skeleton", "cabinpose"), dataset=dataset_id,
    )  # fmt: skip


def frame_batch(dataset: xr.Dataset, frames: slice) -> FrameBatch:
    """Some frames of a dataset as a detector gets them; `DatasetError` where it has no depth."""
    if "depth" not in dataset:
        raise DatasetError("the dataset has no depth for a detector to see", hint="evaluate a predictions file instead")
    names = ("depth", "amplitude", "camera_k", "camera_dist", "frame", "sync_ns")
    return cast("FrameBatch", {name: dataset[name].isel(frame=frames).values for name in names if name in dataset})


def _check_shapes(batch: PoseBatch, model: Predictor, frames: int) -> None:
    """Raises ValueError where a detector breaks its contract, which is a defect."""
    for name, last in (("joints_2d", (2,)), ("joints_3d", (3,)), ("score", ()), ("presence", ())):
        shape, expected = getattr(batch, name).shape, (frames, len(model.persons), len(model.joints), *last)
        if shape != expected:
            raise ValueError(f"{model.name}: {name} has the shape {shape}, not {expected}")
