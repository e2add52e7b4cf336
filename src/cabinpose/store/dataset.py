"""Making a dataset folder, and resuming one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from cabinpose.core import DatasetError, lock, refuse_other_writer, write_whole
from cabinpose.store.part import temporary_parts
from cabinpose.store.part_facts import check_parts
from cabinpose.store.schema import MANIFEST_NAME, Manifest, PartPlan, PartPlans, manifest_yaml, read_manifest, with_checksum_line

_COMPRESSION = 0.7  # of the raw size; noisy depth at 352x287 measured 0.5
_FRAMES_A_DAY = 100 * 86_400  # at a hundred a second


class DatasetWriter:
    """A dataset folder that is being filled, locked for other writers until it is closed.

    new: there was no dataset in it before · made: there was no folder.
    """

    def __init__(self, folder: Path, manifest: Manifest, lock: int, *, new: bool, made: bool) -> None:
        self.folder = folder
        self.manifest = manifest
        self._lock: int | None = lock
        self._new, self._made = new, made

    def complete(self) -> list[PartPlan]:
        """The parts that stand under their final name, in order."""
        return self.manifest.parts_in(self.folder)

    def missing(self) -> PartPlans:
        """The parts still to be made, in order."""
        return self.manifest.parts.without([plan.index for plan in self.complete()])

    def close(self, *, failed: bool = False) -> None:
        """Remove unfinished parts of dead workers, and all of a run that failed before its first part; let other writers in."""
        if self._lock is not None:
            _remove_temporary(self.folder)
            if failed and self._new and not self.complete():
                (self.folder / MANIFEST_NAME).unlink(missing_ok=True)
                if self._made and not any(self.folder.iterdir()):
                    self.folder.rmdir()
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> DatasetWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close(failed=kind is not None)


def create_dataset(
    folder: Path | str, manifest: Manifest, *, overwrite: bool = False, resume: bool = False, told: Path | None = None
) -> DatasetWriter:
    """Make a dataset folder, or go on with one, ready for `PartWriter`s.

    Parameters
    ----------
    folder
        The folder of the dataset.
    manifest
        What it will hold.
    overwrite
        Delete the parts of the dataset that is there.
    resume
        Keep the complete parts of a dataset with the same manifest, which may ask for more frames.
    told
        The name in messages, where `folder` takes its place when the dataset is whole.

    Returns
    -------
    DatasetWriter
        Call `close` (or use `with`) at the end.

    Raises
    ------
    DatasetError
        Where the folder holds anything else, the manifests differ (the message names the keys), another process writes to it,
        or the disk is too small.
    """
    if overwrite and resume:
        raise DatasetError("a dataset is either resumed or overwritten", hint="give one of --resume and --overwrite")
    path = Path(folder)
    made = not path.exists()
    try:
        Path(os.path.realpath(path)).mkdir(parents=True, exist_ok=True)  # where a link leads to
        refuse_other_writer(path, DatasetError)
        held = lock(path, path, DatasetError)
    except OSError as error:
        name = told or path
        raise DatasetError(f"cannot use {name} as a folder: {error.strerror}", hint="give another output folder") from error
    try:
        manifest = _prepare(path, manifest, overwrite=overwrite, resume=resume)
        new = not (path / MANIFEST_NAME).exists()
        writer = DatasetWriter(path, manifest, held, new=new, made=made)
        check_parts(path, writer.complete(), manifest)
        _check_space(writer, told or path)
        write_manifest(path, manifest, told)
    except BaseException:
        os.close(held)
        if made and not any(path.iterdir()):
            path.rmdir()
        raise
    return writer


def _prepare(path: Path, manifest: Manifest, *, overwrite: bool, resume: bool) -> Manifest:
    """Make sure that what the folder holds may be gone on with, or remove it where the user said so; the manifest to write."""
    if not (path / MANIFEST_NAME).exists():
        _remove_temporary(path)
        if any(path.iterdir()):
            raise DatasetError(f"{path} is not empty and holds no dataset", hint="give a new or empty folder with --out")
        return manifest
    old = read_manifest(path)
    if resume:
        _check_same(path, old, manifest)
        if manifest.frames == old.frames:  # else predictions are of other frames
            manifest = manifest.model_copy(update={"upgraded_from": old.upgraded_from})
        last = old.parts[-1]
        if manifest.frames > old.frames and last.frames < old.frames_per_part and (path / last.name).exists():
            shutil.rmtree(path / last.name)  # it is made again, the same frames and more
    elif overwrite:
        for part in sorted(path.glob("part-*.zarr")):
            shutil.rmtree(part)
    else:
        raise DatasetError(
            f"{path} already holds a dataset of {old.frames} frames",
            hint="--resume goes on with it, --overwrite replaces it, or give another folder with --out",
        )
    _remove_temporary(path)
    return manifest


def _remove_temporary(path: Path) -> None:
    for part in temporary_parts(path):
        shutil.rmtree(part, ignore_errors=True)


def _check_same(path: Path, old: Manifest, new: Manifest) -> None:
    before, now = (_flat(m.model_dump(mode="json", exclude={"frames", "upgraded_from"})) for m in (old, new))
    if old.schema_version != new.schema_version:
        raise DatasetError(
            f"{path} is of version {old.schema_version} of the standard, what is made now of version {new.schema_version}",
            hint=f"first `cabinpose upgrade {path}`, which adds what can be known of its frames",
        )
    differing = [key for key in before | now if before.get(key, "(absent)") != now.get(key, "(absent)")]
    if differing:
        lines = [f"{key}: {before.get(key, '(absent)')!r} there, {now.get(key, '(absent)')!r} now" for key in differing[:5]]
        more = f" and {len(differing) - 5} more" if len(differing) > 5 else ""
        raise DatasetError(
            f"{path} holds a dataset made differently ({'; '.join(lines)}{more})",
            hint="resume with the same configuration, or give another folder with --out",
        )
    if new.frames < old.frames:
        raise DatasetError(
            f"{path} is a dataset of {old.frames} frames, which cannot shrink to {new.frames}",
            hint=f"resume with --frames {old.frames} or more",
        )


def _flat(value: Any, path: str = "") -> dict[str, Any]:
    if isinstance(value, Mapping) and value:
        return {k: v for key, item in value.items() for k, v in _flat(item, f"{path}.{key}" if path else str(key)).items()}
    return {path: value}


def _check_space(writer: DatasetWriter, told: Path) -> None:
    """Compare the frames still to come, at a cautious rate of compression, with what the disk has."""
    frames = writer.missing().frames
    need = frames * round(frame_bytes(writer.manifest) * _COMPRESSION)
    free = shutil.disk_usage(writer.folder).free
    if need > free:
        days = frames / _FRAMES_A_DAY
        long = "" if days < 1 else f" (and take {days:,.0f} days at 100 frames/s)"
        raise DatasetError(
            f"{frames} frames need about {need / 1e9:,.1f} GB{long}, {told} has {free / 1e9:,.1f} GB left",
            hint="free some disk space, ask for fewer frames or give a folder on another disk with --out",
        )


def frame_bytes(manifest: Manifest) -> int:
    """Bytes of one frame before compression."""
    total = 0
    for variable in manifest.stored:
        items = 1
        for size in manifest.frame_shape(variable):
            items *= size
        total += items * (16 if variable.dtype == "str" else np.dtype(variable.dtype).itemsize)
    return total


def write_manifest(path: Path, manifest: Manifest, told: Path | None = None) -> None:
    """Write `dataset.yaml` of a folder, or replace it; told: what messages call the folder, if that is another name."""
    text = with_checksum_line(manifest_yaml(manifest))
    write_whole(path / MANIFEST_NAME, text, kind=DatasetError, told=None if told is None else told / MANIFEST_NAME)
