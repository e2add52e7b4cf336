"""The chain from suit to camera against joints that were placed in the camera's frame to begin with."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.chain import camera_from_suit, joints_in_camera, rigid
from cabinpose.core.errors import AlignmentError
from cabinpose.core.frames import apply, is_rigid, transform


def _rig(seed: int, count: int = 7) -> tuple[dict, np.ndarray]:
    rng = np.random.default_rng(seed)
    pose = lambda: transform(Rotation.random(rng=rng), rng.normal(size=3))  # noqa: E731
    camera_from_world, object_head = pose(), pose()
    world_from_object = np.stack([pose() for _ in range(count)])
    joints = rng.normal(size=(count, 20, 3))  # in the optical world, as they are
    suit_from_world = np.stack([pose() for _ in range(count)])  # the suit's world drifts as it likes
    rig = {
        "camera_from_world": camera_from_world,
        "world_from_object": world_from_object,
        "object_from_head": object_head,
        "world_from_head": suit_from_world @ world_from_object @ object_head,
        "p_joints": np.stack([apply(m, p) for m, p in zip(suit_from_world, joints, strict=True)]),
    }
    return rig, apply(camera_from_world, joints)


def _joints(p_joints: np.ndarray, **poses: np.ndarray) -> np.ndarray:
    return joints_in_camera(camera_from_suit(**poses), p_joints)


def test_joints_come_back_wherever_the_suit_thinks_it_is():
    rig, truth = _rig(1)
    assert np.abs(_joints(**rig) - truth).max() < 1e-12


def test_a_missing_object_leaves_the_moment_out_and_a_missing_joint_itself():
    rig, truth = _rig(2)
    rig["world_from_object"][3, 0, 3] = np.nan
    rig["world_from_head"][5] = np.nan
    rig["p_joints"][1, 4] = np.nan
    joints = _joints(**rig)
    gone = np.isnan(joints).any(axis=-1)
    assert gone[3].all()
    assert gone[5].all()
    assert gone.sum() == 41
    assert np.abs(joints - truth)[~gone].max() < 1e-12


def test_streams_of_different_length_are_refused():
    rig, _ = _rig(3)
    rig["world_from_object"] = rig["world_from_object"][:-1]
    with pytest.raises(AlignmentError, match="world_from_object"):
        _joints(**rig)
    rig, _ = _rig(3)
    rig["p_joints"] = rig["p_joints"][:-1]
    with pytest.raises(AlignmentError, match="p_joints"):
        _joints(**rig)


def test_rigid_is_a_pose_or_nothing():
    rng = np.random.default_rng(4)
    p, q = rng.normal(size=(4, 3)), rng.normal(size=(4, 4))
    p[1, 2] = np.nan
    q[2] = 0.0
    poses = rigid(p, q)
    assert np.isnan(poses[1:3]).all()
    assert is_rigid(poses[0])
    assert is_rigid(poses[3])
    assert np.allclose(poses[0], transform(Rotation.from_quat(q[0], scalar_first=True), p[0]))
