"""From a device's clock to the host's: the line below all arrivals.

A sample arrives at the host a latency after its device stamped it, and a latency has a floor: the fastest way. The arrivals that
took it lie on a line over the device's time; all others lie above. The line tells the device's clock on the host's, but for
that floor, which is the same from take to take as long as the rig is: `calibrate` measures the difference between two floors
with a pendulum. It stays valid where a device was started anew between two takes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import AlignmentError
from cabinpose.signals import ClockMap

_GREATEST_DRIFT = 1e-3  # beyond it, stamps are no clock's
_OTHER_UNIT = 0.1  # beyond it they are of another unit, and steps between them say nothing
_QUARTZ = 1e-4  # at worst
_AS_WELL = 2.0  # a line that leaves at most so many times the distance to the arrivals tells them as well: the take is short
_FEWEST = 10


def host_from_device(device_ns: NDArray[np.int64], host_ns: NDArray[np.int64], source: str = "device") -> ClockMap:
    """The map from a device's clock to the host's, without the latency's variable part.

    device_ns, host_ns: (T,) times of the same samples. Of the lines below all arrivals it is the one with the least sum of
    distances to them: the edge of the lower convex hull over the mean device time (the linear programme of Moon, Skelly and
    Towsley, INFOCOM 1999). A take of seconds does not tell a slope from latencies: where that line is steeper than any clock
    and one of a quartz clock lies below the arrivals nearly as closely, it is taken. Raises AlignmentError for too few samples, a
    clock that went backwards or jumped, or a slope that no clock has.
    """
    device, host = np.asarray(device_ns, np.int64), np.asarray(host_ns, np.int64)
    if len(device) < _FEWEST:
        raise AlignmentError(
            f"{source}: {len(device)} samples are too few to tell its clock", hint=f"record at least {_FEWEST}, for seconds"
        )
    start = int(device[0])
    x = (device - start).astype(np.float64)
    y = ((host - host[0]) - (device - start)).astype(np.float64)  # what latency and drift add: small, so that digits stay
    if (np.diff(x) < 0).any():
        raise AlignmentError(
            f"{source}: its clock went backwards during the take", hint="the device was started anew: cut the take there"
        )
    _refuse_jump(source, x, y)
    hull = _lower_hull(x, y)
    middle = float(x.mean())
    right = min(max(int(np.searchsorted(hull[:, 0], middle, side="right")), 1), len(hull) - 1)
    (x0, y0), (x1, y1) = hull[right - 1], hull[right]
    drift = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
    at_start = y0 - drift * x0
    if abs(drift) > _GREATEST_DRIFT:
        likely = math.copysign(_QUARTZ, drift)
        below = float((y - likely * x).min())
        if (y - likely * x - below).mean() > _AS_WELL * (y - drift * x - at_start).mean():
            raise _no_clock(source, drift)
        drift, at_start = likely, below
    return ClockMap(int(host[0]) - start + round(at_start), drift, start)


def _lower_hull(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners (K, 2) of the lower convex hull, x rising (Andrew's monotone chain)."""
    hull: list[tuple[float, float]] = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        if hull and hull[-1][0] == point[0]:
            if hull[-1][1] <= point[1]:
                continue
            hull.pop()
        while len(hull) > 1 and _left_turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    return np.array(hull)


def _left_turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


_PIECES = 8
_JUMP_NS = 50e6  # a floor of the latency that moves by more between two neighbouring pieces is a clock that was set


def _refuse_jump(source: str, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    """A clock that was set in the take moves all that follows; a line through both sides would be wrong on both."""
    if len(x) < _PIECES * _FEWEST:
        return
    pieces = np.array_split(np.arange(len(x)), _PIECES)
    floors = np.array([y[piece].min() for piece in pieces])
    times = np.array([x[piece].mean() for piece in pieces])
    slope = float(np.median(np.diff(floors) / np.diff(times)))
    if abs(slope) > _OTHER_UNIT:
        raise _no_clock(source, slope)
    steps = np.abs(np.diff(floors) - slope * np.diff(times))
    worst = int(steps.argmax())
    if steps[worst] > _JUMP_NS:
        raise AlignmentError(
            f"{source}: its clock jumps by {steps[worst] / 1e6:.0f} ms, {times[worst + 1] / 1e9:.0f} s into the take or before",
            hint="the device's clock was set while it recorded: cut the take there, or record it again",
        )


def _no_clock(source: str, drift: float) -> AlignmentError:
    return AlignmentError(
        f"{source}: its clock runs {drift:+.1e} against the computer's, as no clock does",
        hint="its time stamps may be of another unit, or the take is too short to tell",
    )
