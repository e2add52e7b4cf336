"""A device that counts: numbered samples at a rate, in memory. For rigs to be tried without hardware, tests and benches.

It can lose samples, die and return, deliver in bursts; and since it says what it sent, every sample can be accounted for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import RecordingError, SourceEndedError
from cabinpose.record.sources.base import DeviceSource
from cabinpose.signals import Channels, HostClock, Sample, ToFFrame

_MOST_AT_ONCE = 1000


class NumberedSettings(BaseModel):
    """What the device does."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rate_hz: float = Field(100.0, gt=0, le=1e6, description="samples a second")
    samples: int | None = Field(None, ge=0, description="numbers 0 to samples - 1, then the source ends; left out: no end")
    raw_bytes: int = Field(64, ge=8, le=1 << 26, description="raw bytes of a sample; the first eight are its number")
    width: int = Field(0, ge=0, le=4096, description="width of a ToF frame in each sample, px; 0 = one channel in its place")
    height: int = Field(0, ge=0, le=4096, description="its height, px")
    lose_every: int = Field(0, ge=0, description="every so many numbers one is lost; 0 = none")
    die_every: int = Field(0, ge=0, description="after so many samples the device goes away; 0 = never")
    dead_s: float = Field(0.0, ge=0, description="for how long; what it counts meanwhile is lost")
    silent_from: int | None = Field(
        None, ge=0, description="from this number on it sends nothing, and does not end; left out: never"
    )
    burst: int = Field(1, ge=1, le=_MOST_AT_ONCE, description="samples that are delivered together")


class NumberedSource(DeviceSource[NumberedSettings]):
    """A `FrameSource` whose samples are numbered; `sent` is how many numbers the device has used so far."""

    Settings: ClassVar = NumberedSettings

    def __init__(self, name: str, settings: NumberedSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._began_ns: int | None = None
        self._dead_until_s = 0.0
        self._until_death = settings.die_every
        self.sent = 0
        rng = np.random.Generator(np.random.Philox(key=(1, 0)))
        height, width = shape = settings.height, settings.width
        self._depth = rng.integers(5000, 15000, shape, dtype=np.uint16)
        self._amplitude = rng.integers(0, 4000, shape, dtype=np.uint16)
        self._confidence = rng.integers(0, 255, shape, dtype=np.uint8)
        self._raw = rng.bytes(settings.raw_bytes - 8)
        focal = max(width, 1)
        self._k = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])

    def _connect(self) -> None:
        """Raises RecordingError while the device is away; what it counted meanwhile is lost."""
        if self._clock.now_s() < self._dead_until_s:
            raise RecordingError(f"{self.name} does not answer", hint="wait: it comes back")
        if self._began_ns is None:
            self._began_ns = self._clock.now_ns()
        self._lose(self._due())

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        settings, until = self.settings, self._clock.now_s() + timeout_s
        while True:
            if settings.samples is not None and self.sent >= settings.samples:
                raise SourceEndedError(f"{self.name} has sent its {settings.samples} samples")
            if settings.die_every and self._until_death <= 0:
                self._until_death = settings.die_every
                self._dead_until_s = self._clock.now_s() + settings.dead_s
                raise RecordingError(f"{self.name} went away", hint="it comes back")
            due = self._due()
            if due > self.sent and (due == settings.samples or due - self.sent >= settings.burst):
                return self._samples(min(due, self.sent + _MOST_AT_ONCE))
            left = until - self._clock.now_s()
            if left <= 0:
                return []
            wait = (self.sent + settings.burst) / settings.rate_hz - self._elapsed_s()
            self._clock.sleep(max(min(wait, left, 0.05), 0.001))

    def _disconnect(self) -> None:
        """The device counts on."""

    def _elapsed_s(self) -> float:
        return 0.0 if self._began_ns is None else (self._clock.now_ns() - self._began_ns) / 1e9

    def _due(self) -> int:
        """How many numbers the device has used by now."""
        due = int(self._elapsed_s() * self.settings.rate_hz)
        limits = (self.settings.samples, self.settings.silent_from)
        return min([due, *(limit for limit in limits if limit is not None)])

    def _lose(self, until: int) -> None:
        self.counts.lost += until - self.sent
        self.sent = until

    def _samples(self, until: int) -> list[Sample]:
        settings, samples = self.settings, []
        while self.sent < until and not (settings.die_every and self._until_death <= 0):
            number = self.sent
            if settings.lose_every and number % settings.lose_every == settings.lose_every - 1:
                self._lose(number + 1)
                continue
            device_ns = int(number * 1e9 / settings.rate_hz)
            raw = number.to_bytes(8, "little") + self._raw
            samples.append(Sample(number, self._clock.now_ns(), device_ns, raw, (self._message(number),)))
            self.sent += 1
            self._until_death -= 1
        self.counts.received += len(samples)
        return samples

    def _message(self, number: int) -> ToFFrame | Channels:
        if not self._depth.size:
            return Channels(("number",), np.array([float(number)]))
        depth = self._depth.copy()
        depth.flat[0] = number % 65536
        zero = np.zeros(5)
        return ToFFrame(depth, 1e-4, self._amplitude.copy(), self._confidence.copy(), self._k, zero, zero)
