"""Places of people in a car, and how a joint is seen."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# Places of people in a car, in the order of a dataset.
OCCUPANT_SLOTS: tuple[str, ...] = ("driver", "front_passenger", "rear_left", "rear_center", "rear_right")

DriveSide = Literal["left", "right"]
"""Where a car's wheel is, as the driver sees it."""
SIDE_NAMES = ("", "left", "right")
"""By what `wheel_sides` says: unknown, `DriveSide`s; -1, the right, counts from the end."""
STANDING_SLOT = "standing"  # the place of somebody who is in no car
_LEFT_WITH_WHEEL_LEFT = {"driver": 1, "front_passenger": -1}


class Visibility(IntEnum):
    """State of a joint in an image."""

    ABSENT = 0
    OUTSIDE_IMAGE = 1
    OCCLUDED = 2  # by something else: a seat, the wheel, another person
    SELF_OCCLUDED = 3  # by the person's own body
    VISIBLE = 4


def wheel_sides(hips: NDArray[Any], vehicle_from_camera: NDArray[Any], places: Sequence[str]) -> NDArray[np.int8]:
    """(...,) where the wheel is by who sits where in front: 1 on the left, -1 on the right, 0 where nothing says it.

    hips: (..., P, 2, 3) m, left and right one of the people of `places` in the camera frame, NaN = not known ·
    vehicle_from_camera: (..., 4, 4), NaN = not known. Who faces the rear, with the left hip to the car's right, says nothing:
    where benches face each other there is no wheel.
    """
    import numpy as np  # noqa: PLC0415 - the names of places, which every command's help needs, do without

    to_left = vehicle_from_camera[..., 1, :]
    across = np.einsum("...pij,...j->...pi", hips, to_left[..., :3]) + to_left[..., 3, None, None]
    sides = np.sign(np.where(across[..., 0] > across[..., 1], across.mean(axis=-1), 0.0))
    wheel = np.array([_LEFT_WITH_WHEEL_LEFT.get(place, 0) for place in places])
    return np.sign((sides * wheel).sum(axis=-1)).astype(np.int8)
