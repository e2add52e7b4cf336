"""Delays between clocks: exact signals, noise, real recordings with known shifts, and what has to be refused."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.spatial.transform import Rotation, Slerp

from cabinpose.core.errors import AlignmentError
from cabinpose.signals import DelaySearch, angular_speed, angular_velocity, estimate_delay, rotation_angle
from cabinpose.signals.correlation import correlogram
from cabinpose.signals.register import kabsch

sys.path.insert(0, str(Path(__file__).parent))

from two_clocks import CAMERA_S, DRIFT, OFFSET, OPTICAL_S, motion, to_a, to_b, wxyz

# ------------------------------------------------------------------------------------------------------ exact signals


@pytest.mark.parametrize("swapped", [False, True])
def test_exact_signals_give_delay_and_drift(swapped: bool):
    """30 Hz against 100 Hz, 0.1234567 s and 50 ppm: 0.1 ms is asked for, a tenth of a microsecond is what is there."""
    series = [CAMERA_S, motion(CAMERA_S), OPTICAL_S, motion(to_a(OPTICAL_S))]
    if swapped:
        series = series[2:] + series[:2]
    delay = estimate_delay(*series, DelaySearch(max_lag_s=1.0, drift=True))
    found = delay.to_a if swapped else delay.to_b
    assert np.abs(found(CAMERA_S) - to_b(CAMERA_S)).max() < 1e-7
    truth = -DRIFT / (1 + DRIFT) if swapped else DRIFT
    assert delay.drift == pytest.approx(truth, abs=1e-9)
    assert delay.correlation > 1 - 1e-9
    assert delay.interval_s[1] - delay.interval_s[0] < 1e-6
    assert np.allclose(delay.to_a(delay.to_b(CAMERA_S)), CAMERA_S, rtol=0, atol=1e-12)


def test_one_channel_of_a_constant_delay_far_from_zero():
    shift = 7123.0001
    delay = estimate_delay(
        CAMERA_S,
        motion(CAMERA_S)[:, 0],
        OPTICAL_S + shift,
        3 + 0.1 * motion(OPTICAL_S)[:, 0],
        DelaySearch(max_lag_s=1, around_s=7123.2),
    )
    assert delay.offset_s == pytest.approx(shift, abs=1e-7)
    assert delay.drift == 0.0
    assert delay.drift_interval == (0.0, 0.0)


def test_gaps_irregular_times_and_outliers_do_not_move_it():
    """Jitter of the stamps that is known, a fifth of the frames lost, a pause of 6 s, and 3 % of wild blobs."""
    rng = np.random.default_rng(1)
    time = CAMERA_S + rng.uniform(-0.004, 0.004, len(CAMERA_S))
    keep = (np.abs(time - 17) > 3) & (rng.random(len(time)) > 0.05)
    uv = motion(time) + rng.normal(scale=0.05, size=(len(time), 2))
    wild = rng.random(len(time)) < 0.03
    uv[wild] = rng.uniform(-150, 150, (np.count_nonzero(wild), 2))
    uv[rng.random(len(time)) < 0.05] = np.nan
    delay = estimate_delay(time[keep], uv[keep], OPTICAL_S, motion(to_a(OPTICAL_S)), DelaySearch(max_lag_s=1.0, drift=True))
    assert np.abs(delay.to_b(CAMERA_S) - to_b(CAMERA_S)).max() < 1e-3
    assert delay.correlation < 0.97  # of all, the wild ones with them


def test_the_interval_holds_the_truth_as_often_as_it_says():
    """95 % of 40 takes, with noise that neighbours share; fewer than 33 would come once in 1400."""
    time_a, time_b = np.arange(0, 25, 1 / 30), np.arange(-1, 26, 1 / 60)
    held, halves, errors = 0, [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = np.convolve(rng.normal(scale=12, size=len(time_a) + 14), np.ones(15) / np.sqrt(15), mode="valid")
        delay = estimate_delay(
            time_a,
            motion(time_a)[:, 0] + noise,
            time_b,
            motion(time_b - OFFSET)[:, 0] + rng.normal(size=len(time_b)),
            DelaySearch(max_lag_s=0.6),
        )
        held += delay.interval_s[0] <= OFFSET <= delay.interval_s[1]
        halves.append(0.5 * (delay.interval_s[1] - delay.interval_s[0]))
        errors.append(delay.offset_s - OFFSET)
    assert held >= 33
    assert 1.0 < np.median(halves) / np.std(errors) < 4.0  # nor is it idle: 2 for a normal error of known sigma


def test_the_correlation_over_lags_is_that_of_numpy():
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(40, 2)), rng.normal(size=(55, 2)) + 3
    a[7], b[20:23] = np.nan, np.nan
    shifts = np.arange(-30, 46)
    found = correlogram(a, b, 12, shifts, 0.0)
    for shift, r in zip(shifts, found, strict=True):
        rows = [(a[n], b[n + shift]) for n in range(40) if 0 <= n + shift < 55]
        pairs = np.array([(x, y) for x, y in rows if np.isfinite(x).all() and np.isfinite(y).all()])
        if len(pairs) < 12:
            assert np.isnan(r)
            continue
        x, y = (pairs[:, k] - pairs[:, k].mean(axis=0) for k in (0, 1))
        assert r == pytest.approx((x * y).sum() / np.sqrt((x * x).sum() * (y * y).sum()), abs=1e-10)


# ---------------------------------------------------------------------------------------------------- rotations, marker


def test_rotation_angle_is_that_of_scipy_in_any_frames():
    rng = np.random.default_rng(6)
    turns = Rotation.random(50, rng=rng)
    q = wxyz(turns) * rng.choice((-1.0, 1.0), (50, 1))
    q[:2], q[9] = np.nan, np.nan
    angle = rotation_angle(q)
    assert np.isnan(angle[[0, 1, 9]]).all()
    known = np.delete(np.arange(50), (0, 1, 9))
    assert np.allclose(angle[known], (turns[known] * turns[2].inv()).magnitude(), rtol=0, atol=1e-7)
    world, body = Rotation.random(2, rng=rng)
    elsewhere = rotation_angle(wxyz(world * turns * body)[2:])
    assert np.allclose(angle[known], elsewhere[known - 2], rtol=0, atol=1e-7)


@pytest.mark.parametrize(("baseline", "least"), [(None, 2e-6), (0.1, 5e-4)])
def test_angular_velocity_is_centred_on_its_sample(baseline: float | None, least: float):
    """Irregular samples of a turn whose rate rises: against the closed form, which a delay of 1 ms would miss by 2e-3."""
    rng = np.random.default_rng(7)
    time = np.cumsum(rng.uniform(0.008, 0.012, 300))
    rate = 1.0 + 2.0 * time
    axis = np.array((0.48, 0.6, 0.64))
    q = wxyz(Rotation.random(rng=rng) * Rotation.from_rotvec(np.outer(time + time**2, axis)))
    found = angular_velocity(time, q, baseline_s=baseline)
    inner = slice(10, -10)
    assert np.abs(found[inner] - rate[inner, None] * axis).max() < least
    assert np.abs(angular_speed(time, q, baseline_s=baseline)[inner] - rate[inner]).max() < least
    assert np.isnan(found[[0, -1]]).all()
    q[100] = np.nan
    gone = np.isnan(angular_velocity(time, q, max_gap_s=0.1)).any(axis=1)
    assert np.flatnonzero(gone).tolist() == [0, 99, 100, 101, 299]


# ------------------------------------------------------------------------------------------------------------ bad input


def _noise(seed: int, count: int) -> np.ndarray:
    return np.convolve(np.random.default_rng(seed).normal(size=count + 20), np.hanning(21), mode="valid")


def _jumped(time: np.ndarray, at: float, by: float) -> np.ndarray:
    return time + OFFSET + np.where(time > at, by, 0.0)


@pytest.mark.parametrize("by", [0.05, -0.02, 0.4])
@pytest.mark.parametrize("drift", [False, True])
def test_a_clock_that_jumps_is_refused_with_the_time(by: float, drift: bool):
    """Samples lost without a gap in the stamps, or set back by less than the pause: the signals fit on both sides."""
    stamps = _jumped(OPTICAL_S, 22.0, by)
    keep = np.r_[True, np.diff(np.maximum.accumulate(stamps)) > 0]
    with pytest.raises(AlignmentError, match=r"a clock jumps by -?[0-9.]+ ms between (1[5-9]|2[0-2])\.\d s and 2[2-9]\.\d s"):
        estimate_delay(CAMERA_S, motion(CAMERA_S), stamps[keep], motion(OPTICAL_S)[keep], DelaySearch(max_lag_s=1.0, drift=drift))


def test_unrelated_signals_are_refused():
    for seed in range(5):
        with pytest.raises(AlignmentError, match=r"weak|ambiguous"):
            estimate_delay(
                CAMERA_S, _noise(seed, len(CAMERA_S)), OPTICAL_S, _noise(seed + 100, len(OPTICAL_S)), DelaySearch(max_lag_s=2.0)
            )


def _series() -> dict[str, np.ndarray]:
    return {"ta": CAMERA_S, "a": motion(CAMERA_S), "tb": OPTICAL_S, "b": motion(OPTICAL_S)}


@pytest.mark.parametrize(
    ("change", "options", "says"),
    [
        ({"a": np.full((len(CAMERA_S), 2), 7.0)}, {}, "signal a is constant"),
        ({"b": np.full((len(OPTICAL_S), 2), np.nan)}, {}, "signal b has 0 known samples"),
        ({"b": -motion(OPTICAL_S)}, {"max_lag_s": 0.3}, "weak"),
        ({"b": motion(OPTICAL_S)[:, 0]}, {}, "2 channels, b 1"),
        ({"tb": OPTICAL_S + 500}, {}, "share too little at lags"),
        ({"tb": OPTICAL_S + 30}, {"around_s": -20.0, "max_lag_s": 5.0}, "share too little at lags"),
        ({"tb": OPTICAL_S + 0.5}, {"max_lag_s": 0.45}, "still rises at the edge of the lags allowed, 0.4"),
        ({"ta": CAMERA_S[::-1]}, {}, "the times of signal a do not rise"),
        ({"ta": CAMERA_S[:-1]}, {}, "for 1200 samples"),
        ({"a": np.where(np.arange(len(CAMERA_S))[:, None] % 5 < 2, motion(CAMERA_S), np.nan)}, {}, "no stretch without a gap"),
        ({}, {"max_lag_s": 0.0}, "lags"),
        ({}, {"max_lag_s": np.nan}, "lags"),
    ],
)
def test_bad_signals_are_refused(change: dict[str, np.ndarray], options: dict[str, float], says: str):
    s = _series() | change
    with pytest.raises(AlignmentError, match=says) as error:
        estimate_delay(s["ta"], s["a"], s["tb"], s["b"], DelaySearch(**({"max_lag_s": 1.0} | options)))
    assert error.value.hint


# ------------------------------------------------------------------------------------------------------------ real data


@pytest.mark.real_data
@pytest.mark.parametrize("side", ["left", "right"])
def test_gaitmap_markers_and_gyroscope_are_in_step(real_data: Callable[[str], Path], side: str):
    """One walk, by an IMU at 204.8 Hz and by markers at 100 Hz: published as 2 ms at r = 0.956, here filtered alike."""
    imu, markers = (_table(real_data(f"gaitmap/{name}_sample.csv")) for name in ("imu", "mocap"))
    gyroscope = np.stack([imu[f"{side}_sensor", f"gyr_{axis}"] for axis in "xyz"], axis=-1)
    names = [f"{side[0].upper()}_{marker}" for marker in ("TOE", "FCC", "FM5")]
    points = np.stack([np.stack([markers[name, axis] for axis in "xyz"], axis=-1) for name in names], axis=1) / 1000
    foot = wxyz(Rotation.from_matrix(np.stack([kabsch(p, points[0])[:3, :3] for p in points])))
    time_imu, time_markers = np.arange(len(gyroscope)) / 204.8, np.arange(len(points)) / 100
    speed = angular_speed(time_markers, foot)
    delay = estimate_delay(time_markers, speed, time_imu, np.linalg.norm(gyroscope, axis=1), DelaySearch(max_lag_s=0.5))
    assert abs(delay.offset_s) <= 0.005
    assert delay.correlation > 0.956


def _table(path: Path) -> dict[tuple[str, str], np.ndarray]:
    with path.open(newline="") as file:
        first, second, *rows = csv.reader(file)
    return dict(zip(zip(first, second, strict=True), np.array(rows, np.float64).T, strict=True))


BROAD = ("02_undisturbed_slow_rotation_B", "07_undisturbed_fast_rotation_B", "21_undisturbed_fast_combined")
BROAD_LAG = -4.17e-3  # in the files themselves the gyroscope is late, as a gyroscope's filter makes it; measured below


def _broad(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, speed of the gyroscope, orientations of the optical system (NaN: not seen)."""
    data = loadmat(path)
    time = np.arange(len(data["imu_gyr"])) / data["sampling_rate"].item()
    return time, np.linalg.norm(data["imu_gyr"], axis=1), data["opt_quat"]


