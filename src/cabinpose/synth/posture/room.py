"""The room that arms have: how far it is to the car's sides, and where the own trunk and thighs are.

Coarse shapes that `_native.pose` asks in nanoseconds, so that an elbow can look for a place while a pose is made; the verdict
is left to `synth.validate`. The car's sides are height fields: from the middle plane of a seat sideways to the first surface.
Trunk and thighs are tubes about a bone's axis: the skin's distance from the axis by station and azimuth.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import pose as native
from cabinpose.core.frames import Matrix, invert
from cabinpose.scene.body import DOF_INDEX, SEGMENTS, Person
from cabinpose.scene.cabin import Cabin, Part, Seat, SeatSetting
from cabinpose.synth.posture.limbs import Frames, frames
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.seat_fit import common_fit

Array = NDArray[np.float64]

CELL_M: float = native.CELL_M  # of a side's height field
_BOX_M = (-0.35, 0.95, -0.48, 0.75)  # of the H-point: rear, front, below, above
_BESIDE_M = 0.12  # nearer to the seat's middle plane nothing counts as a side
_BACK_FROM_M = np.array(native.BACK_FROM_M)  # y, z of a backrest's front in the back frame
_AZIMUTHS = 24
_HAND_POINTS = 24
# How much deeper than its skin a limb may lie in trunk, thigh and car: the validator's tolerances less a reserve (m).
YIELD_M = np.array([0.018, 0.006, 0.002])


class Room(NamedTuple):
    """What surrounds a person's arms in one seat, for the kernels.

    sides: (M, 2, X, Z) m from `middle` (M,) to the first surface on the left and on the right (inf: none), at points from
    `corner` (M, 2) x, z: of the car with the neighbours, then of the seat's own armrests if there are any · back: (Y, Z)
    front of the backrest, m in the back frame · trunk: (S, A) radii about the thorax' axis moved forward by `trunk_x`; it
    bends with the pelvis, which is at `pelvis` (3,) of the thorax when seated · thigh: (T, A) radii of the left thigh about the
    femur, `femur` m long (the right one is its mirror image) · radii: (6,) of upper arm and forearm at
    their stations · hand: (2, N, 3) points of the skin of left and right hand at rest, palm frame ·
    shoe: (3,) of the left foot in its sole's frame: toes' x, outer edges' y.
    """

    sides: Array
    middle: Array
    corner: Array
    back: Array
    back_from_vehicle: Array
    trunk: Array
    trunk_x: float
    pelvis: Array
    thigh: Array
    femur: float
    radii: Array
    hand: Array
    shoe: Array


def no_sides() -> Array:
    """(2, X, Z) a height field with nothing in it: inf."""
    rear, front, below, above = _BOX_M
    return np.full((2, int((front - rear) / CELL_M) + 1, int((above - below) / CELL_M) + 1), np.inf)


def sides_corner(seat: Seat) -> Array:
    """(2,) x, z of the first point of a seat's height fields, m: they reach farther before the seat than behind it."""
    x, _, z = seat.design_h_point.tolist()
    return np.array(_corner(seat, x, z))


def _corner(seat: Seat, x: float, z: float) -> tuple[float, float]:
    """The same about an H-point at x, z."""
    rear, front, below, _ = _BOX_M
    return x + (rear if math.cos(seat.facing_yaw) > 0.0 else -front), z + below


def _height_field(parts: list[Part], middle: float, corner: Array) -> Array:
    field = no_sides()
    for part in parts:
        native.lower_sides(part.surface.vertices, part.surface.faces, middle, corner, _BESIDE_M, field)
    return field


@lru_cache(maxsize=64)
def _backrest(cabin: Cabin, slot: str) -> Array:
    """The backrest's front (Y, Z): x in the back frame at points across and up from `_BACK_FROM_M`; -inf beside it."""
    field = np.full((2, int(-2 * _BACK_FROM_M[0] / CELL_M) + 1, int(0.75 / CELL_M)), np.inf)
    for part in cabin.parts:
        if part.group == f"seat:{slot}/back" and part.name.endswith("backrest"):
            x, y, z = part.surface.vertices.astype(np.float64).T
            native.lower_sides(np.stack((y, 1.0 - x, z), axis=-1), part.surface.faces, 0.0, _BACK_FROM_M, 0.0, field)
    return 1.0 - field[0]


@lru_cache(maxsize=64)
def _sides(cabin: Cabin, slot: str) -> Array:
    """(M, 2, X, Z) the height field of the car about a seat's design H-point, then that of the seat's own armrests, if any."""
    seat = cabin.seats[slot]
    body = [p for p in cabin.parts if p.group == "body"]
    fields = [_height_field(body, float(seat.design_h_point[1]), sides_corner(seat))]
    own = [p for p in cabin.parts if p.group == f"seat:{slot}/base" and p.name.endswith("armrests")]
    if own:
        field = _height_field(own, 0.0, np.array([_BOX_M[0], _BOX_M[2]]))  # in the seat's frame
        fields.append(field if math.cos(seat.facing_yaw) > 0.0 else field[::-1, ::-1])
    return np.stack(fields)


