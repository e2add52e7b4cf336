"""Serial chains of hinges: forward kinematics, and inverse kinematics within box limits, in numba.

A chain of N hinges is two arrays: `fixed` (N + 1, 4, 4), the transform from each hinge's frame to the one before it at
angle zero (the last one carries the tool frame: palm, sole or eyes), and `axes` (N, 3), unit vectors in the hinge's own
frame. With angles q (rad), base_from_tool = fixed[0] R(axes[0], q[0]) fixed[1] ... R(axes[N-1], q[N-1]) fixed[N].

The solver is Levenberg-Marquardt with a diagonal damping (Marquardt 1963; Wampler 1986 for manipulators) and an active set
for the limits: a hinge at its limit whose gradient points outwards is held, steps are cut to the box, and a step is
taken only where it lowers the cost. A prior pulls towards a comfortable posture; for the last iterations it is taken
away, or down to a share, so that it chooses among solutions and hardly biases the one that is found.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PRIOR_SHARE = 0.6  # of the iterations, with the prior at work
_DAMPING = (1e-4, 1e-10, 1e8)  # first, least and largest


class Chain(NamedTuple):
    """A serial chain: see the module for `fixed` and `axes`; lower, upper (N,) rad; dofs (N,) indices into a posture."""

    fixed: Array
    axes: Array
    lower: Array
    upper: Array
    dofs: NDArray[np.int64]


class Task(NamedTuple):
    """Where a chain's tool shall be.

    base_from_target: (4, 4), in the chain's base · position_weight: (3,) and rotation_weight: (3,) m/rad, along and
    about the target's own axes, 0 where it is free · prior: (N,) rad, the comfortable posture · stiffness: (N,) the
    weight of departing from it, relative to 1 m of error.
    """

    base_from_target: Array
    position_weight: Array
    rotation_weight: Array
    prior: Array
    stiffness: Array


class Residual(NamedTuple):
    """What a solution misses its target by, over the directions the task asks for: metres and radians."""

    position: float
    rotation: float


@njit(cache=True, nogil=True)
def hinge_rotation(axis: Array, angle: float, out: Array) -> None:
    """Rotation (3, 3) by an angle about a unit axis (Rodrigues), into `out`."""
    c, s = math.cos(angle), math.sin(angle)
    t = 1.0 - c
    x, y, z = axis[0], axis[1], axis[2]
    out[0, 0], out[0, 1], out[0, 2] = t * x * x + c, t * x * y - s * z, t * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = t * x * y + s * z, t * y * y + c, t * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = t * x * z - s * y, t * y * z + s * x, t * z * z + c


@njit(cache=True, nogil=True)
def rotation_vector(r: Array, out: Array) -> None:
    """The rotation vector (3,) of a rotation matrix, into `out`; well-behaved at zero and near half a turn."""
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    s = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(s, r[0, 0] + r[1, 1] + r[2, 2] - 1.0)
    if angle < math.pi - 1e-3:
        k = 0.5 if s < 1e-9 else angle / s
        out[0], out[1], out[2] = k * x, k * y, k * z
        return
    # Near half a turn the antisymmetric part vanishes: the axis is the largest column of R + I.
    best = 0
    for i in range(1, 3):
        if r[i, i] > r[best, best]:
            best = i
    norm = 0.0
    for i in range(3):
        out[i] = 0.5 * (r[i, best] + r[best, i]) + (1.0 if i == best else 0.0)
        norm += out[i] * out[i]
    sign = 1.0 if out[0] * x + out[1] * y + out[2] * z >= 0.0 else -1.0
    for i in range(3):
        out[i] *= sign * angle / math.sqrt(norm)


@njit(cache=True, nogil=True)
def chain_tool(fixed: Array, axes: Array, q: Array, frames: Array) -> None:
    """Frames (N + 1, 4, 4): base_from_hinge of every hinge (before it turns; its axis keeps its direction), then the tool's."""
    n = len(axes)
    turn = np.empty((3, 3))
    frames[0] = fixed[0]
    for i in range(n):
        hinge_rotation(axes[i], q[i], turn)
        current, following, step = frames[i], frames[i + 1], fixed[i + 1]
        turned = np.empty((3, 3))
        for a in range(3):
            for b in range(3):
                turned[a, b] = current[a, 0] * turn[0, b] + current[a, 1] * turn[1, b] + current[a, 2] * turn[2, b]
        for a in range(3):
            for b in range(4):
                total = turned[a, 0] * step[0, b] + turned[a, 1] * step[1, b] + turned[a, 2] * step[2, b]
                following[a, b] = total + (current[a, 3] if b == 3 else 0.0)
            following[3, a] = 0.0
        following[3, 3] = 1.0


