"""How aligned joints are seen: a ball for a head, a plate before it, an arm before the chest."""

from __future__ import annotations

import numpy as np

from cabinpose.align.visibility import visibility
from cabinpose.core.camera import Camera
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE, JOINTS

INDEX = CABINPOSE.index

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)


def _person() -> np.ndarray:
    """Joints that are absent but for a head at 1.2 m, a chest beside it and an elbow and wrist."""
    joints = np.full((len(JOINTS), 3), np.nan)
    joints[INDEX["head"]] = (0.0, -0.2, 1.2)
    joints[INDEX["chest"]] = (0.0, 0.2, 1.2)
    return joints


def _surface(head: float, chest: float) -> np.ndarray:
    depth = np.full((CAMERA.height, CAMERA.width), np.nan, np.float32)
    depth[: CAMERA.height // 2], depth[CAMERA.height // 2 :] = head, chest
    return depth


def test_a_joint_under_its_own_skin_is_visible_and_its_depth_told():
    states, before = visibility(CAMERA, _surface(1.1, 1.05), _person())
    assert states[INDEX["head"]] == states[INDEX["chest"]] == Visibility.VISIBLE
    length = np.linalg.norm(CAMERA.unproject(CAMERA.project((0.0, -0.2, 1.2)), 1.0))
    assert np.isclose(before[INDEX["head"]], 0.1 * length, atol=1e-6)
    others = [j for j in range(len(JOINTS)) if j not in (INDEX["head"], INDEX["chest"])]
    assert (states[others] == Visibility.ABSENT).all()


def test_something_far_before_a_joint_hides_it_and_a_limb_of_its_own_is_told_apart():
    joints = _person()
    states, _ = visibility(CAMERA, _surface(0.8, 0.7), joints)
    assert states[INDEX["head"]] == states[INDEX["chest"]] == Visibility.OCCLUDED
    joints[INDEX["relbow"]], joints[INDEX["rwrist"]] = (-0.2, 0.12, 0.75), (0.2, 0.12, 0.75)  # a forearm across the chest
    states, _ = visibility(CAMERA, _surface(0.8, 0.7), joints)
    assert states[INDEX["head"]] == Visibility.OCCLUDED
    assert states[INDEX["chest"]] == Visibility.SELF_OCCLUDED


def test_outside_the_image_is_said_and_what_was_not_measured_hides_nothing():
    joints = _person()
    joints[INDEX["lfoot"]] = (3.0, 0.0, 1.0)
    joints[INDEX["rfoot"]] = (0.0, 0.0, -1.0)
    states, before = visibility(CAMERA, _surface(np.nan, 1.1), joints)
    assert states[INDEX["lfoot"]] == states[INDEX["rfoot"]] == Visibility.OUTSIDE_IMAGE
    assert states[INDEX["head"]] == Visibility.VISIBLE
    assert np.isnan(before[INDEX["head"]])


def test_a_joint_before_the_surface_is_told_by_a_negative_distance():
    _, before = visibility(CAMERA, _surface(1.3, 1.1), _person())
    assert before[INDEX["head"]] < -0.09
    assert before[INDEX["chest"]] > 0
