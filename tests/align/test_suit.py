"""The suit's segments as our joints."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.suit import HANDS_M, JOINT_POINTS, suit_points
from cabinpose.core.errors import AlignmentError
from cabinpose.core.skeleton import CABINPOSE, MVN_SEGMENTS


def _segments(count: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    position = rng.normal(size=(count, len(MVN_SEGMENTS), 3))
    orientation = np.zeros((count, len(MVN_SEGMENTS), 4))
    orientation[..., 0] = 1.0
    return position, orientation


def joints_of_segments(names, position, orientation, hands_m=HANDS_M) -> np.ndarray:
    return suit_points(names, position, orientation, hands_m=hands_m)[..., :3, 3][:, JOINT_POINTS]


def test_joints_are_origins_of_their_segments_whatever_their_order():
    position, orientation = _segments()
    joints = joints_of_segments(MVN_SEGMENTS, position, orientation)
    for joint, segment in CABINPOSE.maps["mvn"].items():
        assert (joints[:, CABINPOSE.index[joint]] == position[:, MVN_SEGMENTS.index(segment)]).all()
    order = np.random.default_rng(2).permutation(len(MVN_SEGMENTS))
    names = [MVN_SEGMENTS[i] for i in order]
    assert (joints_of_segments(names, position[:, order], orientation[:, order]) == joints).all()


def test_hands_lie_outwards_along_the_arms_stretched_to_the_sides():
    position, orientation = _segments()
    joints = joints_of_segments(MVN_SEGMENTS, position, orientation)
    for hand, wrist, out in (("lhand", "lwrist", HANDS_M[0]), ("rhand", "rwrist", HANDS_M[1])):
        assert np.allclose(joints[:, CABINPOSE.index[hand]] - joints[:, CABINPOSE.index[wrist]], out, atol=1e-12)
    # arms hanging: the left one turns by -90 degrees about the forward axis (+y becomes -z), the right one by +90
    for segment, degrees in (("LeftHand", -90), ("RightHand", 90)):
        turned = Rotation.from_euler("x", degrees, degrees=True).as_quat(scalar_first=True)
        orientation[:, MVN_SEGMENTS.index(segment)] = turned
    joints = joints_of_segments(MVN_SEGMENTS, position, orientation, hands_m=((0, 0.1, 0), (0, -0.1, 0)))
    for hand, wrist in (("lhand", "lwrist"), ("rhand", "rwrist")):
        assert np.allclose(joints[:, CABINPOSE.index[hand]] - joints[:, CABINPOSE.index[wrist]], (0, 0, -0.1), atol=1e-12)


def test_a_missing_segment_is_missing_and_lacking_ones_are_named():
    position, orientation = _segments()
    orientation[1, MVN_SEGMENTS.index("LeftHand")] = np.nan
    joints = joints_of_segments(MVN_SEGMENTS, position, orientation)
    assert np.isnan(joints[1, CABINPOSE.index["lhand"]]).all()
    assert np.isfinite(np.delete(joints, CABINPOSE.index["lhand"], axis=1)).all()
    some = [i for i, name in enumerate(MVN_SEGMENTS) if name not in ("T8", "LeftLowerLeg")]
    with pytest.raises(AlignmentError, match="gives no LeftLowerLeg, T8"):
        joints_of_segments([MVN_SEGMENTS[i] for i in some], position[:, some], orientation[:, some])
