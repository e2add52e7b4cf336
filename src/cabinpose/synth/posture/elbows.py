"""Arms that give way: elbows swivel and hands move aside where trunk, thighs or the car's sides are.

An arm whose palm is where it should be may still turn about the line from shoulder to wrist (the swivel of `two_bone`). It
turns no further than it must: the trouble of `room` is weighed against the angle. A hand that lies in a thigh or in the
trim moves out by the depth, and its arm follows.
"""

from __future__ import annotations

from cabinpose._native import pose as native
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.synth.posture.chain import Array, Residual
from cabinpose.synth.posture.limbs import LOWER, UPPER, LimbTask
from cabinpose.synth.posture.room import YIELD_M, Room


def settle_arm(
    q: Array, rest: RestArrays, vehicle_from_root: Array, side: int, task: LimbTask, room: Room, *, moves: bool,
    upwards: bool = False,
) -> Residual:  # fmt: skip
    """Turn an arm that `limbs.solve_arm` brought to its task out of what is in its way, in place of q.

    moves: the hand itself may move aside, `upwards` or out of what it lies in · returns what the hand misses its
    place by, as moved (m).
    """
    return Residual(native.settle_arm(q, rest, vehicle_from_root, side, LOWER, UPPER, task, room, YIELD_M, moves, upwards), 0.0)
