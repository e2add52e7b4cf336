"""Head and trunk towards something: where a person looks, and how the trunk follows a hand that reaches far."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cabinpose.scene.body import DOF_INDEX
from cabinpose.scene.body.kinematics import RestArrays, fk_into
from cabinpose.scene.body.rig import BONE_INDEX, N_MAIN
from cabinpose.synth.posture.chain import Array, solve_chain
from cabinpose.synth.posture.limbs import LOWER, UPPER

_NECK = DOF_INDEX["neck.flexion"]  # neck's and head's six angles are neighbours
_THORAX, _HEAD = BONE_INDEX["spine01"], BONE_INDEX["head"]
_UPPERARM = tuple(BONE_INDEX[s + "upperarm"] for s in "lr")
_NECK_STIFFNESS = np.array([0.02, 0.03, 0.03, 0.03, 0.06, 0.02])
_TRUNK = np.array(
    [DOF_INDEX[n] for n in ("lumbar.flexion", "lumbar.lateral", "lumbar.rotation", "thorax.flexion", "thorax.rotation")]
)
_TRUNK_EASE = np.array([1.0, 0.5, 0.35, 0.3, 0.8])  # how readily each gives when a hand pulls the trunk along

HEAD_SHARE = (0.8, 0.75)  # of a gaze's yaw and pitch that the head does; the eyes do the rest (Stahl 1999)


@njit(cache=True, nogil=True)
def _turn_head(q: Array, rest: RestArrays, root: Array, target: Array, stiffness: Array, lower: Array, upper: Array) -> float:
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    fk_into(q, rest, root, rotation, position)
    fixed = np.zeros((7, 4, 4))
    for i in range(7):
        for k in range(4):
            fixed[i, k, k] = 1.0
    fixed[0, :3, :3] = rotation[_THORAX]
    axes = np.zeros((6, 3))
    for i in range(2):
        axes[3 * i, 1], axes[3 * i + 1, 0], axes[3 * i + 2, 2] = 1.0, -1.0, 1.0
    angles = np.zeros(6)
    zero, one, weak = np.zeros(6), np.ones(3), np.zeros(3)
    low, high = lower[_NECK : _NECK + 6], upper[_NECK : _NECK + 6]
    _, missed = solve_chain(fixed, axes, low, high, target, weak, one, zero, stiffness, angles, 25, 0.0)
    q[_NECK : _NECK + 6] = angles
    return missed


def head_rotation(vehicle_yaw: float, pitch: float, roll: float = 0.0) -> Array:
    """A head's frame (4, 4): heading `vehicle_yaw` (rad, + left), pitched up by `pitch`, tilted to the left by `roll`."""
    cy, sy, cp, sp, cr, sr = (f(a) for a in (vehicle_yaw, -pitch, -roll) for f in (math.cos, math.sin))
    result = np.eye(4)
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    tip = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    result[:3, :3] = yaw @ tip @ tilt
    return result


def turn_head(q: Array, rest: RestArrays, vehicle_from_root: Array, vehicle_from_head: Array) -> float:
    """Turn neck and head in q, in place, so that the head's frame has this rotation; returns what is missed, rad."""
    return float(_turn_head(q, rest, vehicle_from_root, vehicle_from_head, _NECK_STIFFNESS, LOWER, UPPER))


def look_angles(eye: Array, point: Array, heading: float) -> tuple[float, float]:
    """Yaw (+ left, from `heading`) and pitch (+ up), rad, of the line from an eye to a point."""
    v = point - eye
    yaw = math.atan2(v[1], v[0]) - heading
    return (yaw + math.pi) % (2 * math.pi) - math.pi, math.atan2(v[2], math.hypot(v[0], v[1]))


@njit(cache=True, nogil=True)
def _lean(
    q: Array, rest: RestArrays, root: Array, side: int, point: Array, reach: float, dofs: Array, ease: Array, lower: Array,
    upper: Array,
) -> float:  # fmt: skip
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    n, h = len(dofs), 1e-4
    gradient = np.empty(n)
    missing = 0.0
    for _ in range(12):
        fk_into(q, rest, root, rotation, position)
        shoulder = position[_UPPERARM[side]].copy()
        missing = math.sqrt((point - shoulder) @ (point - shoulder)) - reach
        if missing < 1e-3:
            return max(missing, 0.0)
        norm = 0.0
        for i in range(n):
            old = q[dofs[i]]
            q[dofs[i]] = old + h
            fk_into(q, rest, root, rotation, position)
            moved = point - position[_UPPERARM[side]]
            gradient[i] = (math.sqrt(moved @ moved) - reach - missing) / h
            q[dofs[i]] = old
            norm += ease[i] * gradient[i] * gradient[i]
        if norm < 1e-9:
            return missing
        for i in range(n):
            step = -missing * ease[i] * gradient[i] / norm
            step = min(max(step, -0.2), 0.2)
            q[dofs[i]] = min(max(q[dofs[i]] + step, lower[dofs[i]]), upper[dofs[i]])
    return missing


def lean_to_reach(q: Array, rest: RestArrays, vehicle_from_root: Array, side: int, point: Array, reach: float) -> float:
    """Bend and turn the trunk in q, in place, just so far that the shoulder of `side` comes within `reach` m of a point.

    Returns the distance (m) still missing. Flexion and lateral bend of the loins give most, then rotation.
    """
    return float(_lean(q, rest, vehicle_from_root, side, np.asarray(point), reach, _TRUNK, _TRUNK_EASE, LOWER, UPPER))
