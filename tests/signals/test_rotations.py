"""Quaternion arrays against scipy, and in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.signals import rotations as r


def drawn(count: int, seed: int = 3) -> tuple[Rotation, np.ndarray]:
    found = Rotation.random(count, rng=np.random.default_rng(seed))
    sign = np.random.default_rng(seed + 1).choice((-1.0, 1.0), (count, 1))  # both quaternions of a rotation occur
    return found, sign * found.as_quat(scalar_first=True)


def test_products_angles_and_vectors_are_scipys() -> None:
    (a, qa), (b, qb) = drawn(200), drawn(200, 7)
    both = Rotation.from_quat(r.product(qa, qb), scalar_first=True)
    np.testing.assert_allclose((both * (a * b).inv()).magnitude(), 0, atol=1e-14)
    np.testing.assert_allclose(r.angle(qa), a.magnitude(), atol=1e-14)
    np.testing.assert_allclose(r.angle_between(qa, qb), (a * b.inv()).magnitude(), atol=1e-14)
    np.testing.assert_allclose(r.rotation_vectors(qa), a.as_rotvec(), atol=1e-13)


def test_small_turns_keep_their_digits() -> None:
    q = np.array([np.cos(0.5e-12), np.sin(0.5e-12), 0, 0])
    assert r.angle(q) == pytest.approx(1e-12, rel=1e-9)
    np.testing.assert_allclose(r.rotation_vectors(q), (1e-12, 0, 0), rtol=1e-9)
    np.testing.assert_array_equal(r.rotation_vectors((1.0, 0, 0, 0)), 0)


def test_turn_about_an_axis_is_that_of_scipys_twist() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    turns = np.linspace(-3.1, 3.1, 41)
    swing = Rotation.from_rotvec(0.3 * np.array([0.8, 0.0, -0.6]))  # about a direction square to the axis
    q = (swing * Rotation.from_rotvec(turns[:, None] * axis)).as_quat(scalar_first=True)
    np.testing.assert_allclose(r.turn_about(q, axis), turns, atol=1e-12)
    np.testing.assert_allclose(r.turn_about(-q, axis), turns, atol=1e-12)


def test_since_first_starts_where_a_column_is_known() -> None:
    _, q = drawn(10)
    q = q.reshape(5, 2, 4)
    q[:2, 1] = np.nan
    turned = r.since_first(q)
    np.testing.assert_allclose(r.angle(turned[0, 0]), 0, atol=1e-15)
    assert np.isnan(turned[:2, 1]).all()
    np.testing.assert_allclose(r.angle(turned[2, 1]), 0, atol=1e-15)
    np.testing.assert_allclose(r.angle(turned[4, 1]), r.angle_between(q[4, 1], q[2, 1]), atol=1e-14)


def test_mean_orientation_is_scipys_and_leaves_out_what_is_missing() -> None:
    near = Rotation.from_rotvec([0.4, 1.0, -0.2]) * Rotation.from_rotvec(np.random.default_rng(0).normal(0, 0.2, (50, 3)))
    q = near.as_quat(scalar_first=True)
    q[::2] *= -1
    weights = np.random.default_rng(1).uniform(0, 1, 50)
    expected = near.mean(weights).as_quat(scalar_first=True)
    holed = np.concatenate((q, np.full((3, 4), np.nan)))
    np.testing.assert_allclose(r.angle_between(r.mean_orientation(holed, np.append(weights, (1, 1, 1))), expected), 0, atol=1e-12)
    assert np.isnan(r.mean_orientation(np.full((2, 4), np.nan))).all()
