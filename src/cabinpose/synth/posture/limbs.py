"""Arms and legs of a person as chains: palms and soles brought to their targets within the joint limits.

An arm is seven hinges (shoulder 3, elbow, pronation, wrist 2), a leg six (hip 3, knee, ankle 2), with the axes of
`scene.body.rig`. The clavicle moves the shoulder and follows the raising humerus, so an arm is solved in rounds: the
chain with the shoulder where it is, then the skeleton again. A target beyond an arm's length draws the shoulder girdle
after it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from cabinpose.scene.body import DOF_INDEX, DOFS
from cabinpose.scene.body.kinematics import RestArrays, end_frames_into, fk_into
from cabinpose.scene.body.rig import BONE_INDEX, N_MAIN
from cabinpose.synth.posture.chain import Array, Residual, solve_chain
from cabinpose.synth.posture.two_bone import seed_limb

SIDES = ("l", "r")
LOWER = np.array([dof.lower for dof in DOFS])
UPPER = np.array([dof.upper for dof in DOFS])

ARM = tuple(DOF_INDEX[s + "shoulder.flexion"] for s in SIDES)
_LEG = tuple(DOF_INDEX[s + "hip.flexion"] for s in SIDES)
_CLAVICLE = tuple(DOF_INDEX[s + "clavicle.elevation"] for s in SIDES)  # protraction follows
_THORAX = BONE_INDEX["spine01"]
_UPPERARM = tuple(BONE_INDEX[s + "upperarm"] for s in SIDES)
_FOREARM = tuple(BONE_INDEX[s + "forearm"] for s in SIDES)
_HAND = tuple(BONE_INDEX[s + "hand"] for s in SIDES)
_THIGH = tuple(BONE_INDEX[s + "thigh"] for s in SIDES)
_SHANK = tuple(BONE_INDEX[s + "shank"] for s in SIDES)
_FOOT = tuple(BONE_INDEX[s + "foot"] for s in SIDES)
N_ARM, N_LEG = 7, 6
_ROUNDS = 4
_SWIVELS = 36
_KEPT = 0.5  # of the comfortable posture's pull at the end: it settles slants that a task leaves nearly free, for 0.3 mm
_COMFORTABLE_REACH = 0.93  # of the arm's length; beyond it the shoulder girdle takes part


class Frames(NamedTuple):
    """The skeleton in the vehicle frame: rotation (23, 3, 3) and position (23, 3) of the main bones, palms, soles (2, 4, 4)."""

    rotation: Array
    position: Array
    palms: Array
    soles: Array

    def bone(self, name: str) -> Array:
        """vehicle_from_bone (4, 4)."""
        b = BONE_INDEX[name]
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.rotation[b], self.position[b]
        return result


def arm_angles(q: Array, side: int) -> Array:
    """The seven angles of an arm (0 left, 1 right), a copy."""
    return q[ARM[side] : ARM[side] + N_ARM].copy()


def frames(q: Array, rest: RestArrays, vehicle_from_root: Array) -> Frames:
    """Forward kinematics of a posture q (D,) rad."""
    result = Frames(np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3)), np.empty((2, 4, 4)), np.empty((2, 4, 4)))
    fk_into(q, rest, vehicle_from_root, result.rotation, result.position)
    end_frames_into(rest, result.rotation, result.position, result.palms, result.soles)
    return result


@njit(cache=True, nogil=True)
def arm_chain(rest: RestArrays, side: int, base: Array, shoulder: Array) -> tuple[Array, Array]:
    """Fixed (8, 4, 4) and axes (7, 3) of an arm whose shoulder is at `shoulder` (3,), with base (3, 3) the thorax."""
    s = 1.0 - 2.0 * side
    fixed = np.zeros((N_ARM + 1, 4, 4))
    axes = np.zeros((N_ARM, 3))
    for i in range(N_ARM + 1):
        for k in range(4):
            fixed[i, k, k] = 1.0
    fixed[0, :3, :3] = base
    fixed[0, :3, 3] = shoulder
    fixed[3, :3, 3] = rest.offsets[_FOREARM[side]]
    fixed[5, :3, 3] = rest.offsets[_HAND[side]]
    fixed[7] = rest.palms[side]
    axes[0, 1], axes[1, 0], axes[2, 2] = -1.0, s, -s
    axes[3, 1], axes[4, 2] = -1.0, -s
    axes[5, 0], axes[6, 1] = -s, -1.0
    return fixed, axes


@njit(cache=True, nogil=True)
def leg_chain(rest: RestArrays, side: int, base: Array, hip: Array) -> tuple[Array, Array]:
    """Fixed (7, 4, 4) and axes (6, 3) of a leg whose femur head is at `hip` (3,), with base (3, 3) the pelvis."""
    s = 1.0 - 2.0 * side
    fixed = np.zeros((N_LEG + 1, 4, 4))
    axes = np.zeros((N_LEG, 3))
    for i in range(N_LEG + 1):
        for k in range(4):
            fixed[i, k, k] = 1.0
    fixed[0, :3, :3] = base
    fixed[0, :3, 3] = hip
    fixed[3, :3, 3] = rest.offsets[_SHANK[side]]
    fixed[4, :3, 3] = rest.offsets[_FOOT[side]]
    fixed[6] = rest.soles[side]
    axes[0, 1], axes[1, 0], axes[2, 2] = -1.0, s, -s
    axes[3, 1] = 1.0
    axes[4, 1], axes[5, 0] = -1.0, -s
    return fixed, axes


@njit(cache=True, nogil=True)
def _arm_into(
    q: Array, rest: RestArrays, root: Array, side: int, lower: Array, upper: Array, target: Array, wp: Array, wr: Array,
    prior: Array, stiffness: Array, rotation: Array, position: Array,
) -> tuple[float, float]:  # fmt: skip
    """Bring one palm to its target, in place of q; q's clavicle is the start of the shoulder girdle."""
    first, girdle = ARM[side], _CLAVICLE[side]
    low, high = lower[first : first + N_ARM], upper[first : first + N_ARM]
    s = 1.0 - 2.0 * side
    upper_arm, forearm = rest.offsets[_FOREARM[side]], rest.offsets[_HAND[side]]
    length = math.sqrt(upper_arm @ upper_arm) + math.sqrt(forearm @ forearm)
    oriented = wr[0] > 0.0 and wr[2] > 0.0
    angles = q[first : first + N_ARM].copy()
    elevation, protraction = q[girdle], q[girdle + 1]
    errors = (math.inf, math.inf)
    for attempt in range(_ROUNDS):
        fk_into(q, rest, root, rotation, position)
        thorax = np.ascontiguousarray(rotation[_THORAX])
        shoulder = position[_UPPERARM[side]].copy()
        fixed, axes = arm_chain(rest, side, thorax, shoulder)
        if attempt == 0:
            seed_limb(fixed, axes, low, high, 0, target, oriented, prior, stiffness, _SWIVELS, angles)
        errors = solve_chain(fixed, axes, low, high, target, wp, wr, prior, stiffness, angles, 30 if attempt == 0 else 12, _KEPT)
        q[first : first + N_ARM] = angles
        if attempt == 0:
            # The palm's own place stands for the wrist's: half the hand is a small part of the reach.
            to_target = thorax.T @ (np.ascontiguousarray(target[:3, 3]) - shoulder)
            distance = math.sqrt(to_target @ to_target)
            excess = max(distance - _COMFORTABLE_REACH * (length + 0.07), 0.0) + errors[0]
            if excess > 0.0 and distance > 0.0:
                clavicle = rest.offsets[_UPPERARM[side]]
                lever = max(math.sqrt(clavicle @ clavicle), 0.05)
                protraction += excess * to_target[0] / distance / lever
                elevation += excess * to_target[2] / distance / lever
                if s * to_target[1] < 0.0:  # across the chest
                    protraction += 0.5 * excess * abs(to_target[1]) / distance / lever
                q[girdle] = min(max(elevation, lower[girdle]), upper[girdle])
                q[girdle + 1] = min(max(protraction, lower[girdle + 1]), upper[girdle + 1])
    # The last round moved the humerus, and with it the shoulder: what is missed is measured on the skeleton.
    palms, soles = np.empty((2, 4, 4)), np.empty((2, 4, 4))
    fk_into(q, rest, root, rotation, position)
    end_frames_into(rest, rotation, position, palms, soles)
    miss = 0.0
    for k in range(3):
        along = 0.0
        for i in range(3):
            along += target[i, k] * (palms[side, i, 3] - target[i, 3])
        if wp[k] > 0.0:
            miss += along * along
    return math.sqrt(miss), errors[1]


