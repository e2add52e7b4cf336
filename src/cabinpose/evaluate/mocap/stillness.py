"""When a body or a sensor stands still: the windows of time that SSE and SFE compare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import AlignmentError
from cabinpose.signals import angle_between

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """A named span of time from `start_s` to `end_s`, both included (a plane of motion, "first", "last")."""

    name: str
    start_s: float
    end_s: float

    def frames(self, time_s: F64) -> NDArray[np.bool_]:
        """(T,) which frames lie in it. Raises AlignmentError where none does."""
        inside = (time_s >= self.start_s) & (time_s <= self.end_s)
        if not inside.any():
            span = f"{time_s[0]:.3f} to {time_s[-1]:.3f} s" if len(time_s) else "no time at all"
            raise AlignmentError(
                f"the window '{self.name}', {self.start_s:g} to {self.end_s:g} s, holds no frame",
                hint=f"the recording has frames from {span}",
            )
        return inside


def turning_speed(time_s: F64, quaternion_wxyz: F64, *, over_s: float) -> F64:
    """(T, ...) rad/s of orientations (T, ..., 4) over the `over_s` around each frame, so that noise does not count as motion."""
    before, after = _around(time_s, over_s)
    turned = angle_between(quaternion_wxyz[after], quaternion_wxyz[before])
    return turned / _lasting(time_s, before, after, turned.ndim)


def moving_speed(time_s: F64, position_m: F64, *, over_s: float) -> F64:
    """(T, ...) m/s of positions (T, ..., 3), as `turning_speed`."""
    before, after = _around(time_s, over_s)
    moved = np.linalg.norm(position_m[after] - position_m[before], axis=-1)
    return moved / _lasting(time_s, before, after, moved.ndim)


def still_windows(time_s: F64, still: NDArray[np.bool_], *, least_s: float, margin_s: float = 0.0) -> list[Window]:
    """The stretches of time in which every frame is still (T,), of at least `least_s`, without `margin_s` at both ends."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    found: list[Window] = []
    for first, end in edges.reshape(-1, 2):
        start_s, end_s = float(time_s[first]), float(time_s[end - 1])
        if end_s - start_s >= least_s:
            found.append(Window(f"still {len(found) + 1}", start_s + margin_s, end_s - margin_s))
    return found


def _around(time_s: F64, over_s: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The frames half of `over_s` before and after each, at least its neighbours, within the recording."""
    last = len(time_s) - 1
    here = np.arange(last + 1)
    before = np.minimum(np.searchsorted(time_s, time_s - over_s / 2 - 1e-9), here - 1).clip(0)
    after = np.maximum(np.searchsorted(time_s, time_s + over_s / 2 + 1e-9, side="right") - 1, here + 1).clip(max=last)
    return before, after


def _lasting(time_s: F64, before: NDArray[np.intp], after: NDArray[np.intp], dimensions: int) -> F64:
    lasting = time_s[after] - time_s[before]
    return np.where(lasting > 0, lasting, np.inf).reshape(-1, *[1] * (dimensions - 1))
