"""Rigid transforms: the axioms of the group, and what look_at promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from cabinpose.core.frames import FORWARD_FROM_CAMERA, apply, invert, is_rigid, look_at, rotation_vector, transform

angle = st.floats(-3.1, 3.1)
metre = st.floats(-10, 10)


@st.composite
def rigid(draw: st.DrawFn) -> np.ndarray:
    rotation = Rotation.from_rotvec([draw(angle) for _ in range(3)])
    return transform(rotation, [draw(metre) for _ in range(3)])


@given(a=rigid(), b=rigid(), c=rigid())
@settings(max_examples=100, deadline=None)
def test_group_axioms(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    np.testing.assert_allclose((a @ b) @ c, a @ (b @ c), atol=1e-9)
    np.testing.assert_allclose(a @ invert(a), np.eye(4), atol=1e-9)
    np.testing.assert_allclose(invert(a) @ a, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(invert(a @ b), invert(b) @ invert(a), atol=1e-8)
    assert is_rigid(a @ b)


@given(vector=st.tuples(angle, angle, angle), scale=st.sampled_from((1.0, 1e-4, 1e-9, 0.0)))
@settings(max_examples=100, deadline=None)
def test_rotation_vector_is_scipys(vector: tuple[float, float, float], scale: float) -> None:
    small = scale * np.array(vector)
    np.testing.assert_allclose(
        rotation_vector(small), Rotation.from_rotvec(small).as_matrix(), atol=1e-15 if scale < 1 else 1e-14
    )


@given(a=rigid(), seed=st.integers(0, 100))
@settings(max_examples=50, deadline=None)
def test_apply_is_scipys(a: np.ndarray, seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(3, 5, 3))
    expected = RigidTransform.from_matrix(a).apply(points.reshape(-1, 3)).reshape(points.shape)
    np.testing.assert_allclose(apply(a, points), expected, atol=1e-9)
    np.testing.assert_allclose(apply(invert(a), apply(a, points)), points, atol=1e-8)


def test_invert_takes_stacks() -> None:
    stack = np.stack([transform(Rotation.from_rotvec((0.1 * i, 0.2, -0.3)), (i, 2, 3)) for i in range(4)])
    np.testing.assert_allclose(invert(stack) @ stack, np.broadcast_to(np.eye(4), (4, 4, 4)), atol=1e-12)


def test_transform_rotates_then_translates() -> None:
    moved = apply(transform(Rotation.from_euler("z", 90, degrees=True), (1, 0, 0)), (1, 0, 0))
    np.testing.assert_allclose(moved, (1, 1, 0), atol=1e-12)


@given(eye=st.tuples(metre, metre, metre), target=st.tuples(metre, metre, metre))
@settings(max_examples=100, deadline=None)
def test_look_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> None:
    ray = np.subtract(target, eye)
    if np.hypot(ray[0], ray[1]) < 1e-3:
        return
    pose = look_at(eye, target)
    assert is_rigid(pose)
    np.testing.assert_allclose(apply(invert(pose), target), (0, 0, np.linalg.norm(ray)), atol=1e-8)
    assert abs(pose[2, 0]) < 1e-12  # the camera's x is level
    assert pose[2, 1] < 0  # its y points down


def test_look_at_forward_is_the_named_rotation() -> None:
    """Vehicle: x forward, y left, z up. A camera that looks forward has its x to the right, its y down."""
    np.testing.assert_allclose(look_at((0, 0, 0), (5, 0, 0))[:3, :3], FORWARD_FROM_CAMERA, atol=1e-12)
    np.testing.assert_allclose(FORWARD_FROM_CAMERA @ (1, 0, 0), (0, -1, 0), atol=1e-12)


@pytest.mark.parametrize("target", [(1.0, 2.0, 3.0), (1.0, 2.0, 9.0)])
def test_look_at_refuses_the_undefined(target: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="look_at needs"):
        look_at((1, 2, 3), target)


def test_is_rigid_tells() -> None:
    mirror = np.diag((-1.0, 1, 1, 1))
    projective = np.eye(4)
    projective[3, 0] = 0.1
    for bad in (2 * np.eye(4), mirror, projective, np.eye(3), np.full((4, 4), np.nan)):
        assert not is_rigid(bad)
    assert is_rigid(np.eye(4))
