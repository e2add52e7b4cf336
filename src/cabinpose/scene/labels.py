"""Pixel classes: an id and a colour each, stable across versions.

Body parts follow the thesis' table of 30 regions (2020, Table 5.1), which gives the codes 0x55AA55 and 0x55AAAA
twice; the colours here are unique. Ids are never reused: a new class gets a new number.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Label(NamedTuple):
    """A pixel class: stable id (fits uint8), name and sRGB colour 0xRRGGBB."""

    id: int
    name: str
    rgb: int


_BODY = (
    (1, "foot_left", 0x000055), (2, "foot_right", 0x0000AA), (3, "ankle_left", 0x0000FA), (4, "ankle_right", 0x005500),
    (5, "shin_left", 0x005555), (6, "shin_right", 0x0055AA), (7, "knee_left", 0x0055FA), (8, "knee_right", 0x00AA00),
    (9, "thigh_left", 0x00AA55), (10, "thigh_right", 0x00AAAA), (11, "hip_left", 0x00AAFA), (12, "hip_right", 0x00FA00),
    (13, "hip_center", 0x00FA55), (14, "torso_left", 0x00FAAA), (15, "torso_right", 0x00FAFA),
    (16, "shoulder_left", 0x550000), (17, "shoulder_right", 0x550055), (18, "upper_arm_left", 0x5500AA),
    (19, "upper_arm_right", 0x5500FA), (20, "elbow_left", 0x555500), (21, "elbow_right", 0x555555),
    (22, "forearm_left", 0x5555AA), (23, "forearm_right", 0x5555FA), (24, "wrist_left", 0x55AA00),
    (25, "wrist_right", 0x55AA55), (26, "hand_left", 0x55AAAA), (27, "hand_right", 0x55AAFA), (28, "neck", 0x55FA00),
    (29, "head_left", 0xAA55AA), (30, "head_right", 0xAAAA55), (31, "hair", 0x7A3E12), (32, "headwear", 0xC83C78),
    (33, "glasses", 0x28E6C8),
)  # fmt: skip
_WORLD = (
    (0, "background", 0x000000), (64, "seat", 0x8C8C96), (65, "trim", 0x5A5A64), (66, "glass", 0xE7E7E7),
    (67, "steering_wheel", 0xF0A030), (68, "seat_belt", 0xE03030), (69, "floor", 0x3C3228), (70, "pedal", 0xB4B43C),
    (71, "wall", 0xA0A8A0), (72, "furniture", 0x8C643C), (73, "door", 0x6E5A78), (74, "dashboard", 0x4B6478),
    (75, "console", 0x785A3C), (76, "headrest", 0xAAAAB9), (77, "mirror", 0x3CB4A0), (78, "screen", 0x28C8F0),
    (79, "steering_column", 0xC88250),
)  # fmt: skip
# Parts of a car that versions up to 0.2 had in other classes, with those.
_COARSE = MappingProxyType(
    {
        "door": "trim", "dashboard": "trim", "console": "trim", "mirror": "trim", "screen": "trim", "steering_column": "trim",
        "headrest": "seat",
    }
)  # fmt: skip
# Things that people bring along; by the words of SVIRO an infant seat looks back, a child seat forward.
_THINGS = (
    (80, "infant_seat", 0xF06EAA), (81, "child_seat", 0xA03CC8), (82, "box", 0xB98C50), (83, "bag", 0x963232),
    (84, "backpack", 0x3264B4), (85, "bottle", 0xD2FF3C), (86, "cup", 0xE6AAFF), (87, "book", 0x78B45A), (88, "laptop", 0x64788C),
    (89, "phone", 0xFF7828), (90, "blanket", 0x8CD2C8), (91, "jacket", 0x3C6E5A), (93, "food", 0xD9A441),
)  # fmt: skip
# 34, "person", and 92, "accessory", are kept for imports of TICaM (`store.convert.ticam`): no generated dataset has them.
# Classes of TICaM (Katrolia et al. 2021), beside its 0 for the background and 1 for people; 8 is its "accessory".
_TICAM = MappingProxyType(
    {
        "backpack": 2, "box": 4, "bottle": 5, "phone": 6, "cup": 8, "book": 9, "laptop": 10, "bag": 13, "child_seat": 14,
        "infant_seat": 15, "jacket": 3, "blanket": 7, "food": 8,
    }
)  # fmt: skip

BODY_PARTS: tuple[Label, ...] = tuple(Label(*row) for row in _BODY)
THING_LABELS: tuple[Label, ...] = tuple(Label(*row) for row in _THINGS)
# All labels of pixels, by id: parts of people, what a scene has, things.
LABELS: tuple[Label, ...] = tuple(sorted(BODY_PARTS + tuple(Label(*row) for row in _WORLD) + THING_LABELS))
LABEL_ID = MappingProxyType({label.name: label.id for label in LABELS})
RGB = MappingProxyType({label.id: label.rgb for label in LABELS})
_TO_COARSE = np.arange(256, dtype=np.uint8)
for _fine, _class in _COARSE.items():
    _TO_COARSE[LABEL_ID[_fine]] = LABEL_ID[_class]
FIRST_BODY_ID, LAST_BODY_ID = 1, 63  # ids 1..63 belong to people, 64.. to the world


def coarse_labels(labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Labels of any shape in the classes of versions up to 0.2: door, dashboard, console, mirror, screen and steering column
    are trim there, headrests seat.
    """
    return _TO_COARSE[labels]


def ticam_class(label: Label) -> int:
    """The class of TICaM's masks that pixels of a class of ours have there: 0 for all that is part of the car."""
    return 1 if FIRST_BODY_ID <= label.id <= LAST_BODY_ID else _TICAM.get(label.name, 0)
