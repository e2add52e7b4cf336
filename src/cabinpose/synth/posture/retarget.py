"""Retargeting: a recorded motion as angles of our degrees of freedom.

The recording's skeleton with all rotations zero (upright, looking along +x, arms hanging, thumbs forward) is the
reference pose, like our own zero pose: a segment's rotation away from it is the rotation of ours. Trunk, head, hands and
feet take those rotations. Arms and legs take the directions of their two segments, from joint positions, so that hinge
axes and twist conventions of the recording do not matter: elevation from the upper segment, twist from the plane of the
hinge, and where the limb is nearly straight (the plane is undefined) from the recorded twist.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import MocapError
from cabinpose.scene.body import DOF_INDEX, DOFS
from cabinpose.synth.mocap import Clip

Array = NDArray[np.float64]

# What is needed of a recording, under the names of the CMU database's common conversions.
_NAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pelvis": ("Hips", "hip"),
        "thorax": ("Chest2", "Spine1", "Spine2", "chest"),
        "head": ("Head", "head"),
    }
    | {
        f"{s}{part}": tuple(name.format(side) for name in names)
        for s, side in (("l", "Left"), ("r", "Right"))
        for part, names in {
            "shoulder": ("{}Shoulder", "{}Arm"),
            "elbow": ("{}Elbow", "{}ForeArm"),
            "wrist": ("{}Wrist", "{}Hand"),
            "hip": ("{}Hip", "{}UpLeg"),
            "knee": ("{}Knee", "{}Leg"),
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


class Motion(NamedTuple):
    """A retargeted recording: q (F, D) rad, within the limits, and world_from_root's rotation (F, 3, 3)."""

    q: Array
    root: Array


def retarget(clip: Clip) -> Motion:
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
    return Motion(np.clip(q, lower, upper), pelvis.copy())


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
            f"the recording has no joint {', '.join(missing)}", hint="retargeting knows the joint names of the CMU database"
        )
    return found


def _relative(a: Array, b: Array) -> Array:
    return np.swapaxes(a, -1, -2) @ b


def _set(q: Array, name: str, values: Array) -> None:
    q[:, DOF_INDEX[name]] = values


def _trunk(q: Array, rotation: Array, names: tuple[str, str], shares: tuple[float, float, float]) -> None:
    """Split one rotation Ry(flexion) Rx(-lateral) Rz(rotation) between two joints."""
    angles = Rotation.from_matrix(rotation).as_euler("YXZ") * (1.0, -1.0, 1.0)
    for k, axis in enumerate(("flexion", "lateral", "rotation")):
        _set(q, f"{names[0]}.{axis}", shares[k] * angles[:, k])
        _set(q, f"{names[1]}.{axis}", (1.0 - shares[k]) * angles[:, k])


def _directions(clip: Clip, base: Array, a: int, b: int) -> Array:
    """Unit vectors (F, 3) from joint a to joint b, in the frame `base` (F, 3, 3)."""
    v = clip.positions[:, b] - clip.positions[:, a]
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    return (np.swapaxes(base, 1, 2) @ v[:, :, None])[:, :, 0]


def ball_from_direction(direction: Array, sign: float) -> tuple[Array, Array]:
    """Flexion and abduction (rad) of a shoulder or hip whose limb points along `direction` (F, 3) of the near segment.

    From Ry(-flexion) Rx(sign abduction) (0, 0, -1) = direction, with abduction within a right angle.
    """
    abduction = np.arcsin(np.clip(sign * direction[:, 1], -1.0, 1.0))
    flexion = np.arctan2(direction[:, 0], -direction[:, 2])
    # Close to the straight side the flexion means nothing: it goes to zero rather than jump.
    flexion = np.where(np.hypot(direction[:, 0], direction[:, 2]) < 1e-6, 0.0, flexion)
    return flexion, abduction


def _ball(q: Array, name: str, direction: Array, sign: float) -> Array:
    """Set flexion and abduction of a ball joint; returns its rotation (F, 3, 3) before twist.

    A limb raised backwards of the lower limit of flexion is the same as one abducted beyond a right angle: of the two
    the one within the limits is taken.
    """
    flexion, abduction = ball_from_direction(direction, sign)
    dof = DOFS[DOF_INDEX[f"{name}.flexion"]]
    other_flexion = np.where(flexion > 0, flexion - np.pi, flexion + np.pi)
    other_abduction = np.pi - abduction
    reach = DOFS[DOF_INDEX[f"{name}.abduction"]].upper
    swap = ((flexion < dof.lower) | (flexion > dof.upper)) & (other_abduction <= reach)
    flexion, abduction = np.where(swap, other_flexion, flexion), np.where(swap, other_abduction, abduction)
    _set(q, f"{name}.flexion", flexion)
    _set(q, f"{name}.abduction", abduction)
    return Rotation.from_euler("YX", np.stack((-flexion, sign * abduction), axis=1)).as_matrix()