def _tube(local: Array, start: float, step: float, count: int) -> Array:
    """Radii (count, A) of points (N, 3) about the z axis: the outermost at each station and azimuth, gaps filled."""
    azimuth = np.floor((np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) % 1.0) * _AZIMUTHS).astype(int) % _AZIMUTHS
    station = np.rint((local[:, 2] - start) / step).astype(int)
    good = (station >= 0) & (station < count)
    radii = np.zeros((count, _AZIMUTHS))
    np.maximum.at(radii, (station[good], azimuth[good]), np.hypot(local[good, 0], local[good, 1]))
    for row in radii:
        known = np.flatnonzero(row)
        if len(known):
            around = np.concatenate((known - _AZIMUTHS, known, known + _AZIMUTHS))
            row[:] = np.interp(np.arange(_AZIMUTHS), around, np.tile(row[known], 3))
    return radii


def _limb_radii(
    person: Person, skeleton: Frames, skin: Array, segment: str, bone: str, end: str, stations: tuple[float, ...]
) -> Array:
    a, b = skeleton.bone(bone)[:3, 3], skeleton.bone(end)[:3, 3]
    length = float(np.linalg.norm(b - a))
    away = skin[person.skin_segment == SEGMENTS.index(segment)] - a
    along = away @ (b - a) / length
    radius = np.linalg.norm(away - along[:, None] * (b - a) / length, axis=1)
    near = [np.abs(along - s * length) < 0.15 * length for s in stations]
    return np.array([float(np.percentile(radius[n], 85)) for n in near])


@kept_with_person
def _own(person: Person) -> tuple[Array, float, Array, Array, Array, Array, Array]:
    """A seated person's trunk, its axis, thigh, arm radii and hand points: see `Room`.

    They are given in the bones' frames, where the seat hardly matters: a common one stands for all.
    """
    fit = common_fit(person)
    q = fit.q.copy()
    for side in "lr":
        q[DOF_INDEX[side + "hand.grip"]] = 0.1
    posed = person.pose(q, fit.seat_from_root)
    skin = posed.skin.astype(np.float64)
    skeleton = frames(q, person.rest, fit.seat_from_root)
    segment = person.skin_segment
    thorax = skeleton.bone("spine01")
    trunk = np.isin(segment, [SEGMENTS.index(s) for s in ("pelvis", "abdomen", "thorax")])
    local = (skin[trunk] - thorax[:3, 3]) @ thorax[:3, :3]
    upper_arm = person.segment_lengths["upper_arm"]
    top = float(((fit.shoulders[0] - thorax[:3, 3]) @ thorax[:3, :3])[2]) - 0.3 * upper_arm
    local = local[local[:, 2] < top]
    trunk_x = 0.5 * float(np.percentile(local[:, 0], 2) + np.percentile(local[:, 0], 98))
    local[:, 0] -= trunk_x
    start, step = native.TRUNK_FROM_M, native.TRUNK_STEP_M
    tube = _tube(local, start, step, int((top - start) / step) + 1)

    femur = person.segment_lengths["thigh"]
    bone = skeleton.bone("lthigh")
    leg = (skin[segment == SEGMENTS.index("lthigh")] - bone[:3, 3]) @ bone[:3, :3]
    stations = native.THIGH_STATIONS
    thigh = _tube(leg * (1.0, 1.0, -1.0), 0.0, femur / (stations - 1), stations)
    radii = np.concatenate(
        (
            _limb_radii(person, skeleton, skin, "lupper_arm", "lupperarm", "lforearm", native.ON_UPPER_ARM),
            _limb_radii(person, skeleton, skin, "lforearm", "lforearm", "lhand", native.ON_FOREARM),
        )
    )
    pelvis = (skeleton.position[0] - thorax[:3, 3]) @ thorax[:3, :3]
    foot = skin[segment == SEGMENTS.index("lfoot")] - posed.soles["l"][:3, 3]
    foot = foot @ posed.soles["l"][:3, :3]
    shoe = np.array([foot[:, 0].max(), foot[:, 1].min(), foot[:, 1].max()])
    hands = np.stack([spread_points(skin[segment == SEGMENTS.index(s + "hand")], posed.palms[s], _HAND_POINTS) for s in "lr"])
    return tube, trunk_x, pelvis, thigh, radii, hands, shoe


def arm_radii(person: Person) -> Array:
    """(6,) m radii of a person's upper arm and forearm, from shoulder to wrist."""
    return _own(person)[4]


def spread_points(points: Array, frame: Matrix, count: int) -> Array:
    """`count` of points (N, 3) that lie furthest from each other, in a frame: each next one furthest from those before it."""
    local = (points - frame[:3, 3]) @ frame[:3, :3]
    chosen = [int(np.argmax(local[:, 0]))]
    distance = np.full(len(local), np.inf)
    for _ in range(count - 1):
        distance = np.minimum(distance, np.linalg.norm(local - local[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return local[chosen]


def room_for(person: Person, cabin: Cabin, seat: Seat, setting: SeatSetting) -> Room:
    """The room of a person's arms in a seat at a setting; all but the placing of folding armrests is cached."""
    sides = _sides(cabin, seat.slot)
    x, y, z = seat.design_h_point.tolist()
    middle, corner = [y], [_corner(seat, x, z)]
    if len(sides) > 1:
        x, y, z = seat.h_point(setting).tolist()
        middle.append(y)
        corner.append(_corner(seat, x, z))
    back, back_from_vehicle = _backrest(cabin, seat.slot), invert(seat.vehicle_from_back(setting))
    tube, trunk_x, pelvis, thigh, radii, hands, shoe = _own(person)
    femur = person.segment_lengths["thigh"]
    own = tube, trunk_x, pelvis, thigh, femur, radii, hands, shoe
    return Room(sides, np.array(middle), np.array(corner), back, back_from_vehicle, *own)