@pytest.mark.real_data
@pytest.mark.slow
def test_broad_with_injected_offset_and_drift(real_data: Callable[[str], Path]):
    """Three trials, ±2 s with ±100 ppm: median errors within 1 ms and 5 ppm of what was injected on top of the files' lag."""
    offsets, drifts = [], []
    for n, name in enumerate(BROAD):
        time, gyroscope, q = _broad(real_data(f"broad/{name}.mat"))
        speed = angular_speed(time, q)
        for sign in (1, -1):
            offset, drift = 2.0 * sign, 1e-4 * sign * (-1) ** n
            delay = estimate_delay(time, gyroscope, time + offset + drift * time, speed, DelaySearch(max_lag_s=3.0, drift=True))
            offsets.append(delay.offset_s - BROAD_LAG - offset - drift * delay.reference_s)
            drifts.append(delay.drift - drift)
    assert np.median(np.abs(offsets)) <= 1e-3
    assert np.median(np.abs(drifts)) <= 5e-6
    assert np.max(np.abs(offsets)) <= 1e-4  # what it does; the lines above are what was asked for
    assert np.max(np.abs(drifts)) <= 2e-6


@pytest.mark.real_data
def test_broad_has_a_lag_of_its_own(real_data: Callable[[str], Path]):
    """By other means: turns over 60 ms, optical by scipy's Slerp, at shifts tried one by one."""
    time, gyroscope, q = _broad(real_data(f"broad/{BROAD[1]}.mat"))
    part = slice(10_000, 40_000)
    known = np.flatnonzero(np.isfinite(q[part]).all(axis=1)) + part.start
    optical = Slerp(time[known], Rotation.from_quat(q[known], scalar_first=True))
    middle = time[known[50:-50:7]]
    turned = np.convolve(gyroscope, np.ones(17) / 17, mode="same")[known[50:-50:7]]
    half = 8.5 / 285.714285714
    shifts = np.arange(-8e-3, 1e-3, 0.5e-3)
    r = [np.corrcoef(turned, (optical(middle + s - half).inv() * optical(middle + s + half)).magnitude())[0, 1] for s in shifts]
    assert shifts[int(np.argmax(r))] == pytest.approx(BROAD_LAG, abs=0.6e-3)
