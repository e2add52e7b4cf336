"""Retargeting: a recorded motion as angles of our degrees of freedom.

The recording's skeleton with all rotations zero (upright, looking along +x, thumbs forward) is the reference pose, like our
own zero pose, to which arms that it stretches out are brought down: a segment's rotation away from it is the rotation of ours.
Trunk, head, hands and feet take those rotations. Arms and legs take the directions of their two segments, from joint positions,
so that hinge axes and twist conventions of the recording do not matter: elevation from the upper segment, twist from the plane of
the hinge, and where the limb is nearly straight (the plane is undefined) from the recorded twist.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from cabinpose.core import Floats, MocapError, axis_rotation
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOF_INDEX, DOFS
from cabinpose.store.convert import Clip

# What is needed of a recording, under MVN's names and those of the CMU database's common conversions.
_NAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"pelvis": ("Hips", "Pelvis", "hip"), "thorax": ("Chest2", "T8", "Spine2", "Spine1", "chest"), "head": ("Head", "head")}
    | {
        f"{s}{part}": tuple(name.format(side) for name in names)
        for s, side in (("l", "Left"), ("r", "Right"))
        for part, names in {
            "shoulder": ("{}UpperArm", "{}Arm", "{}Shoulder"),  # a shoulder beside an arm is the collar bone
            "elbow": ("{}Elbow", "{}ForeArm", "{}Forearm"),
            "wrist": ("{}Wrist", "{}Hand"),
            "hip": ("{}Hip", "{}UpLeg", "{}UpperLeg"),
            "knee": ("{}Knee", "{}LowerLeg", "{}Leg"),
            "ankle": ("{}Ankle", "{}Foot"),
            "toe": ("{}Toe", "{}ToeBase"),
        }.items()
    }
)

# Shares of the caudal one of two joints in the rotation of both, after their ranges of motion: lumbar against thorax,
# neck against head (flexion, lateral, rotation).
_LUMBAR_SHARE = (0.65, 0.55, 0.25)
_NECK_SHARE = (0.65, 0.75, 0.45)
_STRAIGHT = np.radians((12.0, 30.0))  # flexion below which, and above which, the hinge's plane is ignored, trusted


class RetargetedMotion(NamedTuple):
    """A retargeted recording: q (F, D) rad, within the limits, and world_from_root's rotation (F, 3, 3)."""

    q: Floats
    root: Floats


def retarget(clip: Clip) -> RetargetedMotion:
    """The angles of every frame of a clip, clipped to the joints' limits.

    Raises MocapError where the clip lacks a joint that is needed.
    """
    joint = _find_joints(clip)
    pelvis, thorax, head = (clip.rotations[:, joint[k]] for k in ("pelvis", "thorax", "head"))
    q = np.zeros((len(clip), len(DOFS)))
    _trunk(q, _relative(pelvis, thorax), ("lumbar", "thorax"), _LUMBAR_SHARE)
    _trunk(q, _relative(thorax, head), ("neck", "head"), _NECK_SHARE)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        _arm(q, clip, joint, side, sign)
        _leg(q, clip, joint, side, sign)
    lower, upper = (np.array([getattr(d, k) for d in DOFS]) for k in ("lower", "upper"))
    return RetargetedMotion(np.clip(q, lower, upper), pelvis.copy())


def _find_joints(clip: Clip) -> dict[str, int]:
    found, missing = {}, []
    for part, names in _NAMES.items():
        known = [clip.names.index(n) for n in names if n in clip.names]
        if known:
            found[part] = known[0]
        else:
            missing.append(" or ".join(names))
    if missing:
        raise MocapError(
            f"the recording has no joint {', '.join(missing)}", hint="the joint names of MVN and the CMU database are known"
        )
    return found


def _relative(a: Floats, b: Floats) -> Floats:
    return rp.matmul(np.swapaxes(a, -1, -2), b)


def _set(q: Floats, name: str, values: Floats) -> None:
    q[:, DOF_INDEX[name]] = values


def _trunk(q: Floats, rotation: Floats, names: tuple[str, str], shares: tuple[float, float, float]) -> None:
    """Split one rotation Ry(flexion) Rx(-lateral) Rz(rotation) between two joints."""
    angles = Rotation.from_matrix(rotation).as_euler("YXZ") * (1.0, -1.0, 1.0)
    for k, axis in enumerate(("flexion", "lateral", "rotation")):
        _set(q, f"{names[0]}.{axis}", shares[k] * angles[:, k])
        _set(q, f"{names[1]}.{axis}", (1.0 - shares[k]) * angles[:, k])


def _directions(clip: Clip, base: Floats, a: int, b: int) -> Floats:
    """Unit vectors (F, 3) from joint a to joint b, in the frame `base` (F, 3, 3)."""
    v = clip.positions[:, b] - clip.positions[:, a]
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    return (rp.matmul(np.swapaxes(base, 1, 2), v[:, :, None]))[:, :, 0]


def ball_from_direction(direction: Floats, sign: float) -> tuple[Floats, Floats]:
    """Flexion and abduction (rad) of a shoulder or hip whose limb points along `direction` (F, 3) of the near segment.

    From Ry(-flexion) Rx(sign abduction) (0, 0, -1) = direction, with abduction within a right angle.
    """
    abduction = rp.arcsin(np.clip(sign * direction[:, 1], -1.0, 1.0))
    flexion = rp.arctan2(direction[:, 0], -direction[:, 2])
    # Close to the straight side the flexion means nothing: it goes to zero rather than jump.
    flexion = np.where(rp.hypot(direction[:, 0], direction[:, 2]) < 1e-6, 0.0, flexion)
    return flexion, abduction


