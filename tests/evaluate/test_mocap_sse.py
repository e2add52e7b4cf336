"""SSE: a motor that turns a sensor whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from cabinpose.core.errors import AlignmentError, ConfigError
from cabinpose.evaluate.mocap.sse import AXES, OFF, ON, STEP_RAD, find_steps, sse, sse_run

RATE, STEPS = 60.0, 33


def turned(axis: str, angle: np.ndarray, *, mount: Rotation | None = None, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Orientations of a sensor that its motor has turned by `angle`, in a world that has nothing to do with either."""
    world = Rotation.from_rotvec((0.3, -1.1, 2.0))
    sensor = world * Rotation.from_rotvec(angle[:, None] * np.array(AXES[axis]))
    if mount is not None:
        sensor = sensor * mount
    jitter = Rotation.from_rotvec(np.random.default_rng(seed).normal(0, noise, (len(angle), 3)))
    return (sensor * jitter).as_quat(scalar_first=True)


def staircase(still_s: float = 2.0, turn_s: float = 0.4, steps: int = STEPS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, the motor's angle and its step (-1 while it turns)."""
    period = still_s + turn_s
    time = np.arange(0, steps * period - turn_s, 1 / RATE)
    number = np.floor(time / period)
    beside = np.clip((time - number * period - still_s) / turn_s, 0, 1)
    return time, (number + beside) * STEP_RAD, np.where(beside > 0, -1, number).astype(int)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("direction", [1, -1])
def test_a_bias_by_the_angle_is_recovered_over_a_full_turn(axis: str, direction: int) -> None:
    """Θ_sensor = Θ + 3° sin Θ, as soft iron distorts a heading: the mean of 3°|sin Θ| over 33 steps, in closed form."""
    time, motor, step = staircase()
    amplitude = np.radians(3.0)
    q = turned(axis, direction * (motor + amplitude * np.sin(motor)))
    run = sse_run(time, q, axis=axis, step=step, samples=60)
    expected = np.degrees(amplitude) * np.abs(np.sin(np.arange(STEPS) * STEP_RAD))
    row = sse([run], rng=np.random.default_rng(0), resamples=0).summary(ON)
    assert row.samples == STEPS * 60
    assert row.mean == pytest.approx(expected.mean(), abs=1e-9)
    assert row.sd == pytest.approx(np.repeat(expected, 60).std(ddof=1), abs=1e-9)
    assert run.tilt_rad.max() < 1e-6


def test_noise_comes_out_as_it_went_in() -> None:
    time, motor, step = staircase(still_s=5.2)
    run = sse_run(time, turned("yaw", motor, noise=np.radians(0.2)), axis="yaw", step=step)
    assert len(run.time_s) == STEPS * 300
    row = sse([run], rng=np.random.default_rng(0), resamples=100).summary(ON)
    # the mean of |N(0, σ²)| is σ √(2/π), its deviation σ √(1 - 2/π)
    assert row.mean == pytest.approx(0.2 * np.sqrt(2 / np.pi), rel=0.03)
    assert row.sd == pytest.approx(0.2 * np.sqrt(1 - 2 / np.pi), rel=0.03)
    assert row.mean_low < 0.2 * np.sqrt(2 / np.pi) < row.mean_high


def test_a_tilted_mounting_shows_beside_the_axis() -> None:
    time, motor, step = staircase()
    mount = Rotation.from_rotvec((0.05, 0, 0))
    run = sse_run(time, turned("yaw", motor, mount=mount), axis="yaw", step=step, samples=None)
    # Half a turn about an axis 0.05 rad beside the sensor's own leaves the sensor's axis by twice that angle.
    assert run.tilt_rad.max() == pytest.approx(0.1, rel=1e-3)
    assert np.abs(run.turn_rad - run.reference_rad).max() < 0.05**2


def test_steps_are_found_by_stillness() -> None:
    time, motor, step = staircase()
    q = turned("pitch", motor, noise=np.radians(0.05))
    found = find_steps(time, q, count=STEPS)
    kept = found >= 0
    assert (found[kept] == step[kept]).all()
    assert kept.sum() > 0.75 * (step >= 0).sum()


def test_the_motors_own_angle_is_a_reference() -> None:
    time, motor, _ = staircase()
    run = sse_run(time, turned("roll", motor + 0.01 * (motor > 1)), axis="roll", reference_rad=motor + 5.0)
    error = np.abs(run.turn_rad - run.reference_rad)
    assert error[motor > 1] == pytest.approx(0.01, abs=1e-9)
    assert error[motor <= 1] == pytest.approx(0, abs=1e-9)


def test_a_missed_step_is_an_error() -> None:
    time, motor, _ = staircase()
    q = turned("yaw", motor)
    gone = (time > 4.6) & (time < 7.2)
    fast = Slerp(time[~gone], Rotation.from_quat(q[~gone], scalar_first=True))(time[~gone]).as_quat(scalar_first=True)
    with pytest.raises(AlignmentError, match=r"stands still 32 times; 33 steps were expected") as caught:
        find_steps(np.arange(len(fast)) / RATE, fast, count=STEPS)
    assert "steps' number" in str(caught.value.hint)


def test_the_wrong_axis_and_no_turn_are_errors() -> None:
    time, motor, step = staircase()
    with pytest.raises(AlignmentError, match="did not turn about its roll axis"):
        sse_run(time, turned("yaw", motor), axis="roll", step=step)
    with pytest.raises(AlignmentError, match="not turned"):
        sse_run(time, turned("yaw", motor), axis="yaw", step=np.where(step == 0, 0, -1))
    with pytest.raises(AlignmentError, match="no sample of the sensor is of a step"):  # a take that ended as it had begun
        sse_run(time, turned("yaw", motor), axis="yaw", step=np.full(len(time), -1))
    with pytest.raises(AlignmentError, match="neither steps nor a reference"):
        sse_run(time, turned("yaw", motor), axis="yaw")
    with pytest.raises(ConfigError, match="unknown axis 'heading'"):
        sse_run(time, turned("yaw", motor), axis="heading", step=step)


def test_both_measures_stand_side_by_side() -> None:
    time, motor, step = staircase(still_s=0.5)
    runs = [sse_run(time, turned(axis, motor), axis=axis, step=step) for axis in AXES]
    result = sse(runs, rng=np.random.default_rng(0), resamples=0)
    assert {(s.measure, s.condition) for s in result.summaries} == {
        (m, c) for m in (ON, OFF) for c in ("All", "roll", "pitch", "yaw")
    }
