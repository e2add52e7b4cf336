"""What --model names, of any task: detectors, lifting with where its 2D joints come from, segmentations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from cabinpose.core import (
    ANATOMY,
    CABINPOSE,
    JOINT_DEFINITIONS,
    Camera,
    ConfigError,
    DriveSide,
    Predictor,
    Segmenter,
    Visibility,
    camera_from,
    has_joint_map,
    require_images,
    told_as,
)
from cabinpose.estimate import JointPredictor, LiftedPredictor, Lifter, lifted, open_model
from cabinpose.estimate.remote import SCHEME, open_predictor
from cabinpose.evaluate import check_predictions, model_name, trained_ranges
from cabinpose.store import Predictions, dataset_skeleton, image_names, read_predictions

TRUTH = "truth"
_FILES = (".jsonl", ".parquet")  # of predictions
Model = Predictions | Predictor | Segmenter


def opened_models(
    names: Sequence[str], dataset: xr.Dataset, joints_from: str | None = None, dataset_names: Sequence[str] = (),
    images: Sequence[str] = (),
) -> list[Model]:  # fmt: skip
    """The models that these names stand for; a lifting model becomes what it says of the dataset, or of another model's joints.

    Parameters
    ----------
    names
        Of packaged models, ONNX or .npz files, models on servers.
    dataset
        What they are for.
    joints_from
        Where lifting models get their 2D joints from: "truth" (the default: the dataset's joints in the image), a predictions
        file, or the name of another model.
    dataset_names
        What a predictions file may call the dataset.
    images
        Those that models on servers are given; default: the ones that they list.

    Raises
    ------
    ConfigError
        For a source of 2D joints without a lifting model, or one that shares no joint with it; for images without a server.
    DatasetError
        For a model that reads an image that the dataset does not have.
    """
    check_chosen(images, [*names, joints_from or TRUTH])
    models = [_opened(name, images) for name in names]
    require_images([model for model in models if not isinstance(model, Lifter)], image_names(dataset), "the dataset")
    if joints_from is not None and not any(isinstance(model, Lifter) for model in models):
        raise ConfigError("--from says where 2D joints to lift come from, and no model lifts", hint="leave out --from")
    source = joints_from or TRUTH
    if source != TRUTH and Path(source).suffix not in _FILES:
        base = open_predictor(source, images if source.startswith(SCHEME) else ())
        require_images([base], image_names(dataset), "the dataset")
        return [LiftedPredictor(base, m) if isinstance(m, Lifter) else m for m in models]
    return [_fed(m, dataset, source, dataset_names) if isinstance(m, Lifter) else m for m in models]


def check_chosen(images: Sequence[str], models: Sequence[str]) -> None:
    """Raise ConfigError where images are chosen and none of the models is on a server."""
    if images and not any(name.startswith(SCHEME) for name in models):
        raise ConfigError(
            f"--images {' '.join(images)} is for models on servers: ours read what they were trained on",
            hint="leave out --images, or name a model as grpc://HOST:PORT/MODEL",
        )


def open_detectors(names: Sequence[str], images: Sequence[str] = ()) -> list[Predictor]:
    """The detectors of these names, each called differently, as `told_apart` has it; images: those that servers' are given."""
    check_chosen(images, names)
    models = [open_predictor(name, images if name.startswith(SCHEME) else ()) for name in names]
    for model, name in zip(models, told_apart([model.name for model in models], names), strict=True):
        model.name = name
    return [*models]


def told_apart(names: Sequence[str], words: Sequence[str]) -> list[str]:
    """What models are called: their names, and behind those that several share the words by which each was given."""
    return [f"{name} ({word})" if list(names).count(name) > 1 else name for name, word in zip(names, words, strict=True)]


def seat_predictors(models: Sequence[Model]) -> list[JointPredictor]:
    """Those of the models that tell seats by place, and so by where the wheel is."""
    bases = [model.base if isinstance(model, LiftedPredictor) else model for model in models]
    return [base for base in bases if isinstance(base, JointPredictor) and base.seats_by_place]


def tell_drive_side(models: Sequence[Model], side: DriveSide | None) -> None:
    """Tell the models that tell seats by place where the wheel is; None: they go by what the frames or their files say.

    Raises ConfigError where none of them does.
    """
    if side is None:
        return
    placed = seat_predictors(models)
    if not placed:
        raise ConfigError(
            f"--drive-side says nothing to {', '.join(map(model_name, models))}",
            hint="leave it out: they do not tell driver and passenger apart; a server is told by `serve --drive-side`",
        )
    for base in placed:
        base.drive_side = side


def _opened(name: str, images: Sequence[str]) -> Predictor | Segmenter | Lifter:
    return open_predictor(name, images) if name.startswith(SCHEME) else open_model(name)


def _fed(lifting: Lifter, dataset: xr.Dataset, source: str, dataset_names: Sequence[str]) -> Predictions:
    """What a lifting model says of 2D joints of the dataset or of a file."""
    if source == TRUTH:
        base = _truth_2d(dataset)
    else:
        base = read_predictions(source)
        check_predictions(base, dataset, dataset_names)
    placed = JOINT_DEFINITIONS.get(base.joint_definition) or dataset_skeleton(dataset)
    if base.skeleton == CABINPOSE.name and has_joint_map(placed, CABINPOSE):
        base = replace(base, joints_2d=told_as(base.joints_2d, base.joints, placed, CABINPOSE), joint_definition=ANATOMY)
    numbers = dataset["frame"].values.astype(np.int64)
    found = lifted(base.take(numbers), base.joints, _cameras(dataset), lifting, base.model)
    if source == TRUTH:  # true positions in the image are no answer
        known = [i for i, name in enumerate(base.joints) if name in lifting.joints]
        found = replace(found.map(lambda a: a[:, :, known]), joints_2d=np.full_like(found.joints_2d[:, :, known], np.nan))
        base = replace(base, joints=tuple(base.joints[i] for i in known))
    return Predictions(
        **vars(found), frame=numbers, persons=base.persons,
        joints=base.joints, model=f"{base.model}+{lifting.name}", skeleton=base.skeleton, dataset=base.dataset,
        trained_on=f"{base.trained_on} {trained_ranges(lifting, dataset)}".strip(), joint_definition=base.joint_definition,
    )  # fmt: skip


def _truth_2d(dataset: xr.Dataset) -> Predictions:
    """The dataset's own joints in the image, as if they had been found."""
    presence = (dataset["visibility"].values > Visibility.OUTSIDE_IMAGE).astype(np.float32)
    joints_2d = np.where(presence[..., None] > 0, dataset["joints_2d"].values, np.nan).astype(np.float32)
    none = np.full((*presence.shape, 3), np.nan, np.float32)
    persons, joints = (tuple(str(name) for name in dataset[axis].values) for axis in ("person", "joint"))
    frame = dataset["frame"].values.astype(np.int64)
    return Predictions(joints_2d, none, presence, presence, frame, persons, joints, TRUTH)


def _cameras(dataset: xr.Dataset) -> list[Camera]:
    """The camera of each frame."""
    k, dist = (dataset[name].values for name in ("camera_k", "camera_dist"))
    width, height = (int(dataset.attrs[side]) for side in ("width", "height"))
    return [camera_from(a, b, width, height) for a, b in zip(k, dist, strict=True)]
