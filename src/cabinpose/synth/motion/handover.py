"""Where a thing changes hands between two people side by side, and how both hold it there."""

from __future__ import annotations

import math

import numpy as np

from cabinpose.core import CABINPOSE, Floats, Matrix, invert, rotation_vector
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import Person, PosedBody
from cabinpose.synth.posture.grasps import Hold, closed_around, hold, other_place
from cabinpose.synth.posture.hands import palm_frame

_STRETCHED = 0.8  # from shoulder to palm, of the shorter arm: elbows stay bent
_BELOW_M, _LEAST_AHEAD_M, _SIGMA_M = 0.14, 0.12, 0.02  # of the place against the shoulders
_TOWARDS = math.radians(60.0)  # of the fingers towards the neighbour, from the line of shoulder and thing: wrists do not cross
_ROOM_M = 0.009  # between a hand that is not yet closed and the thing, beyond where it touches


def meeting_place(
    people: tuple[Person, Person], bodies: tuple[PosedBody, PosedBody], side: int, ahead: Floats, *, rng: np.random.Generator
) -> Floats:
    """(3,) m, vehicle frame: before and between the shoulders of who gives with the hand `side` (0 left, 1 right) and who takes.

    ahead: (3,) the direction in which both sit.
    """
    giver, taker = (body.joints[CABINPOSE.index["lr"[s] + "shoulder"]] for body, s in zip(bodies, (side, 1 - side), strict=True))
    arm = min(sum(person.segment_lengths[name] for name in ("upper_arm", "forearm")) for person in people)
    across = 0.5 * rp.norm(giver - taker)
    forwards = math.sqrt(max((_STRETCHED * arm) ** 2 - across**2 - _BELOW_M**2, _LEAST_AHEAD_M**2))
    return np.asarray(0.5 * (giver + taker) + forwards * ahead - (0.0, 0.0, _BELOW_M) + _SIGMA_M * rng.standard_normal(3))


def giving_palm(held: Hold, body: PosedBody, place: Floats) -> Matrix:
    """`vehicle_from_palm` of a hand, thumb up, that holds what stands upright at `place` (3,) m."""
    return _palm(held, body, place, np.array([0.0, 0.0, 1.0]), 0.0)


def taking_palm(person: Person, body: PosedBody, held: Hold, vehicle_from_thing: Matrix) -> tuple[Hold, Matrix]:
    """How the other side's hand of somebody can hold what another one holds, and `vehicle_from_palm` just before it closes.

    Raises SceneError where the hand is too small for it.
    """
    mine = hold(person, other_place(held), held.kind, held.variant, 1 - held.side)
    return mine, _palm(mine, body, vehicle_from_thing[:3, 3], vehicle_from_thing[:3, 2], _ROOM_M)


def _palm(held: Hold, body: PosedBody, place: Floats, up: Floats, off_m: float) -> Matrix:
    """A palm whose thing, round about `up`, has its origin at `place`; fingers away from the shoulder, to the neighbour."""
    away = place - body.joints[CABINPOSE.index["lr"[held.side] + "shoulder"]]
    away = away - (rp.matmul(away, up)) * up
    left = 1.0 - 2.0 * held.side
    away = rp.matmul(rotation_vector(left * _TOWARDS * up), away)
    thumb = left * up
    palm = palm_frame(np.zeros(3), np.cross(away, thumb), away)
    palm[:3, 3] = place - held.placed(palm)[:3, 3] - off_m * palm[:3, 2]
    return palm


def taken_over(held: Hold, vehicle_from_thing: Matrix, person: Person, body: PosedBody) -> Hold | None:
    """How somebody holds from now on what another one's hand held; None where the hand does not close around it."""
    side = 1 - held.side
    return closed_around(person, held, rp.matmul(invert(body.palms["lr"[side]]), vehicle_from_thing), side)
