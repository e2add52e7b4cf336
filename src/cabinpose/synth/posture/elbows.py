"""Arms that give way: elbows swivel and hands move aside where trunk, thighs or the car's sides are.

An arm whose palm is where it should be may still turn about the line from shoulder to wrist (the swivel of `two_bone`). It
turns no further than it must: the trouble of `room` is weighed against the angle. A hand that lies in a thigh or in the
trim moves out by the depth, and its arm follows.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cabinpose.scene.body.kinematics import RestArrays, end_frames_into, fk_into
from cabinpose.scene.body.rig import BONE_INDEX, N_MAIN
from cabinpose.synth.posture.chain import Array, Residual, hinge_rotation, solve_chain
from cabinpose.synth.posture.limbs import ARM, LOWER, N_ARM, UPPER, LimbTask, arm_chain
from cabinpose.synth.posture.room import YIELD_M, Room, arm_trouble, hand_way_out
from cabinpose.synth.posture.two_bone import euler_near

_THORAX = BONE_INDEX["spine01"]
_UPPERARM = tuple(BONE_INDEX[s + "upperarm"] for s in "lr")
_FOREARM = tuple(BONE_INDEX[s + "forearm"] for s in "lr")
_HAND = tuple(BONE_INDEX[s + "hand"] for s in "lr")
_STEP, _STEPS = math.radians(8.0), 13  # of the swivel, to either side
_TROUBLE, _BEYOND, _EASE = 100.0, 10.0, 0.008  # cost of a squared metre too deep, radian beyond a limit, radian of swivel
_TROUBLED = 1e-6  # m2
_FIRMER = 4.0  # the shoulder's stiffness at the place that was found
_HELD = 20.0  # cost of a squared metre by which a hand that holds something leaves it
_ROUNDS = 3


@njit(cache=True, nogil=True)
def _follow(
    q: Array, rest: RestArrays, root: Array, side: int, lower: Array, upper: Array, target: Array, wp: Array, wr: Array,
    prior: Array, stiffness: Array, rotation: Array, position: Array,
) -> None:  # fmt: skip
    """Improve an arm that is nearly there, in place of q, from where it is."""
    first = ARM[side]
    low, high = lower[first : first + N_ARM], upper[first : first + N_ARM]
    for _ in range(2):
        fk_into(q, rest, root, rotation, position)
        fixed, axes = arm_chain(rest, side, np.ascontiguousarray(rotation[_THORAX]), position[_UPPERARM[side]].copy())
        angles = q[first : first + N_ARM].copy()
        solve_chain(fixed, axes, low, high, target, wp, wr, prior, stiffness, angles, 12, 0.5)
        q[first : first + N_ARM] = angles
    fk_into(q, rest, root, rotation, position)


@njit(cache=True, nogil=True)
def _swivelled(
    q: Array, rest: RestArrays, side: int, lower: Array, upper: Array, room: Room, allowed: Array, rotation: Array,
    position: Array, prior: Array,
) -> None:  # fmt: skip
    """Set the shoulder's and elbow's angles in `prior` to the swivel of least trouble."""
    first = ARM[side]
    shoulder, elbow, wrist = position[_UPPERARM[side]], position[_FOREARM[side]], position[_HAND[side]]
    line = wrist - shoulder
    line = line / max(math.sqrt(line @ line), 1e-6)
    thorax = np.ascontiguousarray(rotation[_THORAX])
    _, axes = arm_chain(rest, side, thorax, shoulder.copy())
    bone = np.ascontiguousarray(rotation[_UPPERARM[side]])
    swing, angles = np.empty((3, 3)), np.empty(3)
    best = math.inf
    for k in range(-_STEPS, _STEPS + 1):
        hinge_rotation(line, k * _STEP, swing)
        place = shoulder + swing @ (elbow - shoulder)
        euler_near(thorax.T @ swing @ bone, axes[:3], q[first : first + 3], angles)
        cost = _EASE * (k * _STEP) ** 2
        for i in range(3):
            beyond = max(lower[first + i] - angles[i], angles[i] - upper[first + i], 0.0)
            cost += _BEYOND * beyond * beyond
        cost += _TROUBLE * arm_trouble(room, rotation, position, side, place, allowed)
        if cost < best:
            best = cost
            prior[:3] = angles
    prior[3] = q[first + 3]


@njit(cache=True, nogil=True)
def _settle(
    q: Array, rest: RestArrays, root: Array, side: int, lower: Array, upper: Array, goal: Array, wp: Array, wr: Array,
    comfort: Array, stiffness: Array, room: Room, allowed: Array, moves: bool, upwards: bool,
) -> float:  # fmt: skip
    rotation, position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
    palms, soles = np.empty((2, 4, 4)), np.empty((2, 4, 4))
    shift = np.empty(3)
    target = goal.copy()
    prior, firm = comfort.copy(), stiffness.copy()
    best, best_cost = q.copy(), math.inf
    miss = 0.0
    for attempt in range(_ROUNDS + 1):
        fk_into(q, rest, root, rotation, position)
        end_frames_into(rest, rotation, position, palms, soles)
        trouble = arm_trouble(room, rotation, position, side, position[_FOREARM[side]], allowed)
        depth = hand_way_out(room, rotation, position, palms[side], side, allowed, shift) if moves else 0.0
        away = palms[side, :3, 3] - target[:3, 3]
        cost = trouble + depth * depth + (0.3 if moves else _HELD) * (away @ away)
        if cost < best_cost - 1e-7:
            best_cost, miss = cost, math.sqrt(away @ away)
            best[:] = q
        if attempt == _ROUNDS or (trouble < _TROUBLED and depth < 1e-3):
            break
        if depth >= 1e-3:
            if upwards:
                target[2, 3] += depth
            else:
                target[:3, 3] += shift
        if trouble >= _TROUBLED:
            _swivelled(q, rest, side, lower, upper, room, allowed, rotation, position, prior)
            firm[:4] = (_FIRMER if moves else 1.0) * stiffness[:4]
        _follow(q, rest, root, side, lower, upper, target, wp, wr, prior, firm, rotation, position)
    q[:] = best
    return miss


def settle_arm(
    q: Array, rest: RestArrays, vehicle_from_root: Array, side: int, task: LimbTask, room: Room, *, moves: bool,
    upwards: bool = False,
) -> Residual:  # fmt: skip
    """Turn an arm that `limbs.solve_arm` brought to its task out of what is in its way, in place of q.

    moves: the hand itself may move aside, `upwards` or out of what it lies in · returns what the hand misses its
    place by, as moved (m).
    """
    miss = _settle(q, rest, vehicle_from_root, side, LOWER, UPPER, *task, room, YIELD_M, moves, upwards)
    return Residual(float(miss), 0.0)
