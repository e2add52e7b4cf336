"""Infants in carriers, and children who sit on no seat: postures that stand for what no backrest and no belt gives.

A posture is a set of joint angles with a spread; its person is put where it belongs, by the skin that lies or stands there, and
the solver then lets it give way to the car as everybody. That infants sleep with arms beside the head or on the chest and legs
drawn up and apart, and how children stand, lie and crouch, is assumed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from cabinpose.core import ConfigError, Floats, Ints32, Matrix, apply, axis_rotation, invert, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, DOFS, LOWER, SEGMENTS, UPPER, Person, vertex_segments
from cabinpose.scene.things import cushion_frame
from cabinpose.synth.posture.actions import Action, Spread
from cabinpose.synth.posture.context import SeatContext
from cabinpose.synth.posture.goals import TASKS
from cabinpose.synth.posture.places import EITHER
from cabinpose.synth.posture.sampling import Drawn
from cabinpose.synth.posture.solver import Goals, Sitter

Where: TypeAlias = Literal["carrier", "standing", "bench", "footwell"]
_STIFFNESS, _ROOT_WEIGHT = 0.12, np.array([4.0, 4.0, 6.0, 0.8, 0.8, 0.8])
_TURNED = axis_rotation("z", math.pi)  # a carrier looks back
_LYING_ON = ("pelvis", "abdomen", "thorax")
_SAG_M = 0.008  # of skin in padding and foam
_LEAST_SKIN = 12  # vertices that carry
_SMALL_M = 0.01  # standard deviation of where somebody is, m
_BEFORE_EDGE_M = 0.15  # of the pelvis, from the front edge of a rear cushion
_BEHIND_FRONT_M = 0.07  # the same of who stands behind a front seat
_ASIDE_M = 0.15
_EDGE_M = 0.33  # of that edge from the H-point
_ABOVE_FLOOR_M = 0.006
_NECK_DOWN = math.radians(14.0)  # of somebody on the side, whose shoulder is below


@dataclass(frozen=True, eq=False)
class FreePose(Action):
    """Something that infants in carriers do, or children without a seat.

    where: they are · stature_m: of whom · angles: of degrees of freedom, deg, those without a side of both · arms: of which each
    side has one · asleep: whether the eyes are closed.
    """

    where: Where = "carrier"
    stature_m: tuple[float, float] = (0.0, math.inf)
    angles: Mapping[str, Spread] = field(default_factory=dict)
    arms: tuple[Mapping[str, Spread], ...] = ({},)
    asleep: bool = False


def _arm(flexion: float, abduction: float, rotation: float, elbow: float, spread: float = 10.0) -> Mapping[str, Spread]:
    names = ("shoulder.flexion", "shoulder.abduction", "shoulder.rotation", "elbow.flexion", "hand.grip")
    values = (flexion, abduction, rotation, elbow, 60.0)
    return MappingProxyType({name: (value, spread) for name, value in zip(names, values, strict=True)})


_ON_CHEST, _BESIDE_HEAD, _HANGING = _arm(30.0, 22.0, 50.0, 105.0), _arm(20.0, 75.0, -70.0, 95.0), _arm(8.0, 22.0, 20.0, 35.0)
_WAVING = _arm(60.0, 35.0, 0.0, 70.0, 22.0)
_DRAWN_UP: Mapping[str, Spread] = {
    "hip.flexion": (92.0, 7.0), "hip.abduction": (32.0, 5.0), "hip.rotation": (-25.0, 7.0), "knee.flexion": (85.0, 12.0),
    "ankle.dorsiflexion": (5.0, 6.0), "lumbar.flexion": (12.0, 3.0), "thorax.flexion": (8.0, 3.0),
}  # fmt: skip
_HOLDING_ON, _IN_FRONT = _arm(62.0, 12.0, 10.0, 40.0), _arm(72.0, 4.0, 35.0, 85.0, 6.0)
FREE_POSES: Mapping[str, FreePose] = MappingProxyType(
    {
        pose.name: pose
        for pose in (
            FreePose(
                "infant_asleep", EITHER, EITHER, weight=0.0, asleep=True, arms=(_ON_CHEST, _BESIDE_HEAD, _HANGING),
                angles={**_DRAWN_UP, "neck.flexion": (10.0, 5.0), "neck.rotation": (0.0, 22.0), "head.lateral": (0.0, 4.0),
                        "neck.lateral": (0.0, 9.0)},
            ),
            FreePose(
                "infant_awake", EITHER, EITHER, weight=0.0, arms=(_WAVING, _ON_CHEST, _HANGING),
                angles={**_DRAWN_UP, "hip.flexion": (92.0, 14.0), "knee.flexion": (70.0, 25.0), "neck.flexion": (16.0, 6.0),
                        "neck.rotation": (0.0, 18.0)},
            ),
            FreePose(
                "child_stand", EITHER, EITHER, weight=0.0, where="standing", stature_m=(0.72, 1.15),
                arms=(_HOLDING_ON, _HANGING),
                angles={"hip.flexion": (14.0, 6.0), "knee.flexion": (12.0, 6.0), "ankle.dorsiflexion": (4.0, 3.0),
                        "hip.abduction": (6.0, 3.0), "lumbar.flexion": (6.0, 5.0), "neck.rotation": (0.0, 20.0)},
            ),
            FreePose(
                "child_lie", EITHER, EITHER, weight=0.0, where="bench", stature_m=(0.45, 1.30), asleep=True,
                arms=(_IN_FRONT,),
                angles={"hip.flexion": (62.0, 9.0), "knee.flexion": (88.0, 10.0), "hip.abduction": (2.0, 2.0),
                        "lumbar.flexion": (14.0, 5.0), "thorax.flexion": (6.0, 4.0), "neck.flexion": (8.0, 5.0)},
            ),
            FreePose(
                "child_footwell", EITHER, EITHER, weight=0.0, where="footwell", stature_m=(0.72, 1.25),
                arms=(_ON_CHEST, _HANGING),
                angles={"hip.flexion": (112.0, 4.0), "knee.flexion": (122.0, 7.0), "hip.abduction": (6.0, 3.0),
                        "lumbar.flexion": (28.0, 6.0), "thorax.flexion": (12.0, 4.0), "neck.flexion": (0.0, 8.0),
                        "neck.rotation": (0.0, 20.0)},
            ),
        )
    }
)  # fmt: skip
"""What infants in carriers do, and children without a seat, by name."""
IN_CARRIER: Mapping[str, float] = MappingProxyType({"infant_asleep": 1.0, "infant_awake": 1.0})
"""How likely infants in carriers do what."""
WITHOUT_SEAT = tuple(name for name, pose in FREE_POSES.items() if pose.where != "carrier")
"""What children without a seat do."""


class _Plane(NamedTuple):
    """What skin lies on: through a point (3,) m, with the direction out of it (3,)."""

    through: Floats
    out: Floats


def draw_free_pose(seated: SeatContext, pose: FreePose, *, rng: np.random.Generator) -> Drawn:
    """The goals of an infant in a carrier, or of a child without a seat: `settled` solves them.

    Raises ConfigError for somebody who is too tall or too small for it, or where there is no carrier.
    """
    low, high = pose.stature_m
    if not low <= seated.person.stature_m <= high:
        raise ConfigError(
            f"'{pose.name}' is for people of {low:g} to {high:g} m, and the one in {seated.seat.slot} is"
            f" {seated.person.stature_m:.2f} m tall",
            hint="name somebody else, or another action",
        )
    if (pose.where == "carrier") != (seated.on is not None and seated.on.thing.lying is not None):
        raise ConfigError(
            f"'{pose.name}' makes no sense in the {seated.seat.slot} seat as it is",
            hint=f"in carriers (child_seats: infant): {', '.join(IN_CARRIER)}; without a child seat: {', '.join(WITHOUT_SEAT)}",
        )
    q = _angles(pose, rng)
    root = {"carrier": _in_carrier, "standing": _standing, "bench": _on_bench, "footwell": _in_footwell}[pose.where](
        seated, q, rng.standard_normal(4)
    )
    stiffness = np.full(len(DOFS), _STIFFNESS)
    none = np.zeros((len(TASKS), 4, 4)) + np.eye(4)
    bones = np.array([BONE_INDEX[name] for name in TASKS], np.int32)
    base: Ints32 = np.full(len(TASKS), -1, np.int32)
    goals = Goals(q, stiffness, LOWER, UPPER, root, _ROOT_WEIGHT, bones, none, base, none, np.zeros((len(TASKS), 6)))
    who = Sitter(seated.person, seated.seat.slot, goals, q.copy(), root.copy(), middle=float(seated.seat.design_h_point[1]))
    return Drawn(who, pose.name, None, np.full(len(TASKS), math.inf), root[:3, 3].copy(), np.full((2, 5), np.nan))


def _angles(pose: FreePose, rng: np.random.Generator) -> Floats:
    """(D,) rad within the limits; sides differ by half of the spread."""
    q = np.zeros(len(DOFS))

    def put(name: str, spread: Spread, score: float) -> None:
        d = DOF_INDEX[name]
        scale = 0.01 if name.endswith("grip") else math.pi / 180.0
        q[d] = min(max(scale * (spread[0] + spread[1] * min(max(score, -2.0), 2.0)), LOWER[d]), UPPER[d])

    for name, spread in pose.angles.items():
        scores = rng.standard_normal(3)
        if name in DOF_INDEX:
            put(name, spread, float(scores[2]))
            continue
        for side, own in zip("lr", scores[:2].tolist(), strict=True):
            put(side + name, spread, 0.8 * float(scores[2]) + 0.6 * own)
    for side in "lr":
        for name, spread in pose.arms[int(rng.integers(len(pose.arms)))].items():
            put(side + name, spread, float(rng.standard_normal()))
    return q


def _laid(
    person: Person, q: Floats, turn: Matrix, place: Floats, planes: tuple[_Plane, ...], segments: tuple[str, ...]
) -> Matrix:
    """(4, 4) the root at `place`, turned, and moved until skin of these segments lies on each of the planes (two at most)."""
    root = transform(turn, place)
    rows = np.flatnonzero(np.isin(vertex_segments(), [SEGMENTS.index(name) for name in segments]))
    skin = person.skin_part(rows)(q, root)
    gaps = [float(np.sort(rp.matmul(skin - p.through, p.out))[:_LEAST_SKIN].mean()) + _SAG_M for p in planes]
    out = np.stack([plane.out for plane in planes])
    shares = rp.solve(rp.matmul(out, out.T), np.array(gaps))
    root[:3, 3] -= rp.matmul(out.T, shares)
    return root


def _in_carrier(seated: SeatContext, q: Floats, scores: Floats) -> Matrix:
    on, person = seated.on, seated.person
    lying = None if on is None else on.thing.lying
    assert on is not None
    assert lying is not None  # of what somebody lies in
    (x0, z0), (x1, z1) = lying.back
    lean = float(rp.arctan2(z1 - z0, x1 - x0))  # of the back, above the horizontal
    back = _Plane(np.array((x0, 0.0, z0)), np.array((-rp.sin(lean), 0.0, rp.cos(lean))))
    bottom = _Plane(np.array((0.0, 0.0, lying.bottom_m)), np.array((0.0, 0.0, 1.0)))
    pitch = 0.5 * math.pi - lean + 0.5 * float(q[DOF_INDEX["lumbar.flexion"]])
    turn = rp.matmul(_TURNED, axis_rotation("y", -pitch), axis_rotation("z", 0.04 * float(scores[0])))
    place = np.array((x0 - 0.08, _SMALL_M * float(scores[1]), z0 + 0.10))
    return np.asarray(rp.matmul(on.vehicle_from_thing, _laid(person, q, turn, place, (back, bottom), _LYING_ON)))


def _floor(seated: SeatContext) -> _Plane:
    return _Plane(np.array((0.0, 0.0, seated.seat.floor_z + _ABOVE_FLOOR_M + _SAG_M)), np.array((0.0, 0.0, 1.0)))


def _edge(seated: SeatContext) -> Floats:
    """(3,) m: the front edge of a seat's cushion, in its middle, vehicle frame."""
    return np.asarray(apply(seated.seat.vehicle_from_seat(seated.setting), np.array((_EDGE_M, 0.0, 0.0))))


