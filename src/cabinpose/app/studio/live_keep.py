"""Frames of a live run as a dataset that can be labelled, with what detectors found in them as proposals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose import __version__
from cabinpose.app.studio.live_session import Shown
from cabinpose.core import OCCUPANT_SLOTS, ConfigError, joined, skeleton_of
from cabinpose.store import (
    DEPTH_SCALE_M,
    Manifest,
    Predictions,
    Source,
    blank_frame,
    dataset_id,
    import_source,
    read_manifest,
    write_predictions,
)

_TICKS = np.iinfo(np.uint16).max
MOST = 200  # frames kept at a time: each of 352x287 takes 0.6 MB of memory


def keep(kept: list[Shown], shown: Shown) -> None:
    """Add a frame to those that are kept, once. Raises ConfigError where there are too many, or of another camera."""
    if any(each.frame is shown.frame for each in kept):
        return
    if len(kept) == MOST:
        raise ConfigError(f"{MOST} frames are kept", hint="label them before more are kept")
    if kept and kept[0].frame.batch["depth"].shape != shown.frame.batch["depth"].shape:
        raise ConfigError("the frames that are kept have another size", hint="label them before those of another camera are kept")
    kept.append(shown)


def write_kept(kept: Sequence[Shown], root: Path) -> tuple[Path, list[Path]]:
    """Write frames as a dataset `kept-DATE-TIME` in a folder, and beside it the predictions of each detector.

    Parameters
    ----------
    kept
        One or more frames of one size.
    root
        The folder.

    Returns
    -------
    tuple of Path and list of Path
        The dataset, in which nobody has joints yet, and the predictions files.

    Raises
    ------
    DatasetError, PredictionsError
        Where one of them is there already, or the disk refuses them.
    """
    folder = root / f"kept-{datetime.now():%Y%m%d-%H%M%S}"  # noqa: DTZ005 - local
    _, height, width = kept[0].frame.batch["depth"].shape
    images = ["depth", *(["amplitude"] if all("amplitude" in shown.frame.batch for shown in kept) else [])]
    models = {model.name: model for shown in kept for model, _ in shown.found}
    slots = dict.fromkeys(slot for model in models.values() for slot in model.persons)
    manifest = Manifest(
        generator="cabinpose.studio", generator_version=__version__, seed=0, licence="private", frames=len(kept),
        width=width, height=height, variables=tuple(images), persons=tuple(slots) or OCCUPANT_SLOTS,
    )  # fmt: skip
    import_source(Source(root, manifest, lambda: _frames(kept, manifest)), folder)
    written = dataset_id(read_manifest(folder))
    files = []
    for number, model in enumerate(models.values(), 1):
        rows, answers = [], []
        for row, shown in enumerate(kept):
            answer = next((found for asked, found in shown.found if asked.name == model.name), None)
            if answer is not None and not answer.error:
                rows.append(row)
                answers.append(answer.poses)
        if answers:
            found = joined(answers)
            predictions = Predictions(
                **vars(found), frame=np.array(rows, np.int64), persons=tuple(model.persons), joints=tuple(model.joints),
                model=model.name, skeleton=skeleton_of(model).name, dataset=written,
                joint_definition=getattr(model, "joint_definition", ""),
            )  # fmt: skip
            files.append(write_predictions(root / f"{folder.name}.predictions-{number}.jsonl", predictions))
    return folder, files


def _frames(kept: Sequence[Shown], manifest: Manifest) -> Iterator[dict[str, Any]]:
    for shown in kept:
        batch, frame = shown.frame.batch, blank_frame(manifest)
        frame["depth"] = _whole(np.nan_to_num(batch["depth"][0].astype(np.float64)) / DEPTH_SCALE_M, beyond=0)
        if "amplitude" in manifest.variables:
            frame["amplitude"] = _whole(np.nan_to_num(batch["amplitude"][0]), beyond=_TICKS)
        frame["camera_k"], frame["camera_dist"] = batch["camera_k"][0], batch["camera_dist"][0]
        frame["sync_ns"] = shown.frame.host_ns
        yield frame


def _whole(values: NDArray[Any], *, beyond: int) -> NDArray[np.uint16]:
    """Values as the whole numbers of a dataset; beyond: what stands for those that are too large."""
    rounded = np.rint(values)
    return np.where(rounded > _TICKS, beyond, np.maximum(rounded, 0)).astype(np.uint16)
