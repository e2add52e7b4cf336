"""Free poses of one person who stands in a room: a mixture of gestures with Gaussian spread, feet on the floor.

How often arms are raised, how far, and how people lean and step follows the joint angles of ITOP's side-view test set
(Haque et al. 2016: in about half of its frames no upper arm is raised beyond 45 deg, in a fifth both are). No pose is
taken from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Matrix, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, LOWER, UPPER, Person
from cabinpose.synth.posture.feet import GROUND_M
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.goals import stand_on
from cabinpose.synth.profiles import Profile

Spread = tuple[float, float]  # mean and sigma, degrees

_THIGH_BONES = (BONE_INDEX["lthigh"], BONE_INDEX["rthigh"])
_SHANK_BONES = (BONE_INDEX["lshank"], BONE_INDEX["rshank"])
_KNEE_RADIUS_M = 0.06
_STRAIGHT_LEG = 0.9999  # of a leg's length: nobody locks the knee

_ARM_DOFS = (
    "shoulder.flexion", "shoulder.abduction", "shoulder.rotation", "elbow.flexion", "elbow.pronation",
    "wrist.flexion", "wrist.radial",
)  # fmt: skip
_WRIST: tuple[Spread, Spread] = ((0.0, 10.0), (-4.0, 7.0))
# Each arm's pose, deg: shoulder flexion, abduction, rotation, elbow flexion, pronation.
ARM_POSES: Mapping[str, tuple[Spread, ...]] = MappingProxyType(
    {
        "hang": ((4.0, 9.0), (12.0, 5.0), (15.0, 12.0), (27.0, 12.0), (10.0, 20.0)),
        "front": ((22.0, 12.0), (14.0, 7.0), (38.0, 13.0), (78.0, 18.0), (15.0, 30.0)),
        "hip": ((-14.0, 7.0), (42.0, 7.0), (40.0, 9.0), (96.0, 10.0), (25.0, 20.0)),
        "cross": ((42.0, 10.0), (6.0, 6.0), (46.0, 9.0), (88.0, 14.0), (10.0, 20.0)),
        "forward": ((78.0, 20.0), (14.0, 12.0), (5.0, 20.0), (28.0, 22.0), (20.0, 30.0)),
        "side": ((8.0, 14.0), (72.0, 18.0), (-15.0, 25.0), (26.0, 24.0), (0.0, 35.0)),
        "up": ((152.0, 16.0), (22.0, 12.0), (0.0, 18.0), (25.0, 22.0), (0.0, 35.0)),
        "goalpost": ((6.0, 10.0), (84.0, 12.0), (-76.0, 10.0), (88.0, 18.0), (0.0, 25.0)),
        "head": ((84.0, 14.0), (52.0, 14.0), (5.0, 14.0), (132.0, 7.0), (0.0, 25.0)),
        "back": ((-32.0, 12.0), (18.0, 8.0), (15.0, 15.0), (35.0, 20.0), (0.0, 30.0)),
    }
)
_LOW, _LOW_SHARES = ("hang", "front", "hip", "back"), (0.62, 0.26, 0.06, 0.06)
_RAISED, _RAISED_SHARES = ("forward", "side", "up", "goalpost", "head"), (0.30, 0.24, 0.18, 0.14, 0.14)
_PAIRS, _PAIR_SHARES = ("none", "both", "left", "right", "cross"), (0.50, 0.19, 0.13, 0.13, 0.05)
_ALIKE = 0.65  # how often two raised arms do the same


class Stance(NamedTuple):
    """What legs and pelvis do: lengths in m, angles in degrees, each mean and sigma.

    width: half the distance of the heels beyond the hips' · stagger: one foot before the other · ahead: of the ankles,
    hips · drop: of the pelvis below straight legs · pitch: of the pelvis, forward · bend: lumbar flexion · shift: of the
    pelvis to a side · lifted: hip flexion, hip abduction and knee flexion of a leg off the floor, or None.

    Who stands has the hips 6.2 cm (sigma 1.3) ahead of the ankles (Woodhull et al. 1985, fifteen people in profile), and
    the knees nearly straight; the other stances are assumed.
    """

    width: Spread = (0.0, 0.03)
    stagger: Spread = (0.0, 0.045)
    ahead: Spread = (0.062, 0.013)
    drop: Spread = (-0.003, 0.003)
    pitch: Spread = (0.0, 3.5)
    bend: Spread = (0.0, 5.0)
    shift: Spread = (0.0, 0.02)
    lifted: tuple[Spread, Spread, Spread] | None = None


STANCES: Mapping[str, tuple[float, Stance]] = MappingProxyType(
    {
        "stand": (0.56, Stance()),
        "step": (0.12, Stance(stagger=(0.0, 0.22), drop=(0.03, 0.02), shift=(0.0, 0.04))),
        "straddle": (0.09, Stance(width=(0.20, 0.08), drop=(0.05, 0.04), shift=(0.0, 0.07))),
        "squat": (0.05, Stance(width=(0.08, 0.04), ahead=(-0.03, 0.03), drop=(0.20, 0.09), pitch=(20.0, 8.0), bend=(16.0, 7.0))),
        "bend": (0.07, Stance(ahead=(-0.03, 0.03), drop=(0.03, 0.02), pitch=(24.0, 9.0), bend=(26.0, 10.0))),
        "lift_leg": (0.11, Stance(lifted=((42.0, 20.0), (6.0, 9.0), (48.0, 24.0)))),
    }
)


@dataclass(frozen=True, eq=False)
class StandingPose:
    """A standing person: q (D,) rad within the limits, floor_from_root (4, 4), and what is done.

    The floor frame: origin on the floor below the pelvis, x where the feet point, z up. The lowest of
    soles and knees touches the floor.
    """

    q: Floats
    floor_from_root: Matrix
    action: str


def sample_standing(person: Person, profile: Profile | None = None, *, index: int = 0, rng: np.random.Generator) -> StandingPose:
    """A free standing pose, then the profile on top of it; a mocap profile gives the whole body of frame `index`.

    Raises ConfigError for an incremental combination that does not exist, MocapError for an unfit recording.
    """
    recorded = None if profile is None else profile.whole_body(index)
    if recorded is not None:
        return _grounded(person, recorded.q, recorded.root, "mocap")
    q, floor_from_root, action = _gesture(person, rng)
    if profile is None:
        return StandingPose(q, floor_from_root, action)
    return _grounded(person, profile.apply(q, index=index, rng=rng), floor_from_root[:3, :3], action)


def _grounded(person: Person, q: Floats, root: Floats, action: str) -> StandingPose:
    """The pose with its pelvis over the origin, as high as the lowest of heels, balls of the feet, toes and knees demands."""
    floor_from_root = transform(root)
    skeleton = frames(q, person.rest, floor_from_root)
    low = np.inf
    for sole in skeleton.soles:
        for forward in (0.0, 0.16, 0.22):
            low = min(low, float(sole[2, 3] + forward * sole[2, 0]))
    for knee in _SHANK_BONES:
        low = min(low, float(skeleton.position[knee, 2]) - _KNEE_RADIUS_M)
    floor_from_root[2, 3] = GROUND_M - low
    return StandingPose(q, floor_from_root, action)


def _normal(spread: Spread, rng: np.random.Generator) -> float:
    return spread[0] + spread[1] * float(np.clip(rng.standard_normal(), -2.5, 2.5))


def _set(q: Floats, name: str, degrees: float) -> None:
    d = DOF_INDEX[name]
    q[d] = min(max(math.radians(degrees), LOWER[d]), UPPER[d])


def _pick(names: tuple[str, ...], shares: tuple[float, ...], rng: np.random.Generator) -> str:
    return names[int(rng.choice(len(names), p=shares))]


def _arm_poses(rng: np.random.Generator) -> tuple[str, str, str]:
    """The pose of the left and the right arm, and what both together are called."""
    pair = _pick(_PAIRS, _PAIR_SHARES, rng)
    low = (_pick(_LOW, _LOW_SHARES, rng), _pick(_LOW, _LOW_SHARES, rng))
    high = (_pick(_RAISED, _RAISED_SHARES, rng), _pick(_RAISED, _RAISED_SHARES, rng))
    alike = rng.random() < _ALIKE
    if pair == "none":
        left, right = (low[0], low[0]) if alike else low
        return left, right, f"arms_{left}" if left == right else "arms_low"
    if pair == "both":
        left, right = (high[0], high[0]) if alike else high
        return left, right, f"arms_{left}" if left == right else "arms_raised"
    if pair == "left":
        return high[0], low[1], f"left_{high[0]}"
    if pair == "right":
        return low[0], high[1], f"right_{high[1]}"
    return "cross", "cross", "arms_cross"


def _gesture(person: Person, rng: np.random.Generator) -> tuple[Floats, Matrix, str]:
    q = np.zeros(len(LOWER))
    left, right, arms = _arm_poses(rng)
    for side, pose in (("l", left), ("r", right)):
        for name, spread in zip(_ARM_DOFS, ARM_POSES[pose] + _WRIST, strict=True):
            _set(q, side + name, _normal(spread, rng))
        _set(q, side + "clavicle.elevation", _normal((0.0, 3.0), rng))
        _set(q, side + "clavicle.protraction", _normal((8.0 if pose in ("forward", "cross", "front") else 0.0, 4.0), rng))
        q[DOF_INDEX[side + "hand.grip"]] = float(np.clip(rng.normal(0.3, 0.22), 0.0, 1.0))
    names = tuple(STANCES)
    stance_name = _pick(names, tuple(STANCES[n][0] for n in names), rng)
    stance = STANCES[stance_name][1]
    _set(q, "lumbar.flexion", _normal(stance.bend, rng))
    for name, sigma in (("lumbar.lateral", 3.5), ("lumbar.rotation", 3.0), ("thorax.lateral", 2.5), ("thorax.rotation", 12.0)):
        _set(q, name, _normal((0.0, sigma), rng))
    _set(q, "thorax.flexion", _normal((2.0, 4.0), rng))
    for name, spread in (
        ("neck.flexion", (4.0, 10.0)), ("neck.lateral", (0.0, 4.0)), ("neck.rotation", (0.0, 22.0)),
        ("head.flexion", (0.0, 4.0)), ("head.rotation", (0.0, 10.0)),
    ):  # fmt: skip
        _set(q, name, _normal(spread, rng))
    root = _stand(person, q, stance, rng)
    return q, root, arms if stance_name == "stand" else stance_name


def _stand(person: Person, q: Floats, stance: Stance, rng: np.random.Generator) -> Matrix:
    """Put pelvis and legs: soles flat on the floor, but for a leg that is lifted; returns floor_from_root."""
    lengths = person.segment_lengths
    size = person.stature_m / 1.75
    leg = _STRAIGHT_LEG * (lengths["thigh"] + lengths["shin"])
    soles = person.rest.soles
    hips_half = float(person.rest.offsets[_THIGH_BONES[0], 1])
    width, stagger = max(_normal(stance.width, rng), -0.03) * size, _normal(stance.stagger, rng) * size
    shift = _normal(stance.shift, rng) * size
    lifted = -1 if stance.lifted is None else int(rng.random() < 0.5)
    if lifted >= 0:
        shift = (1.0 if lifted == 1 else -1.0) * hips_half * 0.8  # over the foot that stands
    yaw, pitch, roll = np.radians([_normal((0.0, 7.0), rng), _normal(stance.pitch, rng), _normal((0.0, 0.8), rng)]).tolist()
    turn = rp.matmul(axis_rotation("z", yaw), axis_rotation("y", pitch), axis_rotation("x", roll))
    hips = rp.matmul(np.stack([person.rest.offsets[_THIGH_BONES[side]] for side in (0, 1)]), turn.T) + (0.0, shift, 0.0)
    ankles = float(hips[:, 0].mean()) - _normal(stance.ahead, rng) * size
    targets, height = [], np.inf
    for side in (0, 1):
        s = 1.0 - 2.0 * side
        toe_out = axis_rotation("z", s * math.radians(_normal((9.0, 6.0), rng)))
        place = np.array([ankles + s * 0.5 * stagger, s * (hips_half + width), GROUND_M])
        target = transform(toe_out, place + float(soles[side, 0, 3]) * toe_out[:, 0])
        ankle = target[:3, 3] - rp.matmul(toe_out, soles[side, :3, 3])
        aside = float(rp.hypot(*(ankle - hips[side])[:2]))
        if side != lifted:
            height = min(height, ankle[2] + math.sqrt(max(leg * leg - aside * aside, 0.01)) - hips[side, 2])
        targets.append(target)
    height -= max(_normal(stance.drop, rng), 0.0) * size
    floor_from_root = transform(turn, (0.0, shift, height))
    feet = []
    for side in (0, 1):
        if side == lifted and stance.lifted is not None:
            for name, spread in zip(("hip.flexion", "hip.abduction", "knee.flexion"), stance.lifted, strict=True):
                _set(q, "lr"[side] + name, _normal(spread, rng))
            _set(q, "lr"[side] + "ankle.dorsiflexion", _normal((-8.0, 10.0), rng))
        else:
            feet.append((side, targets[side]))
    stand_on(person, q, floor_from_root, feet)
    return floor_from_root
