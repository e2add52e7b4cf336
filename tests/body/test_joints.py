"""Where the joints of each set lie in a body."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cabinpose.core.skeleton import CABINPOSE, ITOP, RIG, SKELETONS, Skeleton
from cabinpose.scene.body import DOFS, SEGMENTS, SUBJECTS, BodyModel, PosedBody, joints_in_body


@pytest.fixture(scope="module")
def body() -> PosedBody:
    return BodyModel.load().person(*SUBJECTS["S03"]).pose(np.zeros(len(DOFS)), np.eye(4))


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=list(SKELETONS))
def test_every_joint_lies_in_the_body_and_opposite_its_partner(skeleton: Skeleton, body: PosedBody) -> None:
    joints = joints_in_body(skeleton, body)
    assert joints.shape == (len(skeleton.joints), 3)
    assert (joints > body.skin.min(axis=0) - 0.01).all()
    assert (joints < body.skin.max(axis=0) + 0.01).all()
    assert_allclose(joints[list(skeleton.mirror)] * (1, -1, 1), joints, atol=0.005)  # a body at rest is almost symmetric


def test_itops_joints_are_where_their_definition_says(body: PosedBody) -> None:
    at = dict(zip(ITOP.joints, joints_in_body(ITOP, body), strict=True))
    rig = dict(zip(RIG.joints, body.rig_joints, strict=True))
    assert_allclose(at["neck"], (at["lshoulder"] + at["rshoulder"]) / 2)
    assert_allclose(at["torso"], (at["neck"] + (at["lhip"] + at["rhip"]) / 2) / 2)
    assert_allclose(at["head"], body.skin[body.person.skin_segment == SEGMENTS.index("head")].mean(axis=0), atol=1e-4)
    for theirs, mine in CABINPOSE.maps["itop"].items():
        assert_allclose(at[mine], rig[theirs])
    assert_allclose(at["lfoot"], rig["lankle"])
