"""A dataset against what a model says of it: a predictions file, or a detector that runs now."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any, NamedTuple, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core import (
    CABINPOSE,
    JOINT_DEFINITIONS,
    SKELETONS,
    UNKNOWN_SET,
    ConfigError,
    DatasetError,
    FrameBatch,
    PoseBatch,
    PredictionsError,
    Predictor,
    Segmenter,
    Skeleton,
    has_joint_map,
    images_of,
    joined,
    require_images,
    skeleton_of,
    told_as,
    unknown_name,
)
from cabinpose.evaluate.caveats import Caveats, Identity, remarks
from cabinpose.evaluate.mistakes import Positions, Trial, explanations
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import Report, make_report
from cabinpose.evaluate.samples import Samples, TruthChunk, collect, found_only
from cabinpose.store import (
    CHECKSUM_PREFIX,
    ClassImages,
    Predictions,
    dataset_skeleton,
    empty_batch,
    frame_images,
    frame_ranges,
    image_names,
    in_ranges,
    joint_dimension,
    joints_variable,
    labelled_joints,
    projected,
)

CHUNK = 512  # frames of joints at a time
BATCH = 16  # frames of images at a time, for a detector
_NAMED_FRAMES = 5  # in a note
TRIAL_FRAMES = 600  # on which mistakes are tried

Progress = Callable[[int], None]  # called with the number of frames done


def common_joints(dataset: xr.Dataset, models: Sequence[Predictions | Predictor]) -> tuple[str, ...]:
    """The joints of the dataset, in its order, that all models answer for; errors as of `common_skeleton`."""
    return common_skeleton(dataset, models).joints


def common_skeleton(dataset: xr.Dataset, models: Sequence[Predictions | Predictor]) -> Skeleton:
    """The joints of the dataset, in its order, that all models answer for, as a set: the standard's own or another.

    A joint that nobody in the dataset has is not labelled there, and is left out; where nobody has any, all are judged.

    Raises
    ------
    PredictionsError
        Where the models' joints are of different sets, which are not mixed, of a set that the dataset does not have, unknown to
        it, or have none in common, with each other or with what is labelled.
    """
    names = {skeleton_of(model).name: model_name(model) for model in models}
    if len(names) > 1:
        told = ", ".join(f"{who}'s are of {name}" for name, who in names.items())
        raise PredictionsError(f"the models' joints are of different sets: {told}", hint="evaluate them one by one")
    ((name, who),) = names.items()
    try:
        known = dataset_skeleton(dataset, CABINPOSE.name if name == UNKNOWN_SET else name)
    except DatasetError as error:
        raise PredictionsError(f"{who}: {error}", hint=error.hint) from error
    for model in models:
        if unknown := [joint for joint in model.joints if joint not in known.joints]:
            raise PredictionsError(
                f"{model_name(model)}: the dataset has no joint {', '.join(unknown)}",
                hint=f"its joints are {', '.join(known.joints)}",
            )
    if name not in SKELETONS:
        raise unknown_name("set of joints", name, list(SKELETONS))
    shared = [joint for joint in known.joints if all(joint in model.joints for model in models)]
    if not shared:
        raise PredictionsError("the models have no joint in common", hint="evaluate them one by one")
    if labelled := labelled_joints(dataset, name):
        shared = [joint for joint in shared if joint in labelled]
        if not shared:
            raise PredictionsError(
                f"nobody in the dataset has a joint that {who} finds", hint=f"its people have: {', '.join(labelled)}"
            )
    ours = SKELETONS[name].subset(shared)
    says = {stated for model in models if (stated := getattr(model, "joint_definition", "")) in JOINT_DEFINITIONS}
    if len(says) > 1:
        told = ", ".join(sorted(says))
        raise PredictionsError(f"the models' joints are of different definitions: {told}", hint="evaluate them one by one")
    meant = [ours.marked_by(JOINT_DEFINITIONS[stated].definition) for stated in says] if name == CABINPOSE.name else []
    for each in meant:
        if has_joint_map(known, each):
            return each
        if known.definition != each.definition and has_joint_map(known, CABINPOSE):
            raise PredictionsError(
                f"the models' joints are those of {each.definition}, the dataset's of {known.definition}: no table leads there",
                hint="tell the predictions as anatomy's first (`cabinpose.core.told_as`)",
            )
    return ours.marked_by(known.definition)


def truth_of(dataset: xr.Dataset, skeleton: Skeleton) -> xr.Dataset:
    """joints_2d, joints_3d and visibility of some joints of a set, with sequence and sync_ns.

    Those of a dataset whose joints follow another definition than the set are told as the set's where a table is known. Those of
    another set than the standard's are projected by each frame's camera; what hides them is not known, and those in the
    image count as visible.
    """
    times, joints = dataset[["sequence", "sync_ns"]], list(skeleton.joints)
    if skeleton.name == CABINPOSE.name:
        truth, placed = dataset[["joints_2d", "joints_3d", "visibility"]], dataset_skeleton(dataset)
        if has_joint_map(placed, skeleton) and placed.definition != skeleton.definition:
            places = {name: truth[name] for name in ("joints_2d", "joints_3d")}
            truth = truth.assign(
                {name: each.copy(data=told_as(each.values, placed.joints, placed, skeleton)) for name, each in places.items()}
            )
        return times.assign(truth.sel(joint=joints))
    points = dataset[joints_variable(skeleton.name)].sel({joint_dimension(skeleton.name): joints}).values
    uv, states = projected(dataset, points)
    dims = ("frame", "person", "joint")
    arrays = {"joints_2d": ((*dims, "uv"), uv), "joints_3d": ((*dims, "xyz"), points)}
    return times.assign(arrays | {"visibility": (dims, states)}).assign_coords(person=dataset["person"].values, joint=joints)


def model_name(model: Predictions | Predictor | Segmenter) -> str:
    """What reports call a model."""
    return model.model if isinstance(model, Predictions) else model.name


def check_predictions(predictions: Predictions | ClassImages, dataset: xr.Dataset, names: Sequence[str] = ()) -> None:
    """Raise `PredictionsError` where predictions are of other frames, or name another dataset than this one or one of `names`.

    A folder's name that they state is held against nothing where `names` are not known.
    """
    known = dict.fromkeys([*names, *filter(None, [dataset.attrs.get("dataset_id")])])
    named = predictions.dataset
    if named is not None and known and named not in known and (names or named.startswith(CHECKSUM_PREFIX)):
        raise PredictionsError(
            f"{model_name(predictions)}: the predictions are of the dataset '{named}'",
            hint=f"this one is {' or '.join(known)}; give the right dataset, or write `dataset` as null",
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


def in_places(dataset: xr.Dataset, persons: Sequence[str]) -> xr.Dataset:
    """The dataset with some of its slots. Raises ConfigError for one that it has not."""
    for place in persons:
        if place not in dataset["person"].values:
            raise unknown_name("slot", place, [str(p) for p in dataset["person"].values])
    return dataset.sel(person=list(persons))


def evaluate(
    dataset: xr.Dataset, model: Predictions | Predictor, options: EvaluationOptions, *, joints: Sequence[str] | None = None,
    persons: Sequence[str] | None = None, name: str = "", progress: Progress | None = None,
) -> Report:  # fmt: skip
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
    samples, caveats = samples_of(dataset, model, options, joints=joints, persons=persons, progress=progress)
    return make_report(samples, options, model_name(model), name, caveats)


def samples_of(
    dataset: xr.Dataset, model: Predictions | Predictor, options: EvaluationOptions, *, joints: Sequence[str] | None = None,
    persons: Sequence[str] | None = None, progress: Progress | None = None,
) -> tuple[Samples, Caveats]:  # fmt: skip
    """The errors that `evaluate` reports on, of every person in every frame, and what is to be known before them."""
    skeleton = common_skeleton(dataset, [model])
    if joints is not None:
        skeleton = skeleton.subset(joints)
    labelled = labelled_joints(dataset, skeleton.name)
    lacking = [joint for joint in model.joints if labelled and joint not in labelled]
    predicted = model.persons
    if persons is not None:
        if set(predicted) & set(dataset["person"].values.tolist()):  # else these are no slots, and matched otherwise
            predicted = tuple(p for p in predicted if p in persons)
        dataset = in_places(dataset, persons)
    true = [str(p) for p in dataset["person"].values]
    kept: list[_Kept] = []
    told: list[PoseBatch] = []
    chunks = _keeping(
        _chunks(dataset, model, skeleton, predicted, progress or (lambda _: None)), kept, told, dataset.sizes["frame"]
    )
    samples = collect(chunks, skeleton, true, predicted, options)
    by, lacks, has = ("oks", samples.px, samples.m) if options.match == "oks" else ("distance", samples.m, samples.px)
    if options.match != "slot" and has.found.any() and not lacks.found.any():
        other, space = ("distance", "the image") if by == "oks" else ("oks", "space")
        raise ConfigError(f"{model_name(model)} has no joint in {space} to match people by", hint=f"use --match {other}")
    caveats = _caveats(dataset, model, samples, kept, predicted, options)
    words = joined(told)
    unjudged = [f"nobody in the dataset has {', '.join(lacking)}: not judged"] if lacking else []
    notes = dict.fromkeys((*words.remarks, *caveats.notes, *unjudged))
    return samples, replace(caveats, unseen=words.unseen, notes=tuple(notes))


class _Kept(NamedTuple):
    """Some frames of a chunk: their positions among all frames, truth and answers."""

    place: NDArray[np.int64]
    truth: TruthChunk
    batch: PoseBatch


def _keeping(
    chunks: Iterable[tuple[TruthChunk, PoseBatch]], kept: list[_Kept], told: list[PoseBatch], count: int
) -> Iterator[tuple[TruthChunk, PoseBatch]]:
    """The same chunks; about `TRIAL_FRAMES` of `count` frames, evenly spread, are kept, and of all what is told of them."""
    step, seen = -(-count // TRIAL_FRAMES), 0
    for truth, batch in chunks:
        rows = np.arange(-seen % step, len(truth.frame), step)
        some = TruthChunk._make(each[rows] for each in truth)
        kept.append(_Kept(seen + rows, some, batch.map(itemgetter(rows))))
        told.append(replace(empty_batch(len(truth.frame), 0, 0), reason=batch.reason, remarks=batch.remarks))
        seen += len(truth.frame)
        yield truth, batch


def _caveats(
    dataset: xr.Dataset, model: Predictions | Predictor, samples: Samples, kept: Sequence[_Kept], persons: Sequence[str],
    options: EvaluationOptions,
) -> Caveats:  # fmt: skip
    frames, skeleton = samples.frames, samples.skeleton
    trial = _trial(dataset, model, skeleton, kept, tuple(persons), options)
    notes = [*model.remarks] if isinstance(model, Predictions) else []
    notes += _elsewhere(samples)
    notes += remarks(joined([each.batch for each in kept]), trial.size, options.presence)
    absent = int((~np.isin(frames, model.frame)).sum()) if isinstance(model, Predictions) else 0
    if absent:
        notes.append(f"{absent} of {len(frames)} frames are not in the predictions: all their joints count as missed")
    placed = dataset_skeleton(dataset, skeleton.name).definition
    stated = SKELETONS[skeleton.name].definition
    if skeleton.definition not in (stated, placed):
        notes.append(f"the dataset's joints are {placed}; they were told as {skeleton.definition}")
    elif skeleton.definition != stated:
        notes.append(f"the dataset's joints are {placed}; the set {skeleton.name} is {stated}")
    elif placed != stated and placed:
        notes.append(f"the dataset's joints are {placed}; they were told as those of the set {skeleton.name}: {stated}")
    learnt = int(in_ranges(trained_ranges(model, dataset), frames).sum())
    return Caveats(
        len(frames), len(frames) - absent, identity_of(model, dataset), explanations(trial), tuple(notes), trained_on=learnt
    )


def _elsewhere(samples: Samples) -> list[str]:
    """What is said of people who were found in another's place, which an overlay without names does not show."""
    rows = np.flatnonzero(samples.elsewhere)
    if not rows.size:
        return []
    frames = list(dict.fromkeys(samples.frames[samples.at[rows]].tolist()))
    named = ", ".join(map(str, frames[:_NAMED_FRAMES])) + (
        f" and {len(frames) - _NAMED_FRAMES} more" * (len(frames) > _NAMED_FRAMES)
    )
    people = int(samples.counts.any(axis=1).sum())
    return [f"{rows.size} of {people} people were found, but in another's place (frames {named}): their joints count as wrong"]


