"""The room that arms have: how far it is to the car's sides, and where the own trunk and thighs are.

Coarse shapes that answer in nanoseconds, so that an elbow can look for a place while a pose is made; the verdict is left to
`synth.validate`. The car's sides are height fields: from the middle plane of a seat sideways to the first surface. Trunk and
thighs are tubes about a bone's axis: the skin's distance from the axis by station and azimuth.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.core.frames import Matrix, invert
from cabinpose.scene.body import DOF_INDEX, SEGMENTS, Person
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.cabin import Cabin, Part, Seat, SeatSetting
from cabinpose.synth.posture.limbs import Frames, frames
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.seat_fit import common_fit

Array = NDArray[np.float64]

CELL_M = 0.015  # of a side's height field
_BOX_M = (-0.35, 0.95, -0.48, 0.75)  # of the H-point: rear, front, below, above
_BESIDE_M = 0.12  # nearer to the seat's middle plane nothing counts as a side
_BACK_FROM_M = (-0.30, -0.15)
_AZIMUTHS = 24
_TRUNK_STEP_M = 0.03
_TRUNK_FROM_M = -0.45  # of the thorax' origin, along its axis
_THIGH_STATIONS = 14
_ON_UPPER_ARM = np.array([0.55, 0.8, 1.0])
_ON_FOREARM = np.array([0.2, 0.5, 0.8])
_HAND_POINTS = 24
_CALF = 0.75  # a calf's radius, of the thigh's
# How much deeper than its skin a limb may lie in trunk, thigh and car: the validator's tolerances less a reserve (m).
YIELD_M = np.array([0.018, 0.006, 0.002])
_FOAM_M = 0.05  # a backrest gives way to flesh, not to the bone within
_THORAX = BONE_INDEX["spine01"]
_UPPERARM = tuple(BONE_INDEX[s + "upperarm"] for s in "lr")
_HAND = tuple(BONE_INDEX[s + "hand"] for s in "lr")
_SHIN = tuple(BONE_INDEX[s + "shank"] for s in "lr")
_FOOT = tuple(BONE_INDEX[s + "foot"] for s in "lr")
_THIGH = tuple(BONE_INDEX[s + "thigh"] for s in "lr")


class Room(NamedTuple):
    """What surrounds a person's arms in one seat, for the kernels.

    sides: (M, 2, X, Z) m from `middle` (M,) to the first surface on the left and on the right (inf: none), at points from
    `corner` (M, 2) x, z · back: (Y, Z) front of the backrest, m in the back
    frame · trunk: (S, A) radii about the thorax' axis moved forward by `trunk_x`; it bends
    with the pelvis, which is at `pelvis` (3,) of the thorax when seated · thigh: (T, A) radii of the
    left thigh about the femur, `femur` m long (the right one is its mirror image) · radii: (6,) of upper arm and forearm at
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


