"""Which axis of a C3D file is vertical.

POINT:Y_SCREEN names the axis that a viewer draws upwards. That is a hint for displays: there are systems that write -Z into files
whose z is up. So it is believed as long as the markers do not contradict it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from cabinpose.core import ZUP_FROM_YUP
from cabinpose.signals import F64, trunk_columns

Axis: TypeAlias = Literal["x", "-x", "y", "-y", "z", "-z"]
_FLIP = np.diag([1.0, -1.0, -1.0])  # half a turn about x
WORLD_FROM_UP: Mapping[str, F64] = MappingProxyType(
    {
        "z": np.eye(3), "-z": _FLIP, "y": ZUP_FROM_YUP, "-y": _FLIP @ ZUP_FROM_YUP,
        "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
        "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    }
)  # fmt: skip
_NEAR_AN_AXIS = 0.7  # cosine; a seated person's shoulders lie about 30 degrees before their feet and hips
_MOST = 0.8  # of the frames
_SMALLEST_M = 0.2  # between upper and lower markers, and the spread of markers from which anything can be told
_BELOW_FLOOR_M = -0.05
_FRAMES = 200  # to look at


def vertical_axis(hint: Axis | None, position_m: F64, subjects: Iterable[Mapping[str, int]]) -> tuple[Axis, str]:
    """The axis that points up, and what tells it.

    Markers of shoulders, neck and head lie above those of hips and feet, in most frames. Where names do not tell, a negative axis
    (or none) in the file gives way to one along which everything is above the floor.

    Parameters
    ----------
    hint
        What POINT:Y_SCREEN says; None where there is none.
    position_m : (F, P, 3)
        Points in the file's axes; NaN = occluded.
    subjects
        Of each subject, the columns of its markers by their names.
    """
    position_m = position_m[:: max(1, len(position_m) // _FRAMES)]
    for markers in subjects:
        axis = _by_names(position_m, markers)
        if axis is not None:
            return axis, "shoulders or head above hips or feet"
    axis = _by_floor(hint, position_m)
    if axis is not None:
        return axis, "all markers above the floor"
    return (hint, "POINT:Y_SCREEN") if hint else ("z", "assumed: nothing tells it")


def _by_names(position_m: F64, markers: Mapping[str, int]) -> Axis | None:
    columns = list(markers.values())
    upper, lower = ([columns[i] for i in found] for found in trunk_columns(tuple(markers)))
    if not upper or not lower:
        return None
    seen = np.isfinite(position_m[:, upper, 0]).any(axis=1) & np.isfinite(position_m[:, lower, 0]).any(axis=1)
    if not seen.any():
        return None
    difference = np.nanmean(position_m[seen][:, upper], axis=1) - np.nanmean(position_m[seen][:, lower], axis=1)
    length = np.linalg.norm(difference, axis=1)
    for axis, world_from_file in WORLD_FROM_UP.items():
        up = world_from_file[2]  # the file's axis that becomes z
        if np.mean((length > _SMALLEST_M) & (difference @ up > _NEAR_AN_AXIS * length)) >= _MOST:
            return axis  # type: ignore[return-value]  # a key of the table
    return None


def _by_floor(hint: Axis | None, position_m: F64) -> Axis | None:
    """The opposite of a negative axis, or y in place of none, if all is above the floor along it and not along the other."""
    points = position_m[np.isfinite(position_m).all(axis=2)]
    candidates: dict[Axis | None, tuple[Axis, Axis]] = {
        "-x": ("-x", "x"), "-y": ("-y", "y"), "-z": ("-z", "z"), None: ("z", "y")
    }  # fmt: skip
    if hint not in candidates or not len(points):
        return None
    told, other = (points @ WORLD_FROM_UP[axis][2] for axis in candidates[hint])
    if np.ptp(other) < _SMALLEST_M or told.min() > _BELOW_FLOOR_M or other.min() < _BELOW_FLOOR_M:
        return None
    return candidates[hint][1]
