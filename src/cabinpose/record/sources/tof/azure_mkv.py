"""A recording of an Azure Kinect (.mkv) played as a camera, at its own pace or as fast as it is read."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core.clock import HostClock
from cabinpose.core.errors import CabinposeError, RecordingError, SourceEndedError
from cabinpose.core.ports import Counts, Sample
from cabinpose.core.recorded import ToFFrame
from cabinpose.record.sources.tof.counting import FrameNumbers, FramePeriod
from cabinpose.store.convert.azure_mkv import AzureFile
from cabinpose.store.convert.rows import Row


class AzureMkvSettings(BaseModel):
    """A recording of an Azure Kinect."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    path: Path = Field(description="the .mkv file")
    speed: float = Field(1.0, ge=0, description="how much faster than recorded; 0 = as fast as it is read")


class AzureMkvSource:
    """A `FrameSource` that plays a recording once; frames that the camera dropped are counted from their time stamps."""

    Settings = AzureMkvSettings

    def __init__(self, name: str, settings: AzureMkvSettings, clock: HostClock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._counts = Counts()
        self._numbers = FrameNumbers(self._counts)
        self._period = FramePeriod()
        self._file: AzureFile | None = None
        self._rows: Iterator[Row] = iter(())
        self._next: Row | None = None
        self._began_ns = 0
        self._first_ns = 0

    @property
    def name(self) -> str:
        """What the rig's configuration calls it."""
        return self._name

    @property
    def counts(self) -> Counts:
        """What became of the frames and readings."""
        return self._counts

    def check(self) -> Sequence[str]:
        """What keeps the file from being played."""
        try:
            AzureFile(self._settings.path).close()
        except CabinposeError as error:
            return [error.in_one_line()]
        return []

    def open(self) -> None:
        """Open the file; its time begins now."""
        if self._file is not None:
            return
        self._file = AzureFile(self._settings.path)
        self._rows = self._file.rows()
        self._advance()
        self._began_ns = time.monotonic_ns()
        self._first_ns = self._next[0] if self._next is not None else 0

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """The next message, when its time has come."""
        if self._file is None:
            raise RecordingError(f"{self._name} is not open", hint="call open() first")
        if self._next is None:
            raise SourceEndedError(f"{self._settings.path} was played to its end")
        stamp_ns, device_ns, message = self._next
        if self._settings.speed > 0:
            due_ns = self._began_ns + round((stamp_ns - self._first_ns) / self._settings.speed)
            wait_s = (due_ns - time.monotonic_ns()) / 1e9
            if wait_s > timeout_s:
                time.sleep(timeout_s)
                return []
            time.sleep(max(wait_s, 0.0))
        sequence = None
        if isinstance(message, ToFFrame) and device_ns is not None:
            sequence = self._numbers.forward(self._period.lost_before(device_ns) or 0)
        self._counts.received += 1
        sample = Sample(sequence, self._clock.now_ns(), device_ns, b"", (message,))
        self._advance()
        return [sample]

    def _advance(self) -> None:
        """Go on to the next message; damage ends the file, and counts."""
        damaged = 0
        try:
            self._next = next(self._rows, None)
        except RecordingError:
            self._next, damaged = None, 1
        if self._file is not None:
            self._counts.malformed = self._file.malformed + damaged

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._rows = iter(())
            self._file.close()
            self._file = None
