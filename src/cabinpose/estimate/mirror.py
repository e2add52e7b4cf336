"""What a mirror image swaps: left and right joints, the places of a car, and the classes of left and right body parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import SYMMETRIC_PAIRS
from cabinpose.scene import LABEL_ID

_ITOP_PAIRS = (("lhip", "rhip"),)
_SLOT_PAIRS = (("rear_left", "rear_right"),)  # the driver stays at the wheel of the mirrored car
_FACING_PAIR = ("driver", "front_passenger")  # on benches that face each other there is no wheel: left and right as behind


def mirrored_joints(joints: Sequence[str]) -> list[int]:
    """For each joint the position of its mirror joint: `mirrored = original[..., mirrored_joints(names), :]`."""
    return _partners(joints, (*SYMMETRIC_PAIRS, *_ITOP_PAIRS))


def mirrored_slots(slots: Sequence[str], *, facing: bool = False) -> list[int]:
    """For each place the position of its mirror place; `facing`: on benches that face each other, the front row backwards.

    A place whose partner is not among them stays itself.
    """
    return _partners(slots, (*_SLOT_PAIRS, _FACING_PAIR) if facing else _SLOT_PAIRS)


def mirrored_labels() -> NDArray[np.uint8]:
    """(256,) the class of the mirrored pixel by the class of the pixel (`scene.labels`): left and right parts change."""
    table = np.arange(256, dtype=np.uint8)
    for name, number in LABEL_ID.items():
        if name.endswith("_left"):
            partner = LABEL_ID[name.removesuffix("left") + "right"]
            table[number], table[partner] = partner, number
    return table


def _partners(names: Sequence[str], pairs: Sequence[tuple[str, str]]) -> list[int]:
    other = dict(pairs) | {b: a for a, b in pairs}
    position = {name: i for i, name in enumerate(names)}
    return [position.get(other.get(name, name), i) for name, i in position.items()]
