"""Serial chains of hinges: forward kinematics, and inverse kinematics within box limits.

A chain of N hinges is two arrays: `fixed` (N + 1, 4, 4), the transform from each hinge's frame to the one before it at
angle zero (the last one carries the tool frame: palm, sole or eyes), and `axes` (N, 3), unit vectors in the hinge's own
frame. With angles q (rad), base_from_tool = fixed[0] R(axes[0], q[0]) fixed[1] ... R(axes[N-1], q[N-1]) fixed[N].

The solver is Levenberg-Marquardt with a diagonal damping (Marquardt 1963; Wampler 1986 for manipulators) and an active set
for the limits: a hinge at its limit whose gradient points outwards is held, steps are cut to the box, and a step is
taken only where it lowers the cost. A prior pulls towards a comfortable posture; for the last iterations it is taken
away, or down to a share, so that it chooses among solutions and hardly biases the one that is found.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import pose as native

Array = NDArray[np.float64]


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


def solve(chain: Chain, task: Task, start: Array, *, iterations: int = 40) -> tuple[Array, Residual]:
    """The chain's angles (N,) rad that bring its tool to the task's target, from `start`, and what is missed."""
    q = np.array(start, dtype=np.float64)
    return q, Residual(*native.solve_chain(chain, task, q, iterations))


def tool(chain: Chain, q: Array) -> Array:
    """base_from_tool (4, 4) of a chain at angles q (N,) rad."""
    base_from_tool = np.empty((4, 4))
    native.chain_tool(chain, np.ascontiguousarray(q, dtype=np.float64), base_from_tool)
    return base_from_tool
