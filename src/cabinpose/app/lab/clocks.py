"""A device's clock, and the way of what it sends to the host: what time stamps a recording would carry.

True time is the host's: int64 nanoseconds since the Unix epoch. A device's clock has an origin and a rate of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.signals import ClockMap

Times = NDArray[np.int64]


class ClockSettings(BaseModel):
    """What a device's clock shows, and when what it sends arrives."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    offset_s: float = Field(default=0.0, description="What the device's clock shows at the rig's start (s).")
    drift_ppm: float = Field(default=0.0, gt=-1e5, lt=1e5, description="How much faster than true time it runs (1e-6).")
    resolution_ns: int = Field(default=1, ge=1, description="Its time stamps are rounded to multiples of this (ns).")
    latency_s: float = Field(default=0.0, ge=0, description="From the moment that a sample shows to its arrival, at least (s).")
    jitter_s: float = Field(
        default=0.0, ge=0, description="Mean of what comes on top of the latency, exponentially distributed (s)."
    )


@dataclass(frozen=True)
class Clock:
    """The clock of one device of a rig that starts at `start_ns` (true time)."""

    settings: ClockSettings
    start_ns: int

    @property
    def device_from_true(self) -> ClockMap:
        """What the device's clock shows at a true time, before rounding."""
        offset_ns = round(self.settings.offset_s * 1e9) - self.start_ns
        return ClockMap(offset_ns, self.settings.drift_ppm * 1e-6, self.start_ns)

    def to(self, other: Clock) -> ClockMap:
        """What the clock of another device shows when this one shows t: the truth that alignment looks for."""
        return self.device_from_true.inverse().then(other.device_from_true)

    def stamps(self, true_ns: ArrayLike) -> Times:
        """device_ns (...) of samples that show the moments `true_ns`, rounded to the clock's resolution."""
        step = self.settings.resolution_ns
        return (self.device_from_true(true_ns) + step // 2) // step * step

    def ticks(self, rate_hz: float, from_s: float, to_s: float) -> Times:
        """True times (T,) of a device's samples within [from_s, to_s) after the rig's start.

        The device counts them off by its own clock: its k-th sample is due when it shows k / rate_hz.
        """
        first_ns, last_ns = self.device_from_true(self.start_ns + np.rint(np.array((from_s, to_s)) * 1e9).astype(np.int64))
        first, last = (int(np.ceil(int(at) * rate_hz / 1e9)) for at in (first_ns, last_ns))
        due = np.rint(np.arange(first, last) * (1e9 / rate_hz)).astype(np.int64)
        return self.device_from_true.inverse()(due)

    def arrivals(self, true_ns: ArrayLike, *, rng: Generator) -> Times:
        """host_ns (T,) of samples that show the rising moments `true_ns` (T,): none overtakes another."""
        true = np.asarray(true_ns, np.int64)
        late_s = self.settings.latency_s + self.settings.jitter_s * rng.standard_exponential(true.shape)
        return np.maximum.accumulate(true + np.rint(late_s * 1e9).astype(np.int64))
