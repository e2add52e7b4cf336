"""Writing one part of a dataset: a Zarr v3 group that appears under its final name only when it is whole.

The images of a frame are compressed as they arrive and appended to their shards, so memory does not grow with the
part. `store.zarr_metadata` writes what describes them, `store.shard` the chunks: four times as fast as through the Zarr
library's chunk-by-chunk pipeline. Same frames, same bytes: no time stamps, no threads, a fixed order of everything.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from cabinpose.core import FULL_DISK, DatasetError, output_errors
from cabinpose.store.schema import SCHEMA, Manifest, PartPlan
from cabinpose.store.shard import CRC_BYTES, ShardWriter, compressed, compressed_column, depth_ticks
from cabinpose.store.variables import Variable
from cabinpose.store.zarr_metadata import array_json, dimension_labels, group_json, zarr_arrays

_SUFFIX = ".tmp"
_serial = count()


def temporary_parts(folder: Path) -> list[Path]:
    """Unfinished parts that a killed process left in a dataset folder."""
    return sorted(folder.glob(f".part-*.zarr.*{_SUFFIX}"))


@contextmanager
def _part_errors(folder: Path, told: Path | None) -> Iterator[None]:
    """Turn what the system refuses into a `DatasetError`; after a full disk or a quota it says how to go on, if one can."""
    try:
        with output_errors(folder, DatasetError, told=told):
            yield
    except DatasetError as error:
        if told is None and isinstance(error.__cause__, OSError) and error.__cause__.errno in FULL_DISK:
            error.hint = "free some disk space, then run the same command again with --resume; complete parts are kept"
        raise


class EncodedFrame(NamedTuple):
    """A frame checked against the standard: its images compressed as they stand on disk, and its other values."""

    images: dict[str, bytes]
    values: dict[str, Any]


def encode_frame(frame: Mapping[str, Any], index: int, manifest: Manifest) -> EncodedFrame:
    """Check and compress frame `index`, as `PartWriter.append` takes it: the same bytes in whatever thread this is done.

    What is known of people and seats may be left out, and is missing then. Raises `DatasetError` for another missing variable, an
    unknown or an unfit one.
    """
    names = {v.name for v in manifest.stored}
    missing = sorted({v.name for v in manifest.stored if not v.may_be_left_out} - frame.keys())
    if missing or frame.keys() - names:
        unknown = sorted(frame.keys() - names)
        raise DatasetError(f"frame {index}: missing variables {missing}, unknown variables {unknown}")
    encoded = EncodedFrame({}, {})
    for variable in manifest.stored:
        shape = manifest.frame_shape(variable)
        value = _checked(variable, frame.get(variable.name, variable.missing(shape)), index, shape)
        if variable.is_image:
            encoded.images[variable.name] = compressed(value)
        else:
            encoded.values[variable.name] = value
    return encoded


def _checked(variable: Variable, value: Any, index: int, shape: tuple[int, ...]) -> Any:
    """The value as an array of the standard's shape and type; a `DatasetError` where it does not fit."""
    array = np.array(value, dtype=object) if variable.dtype == "str" else np.asarray(value)
    if array.shape != shape:
        raise DatasetError(f"frame {index}: {variable.name} has shape {array.shape}, the dataset's is {shape}")
    if variable.dtype == "str":
        if not all(isinstance(item, str) for item in array.flat):
            raise DatasetError(f"frame {index}: {variable.name} is text, not {value!r}")
        return array.tolist()
    if variable.scale is not None and array.dtype.kind == "f":
        return depth_ticks(array)
    dtype = np.dtype(variable.dtype)
    if array.dtype != dtype and (variable.is_image or array.dtype.kind != dtype.kind):
        raise DatasetError(f"frame {index}: {variable.name} is {array.dtype}, the standard says {dtype}")
    return np.ascontiguousarray(array, dtype).reshape(shape)


