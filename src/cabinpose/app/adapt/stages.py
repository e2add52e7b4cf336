"""The two stages of an adaptation: to look at the user's frames, and to learn from them and from generated ones."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.adapt.differences import answers_of, differences
from cabinpose.app.adapt.facts import facts_of
from cabinpose.app.adapt.page import FirstLook
from cabinpose.app.adapt.pseudo_labels import Course, Rules, choose, course_of
from cabinpose.app.adapt.scenes import NoiseSource, their_scenes, with_fitted_noise
from cabinpose.app.api import SAMPLE
from cabinpose.core import OCCUPANT_SLOTS, ConfigError, DatasetError
from cabinpose.estimate import JointPredictor
from cabinpose.evaluate import EvaluationOptions, Report, evaluate, predict_dataset, shared_places
from cabinpose.store import Predictions, open_dataset
from cabinpose.synth import SynthConfig

FEWEST: Final = 8  # frames that can be told apart into those that are learnt from and those that judge
JUDGES: Final = 0.25  # share of the frames, the last ones
_ROW = 30  # frames in a row that are looked at, where not all of them are
_SAME_M = 1e-3  # answers to one frame in two batches are nearer

Step = Callable[[int], None]  # called with the number of frames done


def some_rows(dataset: xr.Dataset, most: int) -> NDArray[np.int64]:
    """At most `most` frames of a dataset, by position: all of them, or rows of `_ROW`, evenly spread."""
    count = dataset.sizes["frame"]
    if count <= most:
        return np.arange(count)
    long = min(_ROW, most)
    first = np.linspace(0, count - long, most // long).astype(int)
    return np.unique((first[:, None] + np.arange(long)).ravel())


def learning(course: Course) -> int:
    """How many of the frames may be learnt from: the first ones, up to the border of a row nearest to `1 - JUDGES` of them."""
    count = len(course.group)
    wanted = round((1 - JUDGES) * count)
    borders = np.flatnonzero(np.diff(course.group)) + 1
    near = borders[np.abs(borders - wanted) <= JUDGES / 2 * count]
    return int(near[np.abs(near - wanted).argmin()]) if near.size else wanted


def looked_at(
    model: JointPredictor, dataset: xr.Dataset, name: str, rate_hz: float | None, reference: Path | None, step: Step
) -> FirstLook:
    """What is known of a model on the user's frames before anything is trained.

    Parameters
    ----------
    model, dataset, name
        The model, the frames, and what these are called.
    rate_hz
        Frames a second, where the frames have no times.
    reference
        Dataset like the frames of the model's training; None: the package's frames for models in cars.
    step
        Told how far it is.

    Raises
    ------
    ConfigError
        For too few frames, or where nobody is found in any of them.
    """
    count = dataset.sizes["frame"]
    if count < FEWEST:
        raise ConfigError(
            f"{count} frame{'s' * (count != 1)} are too few", hint=f"give {FEWEST} or more: a quarter of them judges"
        )
    course = course_of(dataset, rate_hz)
    theirs = facts_of(dataset, course.group)
    usual = reference or (SAMPLE if set(model.persons) <= set(OCCUPANT_SLOTS) else None)
    known = None if usual is None else facts_of(open_dataset(usual))
    with warnings.catch_warnings():  # the same is in the rows, or in the remarks
        warnings.simplefilter("ignore")
        found = predict_dataset(dataset, model, dataset_id=dataset.attrs.get("dataset_id"), progress=step)
    answers = answers_of(found, model)
    if answers.nobody == 1.0:
        why = next(iter(found.unseen), "") or next(iter(found.remarks), "")
        raise DatasetError(
            f"{model.name} finds nobody in any of the {count} frames" + (f": {why}" if why else ""),
            hint="look whether the depth is in metres and the image upright: `cabinpose view`; see --unit and --camera",
        )
    part = learning(course)
    rows = np.arange(part)
    first = replace_rows(found, rows)
    chosen = choose(first, course.part(rows), Rules())
    table = differences(model, theirs, known, answers)
    return FirstLook(model.name, name, dataset, table, theirs, known, answers, found, chosen)


def replace_rows(found: Predictions, rows: NDArray[np.int64]) -> Predictions:
    """The answers on some frames, by their positions."""
    some = found.map(lambda values: values[rows])
    return replace(found, **vars(some), frame=found.frame[rows])


def exchanged(model: JointPredictor, dataset: xr.Dataset, found: Predictions) -> NDArray[np.bool_]:
    """(F,) frames in which a model has exchanged who it found in the front row, as the wheel is on the right, or seems to be."""
    said, model.drive_side = model.drive_side, "left"
    try:
        by_place = predict_dataset(dataset, model)
    finally:
        model.drive_side = said
    same = np.isclose(by_place.joints_3d, found.joints_3d, atol=_SAME_M, equal_nan=True)
    return np.any(~same, axis=(1, 2, 3))


def kept_labels(look: FirstLook) -> Predictions:
    """The answers that stand for labels, as predictions: all others are not found."""
    rows = np.flatnonzero(look.chosen.frames)
    some, kept = replace_rows(look.found, rows), look.chosen.joints[rows][..., None]
    return replace(some, joints_2d=np.where(kept, some.joints_2d, np.nan), joints_3d=np.where(kept, some.joints_3d, np.nan))


def scenes_for(
    look: FirstLook, base: SynthConfig | None, measured: SynthConfig | None, seed: int
) -> tuple[SynthConfig, NoiseSource]:
    """Scenes as the user's camera would see them, and where their noise is from."""
    poses = look.dataset["vehicle_from_camera"].values if "vehicle_from_camera" in look.dataset else None
    known = look.reference or look.theirs
    config = their_scenes(look.theirs, known, look.found.persons, base=base, measured=measured, poses=poses)
    if measured is not None:
        return config, NoiseSource(1.0, "as calibrate-noise measured it")
    return with_fitted_noise(config, look.theirs, seed)


def by_labels(dataset: xr.Dataset, models: tuple[Predictions, Predictions]) -> tuple[Report, Report] | None:
    """What the labels of frames say of two models' answers; None where there are none."""
    if not dataset["visibility"].any() or not set(models[0].persons) & set(dataset["person"].values.tolist()):
        return None
    before, after = (evaluate(dataset, each, EvaluationOptions(), persons=shared_places(dataset, models)) for each in models)
    return before, after