@njit(cache=True, nogil=True)
def _project(
    vertices: Array, faces: NDArray[np.integer], middle: float, x0: float, z0: float, cell: float, beside: float, field: Array
) -> None:
    """Lower a height field (2, X, Z) to a mesh (V, 3), (F, 3), seen from the plane y = middle to the left and right."""
    nx, nz = field.shape[1], field.shape[2]
    for k in range(len(faces)):
        a, b, c = vertices[faces[k, 0]], vertices[faces[k, 1]], vertices[faces[k, 2]]
        area = (b[0] - a[0]) * (c[2] - a[2]) - (c[0] - a[0]) * (b[2] - a[2])
        if abs(area) < 1e-12:
            continue
        i0 = max(math.ceil((min(a[0], b[0], c[0]) - x0) / cell), 0)
        i1 = min(math.floor((max(a[0], b[0], c[0]) - x0) / cell), nx - 1)
        j0 = max(math.ceil((min(a[2], b[2], c[2]) - z0) / cell), 0)
        j1 = min(math.floor((max(a[2], b[2], c[2]) - z0) / cell), nz - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                x, z = x0 + i * cell, z0 + j * cell
                u = ((x - a[0]) * (c[2] - a[2]) - (c[0] - a[0]) * (z - a[2])) / area
                v = ((b[0] - a[0]) * (z - a[2]) - (x - a[0]) * (b[2] - a[2])) / area
                if u < -1e-9 or v < -1e-9 or u + v > 1.0 + 1e-9:
                    continue
                away = a[1] + u * (b[1] - a[1]) + v * (c[1] - a[1]) - middle
                side = 0 if away > 0.0 else 1
                if abs(away) > beside:
                    field[side, i, j] = min(field[side, i, j], abs(away))


def no_sides() -> Array:
    """(2, X, Z) a height field with nothing in it: inf."""
    rear, front, below, above = _BOX_M
    return np.full((2, int((front - rear) / CELL_M) + 1, int((above - below) / CELL_M) + 1), np.inf)


def sides_corner(seat: Seat) -> Array:
    """(2,) x, z of the first point of a seat's height fields, m: they reach farther before the seat than behind it."""
    rear, front, below, _ = _BOX_M
    start = rear if math.cos(seat.facing_yaw) > 0.0 else -front
    return np.asarray(seat.design_h_point[[0, 2]] + (start, below), np.float64)


def lower_sides(
    field: Array, vertices: NDArray[np.floating], faces: NDArray[np.integer], middle: float, corner: Array, beside_m: float
) -> None:
    """Bring a mesh (V, 3), (F, 3) nearer than what a height field (2, X, Z) holds into it, in place.

    middle: y of the plane it is seen from · corner: (2,) as of `sides_corner` · beside_m: nearer to the plane nothing counts.
    """
    _project(np.asarray(vertices, np.float64), faces, middle, float(corner[0]), float(corner[1]), CELL_M, beside_m, field)


def _height_field(parts: list[Part], middle: float, corner: Array) -> Array:
    field = no_sides()
    for part in parts:
        lower_sides(field, part.surface.vertices, part.surface.faces, middle, corner, _BESIDE_M)
    return field


@lru_cache(maxsize=64)
def _backrest(cabin: Cabin, slot: str) -> Array:
    """The backrest's front (Y, Z): x in the back frame at points across and up from `_BACK_FROM_M`; -inf beside it."""
    field = np.full((2, int(-2 * _BACK_FROM_M[0] / CELL_M) + 1, int(0.75 / CELL_M)), np.inf)
    for part in cabin.parts:
        if part.group == f"seat:{slot}/back" and part.name.endswith("backrest"):
            x, y, z = part.surface.vertices.astype(np.float64).T
            _project(np.stack((y, 1.0 - x, z), axis=-1), part.surface.faces, 0.0, *_BACK_FROM_M, CELL_M, 0.0, field)
    return 1.0 - field[0]


@lru_cache(maxsize=64)
def _sides(cabin: Cabin, slot: str) -> tuple[Array, Array | None]:
    """The height fields of the car about a seat's design H-point, and of the seat's own armrests in its frame."""
    seat = cabin.seats[slot]
    body = [p for p in cabin.parts if p.group == "body"]
    fixed = _height_field(body, float(seat.design_h_point[1]), sides_corner(seat))
    own = [p for p in cabin.parts if p.group == f"seat:{slot}/base" and p.name.endswith("armrests")]
    return fixed, _height_field(own, 0.0, np.array([_BOX_M[0], _BOX_M[2]])) if own else None


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


def _limb_radii(person: Person, skeleton: Frames, skin: Array, segment: str, bone: str, end: str, stations: Array) -> Array:
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
    tube = _tube(local, _TRUNK_FROM_M, _TRUNK_STEP_M, int((top - _TRUNK_FROM_M) / _TRUNK_STEP_M) + 1)

    femur = person.segment_lengths["thigh"]
    bone = skeleton.bone("lthigh")
    leg = (skin[segment == SEGMENTS.index("lthigh")] - bone[:3, 3]) @ bone[:3, :3]
    thigh = _tube(leg * (1.0, 1.0, -1.0), 0.0, femur / (_THIGH_STATIONS - 1), _THIGH_STATIONS)
    radii = np.concatenate(
        (
            _limb_radii(person, skeleton, skin, "lupper_arm", "lupperarm", "lforearm", _ON_UPPER_ARM),
            _limb_radii(person, skeleton, skin, "lforearm", "lforearm", "lhand", _ON_FOREARM),
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
    fixed, own = _sides(cabin, seat.slot)
    h = seat.design_h_point
    low = np.array([_BOX_M[0], _BOX_M[2]])
    sides, middle, corner = fixed[None], h[1:2].astype(np.float64), sides_corner(seat)[None]
    if own is not None:
        place = seat.vehicle_from_seat(setting)[:3, 3]
        turned = own if abs(seat.facing_yaw) < 1e-6 else np.ascontiguousarray(own[::-1, ::-1])
        start = low if abs(seat.facing_yaw) < 1e-6 else np.array([-_BOX_M[1], _BOX_M[2]])
        sides, middle = np.stack((fixed, turned)), np.array([h[1], place[1]])
        corner = np.stack((corner[0], place[[0, 2]] + start))
    back, back_from_vehicle = _backrest(cabin, seat.slot), invert(seat.vehicle_from_back(setting))
    tube, trunk_x, pelvis, thigh, radii, hands, shoe = _own(person)
    femur = person.segment_lengths["thigh"]
    return Room(sides, middle, corner, back, back_from_vehicle, tube, trunk_x, pelvis, thigh, femur, radii, hands, shoe)


@njit(cache=True, nogil=True)
def beside(room: Room, x: float, y: float, z: float, r: float) -> tuple[float, float]:
    """How deep a ball lies in the car's sides (m, negative: clear), and the way out along y."""
    deepest, way = -1.0, 0.0
    nx, nz = room.sides.shape[2], room.sides.shape[3]
    for m in range(len(room.sides)):
        away = y - room.middle[m]
        side = 0 if away > 0.0 else 1
        for k in range(5):
            dx = 0.8 * r * (1.0 if k == 1 else -1.0 if k == 2 else 0.0)
            dz = 0.8 * r * (1.0 if k == 3 else -1.0 if k == 4 else 0.0)
            i = math.floor((x + dx - room.corner[m, 0]) / CELL_M + 0.5)
            j = math.floor((z + dz - room.corner[m, 1]) / CELL_M + 0.5)
            if i < 0 or j < 0 or i >= nx or j >= nz:
                continue
            depth = abs(away) + (r if k == 0 else 0.6 * r) - room.sides[m, side, i, j]
            if depth > deepest:
                deepest, way = depth, -1.0 if side == 0 else 1.0
    return deepest, way


@njit(cache=True, nogil=True)
def _radius(tube: Array, station: float, azimuth: float) -> float:
    """A tube's radius between stations and azimuths; 0 beyond its ends."""
    n, m = tube.shape
    if station < 0.0 or station > n - 1.0:
        return 0.0
    i = min(int(station), n - 2)
    u = station - i
    turn = (azimuth / (2.0 * math.pi) % 1.0) * m - 0.5
    j = math.floor(turn)
    v = turn - j
    a, b = j % m, (j + 1) % m
    return (1.0 - u) * ((1.0 - v) * tube[i, a] + v * tube[i, b]) + u * ((1.0 - v) * tube[i + 1, a] + v * tube[i + 1, b])


@njit(cache=True, nogil=True)
def in_own(room: Room, rotation: Array, position: Array, which: int, p: Array, r: float, way: Array) -> float:
    """How deep a ball about p (3,) lies in the trunk (`which` 2) or a thigh (0 left, 1 right), m; `way` (3,) out of it."""
    bone = _THORAX if which == 2 else _THIGH[which]
    local, twist = np.empty(3), 0.0
    for k in range(3):
        local[k] = 0.0
        for i in range(3):
            local[k] += rotation[bone, i, k] * (p[i] - position[bone, i])
    if which == 2:
        # Pelvis and loins do not follow the thorax as a rigid body: below it the tube goes over into the pelvis.
        share = min(max(local[2] / room.pelvis[2], 0.0), 1.0)
        yaw_x, yaw_y = 0.0, 0.0
        for i in range(3):
            away = position[0, i] - position[_THORAX, i]
            local[0] -= share * rotation[_THORAX, i, 0] * away
            local[1] -= share * rotation[_THORAX, i, 1] * away
            yaw_x += rotation[_THORAX, i, 0] * rotation[0, i, 0]
            yaw_y += rotation[_THORAX, i, 1] * rotation[0, i, 0]
        local[0] += share * room.pelvis[0] - room.trunk_x
        local[1] += share * room.pelvis[1]
        twist = share * math.atan2(yaw_y, yaw_x)
        station, mirror, tube = (local[2] - _TRUNK_FROM_M) / _TRUNK_STEP_M, 1.0, room.trunk
    else:
        station, mirror, tube = -local[2] / room.femur * (_THIGH_STATIONS - 1.0), 1.0 - 2.0 * which, room.thigh
    distance = math.hypot(local[0], local[1])
    radius = _radius(tube, station, math.atan2(mirror * local[1], local[0]) - twist)
    if radius == 0.0:
        return -1.0
    for i in range(3):
        way[i] = (rotation[bone, i, 0] * local[0] + rotation[bone, i, 1] * local[1]) / max(distance, 1e-6)
    return radius + r - distance


@njit(cache=True, nogil=True)
def behind_front(room: Room, p: Array) -> float:
    """How far a point (3,) lies behind the backrest's front, m (negative: before it, or beside the backrest)."""
    m = room.back_from_vehicle
    x = m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3]
    y = m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3]
    z = m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3]
    j = math.floor((z - _BACK_FROM_M[1]) / CELL_M + 0.5)
    deepest = -1.0
    for step in range(-1, 2):  # a bolster's edge
        i = math.floor((y - _BACK_FROM_M[0]) / CELL_M + 0.5) + step
        if i >= 0 and j >= 0 and i < room.back.shape[0] and j < room.back.shape[1]:
            deepest = max(deepest, room.back[i, j] - x)
    return deepest


