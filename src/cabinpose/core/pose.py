"""Places of people in a car, and how a joint is seen."""

from __future__ import annotations

from enum import IntEnum
from typing import Literal

# Places of people in a car, in the order of a dataset.
OCCUPANT_SLOTS: tuple[str, ...] = ("driver", "front_passenger", "rear_left", "rear_center", "rear_right")

DriveSide = Literal["left", "right"]
"""Where a car's wheel is, as the driver sees it."""
STANDING_SLOT = "standing"  # the place of somebody who is in no car


class Visibility(IntEnum):
    """State of a joint in an image."""

    ABSENT = 0
    OUTSIDE_IMAGE = 1
    OCCLUDED = 2  # by something else: a seat, the wheel, another person
    SELF_OCCLUDED = 3  # by the person's own body
    VISIBLE = 4