def _blend(from_plane: Array, from_record: Array, flexion: Array) -> Array:
    """The twist: from the hinge's plane where the limb is bent, from the recording where it is straight."""
    weight = np.clip((flexion - _STRAIGHT[0]) / (_STRAIGHT[1] - _STRAIGHT[0]), 0.0, 1.0)
    difference = (from_plane - from_record + np.pi) % (2 * np.pi) - np.pi
    return from_record + weight * difference


def _arm(q: Array, clip: Clip, joint: Mapping[str, int], side: str, sign: float) -> None:
    thorax = clip.rotations[:, joint["thorax"]]
    upper = _directions(clip, thorax, joint[side + "shoulder"], joint[side + "elbow"])
    lower = _directions(clip, thorax, joint[side + "elbow"], joint[side + "wrist"])
    raised = _ball(q, side + "shoulder", upper, sign)
    w = (np.swapaxes(raised, 1, 2) @ lower[:, :, None])[:, :, 0]
    elbow = np.arccos(np.clip(-w[:, 2], -1.0, 1.0))
    recorded = _relative(raised, _relative(thorax, clip.rotations[:, joint[side + "shoulder"]]))
    recorded_twist = -sign * np.arctan2(recorded[:, 1, 0] - recorded[:, 0, 1], recorded[:, 0, 0] + recorded[:, 1, 1])
    twist = _blend(np.arctan2(-sign * w[:, 1], w[:, 0]), recorded_twist, elbow)
    _set(q, side + "shoulder.rotation", twist)
    _set(q, side + "elbow.flexion", elbow)
    humerus = raised @ Rotation.from_euler("Z", -sign * twist).as_matrix()
    forearm = humerus @ Rotation.from_euler("Y", -elbow).as_matrix()
    hand = _relative(thorax, clip.rotations[:, joint[side + "wrist"]])
    angles = Rotation.from_matrix(_relative(forearm, hand)).as_euler("ZXY")
    _set(q, side + "elbow.pronation", -sign * angles[:, 0])
    _set(q, side + "wrist.flexion", -sign * angles[:, 1])
    _set(q, side + "wrist.radial", -angles[:, 2])


def _leg(q: Array, clip: Clip, joint: Mapping[str, int], side: str, sign: float) -> None:
    pelvis = clip.rotations[:, joint["pelvis"]]
    thigh = _directions(clip, pelvis, joint[side + "hip"], joint[side + "knee"])
    shank_direction = _directions(clip, pelvis, joint[side + "knee"], joint[side + "ankle"])
    raised = _ball(q, side + "hip", thigh, sign)
    w = (np.swapaxes(raised, 1, 2) @ shank_direction[:, :, None])[:, :, 0]
    knee = np.arccos(np.clip(-w[:, 2], -1.0, 1.0))
    recorded = _relative(raised, _relative(pelvis, clip.rotations[:, joint[side + "hip"]]))
    recorded_twist = -sign * np.arctan2(recorded[:, 1, 0] - recorded[:, 0, 1], recorded[:, 0, 0] + recorded[:, 1, 1])
    twist = _blend(np.arctan2(sign * w[:, 1], -w[:, 0]), recorded_twist, knee)
    _set(q, side + "hip.rotation", twist)
    _set(q, side + "knee.flexion", knee)
    femur = raised @ Rotation.from_euler("Z", -sign * twist).as_matrix()
    shank = femur @ Rotation.from_euler("Y", knee).as_matrix()
    toe = (np.swapaxes(shank, 1, 2) @ _directions(clip, pelvis, joint[side + "ankle"], joint[side + "toe"])[:, :, None])[:, :, 0]
    rest = clip.rest_positions[joint[side + "toe"]] - clip.rest_positions[joint[side + "ankle"]]
    slope = np.arctan2(rest[2], np.hypot(rest[0], rest[1]))  # the toe's fall below the ankle in the reference pose
    _set(q, side + "ankle.dorsiflexion", np.arctan2(toe[:, 2], toe[:, 0]) - slope)
