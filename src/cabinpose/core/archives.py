"""Arrays in .npz files of others, within bounds: what a file claims is held against its size before it is unpacked."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ALWAYS_BYTES = 256 << 20  # that any file may unpack to
_MOST_TIMES = 20  # its own size; images and models of numbers pack to a half or a fifth


def read_arrays(path: Path, names: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name, of which no pickle is opened.

    Parameters
    ----------
    path
        The file.
    names
        Those that are wanted, where they are there; None: all.

    Raises
    ------
    OSError
        Where the file cannot be opened.
    ValueError
        Where it is none, is damaged, holds Python objects, or would unpack to more than 256 MB and 20 times its size.
    """
    try:
        check_archive(path)
        with zipfile.ZipFile(path) as archive:
            found = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            return {name: _array(archive, info) for name, info in found.items() if names is None or name in names}
    except (zipfile.BadZipFile, zlib.error, EOFError, struct.error, NotImplementedError, RuntimeError, MemoryError) as error:
        raise ValueError(f"it is no whole .npz file: {str(error) or type(error).__name__}") from error


def check_archive(path: Path) -> None:
    """Raise ValueError where a ZIP file would unpack to more than 256 MB and 20 times its size, BadZipFile where it is none."""
    with zipfile.ZipFile(path) as archive:
        check_claim(path, sum(info.file_size for info in archive.infolist()))


def check_claim(path: Path, claimed: int) -> None:
    """Raise ValueError where a file that would take `claimed` bytes of memory has less than a 20th of them, beyond 256 MB."""
    size = path.stat().st_size
    if claimed > max(_ALWAYS_BYTES, _MOST_TIMES * size):
        raise ValueError(f"it would unpack to {claimed / 1e9:.1f} GB, from {size / 1e6:.1f} MB")


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    """An array whose shape fits the size of its entry."""
    with archive.open(info) as stream:
        version = np.lib.format.read_magic(stream)
        known = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in known:
            raise ValueError(f"{info.filename} is no array")
        try:
            shape, _, dtype = known[version](stream)
        except Exception as error:  # numpy takes the text for Python, and fails as Python does
            raise ValueError(f"{info.filename} is no array") from error
    if dtype.hasobject:
        raise ValueError(f"{info.filename} holds Python objects, which are not read")
    if math.prod(shape) * dtype.itemsize > info.file_size:
        raise ValueError(f"{info.filename} claims {shape} numbers in {info.file_size} bytes")
    with archive.open(info) as stream:
        array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    return array
