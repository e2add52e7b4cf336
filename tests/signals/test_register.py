"""Registration against constructed truth and against scipy's solution of the same problem."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import AlignmentError
from cabinpose.core.frames import apply, is_rigid, transform
from cabinpose.signals.register import icp, kabsch


def _moved(seed: int, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return transform(Rotation.random(rng=rng), rng.normal(size=3)), rng.normal(size=(count, 3))


def test_exact_pairs_give_the_transform_back():
    a_from_b, b = _moved(1)
    assert np.abs(kabsch(apply(a_from_b, b), b) - a_from_b).max() < 1e-12


def test_noisy_weighted_pairs_give_what_scipy_gives():
    a_from_b, b = _moved(2)
    rng = np.random.default_rng(3)
    a = apply(a_from_b, b) + rng.normal(scale=0.1, size=b.shape)
    weights = rng.uniform(0.1, 3.0, len(b))
    fit = kabsch(a, b, weights)
    share = weights / weights.sum()
    rotation, _ = Rotation.align_vectors(a - share @ a, b - share @ b, weights=weights)
    assert np.abs(fit[:3, :3] - rotation.as_matrix()).max() < 1e-9
    assert np.abs(fit[:3, 3] - (share @ a - rotation.apply(share @ b))).max() < 1e-9


def test_points_in_a_plane_are_never_mirrored():
    """Four markers on a board, and noise that makes the mirror image fit as well: still a rotation."""
    a_from_b, b = _moved(4, 4)
    b[:, 2] = 0.0
    for seed in range(50):
        a = apply(a_from_b, b) + np.random.default_rng(seed).normal(scale=0.02, size=b.shape)
        fit = kabsch(a, b)
        assert is_rigid(fit)
        assert np.linalg.norm(apply(fit, b) - a, axis=1).max() < 0.1


def test_mirrored_points_do_not_fit():
    _, b = _moved(5)
    fit = kabsch(b * (-1.0, 1.0, 1.0), b)
    assert is_rigid(fit)
    assert np.linalg.norm(apply(fit, b) - b * (-1.0, 1.0, 1.0), axis=1).mean() > 0.2


@pytest.mark.parametrize(
    ("a", "b", "says"),
    [
        (np.zeros((2, 3)), np.zeros((2, 3)), "3 needed"),
        (np.outer(np.arange(5.0), (1, 2, 3)), np.outer(np.arange(5.0), (0, 0, 1)), "on a line"),
        (np.full((4, 3), np.nan), np.ones((4, 3)), "not a number"),
        (np.ones((4, 3)), np.ones((5, 3)), "pairs of points"),
    ],
)
def test_what_determines_no_transform_is_refused(a, b, says):
    with pytest.raises(AlignmentError, match=says):
        kabsch(a, b)


def test_directions_need_two_pairs_and_get_no_translation():
    rotation = Rotation.from_euler("xyz", (20, -30, 50), degrees=True)
    fit = kabsch(rotation.apply(np.eye(3)[:2]), np.eye(3)[:2], rotation_only=True)
    assert np.abs(fit - transform(rotation)).max() < 1e-12


def test_icp_finds_a_small_motion_of_shuffled_points():
    rng = np.random.default_rng(6)
    b = rng.normal(size=(300, 3))
    a_from_b = transform(Rotation.from_rotvec((0.05, -0.03, 0.04)), (0.02, 0.03, -0.01))
    order = rng.permutation(300)
    fit = icp(apply(a_from_b, b)[order], b)
    assert np.abs(fit.a_from_b - a_from_b).max() < 1e-9
    assert (order[fit.partner] == np.arange(300)).all()


def test_trimmed_icp_is_not_drawn_by_outliers():
    rng = np.random.default_rng(7)
    b = rng.normal(size=(200, 3))
    a_from_b = transform(Rotation.from_rotvec((0.03, 0.02, -0.02)), (0.01, -0.02, 0.01))
    a = apply(a_from_b, b)
    spoiled = b.copy()
    spoiled[:30] += (3.0, 0.0, 0.0)
    assert np.abs(icp(a, spoiled).a_from_b - a_from_b).max() > 0.01
    assert np.abs(icp(a, spoiled, keep=0.8).a_from_b - a_from_b).max() < 1e-9


def test_icp_starts_where_it_is_told():
    rng = np.random.default_rng(8)
    b = rng.normal(size=(100, 3))
    a_from_b = transform(Rotation.from_euler("z", 150, degrees=True), (2.0, 0.0, 0.0))
    near = transform(Rotation.from_euler("z", 147, degrees=True), (2.02, 0.0, 0.0))
    assert np.abs(icp(apply(a_from_b, b), b, start=near).a_from_b - a_from_b).max() < 1e-9
