"""Time: how the clock of a suit, of a camera and of an optical system relate, from motions that two of them saw.

Delays are maps from the first clock to the second (`Delay.to_b`). A delay of a signal against time stamps
counts with those of the clocks: a gyroscope's filter, an exposure stamped at its end.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.align.calibration import KnownDelay
from cabinpose.core import AlignmentError, Camera, Matrix, UndeterminedError, apply, unknown_name
from cabinpose.signals import Delay, DelaySearch, angular_velocity, estimate_delay, kabsch, resample_positions, rotation_angle

F64 = NDArray[np.float64]
TISSUE_S = 7e-4  # half of a 95 % interval: what soft tissue does to the suit's delay in `cabinpose bench lab`
VAGUE_S = 0.01  # a suit's delay that is known no better is refused
RotationSignal = Literal["velocity", "speed", "angle"]


def suit_to_optical(
    time_suit_s: ArrayLike,
    suit_wxyz: ArrayLike,
    time_optical_s: ArrayLike,
    optical_wxyz: ArrayLike,
    search: DelaySearch,
    *,
    signal: RotationSignal = "velocity",
    baseline_s: float = 0.1,
) -> Delay:
    """From the suit's clock to the optical system's, from the orientations (T, 4), (U, 4) wxyz of one segment (the head) in both.

    signal: "angle", of q·q0* since the first frame (the thesis; both have to begin at rest, and a drifting heading is taken for
    motion) · "speed", the angular speed, which needs no common start · "velocity": the speed first, then the angular velocity as
    three channels, the constant rotation between the two bodies' frames found on the way (Kabsch): a speed has a kink wherever
    the head turns back, components have none. baseline_s: over which turns are taken, see `angular_velocity`. The frames of the
    two worlds, their headings and the drift of these do not matter to the latter two. Errors are those of `estimate_delay`.
    """
    if signal not in ("velocity", "speed", "angle"):
        raise unknown_name("signal", signal, ("velocity", "speed", "angle"))
    times = np.asarray(time_suit_s, np.float64), np.asarray(time_optical_s, np.float64)
    both = np.asarray(suit_wxyz, np.float64), np.asarray(optical_wxyz, np.float64)
    if signal == "angle":
        suit, optical = (rotation_angle(q) for q in both)
        return estimate_delay(times[0], suit, times[1], optical, search)
    suit, optical = (
        angular_velocity(t, q, max_gap_s=_longest_pause(t), baseline_s=baseline_s) for t, q in zip(times, both, strict=True)
    )
    speeds = np.linalg.norm(suit, axis=1), np.linalg.norm(optical, axis=1)
    rough = estimate_delay(times[0], speeds[0], times[1], speeds[1], search)
    if signal == "speed":
        return rough
    partner = resample_positions(times[1], optical, rough.to_b(times[0]), max_gap_s=_longest_pause(times[1]))
    pairs = np.isfinite(partner).all(axis=1) & np.isfinite(suit).all(axis=1)
    try:
        optical_from_suit = kabsch(partner[pairs], suit[pairs], rotation_only=True)[:3, :3]
    except AlignmentError:
        return rough  # turned about one axis only: the frames stay open, and the speed has said all there is
    # The speed knows the delay to some milliseconds; what is allowed about it has only to leave room for a peak and its feet.
    reach = 0.5 + abs(rough.drift) * float(np.ptp(times[0]))
    narrow = replace(search, around_s=rough.offset_s, max_lag_s=reach)
    return estimate_delay(times[0], suit @ optical_from_suit.T, times[1], optical, narrow)


def tof_to_optical(
    time_tof_s: ArrayLike,
    uv: ArrayLike,
    time_optical_s: ArrayLike,
    p_world: ArrayLike,
    camera: Camera,
    camera_from_world: Matrix,
    search: DelaySearch,
) -> Delay:
    """From the ToF camera's clock to the optical system's, from a marker that swings before both as a pendulum.

    uv: (F, 2) px, where each frame shows it (`brightest_blob`; NaN: not) · p_world: (T, 3) m, where the optical system sees it ·
    camera: with the distortion of the image that uv is from. The marker is projected into the image and both coordinates are
    correlated. Space comes first: a swing that is a little elliptic has another phase from every side, so that no axis of it may
    be taken for the image's; and the board that calibrates space stands still, and needs no time. A pendulum repeats: keep
    search.max_lag_s below half its period. Errors are those of `estimate_delay`.
    """
    seen, marker = np.asarray(uv, np.float64), np.asarray(p_world, np.float64)
    if seen.ndim != 2 or seen.shape[1] != 2 or marker.ndim != 2 or marker.shape[1] != 3:
        raise AlignmentError(
            f"pixels (F, 2) and points (T, 3) are needed, not {seen.shape} and {marker.shape}", hint="give one marker's"
        )
    expected = camera.project(apply(camera_from_world, marker))
    # Far outside the image a distortion model means nothing; a little outside, it keeps the filter's kernels whole.
    size = np.array((camera.width, camera.height))
    expected[~((expected > -0.1 * size) & (expected < 1.1 * size)).all(axis=1)] = np.nan
    return estimate_delay(time_tof_s, seen, time_optical_s, expected, search)


def trusted(delay: Delay, *stamps_ns: NDArray[np.int64], known: KnownDelay | None = None) -> Delay:
    """A suit's delay of a take with all of its uncertainty, made sharper by what the head take knows of it.

    stamps_ns: those of suit and optical system, each (T,). Raises UndeterminedError where it is too vague for use.
    """
    delay = with_known(widened(delay, resolution_s(*stamps_ns)), known)
    refuse_vague(delay)
    return delay


def resolution_s(*stamps_ns: NDArray[np.int64]) -> float:
    """The resolutions of clocks, from their stamps (T,), added as independent errors are, s.

    Stamps that stand whole periods apart are counted, not rounded: they tell no resolution.
    """
    pauses = [np.diff(each) for each in stamps_ns if len(each) > 1]
    steps = [float(step) for each in pauses if (step := np.gcd.reduce(each)) < each.min()]
    return float(np.hypot.reduce(np.array([*steps, 0.0]))) / 1e9


def widened(delay: Delay, resolution: float = 0.0) -> Delay:
    """The delay of a suit with what does not average out over a take in its interval.

    Stamps may be rounded or cut off, which moves all of them by up to half the clocks' `resolution` (s), either way: 95 % of a
    uniform error. Skin and muscle move a sensor with the turn's rate, each sensor in its own way, all take long: `TISSUE_S`.
    """
    half = 0.5 * (delay.interval_s[1] - delay.interval_s[0])
    half = float(np.sqrt(half**2 + (0.95 * 0.5 * resolution) ** 2 + TISSUE_S**2))
    return replace(delay, interval_s=(delay.offset_s - half, delay.offset_s + half))


def with_known(measured: Delay, known: KnownDelay | None) -> Delay:
    """A take's delay, made sharper by that of the head take where the two agree.

    What is measured on the host's axis is the difference of two latencies' floors, which stays as long as the rig does; a head
    take has more motion than a drive. The mean is weighted by the squares of the intervals' inverse widths. A delay with a drift
    of its own, or one that contradicts the known one (beyond the root of the sum of the squares of their half widths), stands
    alone.
    """
    if known is None or known.interval_s is None or measured.drift != 0.0:
        return measured
    here, there = (0.5 * (high - low) for low, high in (measured.interval_s, known.interval_s))
    if abs(measured.offset_s - known.offset_s) > np.hypot(here, there):
        return measured
    share = there**2 / max(here**2 + there**2, 1e-30)
    offset = share * measured.offset_s + (1 - share) * known.offset_s
    half = max(np.sqrt(share) * here, min(TISSUE_S, here, there))  # what both takes have in common is not halved
    return replace(measured, offset_s=float(offset), interval_s=(float(offset - half), float(offset + half)))


def refuse_vague(delay: Delay) -> None:
    """Raises UndeterminedError for an interval that is wider than a rig can use."""
    half = 0.5 * (delay.interval_s[1] - delay.interval_s[0])
    if half > VAGUE_S:
        raise UndeterminedError(
            f"the delay is known to ±{1000 * half:.1f} ms only; ±{1000 * VAGUE_S:g} ms are allowed, in which a hand moves 1 cm",
            hint="record longer (30 s), and turn the head more, about all of its axes",
        )


def _longest_pause(time_s: F64) -> float:
    """Two samples and a half: what a derivative may bridge."""
    return 2.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf
