"""The bytes of chunks and shards, as Zarr v3 lays them out.

A shard is its chunks, then an index of (offset, length) as little-endian uint64 per chunk, then the index' CRC-32C
(Zarr sharding codec, `index_location: end`). A chunk is blosc (lz4, bitshuffle) and a CRC-32C, so that a damaged
frame is noticed when it is read.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from cabinpose.store.variables import DEPTH_SCALE_M

FRAMES_PER_SHARD = 100
LEVEL = 5
CRC_BYTES = 4
_LONGEST_TEXT = 1 << 28  # bytes of all texts of a variable in a part
_ABSENT = 0xFFFF_FFFF_FFFF_FFFF  # index entry of a chunk that was never written
_INDEX_BYTES = FRAMES_PER_SHARD * 16 + CRC_BYTES


@cache
def _codecs() -> tuple[Any, Any]:
    """Blosc, and the codec of texts."""
    from numcodecs import blosc  # type: ignore[import-untyped]  # noqa: PLC0415 - 0.1 s, which `--help` does without
    from numcodecs.vlen import VLenUTF8  # type: ignore[import-untyped]  # noqa: PLC0415 - as above

    # Blosc's own threads would decide where blocks are cut, and with it the bytes.
    blosc.use_threads = False
    return blosc.Blosc("lz4", LEVEL, blosc.BITSHUFFLE), VLenUTF8()


def with_checksum(data: bytes) -> bytes:
    """`data` and its CRC-32C as little-endian uint32."""
    return data + int(google_crc32c.value(data)).to_bytes(4, "little")


def checked(data: bytes, stated: bytes = b"") -> bytes:
    """`data` without its checksum; ValueError where that is not right, or not the one that the part states for it, if it does."""
    if len(data) < CRC_BYTES or int(google_crc32c.value(data[:-CRC_BYTES])) != int.from_bytes(data[-CRC_BYTES:], "little"):
        raise ValueError("wrong checksum")
    if stated and data[-CRC_BYTES:] != stated:
        raise ValueError("whole, but not what the part was written with: a file of another part or dataset")
    return data[:-CRC_BYTES]


def compressed(data: NDArray[Any] | bytes) -> bytes:
    """One chunk as it stands on disk; arrays are shuffled by their own item size."""
    return with_checksum(_codecs()[0].encode(data))


def compressed_column(values: Sequence[Any], dtype: str) -> bytes:
    """All values of a variable that is no image, or of a coordinate, as its only chunk. dtype: a numpy name, or "str"."""
    if dtype == "str":
        return compressed(bytes(_codecs()[1].encode(np.array(values, dtype=object).ravel())))
    return compressed(np.ascontiguousarray(values, dtype))


def file_bytes(path: str) -> bytes:
    """What a small file holds, in a third of the time of `Path.read_bytes`."""
    file = os.open(path, os.O_RDONLY)
    try:
        data = b""
        while block := os.read(file, 1 << 20):
            data += block
        return data
    finally:
        os.close(file)


def read_whole(folder: str, shape: tuple[int, ...], dtype: str, stated: bytes = b"") -> NDArray[Any]:
    """The values that `compressed_column` wrote. `folder` is .../<variable>/c; stated: the chunk's checksum, if it is known.

    Raises OSError, ValueError or RuntimeError where the file is missing, damaged, of another shape or another part's.
    """
    packed = checked(file_bytes(f"{folder}{'/0' * len(shape)}"), stated)
    claimed = int.from_bytes(packed[4:8], "little")  # of blosc's head; memory is asked for by it
    if claimed > (_LONGEST_TEXT if dtype == "str" else np.dtype(dtype).itemsize * math.prod(shape)):
        raise ValueError(f"it claims {claimed} bytes")
    data = _codecs()[0].decode(packed)
    if dtype == "str" and int.from_bytes(data[:4], "little") != math.prod(shape):
        raise ValueError("another number of texts")
    values: NDArray[Any] = _codecs()[1].decode(data) if dtype == "str" else np.frombuffer(data, dtype)
    return values.reshape(shape)


def read_frames(
    folder: Path, frames: NDArray[np.int64], shape: tuple[int, ...], dtype: np.dtype[Any], stated: bytes = b""
) -> NDArray[Any]:
    """Frames (n,) of one image variable of a part, in the order asked: (n, *shape). `folder` is .../<variable>/c.

    stated: checksums of all chunks of the part one after the other, if they are known. Raises OSError or ValueError where a file
    is missing, damaged or another part's.
    """
    result = np.empty((len(frames), *shape), dtype)
    shards = frames // FRAMES_PER_SHARD
    for shard in np.unique(shards).tolist():
        with folder.joinpath(str(shard), *["0"] * len(shape)).open("rb") as file:
            file.seek(-_INDEX_BYTES, 2)
            index = np.frombuffer(checked(file.read()), "<u8").reshape(FRAMES_PER_SHARD, 2)
            for position in np.flatnonzero(shards == shard).tolist():
                offset, length = index[frames[position] % FRAMES_PER_SHARD].tolist()
                if offset == _ABSENT:
                    raise ValueError(f"frame {frames[position]} is not there")
                file.seek(offset)
                own = stated[CRC_BYTES * int(frames[position]) :][:CRC_BYTES]
                _codecs()[0].decode(checked(file.read(length), own), result[position])
    return result


def check_last_chunks(folder: str, dims: int, stated: bytes, *, image: bool) -> None:
    """Compare the checksum of the last chunk of each file of an array with what its part states; no chunk is read.

    folder: .../<variable>/c · dims: of the array · stated: as for `read_frames`; b"" compares nothing · image: whether it has
    shards. Raises OSError or ValueError where a file is missing, damaged at its end, or another part's.
    """
    of_file, from_end = (CRC_BYTES * FRAMES_PER_SHARD, CRC_BYTES + _INDEX_BYTES) if image else (len(stated), CRC_BYTES)
    for number, start in enumerate(range(0, len(stated), max(of_file, 1))):
        file = os.open(f"{folder}/{number}{'/0' * (dims - 1)}", os.O_RDONLY)  # a third of the time of `Path.open`
        try:
            os.lseek(file, -from_end, os.SEEK_END)
            found = os.read(file, CRC_BYTES)
        finally:
            os.close(file)
        if found != stated[start : start + of_file][-CRC_BYTES:]:
            raise ValueError(f"not what the part was written with, in file {number}: damaged, or of another part or dataset")


def depth_ticks(depth_m: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
    """Metres to ticks of 0.1 mm, rounded; 0 where not finite, not positive or beyond 6.5535 m."""
    ticks = depth_m * np.float32(1 / DEPTH_SCALE_M)
    ticks += np.float32(0.5)
    np.copyto(ticks, 0, where=~((ticks >= 1) & (ticks < 65536)))  # NaN is neither
    return ticks.astype(np.uint16)


def ticks_of_steps(steps: NDArray[Any], step_m: float) -> NDArray[np.uint16]:
    """Depths in steps of so many metres, 0 = invalid, as ticks of 0.1 mm; 0 what lies beyond them."""
    if step_m == DEPTH_SCALE_M and steps.dtype == np.uint16:
        return steps
    ticks = np.rint(steps * (step_m / DEPTH_SCALE_M))
    return np.where(ticks <= np.iinfo(np.uint16).max, ticks, 0).astype(np.uint16)


class ShardWriter:
    """Streams the frames of one image variable into its shards, one frame a chunk."""

    def __init__(self, folder: Path, frame_dims: int) -> None:
        self._folder = folder  # .../<variable>/c
        self._frame_dims = frame_dims
        self._file: BinaryIO | None = None
        self._index: list[tuple[int, int]] = []
        self._offset = 0
        self._shards = 0

    def append(self, chunk: bytes) -> None:
        """Add one frame as `compressed` gives it."""
        if self._file is None:
            path = self._folder.joinpath(str(self._shards), *["0"] * self._frame_dims)
            path.parent.mkdir(parents=True)
            self._file = path.open("wb")
        self._file.write(chunk)
        self._index.append((self._offset, len(chunk)))
        self._offset += len(chunk)
        if len(self._index) == FRAMES_PER_SHARD:
            self.finish()

    def finish(self) -> None:
        """Close the shard under way with its index; nothing to do where none is open."""
        if self._file is None:
            return
        index = np.full((FRAMES_PER_SHARD, 2), _ABSENT, "<u8")
        index[: len(self._index)] = self._index
        self._file.write(with_checksum(index.tobytes()))
        file, self._file = self._file, None
        self._index, self._offset = [], 0
        self._shards += 1
        file.close()

    def abandon(self) -> None:
        """Close the file of an unfinished shard, which is about to be deleted; a full disk no longer matters."""
        if self._file is not None:
            file, self._file = self._file, None
            try:
                file.close()
            except OSError:
                return
