"""Forward kinematics in numba, for skinning and for inverse kinematics.

An inverse-kinematics solver calls `fk_into` on buffers of its own: q (D,) in the order of `rig.DOFS`, `rest` =
`person.rest`, and gets rotation and position of the 23 main bones; `end_frames_into` turns them into palms and soles,
`joints_into` into the 20 joints. Everything works on packed arrays and allocates nothing, about 3 microseconds a call.
Axes, signs and orders are those of `rig`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.scene.body.rig import (
    BONE_INDEX,
    BONES,
    DOF_INDEX,
    FINGER_BONES,
    HELPER_BONES,
    MAIN_BONES,
    N_CENTRAL_DOFS,
    N_HELPERS,
    N_LIMB,
    N_MAIN,
    N_SIDED_DOFS,
    PARENT,
    SCAPULOHUMERAL,
    SPINE_SHARES,
)

Array = NDArray[np.float64]


class RestArrays(NamedTuple):
    """One person's skeleton at rest, packed for the kernels (float64, m, rad).

    Mesh axes are those of the root in the zero pose, its origin the root's.
    """

    offsets: Array  # (23, 3) a main bone's origin in its parent's frame
    frames: Array  # (23, 3, 3) mesh_from_bone rotation of the mesh at rest
    heads: Array  # (73, 3) origins of all bones in the mesh at rest
    joint_bone: NDArray[np.int64]  # (20,) the main bone that carries a joint
    joint_offset: Array  # (20, 3) the joint in that bone's frame
    palms: Array  # (2, 4, 4) hand_from_palm, left and right
    soles: Array  # (2, 4, 4) foot_from_sole
    pronation: Array  # (2,) elbow.pronation of the mesh at rest
    finger_axes: Array  # (30, 3) axis of curl in mesh axes
    finger_curl: Array  # (30,) rad at grip 1


_SPINE_FIRST, _SPINE_LAST = BONE_INDEX["spine04"], BONE_INDEX["head"]
_THORAX, _LEFT = BONE_INDEX["spine01"], BONE_INDEX["lclavicle"]
_GROUPS = tuple(SPINE_SHARES)
_SHARE = np.zeros((_SPINE_LAST + 1, len(_GROUPS)))
for _column, _group in enumerate(_GROUPS):
    for _bone, _value in SPINE_SHARES[_group]:
        _SHARE[BONE_INDEX[_bone], _column] = _value
# Positions in a side's block of degrees of freedom and of bones.
_ELEVATION, _PROTRACTION, _SHOULDER, _ELBOW, _PRONATION, _WRIST, _GRIP, _HIP, _KNEE, _ANKLE = (
    DOF_INDEX["l" + name] - N_CENTRAL_DOFS
    for name in (
        "clavicle.elevation", "clavicle.protraction", "shoulder.flexion", "elbow.flexion", "elbow.pronation",
        "wrist.flexion", "hand.grip", "hip.flexion", "knee.flexion", "ankle.dorsiflexion",
    )
)  # fmt: skip
_CLAVICLE, _UPPERARM, _FOREARM, _HAND, _THIGH, _SHANK, _FOOT = range(N_LIMB)
_MAIN_PARENT = np.array([-1 if name == "pelvis" else BONE_INDEX[PARENT[name]] for name in MAIN_BONES])
_N_FINGERS = len(FINGER_BONES) // 2
_FIRST_HELPER, _FIRST_FINGER, _N_BONES = N_MAIN, N_MAIN + len(HELPER_BONES), len(BONES)
# Shares of the twist that bones along a limb take up, so that skin turns evenly between its ends.
_UPPERARM_TWIST, _THIGH_TWIST, _FOREARM_NEAR, _FOREARM_FAR, _SCAPULA = 0.35, 0.4, 0.25, 0.7, 0.25


@njit(cache=True, nogil=True)
def _turn(m: Array, axis: int, angle: float) -> None:
    """m @ R_axis(angle), in place: two columns turn."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    for row in range(3):
        a, b = m[row, i], m[row, j]
        m[row, i] = c * a + s * b
        m[row, j] = c * b - s * a


