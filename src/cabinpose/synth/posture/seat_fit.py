"""A body in a seat: pelvis and trunk on cushion and backrest, thighs on the cushion.

The H-point machine of SAE J826 defines where a seat puts the H-point of its manikin; a person's own femur heads come
to lie near it, by how thick their flesh is behind and below. So the pelvis starts on the H-point and is then moved until
the skin presses into cushion and backrest by a stated depth, its pitch until lower and upper back press alike. The shift
away from the H-point is reported. Sitting turns the pelvis backwards and takes the lordosis out of the lumbar spine
(Reed, Manary, Flannagan and Schneider 2002, "A statistical method for predicting automobile driving posture").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose._native import pose as native
from cabinpose.core import Bools, Bytes, Floats, Floats32, Ints, Matrix, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOF_INDEX, DOFS, SEGMENTS, Person, vertex_segments
from cabinpose.scene.cabin import Seat
from cabinpose.scene.things import Sitting
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.memory import kept_with_person

# How far the skin of the back is behind the free surface, of buttocks and thighs below it: of a car's seat, of a child's.
_ON_FOAM, _ON_PADDING = (0.022, 0.038, 0.014), (0.008, 0.012, 0.006)
_HIP_OFF_M = (0.085, 0.065)  # of a child, off back and cushion of a child seat
_LUMBAR, _THORAX = np.radians((30.0, 8.0))  # flexion of the spine against standing
_ABDUCTION = np.radians(7.0)  # of the thighs, at rest
_CUSHION_FRONT_M = 0.375  # front edge of production cushions ahead of the H-point
_EDGES_M = 0.37, 0.33  # where those of front and rear seats are round
_IN_CAR = _CUSHION_FRONT_M, _ON_FOAM
_BEFORE_EDGE_M, _BEFORE_RIM_M = 0.08, 0.10  # of the ankles of shins whose calves lie over a car's cushion, over a child seat
_MAX_SLIDE_M = 0.12
_ROUNDS = 7
_COMMON_SEAT = (0.25, 0.058, 0.095, 0.42)  # angle of the cushion, H-point above it and before the back, torso angle (rad, m)
_TRUNK, _THIGHS = ("pelvis", "abdomen", "thorax"), ("lthigh", "rthigh")
_FEMUR_STATIONS = 11


@dataclass(frozen=True, eq=False)
class SeatFit:
    """A person's trunk and thighs in a seat, in the seat's frame (origin H-point, x forward, z up), whatever its travel.

    q: (D,) rad, trunk as seated, shanks hanging, arms down · seat_from_root: (4, 4) · thigh_angle: of the femur above the
    horizontal while the thigh rests on the cushion, rad · shoulders: (2, 3) · front: (N, 3) float32 skin of belly and chest ·
    thigh_top: (11,) height of the skin above the femur's axis, from hip to knee · edge_m: x before which the ankles of
    somebody in a child seat do not hang, over its front and that of the car's cushion; -inf where thighs end at that.
    """

    q: Floats
    seat_from_root: Matrix
    thigh_angle: float
    shoulders: Floats
    front: Floats32
    thigh_top: Floats
    edge_m: float = -np.inf


def fit_seat(person: Person, seat: Seat, torso_angle: float) -> SeatFit:
    """The fit of a person in a seat whose backrest stands at `torso_angle` (rad from the vertical); cached."""
    recline = round(float(torso_angle), 6)
    return _fit(person, seat.cushion_angle, seat.cushion_below_h_m, seat.backrest_behind_h_m, recline, *_IN_CAR)


def common_fit(person: Person) -> SeatFit:
    """The fit of a person in a seat of middling dimensions, for what hardly depends on the seat."""
    return _fit(person, *_COMMON_SEAT, *_IN_CAR)


def fit_child_seat(person: Person, seat: Seat, torso_angle: float, sitting: Sitting, seat_from_thing: Matrix) -> SeatFit:
    """The fit of a child in a child seat that stands in a seat of the car.

    Parameters
    ----------
    person, seat, torso_angle
        Who, where, and the angle of the car's backrest, rad from the vertical.
    sitting
        Where the child sits in the child seat.
    seat_from_thing
        (4, 4), of the child seat.

    Returns
    -------
    SeatFit
        In the frame of the car's seat.
    """
    tilt = float(rp.arctan2(seat_from_thing[2, 0], seat_from_thing[0, 0])) + rp.arctan(sitting.cushion[1])
    corner = seat_from_thing[:3, 3]
    if sitting.back is None:
        lean = torso_angle
        behind = np.array([-rp.cos(lean), 0.0, -rp.sin(lean)]) * seat.backrest_behind_h_m
    else:
        lean = tilt - rp.arctan(sitting.cushion[1]) - rp.arctan(sitting.back[1])
        behind = (rp.matmul(seat_from_thing, (sitting.back[0], 0.0, 0.0, 1.0)))[:3]
    out, off = np.array([rp.cos(lean), 0.0, rp.sin(lean)]), np.array([-rp.sin(tilt), 0.0, rp.cos(tilt)])
    base = (rp.matmul(seat_from_thing, (0.0, 0.0, sitting.cushion[0], 1.0)))[:3]
    # Where the femur heads come to lie, about: so far from both planes.
    planes = np.array([out[[0, 2]], off[[0, 2]]])
    x, z = rp.solve(planes, (rp.matmul(out, behind) + _HIP_OFF_M[0], rp.matmul(off, base) + _HIP_OFF_M[1]))
    hip = np.array([x, corner[1], z])
    front = float(rp.hypot(*rp.matmul(seat_from_thing, (sitting.front_m, 0.0, sitting.cushion[0], 1.0))[[0, 2]] - hip[[0, 2]]))
    measures = (tilt, _HIP_OFF_M[1] / rp.cos(tilt), _HIP_OFF_M[0], lean, front)
    rounded = [round(float(measure), 6) for measure in measures]
    fit = _fit(person, rounded[0], rounded[1], rounded[2], rounded[3], rounded[4], _ON_PADDING)
    moved = fit.seat_from_root.copy()
    moved[:3, 3] += hip
    skin, edge = fit.front + hip.astype(np.float32), _EDGES_M[seat.slot.startswith("rear")]
    rim = float(rp.matmul(seat_from_thing, (sitting.front_m, 0.0, 0.0, 1.0))[0])
    edge = max(edge + _BEFORE_EDGE_M, rim + _BEFORE_RIM_M)
    return replace(fit, seat_from_root=moved, shoulders=fit.shoulders + hip, front=skin, edge_m=edge)


def _posture(pitch: float, thigh: float) -> Floats:
    """Trunk with the pelvis pitched back by `pitch`, femurs at `thigh` above the horizontal, shanks vertical (rad)."""
    q = np.zeros(len(DOFS))
    q[DOF_INDEX["lumbar.flexion"]], q[DOF_INDEX["thorax.flexion"]] = _LUMBAR, _THORAX
    for side in "lr":
        q[DOF_INDEX[side + "hip.flexion"]] = np.pi / 2 - pitch + thigh
        q[DOF_INDEX[side + "hip.abduction"]] = _ABDUCTION
        q[DOF_INDEX[side + "knee.flexion"]] = np.pi / 2 + thigh
        q[DOF_INDEX[side + "shoulder.abduction"]] = 0.5  # out of the way of the back
    return q


def _root(pitch: float, place: Floats) -> Matrix:
    return transform(axis_rotation("y", -pitch), place)


class _Skin(NamedTuple):
    """Skin of trunk and thighs, the same for everybody: numbers of the vertices (N,), and which of them are where (N,)."""

    rows: Ints
    trunk: Bools
    seated: Bools
    thighs: Bools
    left_thigh: Bools


@cache
def _skin() -> _Skin:
    segment = vertex_segments()
    rows = np.flatnonzero(np.isin(segment, _indices(*_TRUNK, *_THIGHS)))
    where = (_indices(*_TRUNK), _indices("pelvis", *_THIGHS), _indices(*_THIGHS), _indices("lthigh"))
    return _Skin(rows, *(np.isin(segment[rows], w) for w in where))


def _indices(*segments: str) -> list[int]:
    return [SEGMENTS.index(s) for s in segments]


def _lower_half(height: Floats, of: Bools) -> Ints:
    """Which of (N,) heights, of those for which `of` holds, are at most the middle one."""
    which = np.flatnonzero(of)
    there = height[which]
    return which[there <= np.sort(there)[len(there) // 2]]


class Foam(NamedTuple):
    """A seat, in its frame, and the skin that meets it: first that of the back, then that of seat and thighs.

    q: (D,) rad, of which hips and knees follow the thighs · skin_index, skin_weight (R, K), rest (R, 3): of
    `Person.skin_weights` · n_back: how many of the rows are of the back · thigh: (R - n_back,) which of the others are · normal:
    (3,) out of the backrest · up: along the torso line · cushion: out of the cushion, whose free surface is at `free_cushion`
    along it · behind, sunk, thighs_sunk: of the back along `normal`, of seat and thighs below the surface, m · size: stature
    against 1.75 m · femur: m · slides: whether the pelvis stays where it is, off the backrest.
    """

    q: Floats
    skin_index: Bytes
    skin_weight: Floats32
    rest: Floats32
    n_back: int
    thigh: Bools
    normal: Floats
    up: Floats
    cushion: Floats
    free_cushion: float
    behind: float
    sunk: float
    thighs_sunk: float
    size: float
    femur: float
    slides: bool


@kept_with_person
def _fit(
    person: Person, cushion_angle: float, below: float, behind: float, torso_angle: float,
    front: float, sags: tuple[float, float, float],
) -> SeatFit:  # fmt: skip
    mesh = _skin()
    up = np.array([-rp.sin(torso_angle), 0.0, rp.cos(torso_angle)])  # along the torso line
    normal = np.array([rp.cos(torso_angle), 0.0, rp.sin(torso_angle)])  # out of the backrest
    cushion = np.array([-rp.sin(cushion_angle), 0.0, rp.cos(cushion_angle)])
    size = person.stature_m / 1.75
    femur = person.segment_lengths["thigh"]
    slide = float(np.clip(front - 0.01 - femur, 0.0, _MAX_SLIDE_M))  # short thighs: knees to the edge

    pitch, thigh, place = torso_angle + 0.20, cushion_angle, np.array([slide, 0.0, 0.0])
    whole = person.skin_part(mesh.rows)
    skin = whole(_posture(pitch, thigh), _root(pitch, place))
    # What meets backrest and cushion lies behind and below from the start: the rest need not be moved along.
    back = _lower_half(rp.matmul(skin, normal), mesh.trunk & (np.abs(skin[:, 1]) < 0.10 * size))
    bottom = _lower_half(rp.matmul(skin, cushion), mesh.seated)
    meets = person.skin_weights(mesh.rows[np.concatenate((back, bottom))])
    foam = Foam(
        _posture(pitch, thigh), *meets, len(back), mesh.thighs[bottom], normal, up, cushion,
        -below * cushion[2], -(behind + sags[0]), sags[1], sags[2], size, femur, slide > 0.0,
    )  # fmt: skip
    state = np.array((pitch, thigh, *place))
    native.sink(person.rest, foam, rounds=_ROUNDS, state=state)
    pitch, thigh, place = float(state[0]), float(state[1]), state[2:]

    q, root = _posture(pitch, thigh), _root(pitch, place)
    skin = whole(q, root)
    skeleton = frames(q, person.rest, root)
    shoulders = np.stack([skeleton.bone(s + "upperarm")[:3, 3] for s in "lr"])
    skin_before = skin[mesh.trunk & (rp.matmul(skin, normal) > 0.0)][::4].astype(np.float32)
    thigh_top = _thigh_top(skin[mesh.left_thigh], skeleton.bone("lthigh"), femur)
    return SeatFit(q, root, thigh, shoulders, skin_before, thigh_top)


def _thigh_top(skin: Floats, vehicle_from_thigh: Matrix, femur: float) -> Floats:
    """Height of a left thigh's skin (N, 3) above the femur's axis (towards the front) at stations from hip to knee."""
    local = rp.matmul(skin - vehicle_from_thigh[:3, 3], vehicle_from_thigh[:3, :3])
    middle = np.abs(local[:, 1]) < 0.05
    station, height = -local[middle, 2] / femur, local[middle, 0]
    result = np.empty(_FEMUR_STATIONS)
    for k, s in enumerate(np.linspace(0.0, 1.0, _FEMUR_STATIONS)):
        near = np.abs(station - s) < 0.08
        result[k] = height[near].max() if near.any() else np.nan
    good = np.isfinite(result)
    return np.interp(np.arange(_FEMUR_STATIONS), np.flatnonzero(good), result[good])
