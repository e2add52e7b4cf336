"""Smoothed joints: both filters against what their papers say, written down otherwise, and what gaps, absence and swaps do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cabinpose.core.errors import ConfigError
from cabinpose.core.ports import PoseBatch
from cabinpose.estimate import smoothing
from cabinpose.estimate.smoothing import LONGEST_GAP_S, MOST_LAG, SMOOTHERS, Smoother, make_smoother, smoothed
from cabinpose.store.named_poses import FoundPeople
from cabinpose.store.predictions import Predictions

RATE_HZ = 30.0
FOCAL_PX = 250.0


def poses(space: NDArray[Any], expected_m: NDArray[Any] | float = 0.03) -> PoseBatch:
    """Joints (F, P, J, 3) m, in an image `FOCAL_PX` times as large, with what is expected of their errors."""
    shape, points = space.shape[:3], space.astype(np.float32)
    score, expected = np.ones(shape, np.float32), np.broadcast_to(np.asarray(expected_m, np.float32), shape).copy()
    return PoseBatch(FOCAL_PX * points[..., :2], points, score, score, expected_error_m=expected)


def people(frames: int, seed: int = 0, noise_m: float = 0.005) -> NDArray[np.float64]:
    """(F, 2, 6, 3) two people who sway, 0.7 m apart, as a detector sees them."""
    rng = np.random.default_rng(seed)
    still = rng.normal(0.0, 0.3, (2, 6, 3)) + np.array([[[-0.35, 0, 1]], [[0.35, 0, 1]]])
    sway = 0.1 * np.sin(np.arange(frames) / 12.0)[:, None, None, None]
    return np.asarray(still + sway + rng.normal(0.0, noise_m, (frames, *still.shape)))


def times(frames: int, rate_hz: float = RATE_HZ) -> NDArray[np.int64]:
    return (1e9 / rate_hz * np.arange(frames)).astype(np.int64)


def smooth(
    found: PoseBatch, smoother: str | Smoother, at_ns: NDArray[np.int64] | None = None, sequence: Any = 0
) -> NDArray[np.float64]:
    """(F, P, J, 3) smoothed in space."""
    count = len(found.score)
    each = np.broadcast_to(np.asarray(sequence, np.int64), count)
    made = make_smoother(smoother) if isinstance(smoother, str) else smoother
    return smoothed(found, times(count) if at_ns is None else at_ns, each, made).joints_3d.astype(np.float64)


def one_euro_of_the_paper(x: NDArray[Any], at_s: NDArray[Any], fc_min: float, beta: float, fc_speed: float) -> list[Any]:
    """Casiez et al.'s filter of a point (F, D) that may be missing (None): its speed by successive values, a vector's length."""
    out: list[Any] = []
    before: Any = None
    for point, now in zip(x, at_s, strict=True):
        if point is None:
            out.append(None)
            continue
        if before is None:
            before = point, np.zeros_like(point), now, point
        else:
            period = now - before[2]

            def alpha(cutoff: float, period: float = period) -> float:
                return 1.0 / (1.0 + (1.0 / (2.0 * np.pi * cutoff)) / period)

            raw = (point - before[3]) / period
            speed = alpha(fc_speed) * raw + (1.0 - alpha(fc_speed)) * before[1]
            a = alpha(fc_min + beta * float(np.linalg.norm(speed)))
            before = a * point + (1.0 - a) * before[0], speed, now, point
        out.append(before[0])
    return out


def test_one_euro_is_the_papers() -> None:
    rng = np.random.default_rng(1)
    at_ns = np.cumsum(rng.integers(20, 60, 60)) * 1_000_000
    space = people(60)
    absent = rng.random(60) < 0.2
    space[absent, 0, 2] = np.nan
    ours = smooth(poses(space), "one-euro", at_ns)
    for p, j in ((0, 2), (1, 0)):
        points = [None if np.isnan(x).any() else x for x in space[:, p, j].astype(np.float32).astype(np.float64)]
        theirs = one_euro_of_the_paper(points, 1e-9 * at_ns, smoothing._CUTOFF_HZ, smoothing._CUTOFF_PER_SPEED, 1.0)
        for frame, expected in enumerate(theirs):
            np.testing.assert_allclose(ours[frame, p, j], np.nan if expected is None else expected, atol=1e-6)


@pytest.mark.parametrize("speed", [0.05, 0.5])
@pytest.mark.parametrize("rate_hz", [15.0, 60.0])
def test_one_euro_lags_behind_a_steady_motion_as_stated(speed: float, rate_hz: float) -> None:
    """1 / (2 π (f_c + β speed)): a first-order filter of that cut-off follows a ramp so much later, at any rate."""
    count = int(6 * rate_hz)
    space = np.zeros((count, 1, 2, 3))
    space[..., 0] = speed * np.arange(count)[:, None, None] / rate_hz
    behind = (space - smooth(poses(space), "one-euro", times(count, rate_hz)))[-1, 0, 0, 0] / speed
    assert behind == pytest.approx(1 / (2 * np.pi * (0.5 + 20.0 * speed)), rel=1e-3)


def test_one_euro_answers_a_step_as_a_filter_of_the_first_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smoothing, "_CUTOFF_PER_SPEED", 0.0)
    space = np.zeros((20, 1, 1, 3))
    space[5:] = 0.05
    alpha = 1 / (1 + RATE_HZ / (2 * np.pi * 0.5))
    np.testing.assert_allclose(
        smooth(poses(space), "one-euro")[5:, 0, 0, 0], 0.05 * (1 - (1 - alpha) ** np.arange(1, 16)), atol=1e-7
    )


def least_squares(x: NDArray[Any], error_m: NDArray[Any], at_s: NDArray[Any], end: int) -> NDArray[np.float64]:
    """(end, 2) places and velocities of a point along an axis, by all its answers (NaN = none) before `end` at once: the states
    that weigh the answers' errors and the accelerations between them least.
    """
    rows, values = [], []
    for k in range(end):
        if np.isfinite(x[k]):
            row = np.zeros(2 * end)
            row[2 * k] = 1.0
            rows.append(row * 1.596 / error_m[k])
            values.append(x[k] * 1.596 / error_m[k])
    still = np.zeros(2 * end)
    still[1] = 1.0 / 0.5
    rows.append(still)
    values.append(0.0)
    for k in range(1, end):
        t = at_s[k] - at_s[k - 1]
        whiten = np.linalg.cholesky(np.linalg.inv(0.3 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]]))).T
        step = np.zeros((2, 2 * end))
        step[:, 2 * k : 2 * k + 2] = np.eye(2)
        step[:, 2 * k - 2 : 2 * k] = -np.array([[1, t], [0, 1]])
        rows += [*(whiten @ step)]
        values += [0.0, 0.0]
    return np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0].reshape(end, 2)


@pytest.mark.parametrize("lag", [1, 4])
def test_fixed_lag_weighs_all_frames_that_are_there_by_least_squares(lag: int) -> None:
    rng = np.random.default_rng(2)
    count = 25
    at_ns = np.cumsum(rng.integers(20, 60, count)) * 1_000_000
    space, error = people(count), rng.uniform(0.01, 0.1, (count, 2, 6))
    space[rng.random(count) < 0.2, 1, 3] = np.nan
    found = poses(space, error)
    ours = smooth(found, make_smoother("fixed-lag", lag), at_ns)
    for p, j, axis in ((0, 0, 0), (1, 3, 2)):
        x = found.joints_3d[:, p, j, axis].astype(np.float64)
        first = int(np.flatnonzero(np.isfinite(x))[0])
        for frame in range(first, count):
            if np.isfinite(x[frame]):
                end = min(frame + lag + 1, count) - first
                places = least_squares(x[first:], found.expected_error_m[first:, p, j], 1e-9 * at_ns[first:], end)
                assert ours[frame, p, j, axis] == pytest.approx(places[frame - first, 0], abs=2e-6)


@pytest.mark.parametrize("lag", [1, 3, MOST_LAG])
def test_fixed_lag_answers_so_many_frames_later_and_does_not_lag_besides(lag: int) -> None:
    count = 90
    space = np.zeros((count, 1, 2, 3))
    space[..., 0] = 0.4 * np.arange(count)[:, None, None] / RATE_HZ
    found, smoother = poses(space), make_smoother("fixed-lag", lag)
    assert smoother.lag == lag
    answers = [smoother(found.map(lambda v, f=f: v[f : f + 1]), t) for f, t in enumerate(times(count))]  # type: ignore[misc]
    assert answers[:lag] == [None] * lag
    for frame in range(55, count - lag):
        answer = answers[frame + lag]
        assert answer is not None
        np.testing.assert_allclose(answer.joints_3d[0], found.joints_3d[frame], atol=1e-4)
    assert len([*smoother.rest()]) == lag
    assert not [*smoother.rest()]


@pytest.mark.parametrize("name", SMOOTHERS)
class TestEverySmoother:
    """What holds of all of them."""

    def test_joints_shake_less_and_lie_hardly_farther_off(self, name: str) -> None:
        true, found = people(150, noise_m=0.0), people(150)
        answer = smooth(poses(found), name)
        shakes = [np.linalg.norm(np.diff(x, 2, axis=0), axis=-1).mean() for x in (found, answer)]
        off = [np.linalg.norm(x - true, axis=-1).mean() for x in (found, answer)]
        assert shakes[1] < 0.5 * shakes[0]
        assert off[1] < off[0] + 0.002  # these people are never still

    def test_the_image_and_space_are_smoothed_alike(self, name: str) -> None:
        found = poses(people(40))
        both = smoothed(found, times(40), np.zeros(40, np.int64), make_smoother(name))
        np.testing.assert_allclose(both.joints_2d, FOCAL_PX * both.joints_3d[..., :2], atol=1e-3)
        assert both.score is found.score
        assert both.expected_error_m is found.expected_error_m

    def test_joints_of_the_image_alone(self, name: str) -> None:
        found = poses(people(60))
        flat = replace(
            found, joints_3d=np.full_like(found.joints_3d, np.nan), expected_error_m=np.full((60, 2, 6), np.nan, np.float32)
        )
        answer = smoothed(flat, times(60), np.zeros(60, np.int64), make_smoother(name))
        assert np.isnan(answer.joints_3d).all()
        shakes = [np.abs(np.diff(x.joints_2d, 2, axis=0)).mean() for x in (flat, answer)]
        assert shakes[1] < 0.5 * shakes[0]

    def test_what_is_not_found_stays_so_and_comes_back(self, name: str) -> None:
        space = people(60)
        space[20:25, 0, 1] = np.nan  # bridged: 5 frames are 0.17 s
        space[20:40, 1, 1] = np.nan  # 0.67 s: it starts anew
        answer = smooth(poses(space), name)
        np.testing.assert_array_equal(np.isnan(answer), np.isnan(space))
        until = smooth(poses(space[:40]), name)[:15]
        np.testing.assert_allclose(answer[:15], until, atol=1e-7)
        np.testing.assert_allclose(answer[40:, 1, 1], smooth(poses(space[40:]), name)[:, 1, 1], atol=1e-7)
        assert np.abs(answer[25, 0, 1] - smooth(poses(space[25:]), name)[0, 0, 1]).max() > 1e-3

    @pytest.mark.parametrize("kind", ["sequence", "back", "gap"])
    def test_frames_that_do_not_follow_each_other_never_mix(self, name: str, kind: str) -> None:
        first, second = people(20, 3), people(20, 4)
        later = {"sequence": times(40), "back": np.tile(times(20), 2), "gap": times(40)}[kind]
        later[20:] += int(1.1e9 * LONGEST_GAP_S) * (kind == "gap")
        both = smooth(poses(np.concatenate((first, second))), name, later, np.repeat((0, int(kind == "sequence")), 20))
        np.testing.assert_allclose(both, np.concatenate((smooth(poses(first), name), smooth(poses(second), name))), atol=1e-6)

    @pytest.mark.parametrize("flat", [False, True])
    def test_people_who_swap_start_anew(self, name: str, flat: bool) -> None:
        def found(space: NDArray[Any]) -> PoseBatch:
            both = poses(space)
            return replace(both, joints_3d=np.full_like(both.joints_3d, np.nan)) if flat else both

        def answer(space: NDArray[Any]) -> NDArray[Any]:
            return smoothed(found(space), times(len(space)), np.zeros(len(space), np.int64), make_smoother(name)).joints_2d

        space = people(40)
        space[20:] = space[20:, ::-1]
        np.testing.assert_allclose(answer(space), np.concatenate((answer(space[:20]), answer(space[20:]))), atol=1e-4)

    def test_types_stay(self, name: str) -> None:
        frame = poses(people(1)).map(lambda values: values[0])
        who = FoundPeople(
            **vars(frame),
            persons=("driver", "front_passenger"),
            joints=tuple("abcdef"),
            model="m",
            skeleton="cabinpose",
            size=(9, 9),
        )
        smoother = make_smoother(name)
        answers = [*filter(None, [smoother(who, 0)]), *smoother.rest()]
        assert [type(each) for each in answers] == [FoundPeople]
        np.testing.assert_array_equal(answers[0].joints_3d, who.joints_3d)
        none = Predictions(
            **vars(poses(people(0))), frame=np.zeros(0, np.int64), persons=who.persons, joints=who.joints, model="m"
        )
        assert smoothed(none, times(0), np.zeros(0, np.int64), make_smoother(name)) is none

    def test_frames_of_another_detector_and_several_at_once_are_refused(self, name: str) -> None:
        smoother, found = make_smoother(name), poses(people(2))
        with pytest.raises(ConfigError, match="these are 2 frames"):
            smoother(found, 0)
        smoother(found.map(lambda values: values[:1]), 0)
        with pytest.raises(ConfigError, match="not those of the frames before"):
            smoother(found.map(lambda values: values[:1, :1]), 1)


@pytest.mark.parametrize(
    ("name", "lag", "message"),
    [
        ("kalmann", None, "unknown smoother"),
        ("one-euro", 2, "answers at once"),
        ("fixed-lag", 0, "cannot answer 0 frames later"),
        ("fixed-lag", MOST_LAG + 1, "cannot answer 31"),
    ],
)
def test_what_there_is_not_is_refused(name: str, lag: int | None, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        make_smoother(name, lag)
    assert caught.value.hint
