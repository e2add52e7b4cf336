"""Closed-form arms and legs: a ball joint, a hinge and a wrist (or ankle), with the swivel angle searched.

The middle hinge follows from the distance to the target alone. The ball joint may then still turn about the line from
it to the target: the swivel (Tolani, Goswami and Badler 2000, "Real-time inverse kinematics techniques for
anthropomorphic limbs"; Kallmann 2008, "Analytical inverse kinematics with body posture control"). A sweep over the
swivel takes the angle that violates the limits least and, among those within them, lies nearest to a comfortable
posture. The result starts the chain solver, which removes what is left.
"""

from __future__ import annotations

import numpy as np

from cabinpose._native import pose as native
from cabinpose.synth.posture.chain import Array, Chain


def seed(chain: Chain, ball: int, target: Array, prior: Array, stiffness: Array, *, oriented: bool, swivels: int = 48) -> Array:
    """A start (N,) rad for the chain solver: the closed form at the best swivel, clipped to the limits."""
    q = np.empty(len(prior))
    native.seed_limb(chain, ball, target, prior, stiffness, oriented, swivels, q)
    return q
