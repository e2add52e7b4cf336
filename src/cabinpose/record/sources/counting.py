"""Which sample of a device is which: numbers without gaps where nothing was lost, and device time that does not wrap.

Devices count what they send, or give time stamps alone; both wrap, and restart with the device.
"""

from __future__ import annotations

from cabinpose.signals import Counts, Unwrapper

_JUMP = 100_000  # frames lost at once, an hour at 30 Hz: more is a counter that was set, not a loss


class FrameNumbers:
    """Numbers frames by the device's counter, of `modulus` values (None = it never wraps); keeps the `Counts` of a source.

    late: by fewer frames than this one may be late; a counter that goes back further has restarted.
    """

    def __init__(self, counts: Counts, modulus: int | None = None, *, late: int = 16) -> None:
        self._counts, self._most_late = counts, late
        self._unwrap = None if modulus is None else Unwrapper(modulus)
        self._restarting = True  # the next frame begins a count
        self._offset = 0  # of our numbers over the device's
        self._last = -1  # the highest of ours
        self._missing: set[int] = set()  # counted as lost, and may still come late

    def number(self, counter: int) -> int:
        """The number of a frame that the device calls `counter`; counts losses before it, a late one, a duplicate, a restart."""
        if not self._restarting:
            number = self._continuous(counter) + self._offset
            step = number - self._last
            if -self._most_late < step <= 0:
                self._late(number)
                return number
            if 0 < step <= _JUMP:
                return self._forward(step - 1)
            self._counts.restarts += 1
        if self._unwrap is not None:
            self._unwrap.restart()
        self._offset = self._last + 1 - self._continuous(counter)
        self._restarting = False
        return self._forward(0)

    def forward(self, lost: int = 0) -> int:
        """The number of the next frame of a device that does not count; `lost` before it are known to be missing."""
        number = self._forward(0 if self._restarting else lost)
        self._restarting = False
        return number

    def reached_again(self) -> None:
        """The device was lost and reached again: the next frame follows on the last, whatever it is called."""
        self._restarting = True

    def _continuous(self, counter: int) -> int:
        return counter if self._unwrap is None else self._unwrap(counter)

    def _forward(self, lost: int) -> int:
        self._counts.lost += lost
        self._last += 1 + lost
        oldest = self._last - self._most_late + 1
        if lost or self._missing:
            self._missing = {n for n in self._missing if n >= oldest} | set(range(max(self._last - lost, oldest), self._last))
        return self._last

    def _late(self, number: int) -> None:
        if number in self._missing:
            self._missing.discard(number)
            self._counts.lost -= 1
            self._counts.reordered += 1
        else:
            self._counts.duplicate += 1


class DeviceClock:
    """Nanoseconds of a device whose time stamps count `tick_ns` and wrap after `modulus`; the host's clock bridges pauses."""

    def __init__(self, tick_ns: int, modulus: int) -> None:
        self._tick_ns = tick_ns
        self._unwrap = Unwrapper(modulus)
        self._host_ns = 0

    def device_ns(self, stamp: int, host_ns: int) -> int:
        """The continuous time of a stamp that arrived at `host_ns`: however long nothing came, turns are not lost."""
        if self._unwrap.last is not None:
            self._unwrap.last += max(host_ns - self._host_ns, 0) // self._tick_ns
        continuous = self._unwrap(stamp)
        self._unwrap.last, self._host_ns = continuous, host_ns
        return continuous * self._tick_ns

    def restart(self) -> None:
        """Forget what came before: the device has restarted."""
        self._unwrap.restart()


class FramePeriod:
    """Frames missing between two time stamps of a device that does not count, from its period."""

    def __init__(self, period_ns: int | None = None) -> None:
        self._stated_ns = period_ns
        self._steps: list[int] = []  # the latest; their median is the period where none is stated
        self._last: int | None = None

    def lost_before(self, device_ns: int) -> int | None:
        """How many frames are missing before the one of `device_ns`; None where time went back: the device has restarted."""
        last, self._last = self._last, device_ns
        if last is None:
            return 0
        step = device_ns - last
        if step <= 0:
            self._steps.clear()
            return None
        period = self._stated_ns or (sorted(self._steps)[len(self._steps) // 2] if len(self._steps) >= 5 else None)
        self._steps = [*self._steps[-14:], step]
        return 0 if period is None else max(round(step / period) - 1, 0)
