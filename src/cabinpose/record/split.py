"""A take in several files: the recorder goes on in a new one after so long, or so many bytes."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from cabinpose.core import RecordingError
from cabinpose.signals import HostClock, Sample
from cabinpose.store.recording import RecordingWriter, SourceStatus, part_path, parts_beside

_UNITS = {"s": (1.0, 0.0), "min": (60.0, 0.0), "h": (3600.0, 0.0), "MB": (0.0, 1e6), "GB": (0.0, 1e9)}  # to s, to bytes
_LEAST_S, _LEAST_BYTES = 1.0, 1e6


class Limit(NamedTuple):
    """What a file holds at most, about: seconds, bytes; 0 = any."""

    seconds: float = 0.0
    bytes: float = 0.0

    @classmethod
    def of(cls, text: str) -> Limit:
        """Of a text such as 10min or 2GB. Raises ValueError for any other, and for less than a second or a megabyte."""
        match = re.fullmatch(r"(\d+(?:\.\d+)?) ?(s|min|h|MB|GB)", text.strip())
        if match is None:
            raise ValueError("a number with s, min, h, MB or GB, such as 10min or 2GB")
        limit = cls(*(float(match[1]) * factor for factor in _UNITS[match[2]]))
        if limit.seconds < _LEAST_S and limit.bytes < _LEAST_BYTES:
            raise ValueError("at least 1s or 1MB")
        return limit


class SplitWriter:
    """Writes a take into one file, or with a limit into several; each is a recording of its own.

    make: makes the writer of a file, given its path and its number (None: the only one). One thread writes; any may read counts.
    """

    def __init__(
        self, path: Path, make: Callable[[Path, int | None], RecordingWriter], clock: HostClock, limit: Limit | None = None
    ) -> None:
        """Raises RecordingError where a file of the take exists or cannot be made."""
        self.path, self._make, self._clock, self._limit = path, make, clock, limit
        if limit is not None and (there := parts_beside(path)):
            raise RecordingError(f"{min(there.values())} exists", hint="name another file: recordings are never overwritten")
        self._writers = [make(path, None if limit is None else 0)]
        self._began_s = clock.now_s()
        self._ending: list[threading.Thread] = []
        self._errors: list[RecordingError] = []

    @property
    def files(self) -> tuple[Path, ...]:
        """The files so far."""
        return tuple(writer.path for writer in self._writers)

    @property
    def bytes_written(self) -> int:
        """Bytes that the kernel has, of all files."""
        return sum(writer.bytes_written for writer in self._writers)

    def samples(self, source: str) -> int:
        """Samples of a source in all files; see `RecordingWriter.samples`."""
        return sum(writer.samples(source) for writer in self._writers)

    @property
    def full(self) -> bool:
        """Whether it is time for the next file."""
        if self._limit is None:
            return False
        seconds, size = self._limit
        return bool(size and self._now.bytes_written >= size) or bool(seconds and self._clock.now_s() - self._began_s >= seconds)

    def go_on(self) -> None:
        """Write into a new file from now on. Raises RecordingError where it cannot be made.

        The old file gets its end on a thread of its own, since the disk may take long to hold all of it.
        """
        before = self._now
        self._writers.append(self._make(part_path(self.path, len(self._writers)), len(self._writers)))
        self._began_s = self._clock.now_s()
        ending = threading.Thread(target=self._end, args=(before,), name="recording-end", daemon=True)
        self._ending.append(ending)
        ending.start()

    def write(self, source: str, sample: Sample) -> list[str]:
        """As `RecordingWriter.write`."""
        return self._now.write(source, sample)

    def write_status(self, status: SourceStatus, host_ns: int) -> None:
        """As `RecordingWriter.write_status`."""
        self._now.write_status(status, host_ns)

    def poll(self) -> None:
        """As `RecordingWriter.poll`."""
        self._now.poll()

    def close(self) -> None:
        """End all files; harmless if they are closed. Raises the first RecordingError of the disk."""
        self._end(self._now)
        for ending in self._ending:
            ending.join()
        if self._errors:
            raise self._errors[0]

    @property
    def _now(self) -> RecordingWriter:
        return self._writers[-1]

    def _end(self, writer: RecordingWriter) -> None:
        try:
            writer.close()
        except RecordingError as error:
            self._errors.append(error)
