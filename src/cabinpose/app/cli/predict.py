"""`cabinpose predict`: run a model over a dataset and write a predictions file."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from cabinpose.app.cli.arguments import Maybe, RunsModels, SelectsFrames, Smooths, several, tell_unsmoothed
from cabinpose.app.cli.frames import FramesArgument, ReadsFrames, as_dataset
from cabinpose.app.cli.output import print_json, printable, progress, tell_failed
from cabinpose.core import ConfigError, check_output

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from numpy.typing import NDArray

    from cabinpose.core import Segmenter


@dataclass(frozen=True, kw_only=True)
class Predict(RunsModels, Smooths, SelectsFrames, ReadsFrames):
    """Run a model over a dataset, or over frames that are none yet.

    It writes the joints that it finds as a predictions file, or body parts as label images.
    """

    dataset: FramesArgument
    model: str
    """Name of a packaged model, an ONNX or .npz file, or a model on a server (grpc://HOST:PORT/MODEL)."""
    images: Annotated[tuple[str, ...], several("IMAGE [IMAGE ...]")] = ()
    """Images that models on servers are given, by the names of the dataset's variables: depth, amplitude, confidence, noise,
    depth_styled, labels, rgb, nir, and cloud; default: those that they list."""
    out: Path
    """Predictions file to write: JSON lines (.jsonl) or Parquet (.parquet); label images of body parts: .zarr."""
    joints_from: Annotated[Maybe[str], arg(name="from", metavar="SOURCE")] = None
    """Where a lifting model gets its 2D joints: `truth` (the default: those of the dataset), a predictions file, or a model."""
    overwrite: bool = False
    """Replace the file."""


COMMAND = Predict


def run(command: Predict) -> None:
    """Run the model over the frames in their order and write the predictions."""
    from cabinpose.store import SUFFIX, check_new_class_images, check_new_predictions

    check = check_new_class_images if command.out.suffix == SUFFIX else check_new_predictions
    check_output(command.out, parents=False)
    check(command.out, overwrite=command.overwrite)  # before the work, not at its end
    if command.smoothers(1) and command.out.suffix == SUFFIX:
        raise ConfigError("body parts are not smoothed", hint="leave out --smooth, or let --out end in .jsonl or .parquet")
    with as_dataset(command.dataset, command) as folder:
        _run(command, folder)


def _run(command: Predict, folder: Path) -> None:
    """folder: of the dataset of the frames."""
    from cabinpose.app.cli.selection import selected
    from cabinpose.app.models import opened_models, tell_drive_side
    from cabinpose.core import Segmenter, unseen_words
    from cabinpose.estimate import smoothed
    from cabinpose.evaluate import model_name, predict_dataset
    from cabinpose.store import (
        SUFFIX,
        Predictions,
        dataset_id,
        open_dataset,
        read_manifest,
        write_predictions,
    )

    of_parts = command.out.suffix == SUFFIX
    dataset = selected(open_dataset(folder), command)
    name = dataset_id(read_manifest(folder))
    [model] = opened_models([command.model], dataset, command.joints_from, (name, folder.resolve().name), command.images)
    tell_drive_side([model], command.drive_side)
    count, told = dataset.sizes["frame"], dict[str, Any]()
    if isinstance(model, Segmenter):
        if not of_parts:
            raise ConfigError(f"{model.name} finds body parts, which are images", hint=f"let --out end in {SUFFIX}")
        _write_parts(command, dataset, model, name)
    elif of_parts:
        raise ConfigError(f"{model_name(model)} finds joints", hint="let --out end in .jsonl or .parquet")
    else:
        places = [str(place) for place in dataset["person"].values]
        if folder == command.dataset and not set(places) & set(model.persons):
            print(
                f"the model {model_name(model)} looks at {', '.join(model.persons)}, and the dataset has "
                f"{printable(', '.join(places))}: `evaluate` cannot score what it finds",
                file=sys.stderr,
            )
        if isinstance(model, Predictions):
            predictions = replace(model, dataset=name)
        else:
            with progress(count, "frames") as report:
                predictions = predict_dataset(dataset, model, dataset_id=name, progress=report)
            tell_failed(model)
        for smoother in command.smoothers(1):
            smooth = smoothed(predictions, dataset["sync_ns"].values, dataset["sequence"].values, smoother)
            predictions = replace(smooth, model=smoother.model_name(predictions.model))
            tell_unsmoothed([smoother])
        write_predictions(command.out, predictions, overwrite=command.overwrite)
        told = {"unseen": predictions.unseen, "remarks": predictions.remarks}
        for words in unseen_words(predictions.unseen, count):
            print(printable(words), file=sys.stderr)
    if command.as_json:
        print_json({"predictions": str(command.out), "model": model_name(model), "frames": count} | told)
    else:
        print(command.out)
        if folder == command.dataset:
            print(f"score it with: cabinpose evaluate {command.dataset} --predictions {command.out}", file=sys.stderr)


def _write_parts(command: Predict, dataset: xr.Dataset, model: Segmenter, name: str) -> None:
    """Run a segmentation and write its label images."""
    from cabinpose.core import images_of
    from cabinpose.evaluate import BATCH, frame_batch
    from cabinpose.store import write_class_images

    count = dataset.sizes["frame"]
    with progress(count, "frames") as report:

        def batches() -> Iterator[NDArray[np.uint8]]:
            for start in range(0, count, BATCH):
                yield model.segment(frame_batch(dataset, slice(start, start + BATCH), images_of(model)))
                report(min(start + BATCH, count))

        write_class_images(
            command.out, batches(), dataset["frame"].values, model.parts, model=model.name, dataset=name,
            overwrite=command.overwrite,
        )  # fmt: skip
