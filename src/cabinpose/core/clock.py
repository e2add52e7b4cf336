"""Clocks: host time that never jumps, and counters of devices that wrap or begin anew.

A time stamp names its clock: `host_ns` is `HostClock`'s, `device_ns` a device's own, whose start and rate only alignment
relates to the host's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


class HostClock:
    """Nanoseconds since the Unix epoch that advance with the monotonic clock: no step where the system's time is set."""

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """The time now."""
        return time.monotonic_ns() + self._offset_ns

    def from_monotonic_ns(self, monotonic_ns: int) -> int:
        """The time at which `time.monotonic_ns` said `monotonic_ns`."""
        return monotonic_ns + self._offset_ns


@dataclass
class Unwrapper:
    """A counter of `modulus` values made continuous: each value is taken as the nearest one to the last.

    A device that counts 2**32 microseconds wraps after 71.6 minutes; a late value may lie before the last.
    """

    modulus: int
    last: int | None = None

    def __call__(self, value: int) -> int:
        """The continuous value of a counter that reads `value`; the first is taken as it is."""
        if self.last is None:
            self.last = value
            return value
        half = self.modulus // 2
        continuous = self.last + (value - self.last + half) % self.modulus - half
        self.last = max(self.last, continuous)
        return continuous

    def restart(self) -> None:
        """Forget what came before: the device has begun anew."""
        self.last = None
