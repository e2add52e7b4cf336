"""Resampling against scipy's Slerp and numpy's interp, and the rules for what is missing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from cabinpose.core.errors import AlignmentError
from cabinpose.signals.resample import common_clock, resample_positions, resample_rotations

NAN = np.nan


def _times(rng: np.random.Generator, count: int = 60) -> np.ndarray:
    return np.cumsum(rng.uniform(0.005, 0.02, count))


def _quaternions(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return Rotation.random(int(np.prod(shape)), rng=rng).as_quat(scalar_first=True).reshape(*shape, 4)


def test_positions_lie_where_numpy_puts_them():
    rng = np.random.default_rng(1)
    time = _times(rng)
    values = rng.normal(size=(60, 3, 2))
    at = np.sort(rng.uniform(time[0], time[-1], 500))
    result = resample_positions(time, values, at, max_gap_s=1.0)
    assert result.shape == (500, 3, 2)
    for n in np.ndindex(3, 2):
        assert np.allclose(result[(slice(None), *n)], np.interp(at, time, values[(slice(None), *n)]), rtol=0, atol=1e-13)


def test_rotations_are_those_of_scipy_whatever_the_signs():
    """Twenty segments at once, with the sign of half of the quaternions turned: the same rotations as Slerp, one by one."""
    rng = np.random.default_rng(2)
    time = _times(rng)
    q = _quaternions(rng, 60, 20)
    at = np.sort(rng.uniform(time[0], time[-1], 200))
    result = resample_rotations(time, q * rng.choice((-1.0, 1.0), (60, 20, 1)) * 1.3, at, max_gap_s=1.0)
    assert np.allclose(np.linalg.norm(result, axis=-1), 1, rtol=0, atol=1e-14)
    for segment in range(20):
        truth = Slerp(time, Rotation.from_quat(q[:, segment], scalar_first=True))(at)
        found = Rotation.from_quat(result[:, segment], scalar_first=True)
        assert (truth.inv() * found).magnitude().max() < 1e-12


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 1.0, np.pi - 1e-6])
def test_small_and_large_steps_keep_their_share_of_the_angle(angle: float):
    axis = np.array((0.6, 0.0, 0.8))
    q = Rotation.from_rotvec((0 * axis, angle * axis)).as_quat(scalar_first=True)
    result = resample_rotations([0.0, 1.0], q, [0.25, 0.7], max_gap_s=2.0)
    vectors = Rotation.from_quat(result, scalar_first=True).as_rotvec()
    assert np.allclose(vectors, np.outer((0.25, 0.7), angle * axis), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("kind", ["positions", "rotations"])
def test_what_is_missing_stays_missing(kind: str):
    """Samples at 0, 1, 2, 5, 6, 7; the one at 6 is not known, and 2 to 5 is a gap."""
    time = np.array((0.0, 1, 2, 5, 6, 7))
    values = _quaternions(np.random.default_rng(3), 6)
    values[4] = NAN
    call = resample_positions if kind == "positions" else resample_rotations
    at = np.array((-0.1, 0.0, 0.5, 1.0, 2.0, 2.5, 4.9, 5.0, 5.5, 6.0, 6.5, 7.0, 7.1, NAN))
    found = np.isfinite(call(time, values, at, max_gap_s=1.5)).all(axis=1)
    assert found.tolist() == [False, True, True, True, True, False, False, True, False, False, False, True, False, False]
    assert np.allclose(call(time, values, time, max_gap_s=1.5), values, rtol=0, atol=1e-15, equal_nan=True)
    assert np.isfinite(call(time[:4], values[:4], [2.5, 4.9], max_gap_s=3.0)).all()  # the same pause, allowed


def test_the_previous_sample_is_taken_as_it_is():
    time = np.array((0.0, 1, 2, 5))
    values = _quaternions(np.random.default_rng(4), 4)
    at = np.array((0.4, 0.5, 0.6, 1.0, 1.99, 2.0, 3.0, 5.0))
    previous = resample_positions(time, values, at, max_gap_s=1.5, policy="previous")
    assert np.allclose(previous[[0, 1, 2, 3, 4, 5, 7]], values[[0, 0, 0, 1, 1, 2, 3]], rtol=0, atol=1e-15)
    assert np.isnan(previous[6]).all()  # in a gap, nothing is near enough


def test_a_quaternion_of_no_length_is_missing():
    q = np.array(((1.0, 0, 0, 0), (0, 0, 0, 0), (1, 0, 0, 0)))
    assert np.isnan(resample_rotations([0.0, 1, 2], q, [0.5, 1.0, 1.5], max_gap_s=2.0)).all()


@pytest.mark.parametrize(
    ("time", "values", "gap", "says"),
    [
        ([0.0, 1.0, 1.0], np.zeros((3, 3)), 1.0, r"after 1.000000 s comes 1.000000 s \(sample 2; 1 such\)"),
        ([0.0, 2.0, 1.0], np.zeros((3, 3)), 1.0, "do not rise strictly"),
        ([0.0, NAN, 1.0], np.zeros((3, 3)), 1.0, "1 that are no numbers"),
        ([0.0, 1.0], np.zeros((3, 3)), 1.0, "for 3 samples"),
        ([], np.zeros((0, 3)), 1.0, "without samples"),
        ([0.0, 1.0], np.zeros((2, 3)), 0.0, "a gap of 0.0 s"),
        ([0.0, 1.0], np.zeros((2, 3)), NAN, "a gap of nan s"),
    ],
)
def test_bad_series_are_refused(time, values, gap, says):  # type: ignore[no-untyped-def]
    with pytest.raises(AlignmentError, match=says) as error:
        resample_positions(time, values, [0.5], max_gap_s=gap)
    assert error.value.hint


def test_the_last_axis_of_rotations_is_wxyz():
    with pytest.raises(AlignmentError, match="quaternions"):
        resample_rotations([0.0, 1.0], np.zeros((2, 3)), [0.5], max_gap_s=1.0)


def test_a_common_clock_covers_what_all_have():
    at = common_clock([(0.0, 10.0), (1.25, 9.0), np.linspace(0.5, 11, 7)], 100.0)
    assert at[0] == 1.25
    assert np.allclose(np.diff(at), 0.01, rtol=0, atol=1e-12)
    assert at[-1] == pytest.approx(9.0)
    assert len(common_clock([(0.0, 0.3)], 10.0)) == 4  # 0.3 * 10 is a little less than 3
    with pytest.raises(AlignmentError, match=r"one ends at 1.000 s, before another begins at 2.000 s"):
        common_clock([(0.0, 1.0), (2.0, 3.0)], 10.0)
    for spans, rate in (([], 10.0), ([(0.0, NAN)], 10.0), ([(0.0, 1.0)], 0.0), ([(0.0, 1.0)], NAN)):
        with pytest.raises(AlignmentError):
            common_clock(spans, rate)
