"""Arms and legs of a person as chains: palms and soles brought to their targets within the joint limits.

An arm is seven hinges (shoulder 3, elbow, pronation, wrist 2), a leg six (hip 3, knee, ankle 2), with the axes of
`scene.body.rig`. The clavicle moves the shoulder and follows the raising humerus, so an arm is solved in rounds: the
chain with the shoulder where it is, then the skeleton again. A target beyond an arm's length draws the shoulder girdle
after it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cabinpose._native import pose as native
from cabinpose.scene.body import DOF_INDEX, DOFS
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.scene.body.rig import BONE_INDEX, N_MAIN
from cabinpose.synth.posture.chain import Array, Residual

SIDES = ("l", "r")
LOWER = np.array([dof.lower for dof in DOFS])
UPPER = np.array([dof.upper for dof in DOFS])

ARM = tuple(DOF_INDEX[s + "shoulder.flexion"] for s in SIDES)
N_ARM = 7


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
    native.skeleton_frames(q, rest, vehicle_from_root, *result)
    return result


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
    return Residual(*native.solve_arm(q, rest, vehicle_from_root, side, LOWER, UPPER, task))


def solve_leg(q: Array, rest: RestArrays, vehicle_from_root: Array, side: int, task: LimbTask) -> Residual:
    """Bring the sole of `side` (0 left, 1 right) to its target by moving hip, knee and ankle in q, in place."""
    return Residual(*native.solve_leg(q, rest, vehicle_from_root, side, LOWER, UPPER, task))
