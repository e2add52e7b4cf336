"""The protocol's system shared memory: a client's region for its frames, and the regions that a server reads.

Both ends use `pread` and `pwrite` in place of a mapping, so that a region that its owner cuts short is an error here and
not a SIGBUS.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.remote.tensors import TensorError

EXTENSION = "system_shared_memory"  # how a server's metadata says that it has them
_FOLDER = Path("/dev/shm")  # where shm_open(3) of Linux keeps what it opens
_KEY = re.compile(r"/?[A-Za-z0-9._-]{1,128}")
_OURS = "cabinpose-"
_MOST = 64  # regions of a server at a time


class FrameRegion:
    """A client's region: made, registered by name, then unlinked, so that nothing stays behind whatever ends the process.

    The client holds a lock on the file while it lives, by which a server knows that it is still there.
    """

    def __init__(self, byte_size: int) -> None:
        _remove_abandoned()
        self.name = f"{_OURS}{os.getpid()}-{secrets.token_hex(4)}"
        self.key, self.byte_size = f"/{self.name}", byte_size
        self._file = os.open(_FOLDER / self.name, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.truncate(self._file, byte_size)

    def write(self, arrays: Sequence[NDArray[np.generic]]) -> list[int]:
        """Put contiguous arrays one behind the other, and return where each begins."""
        offsets, at = [], 0
        for array in arrays:
            offsets.append(at)
            os.pwrite(self._file, array.data.cast("B"), at)
            at += array.nbytes
        return offsets

    def unlink(self) -> None:
        """Take the name away; whoever has opened the region keeps it."""
        (_FOLDER / self.name).unlink(missing_ok=True)

    def close(self) -> None:
        """Give the memory back."""
        self.unlink()
        os.close(self._file)


def _remove_abandoned() -> None:
    """Remove regions of clients that were killed between making theirs and unlinking it."""
    for path in _FOLDER.glob(f"{_OURS}*"):
        with suppress(OSError):  # another user's, or just gone
            file = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
            try:
                if _unlocked(file):
                    path.unlink()
            finally:
                os.close(file)


def _unlocked(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    fcntl.flock(file, fcntl.LOCK_UN)
    return True


class Registered(NamedTuple):
    """One region of a server: its key, the part of the file that is registered, and the open file."""

    key: str
    offset: int
    byte_size: int
    file: int


class ServerRegions:
    """The regions that clients have registered; used by several threads."""

    def __init__(self) -> None:
        self._regions: dict[str, Registered] = {}
        self._lock = Lock()

    def register(self, name: str, key: str, offset: int, byte_size: int) -> None:
        """Open a region of this user. Raises TensorError for one that is not there, too small, or not to be had."""
        self.sweep()
        with self._lock:
            if name in self._regions or not name or len(name) > 128:
                raise TensorError(f"the region {name[:128]!r} is registered already, or has no proper name")
            if len(self._regions) >= _MOST:
                raise TensorError(f"there are {_MOST} regions registered, and no more can be")
            if not _KEY.fullmatch(key) or key.strip("/").startswith("."):
                raise TensorError(f"{key[:128]!r} is no key of shared memory")
            try:
                file = os.open(_FOLDER / key.strip("/"), os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
            except OSError as error:
                raise TensorError(f"the shared memory {key} cannot be opened: {error.strerror}") from None
            status = os.fstat(file)
            ours = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()
            if not ours or byte_size <= 0 or offset + byte_size > status.st_size:
                os.close(file)
                raise TensorError(f"the shared memory {key} is of another user, or has no {byte_size} bytes at {offset}")
            self._regions[name] = Registered(key, offset, byte_size, file)

    def unregister(self, name: str) -> None:
        """Close a region, or all of them for an empty name; a name that is not registered is no error."""
        with self._lock:
            for each in [name] if name else list(self._regions):
                if region := self._regions.pop(each, None):
                    os.close(region.file)

    def status(self) -> dict[str, Registered]:
        """The regions by name."""
        self.sweep()
        with self._lock:
            return dict(self._regions)

    def sweep(self) -> None:
        """Close regions of cabinpose's clients that have ended without a word."""
        with self._lock:
            for name, region in list(self._regions.items()):
                if region.key.strip("/").startswith(_OURS) and _unlocked(region.file):
                    os.close(self._regions.pop(name).file)

    def read(self, name: str, offset: int, length: int) -> bytearray:
        """A copy of some bytes of a region, `length` being known to be reasonable. Raises TensorError beyond its end."""
        data = bytearray(length)
        with self._lock:
            region = self._within(name, offset, length)
            if os.preadv(region.file, [data], region.offset + offset) != length:
                raise TensorError(f"the shared memory {region.key} has been cut short")
        return data

    def write(self, name: str, offset: int, data: bytes) -> None:
        """Put bytes into a region. Raises TensorError beyond its end."""
        with self._lock:
            region = self._within(name, offset, len(data))
            if os.fstat(region.file).st_size < region.offset + offset + len(data):
                raise TensorError(f"the shared memory {region.key} has been cut short")
            os.pwrite(region.file, data, region.offset + offset)

    def _within(self, name: str, offset: int, length: int) -> Registered:
        region = self._regions.get(name)
        if region is None:
            raise TensorError(f"there is no shared memory region {name[:128]!r}")
        if offset < 0 or length < 0 or offset + length > region.byte_size:
            raise TensorError(f"{length} bytes at {offset} are beyond the region {name}")
        return region
