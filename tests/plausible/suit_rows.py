"""A suit's frames, and its joints as an optical system would see them, right or wrong."""

from __future__ import annotations

import numpy as np

from cabinpose.core import MVN_SEGMENTS
from cabinpose.signals import Facts, Markers, SegmentPoses
from cabinpose.store.convert.rows import Row

FRAMES = 60
RATE_HZ = 60.0
Poses = list[tuple[np.ndarray, np.ndarray]]


def rows_of(
    person: Poses, *, scale: float = 1.0, order: tuple[int, ...] = (0, 1, 2, 3), norm: float = 1.0, rate_hz: float = RATE_HZ
) -> list[Row]:
    """A suit's frames; `rate_hz` is what the file states of them."""
    rows: list[Row] = [(0, 0, Facts("S07", {"frame_rate_hz": rate_hz}))]
    for i, (position, wxyz) in enumerate(person):
        at = round(i * 1e9 / RATE_HZ)
        rows.append((at, at, SegmentPoses("S07", MVN_SEGMENTS, scale * position, norm * wxyz[:, order])))
    return rows


def markers(person: Poses, scale: float = 1.0) -> list[Row]:
    """The joints of the suit as an optical system would see them, under Plug-in Gait's names."""
    names = {"LASI": "LeftUpperLeg", "RASI": "RightUpperLeg", "C7": "Neck", "LKNE": "LeftLowerLeg", "LANK": "LeftFoot",
             "LSHO": "LeftUpperArm", "LELB": "LeftForearm", "LWRA": "LeftHand"}  # fmt: skip
    columns = [MVN_SEGMENTS.index(segment) for segment in names.values()]
    rows: list[Row] = [(0, 0, Facts("points", {"rate_hz": RATE_HZ}))]
    for i, (position, _) in enumerate(person):
        at = round(i * 1e9 / RATE_HZ)
        rows.append((at, at, Markers("S07", tuple(names), scale * position[columns], np.full(len(names), 1e-4))))
    return rows
