"""Poses of people: joints in the camera frame and how each is seen."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

OCCUPANT_SLOTS: tuple[str, ...] = ("driver", "front_passenger", "rear_left", "rear_center", "rear_right")

STANDING_SLOT = "standing"  # the place of somebody who is in no car


class Visibility(IntEnum):
    """State of a joint in an image."""

    ABSENT = 0
    OUTSIDE_IMAGE = 1
    OCCLUDED = 2  # by something else: a seat, the wheel, another person
    SELF_OCCLUDED = 3  # by the person's own body
    VISIBLE = 4


@dataclass(frozen=True)
class Pose:
    """One person's joints: (20, 3) metres in the camera frame, NaN where absent, and (20,) visibility."""

    joints_3d: NDArray[np.float64]
    visibility: NDArray[np.uint8]
