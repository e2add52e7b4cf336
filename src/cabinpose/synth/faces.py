"""What faces in a scene do: where eyes look, how far lids are open, expressions. Drawn from streams of their own.

The shares of expressions and of drowsy people are assumed: there is no count of them in cars.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, at_rank
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, Face, load_faces
from cabinpose.scene.cabin import Cabin
from cabinpose.synth.gaze import ASLEEP, line_of_sight
from cabinpose.synth.posture import FREE_POSES
from cabinpose.synth.scene import ScenePerson
from cabinpose.synth.streams import face_rng


class Expression(NamedTuple):
    """How common one is, and the face units that it is made of, from least to most; those of both sides without the side.

    lids: opening of the lids, of that of a neutral face.
    """

    share: float
    units: Mapping[str, tuple[float, float]]
    lids: float = 1.0


EXPRESSIONS: Mapping[str, Expression] = MappingProxyType(
    {
        "neutral": Expression(0.62, {}),
        "talking": Expression(0.18, {"jawOpen": (0.05, 0.35), "mouthFunnel": (0.0, 0.4), "mouthLowerDown": (0.0, 0.5)}),
        "smiling": Expression(0.10, {"mouthSmile": (0.3, 0.8), "cheekSquint": (0.1, 0.5)}, 0.92),
        "laughing": Expression(
            0.03, {"mouthSmile": (0.6, 0.9), "jawOpen": (0.15, 0.4), "mouthUpperUp": (0.1, 0.5), "cheekSquint": (0.4, 0.8)}, 0.85
        ),
        "frowning": Expression(0.04, {"browDown": (0.4, 0.9), "mouthFrown": (0.1, 0.6)}),
        "yawning": Expression(0.03, {"jawOpen": (0.6, 1.0), "browInnerUp": (0.0, 0.4)}, 0.83),
    }
)  # fmt: skip
_ASLEEP = {"neutral": Expression(0.7, {}), "mouth_open": Expression(0.3, {"jawOpen": (0.08, 0.35)})}
_SIDES_DIFFER = 0.15  # of a unit's share
_DROWSY, _DROWSY_LIDS, _AWAKE_LIDS = 0.02, (0.3, 0.6), (0.85, 1.0)
DROWSY_OPENING = 0.7  # of the lids, below which somebody awake is drowsy
# By which eyes turn in the head: 55 deg to the sides as Guitton & Volle 1987 are quoted, up and down: all assumed.
_SIDEWAYS, _UP, _DOWN = math.radians(55.0), math.radians(35.0), math.radians(45.0)
# From the eyes to a palm, of a hand at the mouth or the face, which then is neutral; and how much farther away a hand leaves the
# whole expression, so that none stops from one frame of a sequence to the next (assumed).
_BUSY_MOUTH_M, _FADING_M = 0.25, 0.20
_TALKS_YEARS = 1.0
_DRAWS = 16


def with_faces(
    people: Iterable[ScenePerson], given: Mapping[str, Face], cabin: Cabin | None, *, seed: int, number: int
) -> list[ScenePerson]:
    """The people, with what their faces do.

    given: by slot, of those for whom it is not drawn · number: the frame's, or that of the first of a sequence, in which
    expressions stay, and lids close where somebody falls asleep.
    """
    result = []
    for person in people:
        face = given.get(person.slot)
        result.append(replace(person, face=face or _drawn(person, cabin, rng=face_rng(seed, number, person.slot))))
    return result


def _drawn(person: ScenePerson, cabin: Cabin | None, *, rng: np.random.Generator) -> Face:
    u = rng.random(_DRAWS).tolist()
    asleep = person.action in ASLEEP
    among = _ASLEEP if asleep else EXPRESSIONS
    name = at_rank({each: of.share for each, of in among.items()}, u[0])
    posed = person.posed
    away_m = min(rp.norm(posed.palms[side][:3, 3] - posed.eyes_m) for side in "lr")
    left = min(max((away_m - _BUSY_MOUTH_M) / _FADING_M, 0.0), 1.0)
    left *= left * (3.0 - 2.0 * left)
    if left == 0.0:
        name = "neutral"
    if name == "talking" and person.person.phenotype.years < _TALKS_YEARS:
        name = "neutral"
    units = []
    for k, (unit, (low, high)) in enumerate(among[name].units.items()):
        share = left * (low + u[3 + k] * (high - low))
        if unit in load_faces().units:
            units.append((unit, share))
            continue
        differ = _SIDES_DIFFER * (u[8 + k] - 0.5)
        units += [(f"{unit}Left", share * (1.0 + differ)), (f"{unit}Right", share * (1.0 - differ))]
    shown = name if left >= 0.5 else "neutral"
    if asleep:
        return Face(lids=(0.0, 0.0), expression=shown, units=tuple(units))
    low, high = _DROWSY_LIDS if u[1] < _DROWSY else _AWAKE_LIDS
    opening = (low + u[2] * (high - low)) * (1.0 + left * (among[name].lids - 1.0))
    return Face(_gaze(person, cabin), (opening, opening), shown, tuple(units))


def _gaze(person: ScenePerson, cabin: Cabin | None) -> tuple[float, float, float]:
    """The line of sight in the head, as far as eyes turn."""
    head = person.posed.bones[BONE_INDEX["head"], :3, :3]
    sight = line_of_sight(head if person.coming_head is None else person.coming_head, _heading(person, cabin))
    forward, left, up = rp.matmul(head.T, sight).tolist()
    yaw = min(max(rp.arctan2(left, forward), -_SIDEWAYS), _SIDEWAYS)
    pitch = min(max(rp.arcsin(min(max(up, -1.0), 1.0)), -_DOWN), _UP)
    return rp.cos(pitch) * rp.cos(yaw), rp.cos(pitch) * rp.sin(yaw), rp.sin(pitch)


def _heading(person: ScenePerson, cabin: Cabin | None) -> float:
    if cabin is not None and person.action not in FREE_POSES:
        return cabin.seats[person.slot].facing_yaw
    ahead: Floats = person.posed.vehicle_from_root[:3, 0]
    return float(rp.arctan2(ahead[1], ahead[0]))