def _standing(seated: SeatContext, q: Floats, scores: Floats) -> Matrix:
    """Before the seat, facing forwards, feet on the floor."""
    aside = abs(float(seated.seat.design_h_point[1])) > _ASIDE_M  # behind a front seat, not between the two
    pitch = (0.1 if aside else 0.5) * float(q[DOF_INDEX["lhip.flexion"]])
    turn = rp.matmul(axis_rotation("z", (0.6 if aside else 0.15) * float(scores[0])), axis_rotation("y", pitch))
    ahead = (_BEHIND_FRONT_M if aside else _BEFORE_EDGE_M) + _SMALL_M * float(scores[1])
    place = _edge(seated) + seated.forward * ahead
    return _laid(seated.person, q, turn, place, (_floor(seated),), ("lfoot", "rfoot"))


def _on_bench(seated: SeatContext, q: Floats, scores: Floats) -> Matrix:
    """On the side, the face to the front, the head towards the car's middle or, in the middle, to either side.

    The neck bends down, in place of q.
    """
    side = float(np.sign(seated.seat.design_h_point[1])) or (1.0 if scores[0] > 0.0 else -1.0)
    frame = cushion_frame(seated.seat, seated.setting)
    q[DOF_INDEX["neck.lateral"]] = -side * _NECK_DOWN
    cushion, back = _Plane(frame[:3, 3], frame[:3, 2]), _Plane(frame[:3, 3] + 0.02 * frame[:3, 0], frame[:3, 0])
    # x of the root to the front, z towards the other side
    turn = np.column_stack((frame[:3, 0], side * frame[:3, 2], -side * frame[:3, 1]))
    turn = rp.matmul(turn, axis_rotation("z", side * (0.25 + 0.12 * float(scores[2]))))
    place = apply(frame, np.array((0.2, 0.0, 0.15)))
    return _laid(seated.person, q, turn, place, (cushion, back), _LYING_ON)