@njit(cache=True, nogil=True)
def _errors(tool: Array, target: Array, wp: Array, wr: Array, e: Array) -> float:
    """The weighted error (6,), position then rotation in the target's frame, into `e`; returns half its square."""
    rel = np.empty((3, 3))
    for a in range(3):
        e[a] = 0.0
        for k in range(3):
            e[a] += target[k, a] * (tool[k, 3] - target[k, 3])
        for b in range(3):
            rel[a, b] = target[0, a] * tool[0, b] + target[1, a] * tool[1, b] + target[2, a] * tool[2, b]
    rotation_vector(rel, e[3:])
    cost = 0.0
    for a in range(3):
        e[a] *= wp[a]
        e[3 + a] *= wr[a]
        cost += 0.5 * (e[a] * e[a] + e[3 + a] * e[3 + a])
    return cost


@njit(cache=True, nogil=True)
def _solve_spd(a: Array, b: Array, held: NDArray[np.bool_], x: Array) -> None:
    """Solve the free rows of a symmetric positive definite system by Cholesky; held unknowns are 0. Overwrites a."""
    n = len(b)
    for i in range(n):
        if held[i]:
            for j in range(n):
                a[i, j] = a[j, i] = 0.0
            a[i, i] = 1.0
            b[i] = 0.0
    for j in range(n):
        d = a[j, j]
        for k in range(j):
            d -= a[j, k] * a[j, k]
        a[j, j] = math.sqrt(max(d, 1e-300))
        for i in range(j + 1, n):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = s / a[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * x[k]
        x[i] = s / a[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= a[k, i] * x[k]
        x[i] = s / a[i, i]


@njit(cache=True, nogil=True)
def _jacobian(frames: Array, axes: Array, target: Array, wp: Array, wr: Array, jac: Array) -> None:
    """The derivative of the errors by the angles (6, N), first order in the rotation error, into `jac`."""
    n = len(axes)
    tool = frames[n]
    w = np.empty(3)
    v = np.empty(3)
    for i in range(n):
        f = frames[i]
        for a in range(3):
            w[a] = f[a, 0] * axes[i, 0] + f[a, 1] * axes[i, 1] + f[a, 2] * axes[i, 2]
        dx, dy, dz = tool[0, 3] - f[0, 3], tool[1, 3] - f[1, 3], tool[2, 3] - f[2, 3]
        v[0], v[1], v[2] = w[1] * dz - w[2] * dy, w[2] * dx - w[0] * dz, w[0] * dy - w[1] * dx
        for a in range(3):
            jac[a, i] = wp[a] * (target[0, a] * v[0] + target[1, a] * v[1] + target[2, a] * v[2])
            jac[3 + a, i] = wr[a] * (target[0, a] * w[0] + target[1, a] * w[1] + target[2, a] * w[2])


@njit(cache=True, nogil=True)
def _prior_cost(q: Array, prior: Array, stiffness: Array, share: float) -> float:
    cost = 0.0
    for i in range(len(q)):
        cost += 0.5 * share * stiffness[i] * (q[i] - prior[i]) ** 2
    return cost


@njit(cache=True, nogil=True)
def solve_chain(
    fixed: Array,
    axes: Array,
    lower: Array,
    upper: Array,
    target: Array,
    wp: Array,
    wr: Array,
    prior: Array,
    stiffness: Array,
    q: Array,
    iterations: int,
    kept: float,
) -> tuple[float, float]:
    """Improve q (N,) rad in place so that the tool meets the target; never leaves the limits.

    For the last iterations only the share `kept` of the prior's stiffness stays at work: 0 leaves no bias.
    Returns the unweighted position (m) and rotation (rad) error over the directions with a weight.
    """
    n = len(q)
    frames = np.empty((n + 1, 4, 4))
    e, e_new = np.empty(6), np.empty(6)
    jac = np.empty((6, n))
    hessian, gradient = np.empty((n, n)), np.empty(n)
    held = np.zeros(n, np.bool_)
    step, trial = np.empty(n), np.empty(n)
    for i in range(n):
        q[i] = min(max(q[i], lower[i]), upper[i])
    damping = _DAMPING[0]
    share = 1.0
    chain_tool(fixed, axes, q, frames)
    task = _errors(frames[n], target, wp, wr, e)
    cost = task + _prior_cost(q, prior, stiffness, share)
    with_prior = int(_PRIOR_SHARE * iterations)
    for iteration in range(iterations):
        if iteration >= with_prior and share > kept:
            share, damping = kept, _DAMPING[0]
            cost = task + _prior_cost(q, prior, stiffness, share)
        if share <= kept and cost < 1e-14:
            break
        _jacobian(frames, axes, target, wp, wr, jac)
        for i in range(n):
            g = share * stiffness[i] * (q[i] - prior[i])
            for k in range(6):
                g += jac[k, i] * e[k]
            gradient[i] = -g
            held[i] = (q[i] <= lower[i] and g > 0.0) or (q[i] >= upper[i] and g < 0.0)
            for j in range(i + 1):
                h = 0.0
                for k in range(6):
                    h += jac[k, i] * jac[k, j]
                hessian[i, j] = hessian[j, i] = h
            hessian[i, i] += share * stiffness[i] + damping
        _solve_spd(hessian, gradient, held, step)
        largest = 0.0
        for i in range(n):
            trial[i] = min(max(q[i] + step[i], lower[i]), upper[i])
            largest = max(largest, abs(trial[i] - q[i]))
        chain_tool(fixed, axes, trial, frames)
        task_new = _errors(frames[n], target, wp, wr, e_new)
        cost_new = task_new + _prior_cost(trial, prior, stiffness, share)
        if cost_new < cost:
            q[:] = trial
            e[:] = e_new
            task, cost = task_new, cost_new
            damping = max(damping * 0.2, _DAMPING[1])
        else:
            damping = damping * 6.0
            chain_tool(fixed, axes, q, frames)
        if damping > _DAMPING[2] or largest < 1e-9:
            if share <= kept:
                break
            with_prior = iteration + 1
    position = rotation = 0.0
    for a in range(3):
        if wp[a] > 0.0:
            position += (e[a] / wp[a]) ** 2
        if wr[a] > 0.0:
            rotation += (e[3 + a] / wr[a]) ** 2
    return math.sqrt(position), math.sqrt(rotation)


def solve(chain: Chain, task: Task, start: Array, *, iterations: int = 40) -> tuple[Array, Residual]:
    """The chain's angles (N,) rad that bring its tool to the task's target, from `start`, and what is missed."""
    q = np.array(start, dtype=np.float64)
    position, rotation = solve_chain(
        chain.fixed, chain.axes, chain.lower, chain.upper,
        task.base_from_target, task.position_weight, task.rotation_weight, task.prior, task.stiffness, q, iterations, 0.0,
    )  # fmt: skip
    return q, Residual(position, rotation)


def tool(chain: Chain, q: Array) -> Array:
    """base_from_tool (4, 4) of a chain at angles q (N,) rad."""
    frames = np.empty((len(chain.axes) + 1, 4, 4))
    chain_tool(chain.fixed, chain.axes, np.asarray(q, dtype=np.float64), frames)
    return frames[-1]
