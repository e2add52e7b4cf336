"""The suit's segments as joints of ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cabinpose.align.chain import rigid
from cabinpose.core import CABINPOSE, JOINTS, MVN_JOINTS, MVN_SEGMENTS, AlignmentError, Matrix

F64 = NDArray[np.float64]

Triple = tuple[float, float, float]

# Wrist to finger base of a man of 1.75 m (a hand's length of 0.19 m, palm 0.45 of it), left and right, in MVN's hand segments,
# whose pose of identity has the arms stretched out to the sides: left is +y.
HANDS_M: tuple[Triple, Triple] = ((0.0, 0.085, 0.0), (0.0, -0.085, 0.0))

# The suit's points: the origins of its segments and the finger bases, which MVN does not have. Each point but the pelvis lies at
# a constant place in the axes of the segment before it (`CARRIER`, -1 for the pelvis), which comes earlier in the list.
POINTS: tuple[str, ...] = (*MVN_SEGMENTS, "lhand", "rhand")
_BEFORE = {child: parent for _, parent, child in MVN_JOINTS} | {"lhand": "LeftHand", "rhand": "RightHand"}
CARRIER = np.array([POINTS.index(_BEFORE[name]) if name in _BEFORE else -1 for name in POINTS])
JOINT_POINTS = np.array([POINTS.index(CABINPOSE.maps["mvn"].get(joint, joint)) for joint in JOINTS])


def suit_points(names: Sequence[str], position_m: F64, orientation_wxyz: F64, *, hands_m: tuple[Triple, Triple]) -> Matrix:
    """The suit's points and how they are turned, in the suit's world.

    Parameters
    ----------
    names
        Of the S segments.
    position_m, orientation_wxyz
        (T, S, 3) and (T, S, 4), as the suit gives them.
    hands_m
        The finger base in the left and in the right hand segment, m.

    Returns
    -------
    ndarray
        (T, 25, 4, 4) world_from_segment of `POINTS`; a finger base is turned as its hand. NaN where a segment is. The joints of
        `core.skeleton.JOINTS` are the origins of `JOINT_POINTS`.

    Raises
    ------
    AlignmentError
        Where segments are lacking.
    """
    lacking = sorted(set(MVN_SEGMENTS) - set(names))
    if lacking:
        raise AlignmentError(
            f"the suit gives no {', '.join(lacking)}", hint="stream all 23 segments (MVN: Position + Orientation, full body)"
        )
    order = [list(names).index(segment) for segment in MVN_SEGMENTS]
    order += [order[point] for point in CARRIER[len(MVN_SEGMENTS) :]]
    poses = rigid(position_m[:, order], orientation_wxyz[:, order])
    poses[..., :3, 3] = position_m[:, order]
    for point, hand in zip((-2, -1), hands_m, strict=True):
        poses[:, point, :3, 3] += poses[:, point, :3, :3] @ np.array(hand)
    return poses