def _ball(
    q: Floats, name: str, direction: Floats, distal: Floats, recorded: Floats, sign: float, bends: float
) -> tuple[Floats, Floats]:
    """Set the three angles of a shoulder or hip, and return its rotation (F, 3, 3) and the flexion of the hinge behind it.

    direction, distal: (F, 3) of the two segments in the near one's frame · recorded: (F, 3, 3) the recorded rotation,
    for the twist of a straight limb · bends: +1 where the hinge brings the far segment forward (elbow), -1 back (knee).
    A direction is reached with abduction below or beyond a right angle: of the two the one that leaves the limits
    less, twist included, is taken.
    """
    flexion, abduction = ball_from_direction(direction, sign)
    dofs = [DOFS[DOF_INDEX[f"{name}.{axis}"]] for axis in ("flexion", "abduction", "rotation")]
    best, best_beyond = np.zeros((len(direction), 3)), np.full(len(direction), np.inf)
    hinge = np.zeros(len(direction))
    other = np.where(flexion > 0, flexion - np.pi, flexion + np.pi)
    for f, a in ((flexion, abduction), (other, np.pi - abduction)):
        raised = _raised(f, a, sign)
        w = (rp.matmul(np.swapaxes(raised, 1, 2), distal[:, :, None]))[:, :, 0]
        hinge = rp.arccos(np.clip(-w[:, 2], -1.0, 1.0))
        turn = _relative(raised, recorded)
        from_record = -sign * rp.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
        twist = _blend(rp.arctan2(-sign * bends * w[:, 1], bends * w[:, 0]), from_record, hinge)
        twist = (twist + np.pi) % (2 * np.pi) - np.pi
        angles = np.stack((f, a, twist), axis=1)
        beyond = sum(np.maximum(d.lower - angles[:, k], 0) + np.maximum(angles[:, k] - d.upper, 0) for k, d in enumerate(dofs))
        better = beyond < best_beyond - 1e-9
        best[better], best_beyond = angles[better], np.minimum(beyond, best_beyond)
    for k, dof in enumerate(dofs):
        _set(q, dof.name, best[:, k])
    rotation = rp.matmul(_raised(best[:, 0], best[:, 1], sign), Rotation.from_euler("Z", -sign * best[:, 2:]).as_matrix())
    return rotation, hinge


def _raised(flexion: Floats, abduction: Floats, sign: float) -> Floats:
    return Rotation.from_euler("YX", np.stack((-flexion, sign * abduction), axis=1)).as_matrix()


def _blend(from_plane: Floats, from_record: Floats, flexion: Floats) -> Floats:
    """The twist: from the hinge's plane where the limb is bent, from the recording where it is straight."""
    weight = np.clip((flexion - _STRAIGHT[0]) / (_STRAIGHT[1] - _STRAIGHT[0]), 0.0, 1.0)
    difference = (from_plane - from_record + np.pi) % (2 * np.pi) - np.pi
    return from_record + weight * difference


def _arm(q: Floats, clip: Clip, joint: Mapping[str, int], side: str, sign: float) -> None:
    thorax = clip.rotations[:, joint["thorax"]]
    upper = _directions(clip, thorax, joint[side + "shoulder"], joint[side + "elbow"])
    lower = _directions(clip, thorax, joint[side + "elbow"], joint[side + "wrist"])
    rest = clip.rest_positions[joint[side + "wrist"]] - clip.rest_positions[joint[side + "shoulder"]]
    hanging = axis_rotation("x", float(rp.arctan2(rest[1], -rest[2])))
    recorded = _relative(thorax, rp.matmul(clip.rotations[:, joint[side + "shoulder"]], hanging))
    humerus, elbow = _ball(q, side + "shoulder", upper, lower, recorded, sign, 1.0)
    _set(q, side + "elbow.flexion", elbow)
    forearm = rp.matmul(humerus, Rotation.from_euler("Y", -elbow[:, None]).as_matrix())
    hand = _relative(thorax, rp.matmul(clip.rotations[:, joint[side + "wrist"]], hanging))
    angles = Rotation.from_matrix(_relative(forearm, hand)).as_euler("ZXY")
    _set(q, side + "elbow.pronation", -sign * angles[:, 0])
    _set(q, side + "wrist.flexion", -sign * angles[:, 1])
    _set(q, side + "wrist.radial", -angles[:, 2])


def _leg(q: Floats, clip: Clip, joint: Mapping[str, int], side: str, sign: float) -> None:
    pelvis = clip.rotations[:, joint["pelvis"]]
    thigh = _directions(clip, pelvis, joint[side + "hip"], joint[side + "knee"])
    shank_direction = _directions(clip, pelvis, joint[side + "knee"], joint[side + "ankle"])
    recorded = _relative(pelvis, clip.rotations[:, joint[side + "hip"]])
    femur, knee = _ball(q, side + "hip", thigh, shank_direction, recorded, sign, -1.0)
    _set(q, side + "knee.flexion", knee)
    shank = rp.matmul(femur, Rotation.from_euler("Y", knee[:, None]).as_matrix())
    toe = (
        rp.matmul(np.swapaxes(shank, 1, 2), _directions(clip, pelvis, joint[side + "ankle"], joint[side + "toe"])[:, :, None])
    )[:, :, 0]
    rest = clip.rest_positions[joint[side + "toe"]] - clip.rest_positions[joint[side + "ankle"]]
    slope = rp.arctan2(rest[2], rp.hypot(rest[0], rest[1]))  # the toe's fall below the ankle in the reference pose
    _set(q, side + "ankle.dorsiflexion", rp.arctan2(toe[:, 2], toe[:, 0]) - slope)
