"""Neighbours: what people side by side on a bench, or face to face, mean for what each of them seeks.

Where shoulders have no room side by side, as in most full rear rows, some lean forward from the start; the rest is left to the
solver, in which all of a row give way to each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, SEGMENTS, Person
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.seat_fit import common_fit

CLOSE_M = 0.6  # between seats whose people touch
_ROW_M = 0.4  # fore-aft between the seats of one row
_SHOULDER_OVER_HIP_M = 0.45
_SHIFTED_M = 0.03  # by which neighbours move away from each other
_FORWARD_SHARE = 0.8  # of the people between two others who lean forward from the start
_BESIDE_TUNNEL_M = 0.27  # from the middle of a car to what the feet of those who sit beside leave to the one in the middle
_ASIDE_M = 0.04
LOW_TUNNEL_M = 0.04  # which feet stand on
_TUNNEL_AHEAD_M = 1.0  # of the rearmost seat, where feet stand


class Neighbours(NamedTuple):
    """What neighbours mean for one person in one seat.

    close: whether somebody sits within touch at the left hand and at the right · feet: (m) how far to the left and to the right
    of the seat's middle the feet have room, inf where nobody is · lean: forward, before anything else, rad, -inf where nobody is
    · aside: moved to the left (m), away from the only neighbour · faced: somebody sits opposite, feet between the two.
    """

    close: tuple[bool, bool]
    feet: tuple[float, float]
    lean: float
    aside: float
    faced: bool


NOBODY = Neighbours((False, False), (math.inf, math.inf), -math.inf, 0.0, False)


def beside_each_other(one: Seat, two: Seat) -> bool:
    """Whether two seats belong to one row."""
    same_way = rp.cos(one.facing_yaw - two.facing_yaw) > 0.0
    return one.slot != two.slot and same_way and abs(float(one.design_h_point[0] - two.design_h_point[0])) < _ROW_M


@lru_cache(maxsize=32)
def tunnel_m(cabin: Cabin) -> float:
    """Height of the floor's tunnel along the centre line over the floor beside it, m; 0 in a car without a part "floor"."""
    floor = next((p.surface.vertices for p in cabin.parts if p.name == "floor"), None)
    if floor is None:
        return 0.0
    rear = min(float(s.design_h_point[0]) for s in cabin.seats.values())
    before = (floor[:, 0] > rear) & (floor[:, 0] < rear + _TUNNEL_AHEAD_M)
    across = np.abs(floor[:, 1])
    middle, beside = floor[before & (across < 0.05), 2], floor[before & (across > 0.2) & (across < 0.5), 2]
    return float(middle.max() - np.median(beside)) if len(middle) and len(beside) else 0.0


def is_opposite(seat: Seat, other: Seat) -> bool:
    """Whether two seats face each other."""
    ahead = rp.cos(seat.facing_yaw) * float(other.design_h_point[0] - seat.design_h_point[0])
    return rp.cos(seat.facing_yaw - other.facing_yaw) < -0.5 and ahead > 0.0


def close_seats(seat: Seat, cabin: Cabin, taken: Sequence[str]) -> list[str]:
    """Those of the seats `taken` whose people touch somebody in `seat`."""
    return [
        s
        for s in taken
        if beside_each_other(seat, cabin.seats[s])
        and abs(float(seat.design_h_point[1] - cabin.seats[s].design_h_point[1])) < CLOSE_M
    ]


@kept_with_person
def _arm_radius(person: Person) -> float:
    """Of the upper arm's thick part, m."""
    near, far = (person.rest.heads[BONE_INDEX[name]] for name in ("lupperarm", "lforearm"))
    away = person.rest_skin[person.skin_segment == SEGMENTS.index("lupper_arm")] - near
    length = rp.norm(far - near)
    along = (away * (far - near)).sum(axis=1) / length
    radius = np.linalg.norm(away - along[:, None] * (far - near) / length, axis=1)
    return float(np.percentile(radius[np.abs(along - 0.55 * length) < 0.15 * length], 85))


def half_breadth(person: Person) -> float:
    """Half of a seated person's breadth over the deltoids, m."""
    return float(common_fit(person).shoulders[0, 1]) + _arm_radius(person)


def _between(seat: Seat, cabin: Cabin, taken: Sequence[str]) -> tuple[int, float]:
    """How much somebody sits between others: by close neighbours, then by nearness to the middle."""
    return len(close_seats(seat, cabin, taken)), -abs(float(seat.design_h_point[1]))


def neighbours_of(
    person: Person, slot: str, cabin: Cabin, others: Mapping[str, Person], *, rng: np.random.Generator
) -> Neighbours:
    """What the people around a seat mean for the person who is to sit in it.

    Parameters
    ----------
    person, slot, cabin
        Who is to sit where.
    others
        Everybody else in the car, by slot.
    rng
        Decides who leans forward, and how far.

    Returns
    -------
    Neighbours
        `NOBODY` where nobody sits beside or opposite.
    """
    seat = cabin.seats[slot]
    row = [s for s in others if beside_each_other(seat, cabin.seats[s])]
    opposite = any(is_opposite(seat, cabin.seats[s]) for s in others)
    if not row and not opposite:
        return NOBODY
    close = close_seats(seat, cabin, row)
    middle = float(seat.design_h_point[1])
    overlap = passing = 0.0
    for name in close:
        away = abs(float(cabin.seats[name].design_h_point[1]) - middle)
        overlap = max(overlap, half_breadth(person) + half_breadth(others[name]) - away - _SHIFTED_M)
        passing = max(passing, _arm_radius(person) + _arm_radius(others[name]))
    lean, shares = 0.0, rng.random(2)
    everybody = (slot, *others)
    first = all(_between(cabin.seats[s], cabin, everybody) < _between(seat, cabin, everybody) for s in close)
    if overlap > 0.0 and first and shares[0] < _FORWARD_SHARE:
        ahead = math.sqrt(passing**2 - (passing - min(overlap, passing)) ** 2)
        lean = (1.0 + 0.25 * shares[1]) * rp.arcsin(ahead / _SHOULDER_OVER_HIP_M)
    left = [rp.cos(seat.facing_yaw) * (float(cabin.seats[s].design_h_point[1]) - middle) for s in close]
    feet = [math.inf, math.inf]
    for name, y in zip(close, left, strict=True):
        feet[0 if y > 0.0 else 1] = _foot_border(seat, cabin.seats[name], cabin)
    aside = -math.copysign(min(_ASIDE_M, max(overlap, 0.0) / 3.0), left[0]) if len(close) == 1 else 0.0
    return Neighbours((any(y > 0.0 for y in left), any(y < 0.0 for y in left)), (feet[0], feet[1]), float(lean), aside, opposite)


def _foot_border(seat: Seat, other: Seat, cabin: Cabin) -> float:
    """How far (m) from a seat's middle feet have room towards a neighbour: on both sides of a tunnel in the middle."""
    away = abs(float(other.design_h_point[1] - seat.design_h_point[1]))
    in_the_middle = [abs(float(s.design_h_point[1])) < 0.05 for s in (seat, other)]
    if tunnel_m(cabin) <= LOW_TUNNEL_M or not any(in_the_middle):
        return 0.5 * away
    return _BESIDE_TUNNEL_M if in_the_middle[0] else away - _BESIDE_TUNNEL_M
