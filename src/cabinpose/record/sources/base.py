"""What the sources share: the life of a device, reaching it again, and files that are played."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import CabinposeError, DependencyError, RecordingError, Registry, SourceEndedError
from cabinpose.signals import Counts, HostClock, Sample

SettingsT = TypeVar("SettingsT", bound=BaseModel)
_K = TypeVar("_K")


def apart(codes: dict[_K, str]) -> dict[_K, str]:
    """Codes of subjects by what a device calls them. Raises ValueError where two have one: all would be one person's."""
    if twice := [code for code in codes.values() if list(codes.values()).count(code) > 1]:
        raise ValueError(f"two are called {twice[0]}: give each a code of their own")
    return codes


class DeviceSource(ABC, Generic[SettingsT]):
    """A `signals.FrameSource`: opened, read again and again, closed. A subclass connects, reads and disconnects.

    Settings: what a rig may say of it · is_camera: whether it gives a `ToFFrame` at a time, which `live` can show · plays: the
    suffix of the files that it plays, ".mkv", whose path is its setting `path` · leads_take: whether the take begins and
    ends with it, as with a motor.
    """

    Settings: ClassVar[type[BaseModel]]
    is_camera: ClassVar[bool] = False
    plays: ClassVar[str] = ""
    leads_take: ClassVar[bool] = False

    @classmethod
    def __subclasshook__(cls, other: type) -> bool:
        """A class that has `Settings` and the methods of `signals.FrameSource` is a source too."""
        if cls is not DeviceSource:
            return NotImplemented
        return all(hasattr(other, name) for name in ("Settings", "check", "open", "read", "close")) or NotImplemented

    def __init__(self, name: str, settings: SettingsT | None = None, clock: HostClock | None = None) -> None:
        self.name = name
        self.settings: SettingsT = settings or self.Settings()  # type: ignore[assignment]
        self.counts = Counts()
        self._clock = clock or HostClock()
        self._opened = False
        self._next_attempt_s = 0.0

    def check(self) -> Sequence[str]:
        """What keeps the device from working now, one line each, with the remedy; nothing = ready."""
        try:
            return self._missing()
        except CabinposeError as error:
            return [error.in_one_line()]

    def open(self) -> None:
        """Connect; harmless if it is open. Raises RecordingError or DependencyError, with nothing left open."""
        if not self._opened:
            self._connect()
            self._opened = True

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """What has arrived, in the order of arrival; waits at most `timeout_s` for the first."""
        if not self._opened:
            raise RecordingError(f"{self.name} is not open", hint="call open() first")
        return self._read(timeout_s)

    def close(self) -> None:
        """Disconnect; harmless if it is not open. The counts stay."""
        if self._opened:
            self._opened = False
            self._disconnect()

    def _missing(self) -> Sequence[str]:
        """As `check`; may raise instead."""
        return []

    @abstractmethod
    def _connect(self) -> None:
        """As `open`, of a device that is not open."""

    @abstractmethod
    def _read(self, timeout_s: float) -> Sequence[Sample]:
        """As `read`, of a device that is open."""

    @abstractmethod
    def _disconnect(self) -> None:
        """As `close`, of a device that is open; raises nothing."""

    def _listened(self, seconds: float) -> list[str]:
        """What another source with the same settings complains of after it has listened for so long, or received something."""
        with closing(type(self)(self.name, self.settings, self._clock)) as probe:
            probe.open()
            until = self._clock.now_s() + seconds
            while not (probe.counts.received or probe.counts.malformed) and self._clock.now_s() < until:
                probe.read(0.1)
            return probe._complaints()

    def _complaints(self) -> list[str]:
        """What is wrong with a device that is open, from what it has sent so far."""
        return []

    def _attempt(self, pause_s: float) -> bool:
        """Whether it is time to try to reach the device again: not before `pause_s` have passed since the last attempt."""
        now = self._clock.now_s()
        due = now >= self._next_attempt_s
        if due:
            self._next_attempt_s = now + pause_s
        return due

    def _reconnect(self) -> None:
        """Connect again, which counts as a restart; a device that is still away is no error."""
        try:
            self._connect()
        except DependencyError:
            raise
        except RecordingError:
            return
        self.counts.restarts += 1


class PlayedSettings(BaseModel):
    """Which file is played, and how fast."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    path: Path = Field(description="the file")
    speed: float = Field(1.0, ge=0, le=1000, description="how much faster than recorded; 0 = as fast as it is read")


PlayedT = TypeVar("PlayedT", bound=PlayedSettings)


class PlayedSource(DeviceSource[PlayedT]):
    """A file that is played once, at its own pace or another. `_connect` of a subclass calls `_play`."""

    _at_once = 256  # the most samples of one `read`

    def _play(self, samples: Iterator[Sample]) -> None:
        """Begin to play samples, the first of them now; until then, their host times are those of the file."""
        self._samples = samples
        self._next = next(samples, None)
        self._began_ns = self._clock.now_ns()
        self._first_ns = 0 if self._next is None else self._next.host_ns

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        """The samples that are due; SourceEndedError after the last."""
        if self._next is None:
            raise SourceEndedError(f"{self.settings.path} was played to its end")
        self._clock.sleep(min((self._due_ns(self._next) - self._clock.now_ns()) / 1e9, timeout_s))
        played: list[Sample] = []
        now_ns = self._clock.now_ns()
        while self._next is not None and len(played) < self._at_once and self._due_ns(self._next) <= now_ns:
            played.append(self._played(self._next, now_ns))
            self._next = next(self._samples, None)
        return played

    def _played(self, sample: Sample, now_ns: int) -> Sample:
        """A sample as it is played at `now_ns`."""
        self.counts.received += 1
        return replace(sample, host_ns=now_ns)

    def _due_ns(self, sample: Sample) -> int:
        speed = self.settings.speed
        return 0 if speed == 0 else self._began_ns + int((sample.host_ns - self._first_ns) / speed)


# Devices by the kind that rigs name them by.
SOURCES: Registry[type[DeviceSource[Any]]] = Registry("cabinpose.sources", "kind of source", DeviceSource, subclass=True)


def is_camera(source: type) -> bool:
    """Whether `live` can show what a source gives; of a class that is no `DeviceSource` and does not say, it is assumed."""
    return getattr(source, "is_camera", True)


def cameras() -> list[str]:
    """Kinds of cameras that need no file. All sources are imported; one that cannot be is left out, with a warning."""
    return [kind for kind, source in SOURCES.items() if is_camera(source) and not getattr(source, "plays", "")]


def player_of(suffix: str) -> str | None:
    """The kind of source that plays files of a suffix (".mkv"), None where none does. Imports sources up to that one."""
    return next((kind for kind, source in SOURCES.items() if suffix and getattr(source, "plays", "") == suffix), None)