@njit(cache=True, nogil=True)
def _quaternion(m: Array) -> tuple[float, float, float, float]:
    """(w, x, y, z) of a rotation matrix, w >= 0 (Shepperd 1978)."""
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace > 0:
        r = np.sqrt(1 + trace)
        w, k = r / 2, 0.5 / r
        return w, (m[2, 1] - m[1, 2]) * k, (m[0, 2] - m[2, 0]) * k, (m[1, 0] - m[0, 1]) * k
    i = 0
    if m[1, 1] > m[0, 0]:
        i = 1
    if m[2, 2] > m[i, i]:
        i = 2
    j, n = (i + 1) % 3, (i + 2) % 3
    r = np.sqrt(max(1 + m[i, i] - m[j, j] - m[n, n], 1e-300))
    k = 0.5 / r
    v = np.zeros(3)
    v[i], v[j], v[n] = r / 2, (m[j, i] + m[i, j]) * k, (m[n, i] + m[i, n]) * k
    w = (m[n, j] - m[j, n]) * k
    if w < 0:
        return -w, -v[0], -v[1], -v[2]
    return w, v[0], v[1], v[2]


@njit(cache=True, nogil=True)
def _about(x: float, y: float, z: float, angle: float, out: Array) -> None:
    """Rotation by `angle` about a unit axis (Rodrigues)."""
    c, s = np.cos(angle), np.sin(angle)
    t = 1 - c
    out[0, 0], out[0, 1], out[0, 2] = c + t * x * x, t * x * y - s * z, t * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = t * x * y + s * z, c + t * y * y, t * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = t * x * z - s * y, t * y * z + s * x, c + t * z * z


@njit(cache=True, nogil=True)
def _share_of(m: Array, share: float, out: Array) -> None:
    """The rotation by `share` of m's angle about m's axis."""
    w, x, y, z = _quaternion(m)
    n = np.sqrt(x * x + y * y + z * z)
    if n < 1e-12:
        _about(1.0, 0.0, 0.0, 0.0, out)
    else:
        _about(x / n, y / n, z / n, share * 2 * np.arctan2(n, w), out)


@njit(cache=True, nogil=True)
def _swing_and_share_of_twist(m: Array, ax: float, ay: float, az: float, share: float, out: Array) -> None:
    """m = swing . twist about the axis a: the whole swing and a share of the twist."""
    w, x, y, z = _quaternion(m)
    twist = 2 * np.arctan2(x * ax + y * ay + z * az, w)
    if twist > np.pi:
        twist -= 2 * np.pi
    back = np.empty((3, 3))
    _about(ax, ay, az, (share - 1) * twist, back)
    _product(m, back, out)


@njit(cache=True, nogil=True)
def _product(a: Array, b: Array, out: Array) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True, nogil=True)
def _place(b: int, parent: int, rest: RestArrays, rotation: Array, position: Array) -> None:
    for i in range(3):
        position[b, i] = position[parent, i]
        for j in range(3):
            rotation[b, i, j] = rotation[parent, i, j]
            position[b, i] += rotation[parent, i, j] * rest.offsets[b, j]