def _trial(
    dataset: xr.Dataset, model: Predictions | Predictor, skeleton: Skeleton, kept: Sequence[_Kept], persons: tuple[str, ...],
    options: EvaluationOptions,
) -> Trial:  # fmt: skip
    place = np.concatenate([each.place for each in kept])
    by_slot = options.match == "slot"
    slots = [str(p) for p in dataset["person"].values]
    rows = [slots.index(name) for name in persons] if by_slot else list(range(len(slots)))

    def of_truth(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(each.truth, name) for each in kept])[:, rows]

    counts = (of_truth("visibility") >= options.min_visibility)[..., None]
    true = Positions(np.where(counts, of_truth("joints_2d"), np.nan), np.where(counts, of_truth("joints_3d"), np.nan))

    def found(answers: PoseBatch) -> Positions:
        answers = found_only(answers, options.presence)
        return Positions(answers.joints_2d.astype(np.float64), answers.joints_3d.astype(np.float64))

    def at(numbers: NDArray[np.int64]) -> Positions:
        assert isinstance(model, Predictions)
        return found(_columns(model.take(numbers), model, skeleton, persons))

    given, frame = found(joined([each.batch for each in kept])), np.concatenate([each.truth.frame for each in kept])
    return Trial(
        true, given, frame, place, persons, skeleton, (int(dataset.attrs["width"]), int(dataset.attrs["height"])),
        dataset["vehicle_from_camera"].isel(frame=place).values, at if isinstance(model, Predictions) else None, by_slot,
    )  # fmt: skip


