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
from numba import njit
from numpy.typing import NDArray

from cabinpose.core.frames import Matrix
from cabinpose.scene.body import DOF_INDEX, SEGMENTS, Person
from cabinpose.scene.body.kinematics import RestArrays, fk_into
from cabinpose.scene.body.rig import BONE_INDEX, N_MAIN
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.feet import is_opposite
from cabinpose.synth.posture.limbs import LOWER, UPPER, frames
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.room import Room, arm_radii, beside, lower_sides, no_sides, sides_corner, spread_points
from cabinpose.synth.posture.seat_fit import common_fit

Array = NDArray[np.float64]

CLOSE_M = 0.6  # between seats whose people touch
_ROW_M = 0.4  # fore-aft between the seats of one row
_BESIDE_M = 0.02  # a neighbour nearer than this to the own middle plane is everywhere
_SPINE = tuple(BONE_INDEX[name] for name in ("pelvis", "spine04", "spine03", "spine02", "spine01"))
_UPPERARM = tuple(BONE_INDEX[s + "upperarm"] for s in "lr")
_ARMS_OUT_M = 0.04  # beyond the breadth of the shoulders that nobody is denied
_FLANK_POINTS = 72
_THORAX = BONE_INDEX["spine01"]
_TO_ELBOW_M = np.array([0.14, 0.0, -0.22])  # from the shoulder, in the thorax' frame
_DELTOID_M = 0.008  # more than the upper arm's own radius
_SHOULDER_OVER_HIP_M = 0.45
_SHIFTED_M = 0.03  # by which neighbours move away from each other
_FORWARD_SHARE = 0.65  # of those in the middle who give way before the others do
_LATERAL, _ROTATION = DOF_INDEX["lumbar.lateral"], DOF_INDEX["thorax.rotation"]
# How a trunk gives way: forward lean (rad), shift to the left (m), lateral bend and turn of the chest (rad): the step of the
# search and what is as uncomfortable as a centimetre of squeeze at one point.
_STEPS = np.array([math.radians(4.0), 0.012, math.radians(3.0), math.radians(5.0)])
_EASES = np.array([math.radians(5.0), 0.015, math.radians(4.0), math.radians(7.0)])
_MOST = np.array([math.radians(20.0), 0.06, math.radians(10.0), math.radians(15.0)])
_SWEEPS = 3
_SQUEEZE_M = 0.006  # that both put up with
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
            lower_sides(field, seated[name], others[name].skin_faces, middle, corner, _BESIDE_M)
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


def within(room: Room, seat: Seat, field: Array) -> Room:
    """A room with one more height field (2, X, Z) of `Company` in it."""
    if np.isinf(field).all():
        return room
    corner = sides_corner(seat)
    return room._replace(
        sides=np.concatenate((room.sides, field[None])),
        middle=np.append(room.middle, float(seat.design_h_point[1])),
        corner=np.concatenate((room.corner, corner[None])),
    )


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


@njit(cache=True, nogil=True)
def _squeeze(room: Room, rotation: Array, position: Array, bone: NDArray[np.int64], local: Array, deltoid: float) -> float:
    """The sum of squares (cm2) of what trunk and shoulders lie too deep in neighbours and the car's sides."""
    total = 0.0
    for n in range(len(bone) + 4):
        r = 0.0
        if n < len(bone):
            b = bone[n]
            x, y, z = position[b, 0], position[b, 1], position[b, 2]
            for k in range(3):
                x += rotation[b, 0, k] * local[n, k]
                y += rotation[b, 1, k] * local[n, k]
                z += rotation[b, 2, k] * local[n, k]
        else:
            b = _UPPERARM[(n - len(bone)) % 2]
            x, y, z, r = position[b, 0], position[b, 1], position[b, 2], deltoid
            if n >= len(bone) + 2:  # where an elbow may hang
                for k in (0, 2):
                    x += rotation[_THORAX, 0, k] * _TO_ELBOW_M[k]
                    y += rotation[_THORAX, 1, k] * _TO_ELBOW_M[k]
                    z += rotation[_THORAX, 2, k] * _TO_ELBOW_M[k]
        depth = beside(room, x, y, z, r)[0] - _SQUEEZE_M
        if depth > 0.0:
            total += (3.0 if r > 0.0 else 1.0) * (100.0 * depth) ** 2
    return total


@njit(cache=True, nogil=True)
def _moved(q: Array, root: Array, forward: float, way: Array, q_out: Array, root_out: Array) -> None:
    """q (D,) and root (4, 4) with a trunk that gives way by `way` (lean, shift, bend, turn)."""
    c, s = math.cos(way[0]), math.sin(way[0])
    root_out[:] = root
    for i in range(3):
        root_out[i, 0] = c * root[i, 0] - s * root[i, 2]
        root_out[i, 2] = s * root[i, 0] + c * root[i, 2]
    root_out[1, 3] += forward * way[1]
    q_out[:] = q
    q_out[_LATERAL] += way[2]
    q_out[_ROTATION] += way[3]


@njit(cache=True, nogil=True)
def _give_way(
    q: Array, rest: RestArrays, root: Array, forward: float, room: Room, bone: NDArray[np.int64], local: Array, deltoid: float,
    lower: Array, upper: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """The way (lean, shift, bend, turn) of least squeeze and discomfort, one coordinate after the other; q, root with it."""
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    way, trial = np.zeros(4), np.empty(4)
    q_out, root_out = q.copy(), root.copy()
    fk_into(q, rest, root, rotation, position)
    best = _squeeze(room, rotation, position, bone, local, deltoid)
    for sweep in range(_SWEEPS):
        before = best
        for axis in (1, 2, 0, 3):
            start = way[axis]
            for k in range(-5, 6):
                trial[:] = way
                trial[axis] = start + k * _STEPS[axis] / (1.0 + sweep)
                if abs(trial[axis]) > _MOST[axis] or (axis == 0 and trial[0] < 0.0):
                    continue
                _moved(q, root, forward, trial, q_out, root_out)
                outside = 0.0
                for d in (_LATERAL, _ROTATION):
                    outside += max(lower[d] - q_out[d], q_out[d] - upper[d], 0.0)
                cost = 1e3 * outside
                for i in range(4):
                    cost += (trial[i] / _EASES[i]) ** 2
                if cost >= best:
                    continue
                fk_into(q_out, rest, root_out, rotation, position)
                cost += _squeeze(room, rotation, position, bone, local, deltoid)
                if cost < best:
                    best = cost
                    way[axis] = trial[axis]
        if best > 0.99 * before:
            break
    _moved(q, root, forward, way, q_out, root_out)
    return q_out, root_out


def give_way(q: Array, person: Person, vehicle_from_root: Matrix, seat: Seat, room: Room) -> Matrix:
    """Turn and bend a trunk out of its neighbours and the car's sides, in place of q; returns `vehicle_from_root` then.

    room: with the neighbours in it.
    """
    bone, local = _flanks(person)
    deltoid = float(room.radii[0]) + _DELTOID_M
    forward = math.cos(seat.facing_yaw)
    q[:], root = _give_way(q, person.rest, vehicle_from_root, forward, room, bone, local, deltoid, LOWER, UPPER)
    return np.asarray(root)
