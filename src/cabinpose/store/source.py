"""Datasets of frames that come from elsewhere, another format or a recording: what there is, and writing it.

Unknown is said openly: NaN for joints, intrinsics and extrinsics, `ABSENT` for joints that a source does not have,
0 for times and seeds, "unknown" for the names of a frame. Nothing is made up to fill a gap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DatasetError, known_camera, output_errors, whole_folder
from cabinpose.store.dataset import create_dataset, write_manifest
from cabinpose.store.part import PartWriter
from cabinpose.store.schema import MANIFEST_NAME, Manifest
from cabinpose.store.variables import FIRST_OF_WORLD

UNKNOWN = "unknown"
Report = Callable[[int], None]  # called with the number of frames done


@dataclass(frozen=True)
class Source:
    """A dataset to be written: where it comes from, its manifest, and its frames in order, made one by one.

    A frame has a value for each of `manifest.stored`. Iterating raises `DatasetError` where the source is damaged. note: what the
    source has and the dataset will not, for the user to know · outcome: what was done to the frames, once they are made.
    """

    path: Path
    manifest: Manifest
    frames: Callable[[], Iterator[dict[str, Any]]]
    note: str = ""
    outcome: Callable[[], str] = str


def blank_frame(manifest: Manifest) -> dict[str, Any]:
    """A frame without images that knows nothing yet but its shapes: numbers NaN, joints absent, places empty, times 0."""
    frame: dict[str, Any] = {}
    for variable in manifest.stored:
        shape = manifest.frame_shape(variable)
        if variable.is_image:
            continue
        if variable.dtype == "str":
            frame[variable.name] = variable.missing(shape) if shape else UNKNOWN
        else:
            frame[variable.name] = variable.missing(shape)
    return frame


def visible_box(seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(4,) px, `box_2d` of the dataset standard: the least and greatest u, v of the pixels (H, W) that are seen; NaN of none."""
    if not seen.any():
        return np.full(4, np.nan, np.float32)
    across, down = np.flatnonzero(seen.any(axis=0)), np.flatnonzero(seen.any(axis=1))
    return np.array((across[0], down[0], across[-1], down[-1]), np.float32)


def visible_boxes(labels: NDArray[np.uint8] | None, instance: NDArray[np.uint8], persons: int) -> NDArray[np.float32]:
    """(P, 4) px, `box_2d` of everybody in images (H, W); things in the hand are no part of who holds them."""
    people = instance if labels is None else instance * (labels < FIRST_OF_WORLD)
    return np.stack([visible_box(people == 1 + row) for row in range(persons)])


def import_source(source: Source, out: Path | str, *, overwrite: bool = False, report: Report | None = None) -> Path:
    """Write a source as a dataset, one frame in memory at a time.

    Parameters
    ----------
    source
        What to write.
    out
        The folder of the dataset; it appears when the dataset is whole.
    overwrite
        Replace the dataset in `out`.
    report
        Called with the number of frames done.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    DatasetError
        Where `out` exists and is no dataset to overwrite or holds more than that, where a frame cannot be read, or where the disk
        is full; then nothing is left behind, and what was in `out` stays.
    """
    folder = Path(out)
    if source.path.resolve().is_relative_to(folder.resolve()):
        raise DatasetError(f"{folder} holds the source, {source.path}", hint="give another folder with --out")
    check_new_dataset(folder, overwrite=overwrite)
    with new_folder(folder, overwrite=overwrite) as temporary:
        fill_dataset(source, temporary, folder, report)
    return folder


def fill_dataset(source: Source, folder: Path, told: Path, report: Report | None) -> None:
    """Write the frames of a source into a new or empty folder, `told` in messages; see `import_source`."""
    manifest, frames, done = source.manifest, source.frames(), 0
    last: str | None = None  # two imports may have one configuration: each part names the one before it, the manifest the last
    with create_dataset(folder, manifest, told=told):
        for plan in manifest.parts:
            with PartWriter(folder, plan, manifest, after=last, told=told) as part:
                for _ in range(plan.frames):
                    frame = next(frames, None)
                    if frame is None:
                        raise DatasetError(f"{source.path} ended after {done} frames", hint="it changed while it was read")
                    k, dist = frame["camera_k"], frame["camera_dist"]
                    known_camera(k, dist, manifest.width, manifest.height, whose=f"{source.path}: camera_k", error=DatasetError)
                    if "instance" in frame and "box_2d" in frame and np.isnan(frame["box_2d"]).all():
                        frame["box_2d"] = visible_boxes(frame.get("labels"), frame["instance"], len(manifest.persons))
                    part.append(frame)
                    done += 1
                    if report is not None:
                        report(done)
            last = part.checksum
        assert last is not None
        write_manifest(folder, manifest.with_content(last), told)


def check_new_dataset(folder: Path, *, overwrite: bool) -> None:
    """Raise `DatasetError` unless a dataset may be written to `folder`: `overwrite` replaces a dataset and nothing else."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if not (folder / MANIFEST_NAME).exists():
        raise DatasetError(f"{folder} exists and is no dataset", hint="give a new or empty folder with --out")
    if not overwrite:
        raise DatasetError(f"{folder} already holds a dataset", hint="--overwrite replaces it, or give another folder with --out")
    refuse_others(folder)


def refuse_others(folder: Path) -> None:
    """Raise `DatasetError` where a folder that is about to be replaced holds what is no part of its dataset, such as labels."""
    own = (MANIFEST_NAME, "part-*.zarr", ".part-*.zarr.*")  # with the parts that a killed process left
    for name in sorted(each.name for each in folder.iterdir()):
        if not any(fnmatchcase(name, pattern) for pattern in own):
            raise DatasetError(
                f"{folder} holds {name}, which is no part of the dataset and would be lost", hint="move it away first"
            )


@contextmanager
def new_folder(folder: Path, *, overwrite: bool) -> Iterator[Path]:
    """The name of a folder to make, which takes the place of `folder` when the block ends without an error, else is removed."""
    with output_errors(folder, DatasetError):
        folder.parent.mkdir(parents=True, exist_ok=True)
    with whole_folder(folder, kind=DatasetError) as temporary:
        if folder.exists() and not overwrite and (not folder.is_dir() or any(folder.iterdir())):
            raise DatasetError(
                f"{folder} exists and is not empty", hint="--overwrite replaces it, or give another folder with --out"
            )
        yield temporary
