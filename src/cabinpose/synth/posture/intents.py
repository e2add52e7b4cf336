"""What hands do: an action's places, and what they hold."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Matrix
from cabinpose.scene.body import Person
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture import hands as at
from cabinpose.synth.posture.actions import (
    Action,
    Place,
    armrest_point_name,
    target_name,
)
from cabinpose.synth.posture.grasps import HANDED, Hold, can_hold, handed, hold, serves

_CLOCKS_DEG, _CLOCK_SHARES = (90.0, 65.0, 100.0), (0.55, 0.35, 0.1)  # nine-three, ten-two, below


class Reach(NamedTuple):
    """Where hands go that have no place of the cabin to reach for, vehicle frame: (3,) m.

    side: the hand that goes there, None for the inboard one · palm: `vehicle_from_palm` (4, 4) sought there, None for one that
    points.
    """

    point: Floats
    side: int | None = None
    palm: Matrix | None = None


class Hand(NamedTuple):
    """One hand's intent, drawn once: its place, three standard normal numbers, the clock angle, the point to reach, and how the
    fingers lie: (6,) as `Person.pose` takes them, NaN where they follow the grip; palm: as in `Reach`.
    """

    place: Place
    noise: tuple[float, float, float]
    clock: float
    point: Floats | None
    fingers: Floats = at.BY_GRIP
    palm: Matrix | None = None


def intents(
    action: Action, seat: Seat, cabin: Cabin, inboard: int, drives: bool, reached: Reach | None, *, rng: np.random.Generator
) -> tuple[Hand, Hand]:
    """What each hand does, left then right; places that a seat lacks become the lap."""
    clock = math.radians(float(rng.choice(_CLOCKS_DEG, p=_CLOCK_SHARES)))
    point_name = target_name(action, seat, cabin)
    result = []
    for side in (0, 1):
        place: Place = action.inboard if side == inboard else action.outboard
        other: Place = action.outboard if side == inboard else action.inboard
        chance = float(rng.random())
        if place == "either":
            if drives:
                place = "wheel" if other != "wheel" and chance < 0.8 else "thigh"
            else:
                place = "armrest" if side != inboard and chance < 0.2 else "thigh"
        if place == "armrest" and armrest_point_name(seat, cabin) is None:
            place = "thigh"
        noise = tuple(float(v) for v in np.clip(rng.standard_normal(3), -2.0, 2.0))
        mine = clock + math.radians(5.0) * noise[0]
        there = reached if place in ("reach", "give") else None
        point = None if there is None else there.point
        if place == "reach" and point_name is not None:
            point = cabin.reach_targets[point_name] + 0.012 * np.array(noise)
        elif place == "armrest":
            point = cabin.reach_targets[armrest_point_name(seat, cabin) or ""]
        result.append(Hand(place, (noise[0], noise[1], noise[2]), mine if side == 0 else -mine, point, palm=there and there.palm))
    return result[0], result[1]


def holding(person: Person, hands: tuple[Hand, Hand], *, rng: np.random.Generator) -> tuple[tuple[Hand, Hand], Hold | None]:
    """What one of the hands holds, the first design that fits into it; a second hand beside it goes to the lap."""
    able = [side for side in (0, 1) if hands[side].place in HANDED]
    if not able:
        return hands, None
    side = able[int(rng.integers(len(able)))]
    place = hands[side].place
    order = handed(place, rng=rng)
    kind, variant = next((d for d in order if can_hold(person, place, *d)), order[0])
    rest = [h._replace(place="thigh") if s != side and s in able else h for s, h in enumerate(hands)]
    return (rest[0], rest[1]), hold(person, place, kind, variant, side)


def carrying(hands: tuple[Hand, Hand], carried: Hold) -> tuple[Hand, Hand]:
    """The hands of somebody who holds a thing all the time: over the lap, where the action has no use for it."""
    mine, other = hands[carried.side], hands[1 - carried.side]
    mine = mine if serves(carried, mine.place) else mine._replace(place="carry")
    other = other._replace(place="thigh") if other.place in HANDED else other
    return (mine, other) if carried.side == 0 else (other, mine)