@njit(cache=True, nogil=True)
def _leg_into(
    q: Array, rest: RestArrays, root: Array, side: int, lower: Array, upper: Array, target: Array, wp: Array, wr: Array,
    prior: Array, stiffness: Array, rotation: Array, position: Array,
) -> tuple[float, float]:  # fmt: skip
    """Bring one sole to its target, in place of q."""
    first = _LEG[side]
    low, high = lower[first : first + N_LEG], upper[first : first + N_LEG]
    fk_into(q, rest, root, rotation, position)
    fixed, axes = leg_chain(rest, side, np.ascontiguousarray(rotation[0]), position[_THIGH[side]].copy())
    angles = prior.copy()
    # The closed form takes the ankle to where the target's sole puts it.
    sole = rest.soles[side]
    ankle = np.eye(4)
    for i in range(3):
        ankle[i, 3] = target[i, 3]
        for k in range(3):
            for j in range(3):  # ankle in the sole frame: -R^T t
                ankle[i, 3] -= target[i, k] * sole[j, k] * sole[j, 3]
    knee_chain = np.ascontiguousarray(fixed[:5])
    four = np.empty(4)
    seed_limb(
        knee_chain, np.ascontiguousarray(axes[:4]), low[:4], high[:4], 0, ankle, False, prior[:4], stiffness[:4], _SWIVELS, four
    )
    angles[:4] = four
    errors = solve_chain(fixed, axes, low, high, target, wp, wr, prior, stiffness, angles, 40, _KEPT)
    q[first : first + N_LEG] = angles
    return errors


class LimbTask(NamedTuple):
    """A palm's or sole's target: vehicle_from_target (4, 4), weights (3,) of position and rotation (m/rad) along and about
    the target's axes (0: free), and the comfortable posture (7 or 6,) rad with its stiffness.
    """

    target: Array
    position_weight: Array
    rotation_weight: Array
    prior: Array
    stiffness: Array


def solve_arm(q: Array, rest: RestArrays, vehicle_from_root: Array, side: int, task: LimbTask) -> Residual:
    """Bring the palm of `side` (0 left, 1 right) to its target by moving shoulder girdle, arm and wrist in q, in place."""
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    return Residual(*_arm_into(q, rest, vehicle_from_root, side, LOWER, UPPER, *task, rotation, position))


def solve_leg(q: Array, rest: RestArrays, vehicle_from_root: Array, side: int, task: LimbTask) -> Residual:
    """Bring the sole of `side` (0 left, 1 right) to its target by moving hip, knee and ankle in q, in place."""
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    return Residual(*_leg_into(q, rest, vehicle_from_root, side, LOWER, UPPER, *task, rotation, position))
