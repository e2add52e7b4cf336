"""Closed-form arms and legs: a ball joint, a hinge and a wrist (or ankle), with the swivel angle searched.

The middle hinge follows from the distance to the target alone. The ball joint may then still turn about the line from
it to the target: the swivel (Tolani, Goswami and Badler 2000, "Real-time inverse kinematics techniques for
anthropomorphic limbs"; Kallmann 2008, "Analytical inverse kinematics with body posture control"). A sweep over the
swivel takes the angle that violates the limits least and, among those within them, lies nearest to a comfortable
posture. The result starts the chain solver, which removes what is left.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cabinpose.synth.posture.chain import Array, Chain, chain_tool, hinge_rotation

_VIOLATION = 1e3  # cost of a squared radian beyond a limit, against 1 for one of discomfort


@njit(cache=True, nogil=True)
def euler_near(r: Array, axes: Array, near: Array, out: Array) -> None:
    """Angles (3,) of a rotation about three mutually orthogonal axes in turn, r = R(a0) R(a1) R(a2), into `out`.

    In the frame of the axes this is the x-y-z sequence, mirrored where the axes are left-handed. Of the two solutions
    the one nearer to `near` (3,) is taken; where the middle axis is at a right angle the last angle stays near it.
    """
    m = axes @ r @ axes.T  # rows of `axes` are the axes: r seen along them
    sign = 1.0 if np.cross(axes[0], axes[1]) @ axes[2] > 0.0 else -1.0
    sine = min(max(m[0, 2], -1.0), 1.0)
    best = math.inf
    for branch in range(2):
        b = math.asin(sine) if branch == 0 else math.pi - math.asin(sine)
        c = math.cos(b)
        if abs(c) > 1e-6:
            a = math.atan2(-m[1, 2] / c, m[2, 2] / c)
            g = math.atan2(-m[0, 1] / c, m[0, 0] / c)
        else:
            g = sign * near[2]
            a = math.atan2(m[2, 1], m[1, 1]) - (g if sine > 0 else -g)
        cost = 0.0
        angles = (sign * a, sign * b, sign * g)
        for i in range(3):
            cost += _wrapped(angles[i] - near[i]) ** 2
        if cost < best:
            best = cost
            for i in range(3):
                out[i] = near[i] + _wrapped(angles[i] - near[i])


@njit(cache=True, nogil=True)
def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True, nogil=True)
def _hinge_for_distance(elbow: Array, axis: Array, wrist: Array, distance: float, lower: float, upper: float) -> float:
    """The hinge angle within [lower, upper] at which |elbow + R(axis, angle) wrist| is `distance`, or comes nearest.

    The squared length is a + b cos(angle) + c sin(angle): the part of the wrist along the axis stays, the rest turns.
    """
    along = axis @ wrist
    across = wrist - along * axis
    side = np.cross(axis, across)
    a = float(elbow @ elbow + wrist @ wrist + 2.0 * along * (elbow @ axis))
    b, c = float(2.0 * (elbow @ across)), float(2.0 * (elbow @ side))
    amplitude = math.sqrt(b * b + c * c)
    phase = math.atan2(c, b)
    ratio = float((distance * distance - a) / max(amplitude, 1e-12))
    spread = math.acos(min(max(ratio, -1.0), 1.0))
    best: float = lower
    best_cost = math.inf
    for candidate in (phase + spread, phase - spread, lower, upper):
        angle = min(max(_wrapped(candidate - 0.5 * (lower + upper)) + 0.5 * (lower + upper), lower), upper)
        cost = abs(a + b * math.cos(angle) + c * math.sin(angle) - distance * distance)
        if cost < best_cost - 1e-12:
            best, best_cost = angle, cost
    return best


@njit(cache=True, nogil=True)
def seed_limb(
    fixed: Array, axes: Array, lower: Array, upper: Array, ball: int, target: Array, oriented: bool,
    prior: Array, stiffness: Array, swivels: int, q: Array,
) -> float:  # fmt: skip
    """Angles (N,) rad that bring the limb's tool near `target` (4, 4, chain base), into q; returns the cost of the best swivel.

    The chain: any hinges up to `ball` (they stay at the prior), three orthogonal hinges through one point, the middle
    hinge, then the rest (three orthogonal hinges are solved for the tool's rotation where `oriented`, otherwise all
    stay at the prior). What the closed form leaves out (an ankle of two hinges, a rest bent by the prior) the chain
    solver mends.
    """
    n = len(axes)
    frames = np.empty((n + 1, 4, 4))
    for i in range(n):
        q[i] = min(max(prior[i], lower[i]), upper[i])
    full_wrist = oriented and n == ball + 7
    chain_tool(fixed, axes, q, frames)
    # The rest of the chain behind the middle hinge, at the prior: where the wrist sits in the frame of the hinge.
    hinge = ball + 3
    wrist_at = frames[n][:3, 3].copy()
    goal = target[:3, 3].copy()
    wanted = np.ascontiguousarray(target[:3, :3])
    if full_wrist:
        # The wrist's centre does not depend on its own angles: take it from the tool back.
        tool_from_wrist = _inverse(frames[n]) @ frames[n - 1]
        wrist_at = frames[n - 1][:3, 3].copy()
        centre = tool_from_wrist[:3, 3].copy()
        # The last hinges turn the tool about the centre, so its place in the tool frame is constant.
        goal = wanted @ centre + goal
    hinge_frame = frames[hinge]
    turn = np.empty((3, 3))
    hinge_rotation(axes[hinge], q[hinge], turn)
    wrist_local = turn.T @ (np.ascontiguousarray(hinge_frame[:3, :3].T) @ (wrist_at - hinge_frame[:3, 3]))
    origin = frames[ball][:3, 3].copy()
    base = frames[ball][:3, :3].copy()
    to_goal = goal - origin
    distance = math.sqrt(to_goal @ to_goal)
    elbow = np.ascontiguousarray(fixed[hinge][:3, 3])
    elbow_rotation = np.ascontiguousarray(fixed[hinge][:3, :3])
    # In the frame of the upper bone the hinge sits at `elbow`, turned by `elbow_rotation`.
    local_axis = elbow_rotation @ axes[hinge]
    bend = _hinge_for_distance(elbow, local_axis, elbow_rotation @ wrist_local, distance, lower[hinge], upper[hinge])
    hinge_rotation(axes[hinge], bend, turn)
    reach = elbow + elbow_rotation @ (turn @ wrist_local)
    if distance < 1e-9:
        return math.inf
    aim = base.T @ (to_goal / distance)
    reach = reach / math.sqrt(reach @ reach)
    first = _shortest_rotation(reach, aim)
    swivel = np.empty((3, 3))
    angles, wrist_angles = np.empty(3), np.empty(3)
    trial, best = q.copy(), math.inf
    trial[hinge] = bend
    for k in range(swivels):
        hinge_rotation(aim, 2.0 * math.pi * k / swivels, swivel)
        rotation = swivel @ first
        euler_near(rotation, axes[ball : ball + 3], prior[ball : ball + 3], angles)
        trial[ball : ball + 3] = angles
        if full_wrist:
            upper_bone = base @ rotation
            lower_bone = upper_bone @ elbow_rotation @ turn
            rest = (lower_bone @ np.ascontiguousarray(fixed[hinge + 1][:3, :3])).T @ wanted
            rest = rest @ np.ascontiguousarray(fixed[n][:3, :3]).T
            euler_near(rest, axes[hinge + 1 : n], prior[hinge + 1 : n], wrist_angles)
            trial[hinge + 1 : n] = wrist_angles
        cost = 0.0
        for i in range(ball, n):
            beyond = max(lower[i] - trial[i], trial[i] - upper[i], 0.0)
            cost += _VIOLATION * beyond * beyond + stiffness[i] * (trial[i] - prior[i]) ** 2
        if cost < best:
            best = cost
            q[:] = trial
    for i in range(n):
        q[i] = min(max(q[i], lower[i]), upper[i])
    return best


@njit(cache=True, nogil=True)
def _inverse(a_from_b: Array) -> Array:
    result = np.eye(4)
    rotation = np.ascontiguousarray(a_from_b[:3, :3].T)
    result[:3, :3] = rotation
    result[:3, 3] = -rotation @ np.ascontiguousarray(a_from_b[:3, 3])
    return result


@njit(cache=True, nogil=True)
def _shortest_rotation(a: Array, b: Array) -> Array:
    """The rotation about the common normal that turns unit vector a onto unit vector b."""
    normal = np.cross(a, b)
    s = math.sqrt(normal @ normal)
    result = np.empty((3, 3))
    if s > 1e-9:
        hinge_rotation(normal / s, math.atan2(s, a @ b), result)
    elif a @ b > 0.0:
        result[:] = np.eye(3)
    else:
        other = np.zeros(3)
        other[np.argmin(np.abs(a))] = 1.0
        across = np.cross(a, other)
        hinge_rotation(across / math.sqrt(across @ across), math.pi, result)
    return result


def seed(chain: Chain, ball: int, target: Array, prior: Array, stiffness: Array, *, oriented: bool, swivels: int = 48) -> Array:
    """A start (N,) rad for the chain solver: the closed form at the best swivel, clipped to the limits."""
    q = np.empty(len(prior))
    seed_limb(chain.fixed, chain.axes, chain.lower, chain.upper, ball, target, oriented, prior, stiffness, swivels, q)
    return q