def _in_footwell(seated: SeatContext, q: Floats, scores: Floats) -> Matrix:
    """Sitting on the floor before the seat, the back to the nearer door, knees drawn up."""
    side = float(np.sign(seated.seat.design_h_point[1])) or (1.0 if scores[0] > 0.0 else -1.0)
    turn = rp.matmul(axis_rotation("z", -side * (0.5 * math.pi) + 0.1 * float(scores[1])), axis_rotation("y", -0.30))
    place = _edge(seated) + seated.forward * (_BEFORE_EDGE_M + _SMALL_M * float(scores[2])) + (0.0, side * 0.10, 0.0)
    return _laid(seated.person, q, turn, place, (_floor(seated),), ("pelvis", "lthigh", "rthigh", "lfoot", "rfoot"))


def straps_of(posed_joints: Mapping[str, Floats], vehicle_from_thing: Matrix) -> tuple[Floats, Floats]:
    """Where a carrier's harness comes out of its padding, (2, 3) m each, vehicle frame: above the shoulders, beside the hips."""
    local = {name: apply(invert(vehicle_from_thing), place) for name, place in posed_joints.items()}
    trunk = local["neck"] - 0.5 * (local["lpelvis"] + local["rpelvis"])
    size = rp.norm(trunk)
    up, across = trunk / size, (local["lshoulder"] - local["rshoulder"]) / rp.norm(local["lshoulder"] - local["rshoulder"])
    behind = -np.cross(across, up)
    slots = np.stack([local[s + "shoulder"] - sign * 0.06 * size * across + size * (0.10 * up + 0.20 * behind)
                      for s, sign in (("l", 1.0), ("r", -1.0))])  # fmt: skip
    hips = np.stack(
        [local[s + "pelvis"] + sign * 0.22 * size * across + 0.05 * size * behind for s, sign in (("l", 1.0), ("r", -1.0))]
    )
    return np.asarray(apply(vehicle_from_thing, slots)), np.asarray(apply(vehicle_from_thing, hips))
