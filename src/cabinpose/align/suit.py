"""The suit's segments as joints of ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import AlignmentError
from cabinpose.core.skeleton import INDEX, JOINTS, RIGS

F64 = NDArray[np.float64]

Triple = tuple[float, float, float]

# Wrist to finger base of a man of 1.75 m (a hand's length of 0.19 m, palm 0.45 of it), left and right, in MVN's hand segments,
# whose pose of identity has the arms stretched out to the sides: left is +y.
HANDS_M: tuple[Triple, Triple] = ((0.0, 0.085, 0.0), (0.0, -0.085, 0.0))


def joints_of_segments(
    names: Sequence[str], position_m: F64, orientation_wxyz: F64, *, hands_m: tuple[Triple, Triple] = HANDS_M
) -> F64:
    """(T, 20, 3) m: our joints in the suit's world from MVN's segments, (T, S, 3) and (T, S, 4) wxyz with these names.

    A joint is the origin of the segment that `RIGS["mvn"]` names. MVN has no finger base: hands_m says where it is in the
    left and the right hand segment, m. NaN where a segment is. Raises AlignmentError where segments are lacking.
    """
    rig = RIGS["mvn"]
    lacking = sorted({theirs for theirs in rig.values() if theirs not in names})
    if lacking:
        raise AlignmentError(
            f"the suit gives no {', '.join(lacking)}", hint="stream all 23 segments (MVN: Position + Orientation, full body)"
        )
    joints = np.full((len(position_m), len(JOINTS), 3), np.nan)
    for joint, theirs in rig.items():
        joints[:, INDEX[joint]] = position_m[:, list(names).index(theirs)]
    for side, offset in zip("lr", hands_m, strict=True):
        hand = list(names).index(rig[f"{side}wrist"])
        turned = orientation_wxyz[:, hand]
        known = np.isfinite(turned).all(axis=-1)
        along = Rotation.from_quat(turned[known], scalar_first=True).apply(offset)
        joints[known, INDEX[f"{side}hand"]] = position_m[known, hand] + along
    return joints
