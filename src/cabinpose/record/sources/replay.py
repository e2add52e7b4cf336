"""A recording played as if its devices were there: at its own pace, faster, or as fast as it is read."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core.clock import HostClock
from cabinpose.core.errors import RecordingError, SourceEndedError, unknown_name
from cabinpose.core.ports import Counts, Sample
from cabinpose.store.recording import Recording

_MOST_AT_ONCE = 256
_REMEMBERED = 4096  # missing numbers that may still come late


class ReplaySettings(BaseModel):
    """Which recording, and how fast."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    path: Path = Field(description="the recording")
    source: str | None = Field(None, description="name of the source in the recording; may be left out where it has one")
    speed: float = Field(1.0, ge=0, le=1000, description="how much faster than recorded; 0 = as fast as it is read")
    host_time: bool = Field(False, description="keep the recorded host times; otherwise a sample arrives when it is played")


class ReplaySource:
    """A `FrameSource` that plays one source of a recording once.

    Numbers and device times are those that were recorded, so gaps are seen as they were then; `counts.lost` are the gaps.
    """

    Settings: ClassVar = ReplaySettings

    def __init__(self, name: str, settings: ReplaySettings, clock: HostClock) -> None:
        self._name, self._settings, self._clock = name, settings, clock
        self._counts = Counts()
        self._recording: Recording | None = None
        self._samples: Iterator[tuple[str, Sample]] = iter(())
        self._next: Sample | None = None
        self._began_ns = self._first_ns = 0
        self._last: int | None = None
        self._missing: set[int] = set()  # counted as lost, and may still come

    @property
    def name(self) -> str:
        """What the rig's configuration calls it."""
        return self._name

    @property
    def counts(self) -> Counts:
        """What became of the samples."""
        return self._counts

    def check(self) -> Sequence[str]:
        """What keeps the recording from being played."""
        try:
            with Recording(self._settings.path, damaged="skip") as recording:
                self._source_in(recording)
        except RecordingError as error:
            return [f"{error}; {error.hint}"]
        return []

    def open(self) -> None:
        """Open the recording; after an interruption it goes on where it was. Raises RecordingError where it cannot be read."""
        if self._recording is not None:
            return
        self._recording = recording = Recording(self._settings.path, damaged="skip")
        self._samples = recording.samples([self._source_in(recording)])
        self._next = next(self._samples, (None, None))[1]
        self._began_ns = self._clock.now_ns()
        self._first_ns = self._next.host_ns if self._next is not None else 0

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """The samples that are due; SourceEndedError after the last."""
        if self._next is None:
            raise SourceEndedError(f"{self._name} has played all of {self._settings.path.name}")
        wait = self._due_ns(self._next) - self._clock.now_ns()
        if wait > 0:
            time.sleep(min(wait / 1e9, timeout_s))
        played: list[Sample] = []
        now = self._clock.now_ns()
        while self._next is not None and len(played) < _MOST_AT_ONCE and self._due_ns(self._next) <= now:
            sample = self._next
            played.append(sample if self._settings.host_time else replace(sample, host_ns=now))
            self._count(sample)
            self._next = next(self._samples, (None, None))[1]
        return played

    def close(self) -> None:
        """Close the recording."""
        if self._recording is not None:
            self._recording.close()
            self._recording = None

    def _source_in(self, recording: Recording) -> str:
        name, there = self._settings.source, recording.sources
        if name is None and len(there) == 1:
            return there[0]
        if name not in there:
            if name is None:
                raise RecordingError(
                    f"{self._settings.path} has {len(there)} sources", hint=f"name one with `source`: {', '.join(there)}"
                )
            raise RecordingError(str(error := unknown_name("source of the recording", name, there)), hint=error.hint)
        return name

    def _due_ns(self, sample: Sample) -> int:
        if self._settings.speed == 0:
            return 0
        return self._began_ns + int((sample.host_ns - self._first_ns) / self._settings.speed)

    def _count(self, sample: Sample) -> None:
        self._counts.received += 1
        number, last = sample.sequence, self._last
        if number is None:
            return
        if last is None or number > last:
            if last is not None:
                self._counts.lost += number - last - 1
                self._missing |= set(range(max(last + 1, number - _REMEMBERED), number))
            self._last = number
        elif number in self._missing:
            self._missing.remove(number)
            self._counts.lost -= 1
            self._counts.reordered += 1
        else:
            self._counts.duplicate += 1
        if len(self._missing) > 2 * _REMEMBERED:
            self._missing = set(sorted(self._missing)[-_REMEMBERED:])
