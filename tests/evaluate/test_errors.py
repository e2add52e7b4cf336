"""Errors of single joints, held against closed forms and slow, plain ways to the same number."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from cabinpose.evaluate import errors

SEEDS = st.integers(0, 2**32 - 1)


def pose(seed: int, samples: int = 3, joints: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.4, (samples, joints, 3))


def test_distances_are_euclidean() -> None:
    predicted = np.array([[[3.0, 4.0], [0.0, 0.0], [np.nan, 0.0]]])
    assert errors.distances(predicted, np.zeros((1, 3, 2))).tolist()[0][:2] == [5.0, 0.0]
    assert np.isnan(errors.distances(predicted, np.zeros((1, 3, 2)))[0, 2])


@given(SEEDS)
def test_a_shift_of_a_person_is_nothing_to_the_root(seed: int) -> None:
    true = pose(seed)
    moved = true + np.random.default_rng(seed).normal(size=(3, 1, 3))
    moved[0, 1, 2] += 0.3  # a joint of the first
    moved[1, 4] = np.nan  # the root of the second was not found
    found = errors.root_relative_distances(moved, true, root=4)
    assert found[0].tolist() == pytest.approx([0.0, 0.3, 0.0, 0.0, np.nan, 0.0, 0.0], abs=1e-9, nan_ok=True)
    assert np.isnan(found[1]).all()


@given(SEEDS, st.floats(0.2, 5))
def test_alignment_takes_a_similarity_away(seed: int, scale: float) -> None:
    true = pose(seed)
    rng = np.random.default_rng(seed)
    turned = scale * true @ Rotation.random(rng=rng).as_matrix().T + rng.normal(size=3)
    assert np.allclose(errors.aligned_distances(turned, true), 0, atol=1e-9)


def test_alignment_does_not_mirror() -> None:
    true = pose(1, samples=1)
    assert errors.aligned_distances(true * (-1, 1, 1), true).mean() > 0.05


@pytest.mark.parametrize("seed", range(3))
def test_alignment_is_the_least_squares_one(seed: int) -> None:
    """Against a search over rotation vector, scale and shift, on the joints that both have."""
    true, predicted = pose(seed, 1), pose(seed, 1) + pose(seed + 9, 1) * 0.3
    predicted[0, 2] = np.nan
    both = [0, 1, 3, 4, 5, 6]

    def moved(x: np.ndarray) -> np.ndarray:
        return x[3] * predicted[0, both] @ Rotation.from_rotvec(x[:3]).as_matrix().T + x[4:]

    best = minimize(lambda x: ((moved(x) - true[0, both]) ** 2).sum(), np.r_[0, 0, 0, 1, 0, 0, 0], tol=1e-14)
    ours = errors.aligned_distances(predicted, true)[0]
    assert np.isnan(ours[2])
    assert np.allclose(ours[both], np.linalg.norm(moved(best.x) - true[0, both], axis=-1), atol=1e-5)


def test_alignment_needs_three_joints() -> None:
    true = pose(0, 2)
    predicted = true.copy()
    predicted[0, 2:] = np.nan
    predicted[1, 3:] = np.nan
    ours = errors.aligned_distances(predicted, true)
    assert np.isnan(ours[0]).all()
    assert np.isfinite(ours[1]).sum() == 3


def test_bones_by_hand() -> None:
    true = np.array([[[0.0, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0]]])
    predicted = np.array([[[0.0, 0, 0], [0.0, 0.25, 0], [0.0, 0.25, 0.5]]])
    ours = errors.bone_length_errors(predicted, true, [(0, 1), (1, 2)])[0]
    assert np.isnan(ours[0])
    assert np.allclose(ours[1:], [0.05, 0.1])


def test_swaps() -> None:
    true = np.array([[[-0.2, 0.0, 1], [0.2, 0.0, 1], [0, 1, 1]]])
    close = true * ([0.1], [0.1], [1.0])
    for predicted, swapped in ((true, 0.0), (true[:, [1, 0, 2]], 1.0), (close, 0.0), (close[:, [1, 0, 2]] * (-1, 1, 1), 0.0)):
        assert errors.swaps(predicted, true, [(0, 1)])[0, 0] == swapped
    barely = true.copy()
    barely[0, 0, 0], barely[0, 1, 0] = 0.05, -0.05  # crossed is better (0.30 against 0.50), but not twice as good
    assert errors.swaps(barely, true, [(0, 1)])[0, 0] == 0
    assert np.isnan(errors.swaps(true, true, [(0, 1)])[0, 1:]).all()
    missing = true.copy()
    missing[0, 0] = np.nan
    assert np.isnan(errors.swaps(missing, true, [(0, 1)])[0, 0])


def test_accelerations() -> None:
    """Constant speed of the error has none, a parabola has twice its coefficient; gaps are not measured."""
    t = np.arange(6.0)[:, None, None]
    steady = np.concatenate((2 * t, -t, 0 * t), axis=-1)
    parabola = np.concatenate((3 * t**2, 4 * t**2, 0 * t), axis=-1)
    follows = np.array([False, True, True, True, True, True])
    assert np.allclose(errors.accelerations(steady, follows), 0)
    assert np.allclose(errors.accelerations(parabola, follows), 10)
    follows[3] = False
    assert np.isfinite(errors.accelerations(parabola, follows)[:, 0]).tolist() == [True, False, False, True]
