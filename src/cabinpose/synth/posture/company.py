"""Neighbours: what people side by side on a bench, or face to face, leave each other.

Who sits down first keeps arms and knees on the own side of a border, which leaves wide people more; who comes later finds the
neighbours as they sit. Where shoulders have no room side by side, as in most full rear rows, people lean forward, turn
or move away by as little as makes room. What still collides is left to `synth.validate`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import pose as native
from cabinpose.core.frames import Matrix
from cabinpose.scene.body import SEGMENTS, Person
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.feet import is_opposite
from cabinpose.synth.posture.limbs import LOWER, UPPER, frames
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.room import Room, arm_radii, no_sides, sides_corner, spread_points
from cabinpose.synth.posture.seat_fit import common_fit

Array = NDArray[np.float64]

CLOSE_M = 0.6  # between seats whose people touch
_ROW_M = 0.4  # fore-aft between the seats of one row
_BESIDE_M = 0.02  # a neighbour nearer than this to the own middle plane is everywhere
_SPINE = tuple(BONE_INDEX[name] for name in ("pelvis", "spine04", "spine03", "spine02", "spine01"))
_ARMS_OUT_M = 0.04  # beyond the breadth of the shoulders that nobody is denied
_FLANK_POINTS = 72
_SHOULDER_OVER_HIP_M = 0.45
_SHIFTED_M = 0.03  # by which neighbours move away from each other
_FORWARD_SHARE = 0.65  # of those in the middle who give way before the others do
_CROWDED_OUT = frozenset(("lean_side", "phone_ear"))  # what needs the neighbour's room
_IN_THE_MIDDLE_OUT = frozenset(("phone_ear_outer",))


class Company(NamedTuple):
    """What neighbours mean for one person in one seat.

    people, borders: (2, X, Z) m, height fields as in `Room`: those who sit already, and the borders
    to close ones, which elbows keep · close: whether somebody sits within touch at the left hand and at the right ·
    lean: forward, before anything else, rad · faced: somebody sits opposite, feet between the two.
    """

    people: Array
    borders: Array
    close: tuple[bool, bool]
    lean: float
    faced: bool

    @property
    def left_out(self) -> frozenset[str]:
        """Names of the actions that have no room."""
        if not any(self.close):
            return frozenset()
        return _CROWDED_OUT | _IN_THE_MIDDLE_OUT if all(self.close) else _CROWDED_OUT


def beside_each_other(one: Seat, two: Seat) -> bool:
    """Whether two seats belong to one row."""
    same_way = math.cos(one.facing_yaw - two.facing_yaw) > 0.0
    return one.slot != two.slot and same_way and abs(float(one.design_h_point[0] - two.design_h_point[0])) < _ROW_M


def close_seats(seat: Seat, cabin: Cabin, taken: Sequence[str]) -> list[str]:
    """Those of the seats `taken` whose people touch somebody in `seat`."""
    return [
        s
        for s in taken
        if beside_each_other(seat, cabin.seats[s])
        and abs(float(seat.design_h_point[1] - cabin.seats[s].design_h_point[1])) < CLOSE_M
    ]


def half_breadth(person: Person) -> float:
    """Half of a seated person's breadth over the deltoids, m."""
    return float(common_fit(person).shoulders[0, 1]) + float(arm_radii(person)[0])


def company_of(
    person: Person,
    slot: str,
    cabin: Cabin,
    others: Mapping[str, Person],
    seated: Mapping[str, NDArray[np.floating]],
    *,
    rng: np.random.Generator,
) -> Company | None:
    """What the people around a seat mean for the one who is to sit in it; None where there is nobody near.

    others: everybody else in the car by slot · seated: the skin (V, 3) m, vehicle frame, of those who sit already.
    """
    seat = cabin.seats[slot]
    row = [s for s in others if beside_each_other(seat, cabin.seats[s])]
    opposite = any(is_opposite(seat, cabin.seats[s]) for s in others)
    if not row and not opposite:
        return None
    close = close_seats(seat, cabin, row)
    field, borders, corner, middle = no_sides(), no_sides(), sides_corner(seat), float(seat.design_h_point[1])
    overlap = passing = 0.0
    for name in row:
        away = float(cabin.seats[name].design_h_point[1]) - middle
        if name in seated:
            native.lower_sides(seated[name], others[name].skin_faces, middle, corner, _BESIDE_M, field)
        if name in close and name not in seated:
            mine, theirs = half_breadth(person), half_breadth(others[name])
            side = 0 if away > 0.0 else 1
            border = max(abs(away) * mine / (mine + theirs), mine + _ARMS_OUT_M)
            borders[side] = np.minimum(borders[side], border)
            if name not in seated:
                overlap = max(overlap, mine + theirs - abs(away) - _SHIFTED_M)
                passing = max(passing, float(arm_radii(person)[0] + arm_radii(others[name])[0]))
    lean = 0.0
    if overlap > 0.0:
        chance, share = rng.random(2)
        if chance < _FORWARD_SHARE:
            ahead = math.sqrt(passing**2 - (passing - min(overlap, passing)) ** 2)
            lean = (1.0 + 0.25 * share) * math.asin(ahead / _SHOULDER_OVER_HIP_M)
    left = [math.cos(seat.facing_yaw) * (float(cabin.seats[s].design_h_point[1]) - middle) for s in close]
    return Company(field, borders, (any(y > 0.0 for y in left), any(y < 0.0 for y in left)), float(lean), opposite)


def within(room: Room, field: Array) -> Room:
    """A room with what a height field (2, X, Z) of `Company` for the same seat holds in it."""
    if np.isinf(field).all():
        return room
    sides = room.sides.copy()
    np.minimum(sides[0], field, out=sides[0])  # seen from one plane: of the two the nearer counts
    return room._replace(sides=sides)


@kept_with_person
def _flanks(person: Person) -> tuple[NDArray[np.int64], Array]:
    """Points (N, 3) of a person's trunk that are far from each other, each in the frame of a bone (N,) of the spine."""
    fit = common_fit(person)
    skin = person.pose(fit.q, fit.seat_from_root).skin.astype(np.float64)
    trunk = skin[np.isin(person.skin_segment, [SEGMENTS.index(s) for s in ("pelvis", "abdomen", "thorax")])]
    points = spread_points(trunk[np.abs(trunk[:, 1]) > 0.06], np.eye(4), _FLANK_POINTS)
    skeleton = frames(fit.q, person.rest, fit.seat_from_root)
    away = points[:, None] - skeleton.position[list(_SPINE)]
    bone = np.array(_SPINE)[np.argmin(np.linalg.norm(away[..., [0, 2]], axis=-1), axis=1)]
    local = np.einsum("nij,ni->nj", skeleton.rotation[bone], points - skeleton.position[bone])
    return bone, np.ascontiguousarray(local)


def give_way(q: Array, person: Person, vehicle_from_root: Matrix, seat: Seat, room: Room) -> Matrix:
    """Turn and bend a trunk out of its neighbours and the car's sides, in place of q; returns `vehicle_from_root` then.

    room: with the neighbours in it.
    """
    root = vehicle_from_root.copy()
    native.give_way(q, person.rest, root, math.cos(seat.facing_yaw), room, _flanks(person), LOWER, UPPER)
    return root