@njit(cache=True, nogil=True)
def arm_trouble(room: Room, rotation: Array, position: Array, side: int, elbow: Array, allowed: Array) -> float:
    """The sum of squares (m2) of what an arm with its elbow at `elbow` (3,) lies too deep in trunk, thighs and the car."""
    shoulder, wrist = position[_UPPERARM[side]], position[_HAND[side]]
    p, way = np.empty(3), np.empty(3)
    total = 0.0
    for k in range(6):
        t = _ON_UPPER_ARM[k] if k < 3 else _ON_FOREARM[k - 3]
        for i in range(3):
            p[i] = shoulder[i] + t * (elbow[i] - shoulder[i]) if k < 3 else elbow[i] + t * (wrist[i] - elbow[i])
        r = room.radii[k]
        depth = beside(room, p[0], p[1], p[2], r)[0] - allowed[2]
        if depth > 0.0:
            total += depth * depth
        depth = behind_front(room, p) + max(r - _FOAM_M, 0.0)
        if depth > 0.0:
            total += depth * depth
        if k > 0:
            depth = in_own(room, rotation, position, 2, p, r, way) - allowed[0]
            if depth > 0.0:
                total += depth * depth
        if k > 1:
            for thigh in range(2):
                depth = in_own(room, rotation, position, thigh, p, r, way) - allowed[1]
                if depth > 0.0:
                    total += depth * depth
    return total