def identity_of(model: Predictions | Predictor, dataset: xr.Dataset) -> Identity:
    """How it is known that answers are of a dataset, see `Caveats`; what contradicts it is refused by `check_predictions`."""
    if not isinstance(model, Predictions):
        return "run"
    if model.dataset is None:
        return "unchecked"
    return "id" if model.dataset == dataset.attrs.get("dataset_id") else "name"


def trained_ranges(model: Any, dataset: xr.Dataset) -> str:
    """Ranges of a dataset's frames that a model, or the one of predictions, is known to have been trained on; "" for none.

    A model says it by `trained_on`, see `core.Predictor`.
    """
    if isinstance(model, Predictions):
        return model.trained_on
    numbers = dataset["frame"].values
    ranges = getattr(model, "trained_on", {}).get(dataset.attrs.get("frames_id"), "")
    return frame_ranges(numbers[in_ranges(ranges, numbers)])


def _columns(batch: PoseBatch, model: Predictions | Predictor, skeleton: Skeleton, persons: Sequence[str]) -> PoseBatch:
    """A model's answers for some slots and joints, in their order."""
    rows, columns = [model.persons.index(name) for name in persons], [model.joints.index(name) for name in skeleton.joints]
    return batch.map(lambda values: values[:, rows][:, :, columns])