class PartWriter:
    """Writes one part, frame by frame; leaving the `with` block without an error makes it part of the dataset.

    An exception inside the block removes everything that was written. `attrs` may be filled with plain data about
    the part as a whole (`proposals`, `rejections`). after: the checksum of the part before it, where the manifest does not
    decide what the frames are; `checksum` is this part's, once it is whole. told: as of `create_dataset`.
    """

    def __init__(
        self, folder: Path | str, plan: PartPlan, manifest: Manifest, *, after: str | None = None, told: Path | None = None
    ) -> None:
        self.folder = Path(folder)
        self.plan = plan
        self.attrs: dict[str, Any] = {}
        self.checksum: str | None = None
        self._after = after
        self._told = told
        self._manifest = manifest
        self._temporary = self.folder / f".{plan.name}.{os.getpid()}-{next(_serial)}{_SUFFIX}"
        self._images = {
            v.name: ShardWriter(self._temporary / v.name / "c", len(v.dims) - 1) for v in manifest.stored if v.is_image
        }
        self._columns: dict[str, list[Any]] = {v.name: [] for v in manifest.stored if not v.is_image}
        self._crcs: dict[str, bytes] = dict.fromkeys(self._images, b"")  # of all chunks of an array, one after the other
        self._written: list[int] = []
        self._skipped: list[int] = []

    def __enter__(self) -> PartWriter:
        with _part_errors(self.folder, self._told):
            self._temporary.mkdir()
        return self

    def append(self, frame: Mapping[str, Any]) -> None:
        """Add the next frame: a value of shape `Manifest.frame_shape` for each variable in `Manifest.stored`.

        Depths are float metres (NaN, 0 or beyond 6.5535 m: invalid) or uint16 ticks of 0.1 mm, written as they are.
        Raises `DatasetError` for a missing, unknown or unfit variable, or one frame too many.
        """
        self._expect_another()
        self.append_encoded(encode_frame(frame, self._next, self._manifest))

    def append_encoded(self, frame: EncodedFrame) -> None:
        """Add the next frame as `encode_frame` gives it. Raises `DatasetError` for one frame too many."""
        self._expect_another()
        with _part_errors(self.folder, self._told):
            for name, chunk in frame.images.items():
                self._images[name].append(chunk)
                self._crcs[name] += chunk[-CRC_BYTES:]
        for name, value in frame.values.items():
            self._columns[name].append(value)
        self._written.append(self._next)

    def skip(self) -> None:
        """Leave the next frame out: its index belongs to a scene that cannot be. The part has fewer frames."""
        self._expect_another()
        self._skipped.append(self._next)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if kind is None:
                with _part_errors(self.folder, self._told):
                    self._commit()
        finally:
            for image in self._images.values():
                image.abandon()
            shutil.rmtree(self._temporary, ignore_errors=True)

    @property
    def missing(self) -> int:
        """How many frames the part still needs."""
        return self.plan.first + self.plan.frames - self._next

    @property
    def _next(self) -> int:
        return self.plan.first + len(self._written) + len(self._skipped)

    def _expect_another(self) -> None:
        if not self.missing:
            raise DatasetError(f"{self.plan.name} holds {self.plan.frames} frames, not more")

    def _commit(self) -> None:
        if self.missing:
            raise DatasetError(f"{self.plan.name} needs {self.plan.frames} frames, got {self._next - self.plan.first}")
        if not self._written:
            raise DatasetError(f"{self.plan.name} would be empty: every frame of it was skipped", hint="choose larger parts")
        for image in self._images.values():
            image.finish()
        columns: dict[str, Sequence[Any]] = self._columns | {"frame": self._written, **dimension_labels(self._manifest)}
        arrays = zarr_arrays(self._manifest, len(self._written))
        for array in arrays:
            if not array.is_image:
                path = self._temporary.joinpath(array.name, "c", *["0"] * len(array.shape))
                path.parent.mkdir(parents=True)
                column = compressed_column(columns[array.name], array.dtype)
                path.write_bytes(column)
                self._crcs[array.name] = column[-CRC_BYTES:]
        for array in arrays:
            (self._temporary / array.name / "zarr.json").write_text(array_json(array), encoding="utf-8")
        text = group_json(arrays, self._attributes())
        (self._temporary / "zarr.json").write_text(text, encoding="utf-8")
        self.checksum = json.loads(text)["attributes"]["checksum"]
        for path in sorted(self._temporary.rglob("*")):
            sync(path)
        sync(self._temporary)
        try:
            self._temporary.rename(self.folder / self.plan.name)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            return  # another worker was quicker, with the same bytes
        sync(self.folder)

    def _attributes(self) -> dict[str, Any]:
        files = sorted(path for path in self._temporary.rglob("*") if path.is_file())
        manifest = self._manifest
        return {
            "checksum": "",  # of the whole text, by `group_json`
            "schema": SCHEMA,
            "schema_version": manifest.schema_version,
            "generator": manifest.generator,
            "generator_version": manifest.generator_version,
            "seed": manifest.seed,
            "licence": manifest.licence,
            "dataset": manifest.parts_belong_to,
            **({} if self._after is None else {"after": self._after}),
            "part": self.plan.index,
            "first_frame": self.plan.first,
            "frames": len(self._written),
            "skipped": self._skipped,
            **self.attrs,
            "coordinates": " ".join(v.name for v in manifest.stored if v.coordinate),
            "chunk_crc32c": {name: crcs.hex() for name, crcs in sorted(self._crcs.items())},
            "file_sizes": {path.relative_to(self._temporary).as_posix(): path.stat().st_size for path in files},
        }


def sync(path: Path) -> None:
    """Wait until a file, or the entries of a folder, would survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