@njit(cache=True, nogil=True)
def hand_way_out(room: Room, rotation: Array, position: Array, palm: Array, side: int, allowed: Array, out: Array) -> float:
    """The shift (3,) m, into `out`, that takes a hand out of thighs, trunk and the car's sides; returns its length."""
    p, way, deepest = np.empty(3), np.empty(3), np.zeros(4)
    ways = np.zeros((4, 3))
    for n in range(room.hand.shape[1]):
        for i in range(3):
            p[i] = palm[i, 3]
            for k in range(3):
                p[i] += palm[i, k] * room.hand[side, n, k]
        for which in range(3):
            depth = in_own(room, rotation, position, which, p, 0.0, way) - (allowed[0] if which == 2 else allowed[1])
            if depth > deepest[which]:
                deepest[which] = depth
                ways[which] = way
        depth, sign = beside(room, p[0], p[1], p[2], 0.0)
        if depth - allowed[2] > deepest[3]:
            deepest[3] = depth - allowed[2]
            ways[3, 1] = sign
    for i in range(3):
        out[i] = 0.0
        for which in range(4):
            out[i] += deepest[which] * ways[which, i]
    return math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])


@njit(cache=True, nogil=True)
def foot_aside(room: Room, sole: Array, side: int) -> float:
    """The shift along y (m) that takes a shoe, sole frame (4, 4), out of tunnel and doors."""
    deepest, sign = 0.0, 0.0
    for n in range(6):
        x = (0.0, 0.6, 0.95)[n % 3] * room.shoe[0]
        y = room.shoe[1 + n // 3] * (1.0 - 2.0 * side)
        px = sole[0, 3] + sole[0, 0] * x + sole[0, 1] * y
        py = sole[1, 3] + sole[1, 0] * x + sole[1, 1] * y
        for up in (0.03, 0.06):
            depth, way = beside(room, px, py, sole[2, 3] + up, 0.005)
            if depth > deepest:
                deepest, sign = depth, way
    return sign * deepest


@njit(cache=True, nogil=True)
def leg_aside(room: Room, position: Array, side: int) -> float:
    """The shift along y (m) that takes a leg, thigh to ankle, out of the car's sides and neighbours."""
    hip, knee, ankle = position[_THIGH[side]], position[_SHIN[side]], position[_FOOT[side]]
    girth = room.thigh[_THIGH_STATIONS // 2].mean()
    deepest, sign = 0.0, 0.0
    for k in range(5):
        t = (0.6, 0.95, 0.15, 0.45, 0.75)[k]
        a, b = (hip, knee) if k < 2 else (knee, ankle)
        r = girth if k < 2 else _CALF * girth
        depth, way = beside(room, a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2]), r)
        if depth > deepest:
            deepest, sign = depth, way
    return sign * deepest


@njit(cache=True, nogil=True)
def shoulder_aside(room: Room, position: Array) -> float:
    """How deep (m, + at the left) the nearer shoulder lies in the car's sides."""
    deepest, result = 0.0, 0.0
    for side in range(2):
        p = position[_UPPERARM[side]]
        depth, _ = beside(room, p[0], p[1], p[2], room.radii[0] + 0.01)
        if depth > deepest:
            deepest, result = depth, depth * (1.0 - 2.0 * side)
    return result