def _chunks(
    dataset: xr.Dataset, model: Predictions | Predictor, skeleton: Skeleton, persons: Sequence[str], progress: Progress
) -> Iterator[tuple[TruthChunk, PoseBatch]]:
    count = dataset.sizes["frame"]
    step = CHUNK if isinstance(model, Predictions) else BATCH
    truth = truth_of(dataset, skeleton)
    if not isinstance(model, Predictions):
        require_images([model], image_names(dataset), "the dataset")
    for start in range(0, count, step):
        part = truth.isel(frame=slice(start, start + step))
        frame, sequence, sync_ns = (part[name].values.astype(np.int64) for name in ("frame", "sequence", "sync_ns"))
        joints_2d, joints_3d, visibility = (part[name].values for name in ("joints_2d", "joints_3d", "visibility"))
        chunk = TruthChunk(frame, joints_2d, joints_3d, visibility, sequence, sync_ns)
        if isinstance(model, Predictions):
            batch = model.take(chunk.frame)
        else:
            batch = model.predict(frame_batch(dataset, slice(start, start + step), images_of(model)))
            _check_shapes(batch, model, len(chunk.frame))
        yield chunk, _columns(batch, model, skeleton, persons)
        progress(min(start + step, count))


def predict_dataset(
    dataset: xr.Dataset, model: Predictor, *, dataset_id: str | None = None, progress: Progress | None = None
) -> Predictions:
    """What a detector finds in every frame of a dataset or a selection of it, in order.

    Parameters
    ----------
    dataset
        The frames, with the images that the detector reads.
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
    require_images([model], image_names(dataset), "the dataset")
    count, batches = dataset.sizes["frame"], []
    for start in range(0, count, BATCH):
        batches.append(model.predict(frame_batch(dataset, slice(start, start + BATCH), images_of(model))))
        if progress is not None:
            progress(min(start + BATCH, count))
    found = joined(batches)
    return Predictions(
        **vars(found), frame=dataset["frame"].values.astype(np.int64), persons=model.persons, joints=model.joints,
        model=model.name, skeleton=skeleton_of(model).name, dataset=dataset_id, trained_on=trained_ranges(model, dataset),
        joint_definition=getattr(model, "joint_definition", ""),
    )  # fmt: skip


def frame_batch(dataset: xr.Dataset, frames: slice, images: Sequence[str] = ("depth",)) -> FrameBatch:
    """Some frames of a dataset as a detector gets them: depth and amplitude where there are any, and the images that it reads.

    Parameters
    ----------
    dataset
        A dataset or a selection of it.
    frames
        Which of its frames, by position.
    images
        What the detector asks for, see `cabinpose.core.images_of`.

    Raises
    ------
    DatasetError
        Where the dataset does not have one of these.
    """
    if "depth" in images and "depth" not in dataset:
        raise DatasetError("the dataset has no depth for a detector to see", hint="evaluate a predictions file instead")
    usual = [name for name in ("depth", "amplitude") if name in dataset]
    rest = ("camera_k", "camera_dist", "drive_side", "frame", "sync_ns")
    found = frame_images(dataset, frames, list(dict.fromkeys([*usual, *images])))
    return cast("FrameBatch", found | {name: dataset[name].isel(frame=frames).values for name in rest if name in dataset})


def _check_shapes(batch: PoseBatch, model: Predictor, frames: int) -> None:
    """Raises ValueError where a detector breaks its contract, which is a defect."""
    for name, last in (("joints_2d", (2,)), ("joints_3d", (3,)), ("score", ()), ("presence", ())):
        shape, expected = getattr(batch, name).shape, (frames, len(model.persons), len(model.joints), *last)
        if shape != expected:
            raise ValueError(f"{model.name}: {name} has the shape {shape}, not {expected}")