@njit(cache=True, nogil=True)
def fk_into(q: Array, rest: RestArrays, vehicle_from_root: Array, rotation: Array, position: Array) -> None:
    """Frames of the main bones in the vehicle frame, written to rotation (23, 3, 3) and position (23, 3).

    q: (D,) rad in the order of `rig.DOFS`; vehicle_from_root: (4, 4). Limits are not applied.
    """
    for i in range(3):
        position[0, i] = vehicle_from_root[i, 3]
        for j in range(3):
            rotation[0, i, j] = vehicle_from_root[i, j]
    whole, part, before = np.empty((4, 3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for group in range(4):
        _about(1.0, 0.0, 0.0, 0.0, whole[group])
        _turn(whole[group], 1, q[3 * group])
        _turn(whole[group], 0, -q[3 * group + 1])
        _turn(whole[group], 2, q[3 * group + 2])
    for b in range(_SPINE_FIRST, _SPINE_LAST + 1):
        _place(b, b - 1, rest, rotation, position)
        for group in range(4):
            if _SHARE[b, group] > 0:
                _share_of(whole[group], _SHARE[b, group], part)
                before[:] = rotation[b]
                _product(before, part, rotation[b])
    for side in range(2):
        s = 1.0 - 2.0 * side
        d, b = N_CENTRAL_DOFS + side * N_SIDED_DOFS, _LEFT + side * N_LIMB
        humerus = rotation[b + _UPPERARM]
        humerus[:] = rotation[_THORAX]
        _turn(humerus, 1, -q[d + _SHOULDER])
        _turn(humerus, 0, s * q[d + _SHOULDER + 1])
        _turn(humerus, 2, -s * q[d + _SHOULDER + 2])
        cosine = 0.0
        for i in range(3):
            cosine += humerus[i, 2] * rotation[_THORAX, i, 2]
        _place(b + _CLAVICLE, _THORAX, rest, rotation, position)
        _turn(rotation[b + _CLAVICLE], 2, -s * q[d + _PROTRACTION])
        _turn(rotation[b + _CLAVICLE], 0, s * (q[d + _ELEVATION] + SCAPULOHUMERAL * (1 - cosine)))
        before[:] = humerus
        _place(b + _UPPERARM, b + _CLAVICLE, rest, rotation, position)
        humerus[:] = before
        _place(b + _FOREARM, b + _UPPERARM, rest, rotation, position)
        _turn(rotation[b + _FOREARM], 1, -q[d + _ELBOW])
        _place(b + _HAND, b + _FOREARM, rest, rotation, position)
        _turn(rotation[b + _HAND], 2, -s * q[d + _PRONATION])
        _turn(rotation[b + _HAND], 0, -s * q[d + _WRIST])
        _turn(rotation[b + _HAND], 1, -q[d + _WRIST + 1])
        _place(b + _THIGH, 0, rest, rotation, position)
        _turn(rotation[b + _THIGH], 1, -q[d + _HIP])
        _turn(rotation[b + _THIGH], 0, s * q[d + _HIP + 1])
        _turn(rotation[b + _THIGH], 2, -s * q[d + _HIP + 2])
        _place(b + _SHANK, b + _THIGH, rest, rotation, position)
        _turn(rotation[b + _SHANK], 1, q[d + _KNEE])
        _place(b + _FOOT, b + _SHANK, rest, rotation, position)
        _turn(rotation[b + _FOOT], 1, -q[d + _ANKLE])
        _turn(rotation[b + _FOOT], 0, -s * q[d + _ANKLE + 1])


@njit(cache=True, nogil=True)
def joints_into(rest: RestArrays, rotation: Array, position: Array, out: Array) -> None:
    """The 20 joints (20, 3) of `core.skeleton.JOINTS` from the frames of `fk_into`, m, vehicle frame."""
    for k in range(len(rest.joint_bone)):
        b = rest.joint_bone[k]
        for i in range(3):
            out[k, i] = position[b, i]
            for j in range(3):
                out[k, i] += rotation[b, i, j] * rest.joint_offset[k, j]


@njit(cache=True, nogil=True)
def end_frames_into(rest: RestArrays, rotation: Array, position: Array, palms: Array, soles: Array) -> None:
    """vehicle_from_palm and vehicle_from_sole, each (2, 4, 4), left and right, from the frames of `fk_into`."""
    for side in range(2):
        for local, bone, out in (
            (rest.palms, _LEFT + side * N_LIMB + _HAND, palms),
            (rest.soles, _LEFT + side * N_LIMB + _FOOT, soles),
        ):
            for i in range(3):
                for j in range(4):
                    value = position[bone, i] if j == 3 else 0.0
                    for k in range(3):
                        value += rotation[bone, i, k] * local[side, k, j]
                    out[side, i, j] = value
                    out[side, 3, j] = 1.0 if j == 3 else 0.0


@njit(cache=True, nogil=True)
def _set_skin(out: Array, b: int, turn: Array, pivot: Array, head: Array) -> None:
    for i in range(3):
        t = pivot[i]
        for j in range(3):
            out[b, i, j] = turn[i, j]
            t -= turn[i, j] * head[j]
        out[b, i, 3] = t


@njit(cache=True, nogil=True)
def skin_transforms_into(q: Array, rest: RestArrays, rotation: Array, position: Array, out: Array) -> None:
    """vehicle_from_mesh (73, 3, 4) of every bone, from the frames of `fk_into`: what skinning applies to the mesh at rest.

    Helper bones turn by a share of the joint they sit at (see `tools/export_body.py`), fingers curl with the grip.
    """
    skin = np.empty((N_MAIN, 3, 3))
    for b in range(N_MAIN):
        _product(rotation[b], rest.frames[b].T, skin[b])
        _set_skin(out, b, skin[b], position[b], rest.heads[b])
    delta, part, turn, pivot = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for side in range(2):
        s = 1.0 - 2.0 * side
        d, b, h = N_CENTRAL_DOFS + side * N_SIDED_DOFS, _LEFT + side * N_LIMB, _FIRST_HELPER + side * N_HELPERS
        # Bones between two segments: (near, far, helper, share of the angle, twist only).
        for near, far, helper, share, kind in (
            (b + _CLAVICLE, b + _UPPERARM, h, _SCAPULA, 0),
            (b + _CLAVICLE, b + _UPPERARM, h + 1, 0.5, 0),
            (b + _CLAVICLE, b + _UPPERARM, h + 2, _UPPERARM_TWIST, 1),
            (b + _UPPERARM, b + _FOREARM, h + 3, 0.5, 0),
            (0, b + _THIGH, h + 7, 0.5, 0),
            (0, b + _THIGH, h + 8, _THIGH_TWIST, 1),
            (b + _THIGH, b + _SHANK, h + 9, 0.5, 0),
            (b + _SHANK, b + _FOOT, h + 10, 0.5, 0),
        ):
            _product(skin[near].T, skin[far], delta)
            if kind == 0:
                _share_of(delta, share, part)
            else:
                axis = rest.frames[far]
                _swing_and_share_of_twist(delta, axis[0, 2], axis[1, 2], axis[2, 2], share, part)
            _product(skin[near], part, turn)
            if helper == h:  # the scapula turns about its own origin, carried by the clavicle
                for i in range(3):
                    pivot[i] = out[near, i, 3]
                    for j in range(3):
                        pivot[i] += out[near, i, j] * rest.heads[helper, j]
            else:
                pivot[:] = position[far]
            _set_skin(out, helper, turn, pivot, rest.heads[far] if helper != h else rest.heads[helper])
        # The forearm's skin turns about its long axis, more towards the hand.
        ulna = b + _FOREARM
        twist = -s * (q[d + _PRONATION] - rest.pronation[side])
        for helper, share in ((h + 4, _FOREARM_NEAR), (h + 5, _FOREARM_FAR)):
            _about(rest.frames[ulna, 0, 2], rest.frames[ulna, 1, 2], rest.frames[ulna, 2, 2], share * twist, part)
            _product(skin[ulna], part, turn)
            _set_skin(out, helper, turn, position[ulna], rest.heads[ulna])
        _product(out[h + 5, :, :3].T, skin[b + _HAND], delta)
        _share_of(delta, 0.5, part)
        _product(out[h + 5, :, :3], part, turn)
        _set_skin(out, h + 6, turn, position[b + _HAND], rest.heads[b + _HAND])
        for k in range(_N_FINGERS):
            f = side * _N_FINGERS + k
            bone = _FIRST_FINGER + f
            near = b + _HAND if k % 3 == 0 else bone - 1
            axis_ = rest.finger_axes[f]
            _about(axis_[0], axis_[1], axis_[2], q[d + _GRIP] * rest.finger_curl[f], part)
            _product(out[near, :, :3], part, turn)
            for i in range(3):
                pivot[i] = out[near, i, 3]
                for j in range(3):
                    pivot[i] += out[near, i, j] * rest.heads[bone, j]
            _set_skin(out, bone, turn, pivot, rest.heads[bone])


def main_frames(q: Array, rest: RestArrays, vehicle_from_root: Array) -> tuple[Array, Array]:
    """`fk_into` on new buffers: rotation (23, 3, 3) and position (23, 3)."""
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    fk_into(q, rest, vehicle_from_root, rotation, position)
    return rotation, position


def skin_transforms(q: Array, rest: RestArrays, rotation: Array, position: Array) -> Array:
    """`skin_transforms_into` on a new buffer (73, 3, 4)."""
    out = np.empty((_N_BONES, 3, 4))
    skin_transforms_into(q, rest, rotation, position, out)
    return out
