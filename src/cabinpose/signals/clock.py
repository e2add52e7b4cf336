"""Clocks: host time that never jumps, and counters of devices that wrap or begin anew.

A time stamp names its clock: `host_ns` is `HostClock`'s, `device_ns` a device's own, whose start and rate only alignment
relates to the host's.
"""

from __future__ import annotations

import math
import select
import selectors
import socket
import threading
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

LATEST_NS = 1_000_000_000
"""No sample is overtaken by one that is newer by more: where a device's time falls by more, it was started anew."""


class HostClock:
    """Nanoseconds since the Unix epoch that advance with the monotonic clock: no step where the system's time is set.

    It also waits, so that a test can put a clock of its own in the place of time that passes.
    """

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """The time now."""
        return time.monotonic_ns() + self._offset_ns

    def now_s(self) -> float:
        """The time now in seconds, exact to about 0.2 microseconds: for intervals and deadlines."""
        return self.now_ns() / 1e9

    def sleep(self, seconds: float) -> None:
        """Let so much time pass; none, where `seconds` is negative."""
        time.sleep(max(seconds, 0.0))

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        """Wait for an event; whether it is set."""
        return event.wait(max(timeout_s, 0.0))

    def join(self, thread: threading.Thread, timeout_s: float) -> bool:
        """Wait for the end of a thread, for ever where `timeout_s` is infinite; whether it has ended."""
        thread.join(None if timeout_s == math.inf else max(timeout_s, 0.0))
        return not thread.is_alive()

    def readable(self, connection: socket.socket, timeout_s: float) -> bool:
        """Wait for bytes, or a connection, on a socket; whether there are any."""
        return bool(select.select([connection], [], [], max(timeout_s, 0.0))[0])

    def select(self, selector: selectors.BaseSelector, timeout_s: float) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for the sockets of a selector; those that are ready, and for what."""
        return selector.select(max(timeout_s, 0.0))


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


@dataclass(frozen=True)
class ClockMap:
    """What clock b shows when clock a shows t: b = a + offset_ns + drift * (a - reference_ns).

    drift: of b against a, dimensionless (1e-6 = 1 ppm) · reference_ns: time of a at which the offset holds. Times are int64
    nanoseconds; only the small difference to the reference is a float, so that an epoch costs no digits.
    """

    offset_ns: int
    drift: float = 0.0
    reference_ns: int = 0

    def __call__(self, a_ns: ArrayLike) -> NDArray[np.int64]:
        """Times (...) of clock a on clock b."""
        a = np.asarray(a_ns, np.int64)
        return a + self.offset_ns + np.rint(self.drift * (a - self.reference_ns)).astype(np.int64)

    def inverse(self) -> ClockMap:
        """What clock a shows when clock b does."""
        return ClockMap(-self.offset_ns, -self.drift / (1 + self.drift), self.reference_ns + self.offset_ns)

    def then(self, c_from_b: ClockMap) -> ClockMap:
        """The map from a to c."""
        reference = self.reference_ns
        offset = int(c_from_b(self(reference))) - reference
        return ClockMap(offset, (1 + self.drift) * (1 + c_from_b.drift) - 1, reference)
