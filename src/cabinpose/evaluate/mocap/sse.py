"""SSE, the static evaluation of a sensor: a motor turns it in known steps about one of its axes (thesis, 3.1.1.1).

ξ_t = |(sΘ_t − sΘ_0) − mΘ_t|, its mean and σ over all samples of all steps (eq. 3.1). Θ is the turn about the axis: the twist of
the sensor's orientation since the first step, followed over full turns. Euler angles would fold where the pitch passes 90°. sΘ_0
is the mean over the first step, so that the noise of one sample does not shift all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError, ConfigError, unknown_name
from cabinpose.evaluate.mocap.result import Errors, Judgement, judgement
from cabinpose.evaluate.mocap.stillness import still_windows, turning_speed
from cabinpose.signals import conjugate, mean_orientation, product, turn_about

F64 = NDArray[np.float64]
AXES = MappingProxyType({"roll": (1.0, 0.0, 0.0), "pitch": (0.0, 1.0, 0.0), "yaw": (0.0, 0.0, 1.0)})  # Figure 3.9
STEP_RAD = np.radians(11.25)
SAMPLES = 300
ON, OFF = "error about the axis", "tilt off the axis"


@dataclass(frozen=True)
class SseRun:
    """One axis' run, T samples at standstill: which step (T,), reference_rad and turn_rad (T,) since the first step.

    tilt_rad (T,): the rotation that is left when the turn about the axis is taken out; 0 for a sensor whose axis is the motor's.
    """

    axis: str
    time_s: F64
    step: NDArray[np.int64]
    reference_rad: F64
    turn_rad: F64
    tilt_rad: F64

    def errors(self) -> tuple[Errors, Errors]:
        """Errors about the axis (eq. 3.1) and the tilt off it."""
        about = np.abs(self.turn_rad - self.reference_rad)[:, None]
        return (
            Errors(ON, "rad", self.axis, ("sensor",), self.time_s, about),
            Errors(OFF, "rad", self.axis, ("sensor",), self.time_s, self.tilt_rad[:, None]),
        )


def find_steps(
    time_s: ArrayLike, orientation_wxyz: ArrayLike, *, count: int, limit_rad_s: float = np.radians(1.5), least_s: float = 0.5,
    margin_s: float = 0.1, over_s: float = 0.25,
) -> NDArray[np.int64]:  # fmt: skip
    """(T,) the step that each sample belongs to, from 0, -1 while the motor turns; from the sensor's stillness alone.

    The sensor is still where it turns more slowly than `limit_rad_s`, measured over `over_s`, for `least_s` or more.
    `margin_s` is left out at both ends, where the motor may still settle. Raises AlignmentError unless there are `count`
    standstills: they are numbered in order, so a missed one would shift all that follow.
    """
    time, q = np.asarray(time_s, np.float64), np.asarray(orientation_wxyz, np.float64)
    still = turning_speed(time, q, over_s=over_s) < limit_rad_s
    windows = still_windows(time, still, least_s=least_s, margin_s=margin_s)
    if len(windows) != count:
        raise AlignmentError(
            f"the sensor stands still {len(windows)} times; {count} steps were expected",
            hint="give the steps' number, or the limits of stillness (speed, time); a source of kind stepper tells them itself",
        )
    step = np.full(len(time), -1, np.int64)
    for number, window in enumerate(windows):
        step[window.frames(time)] = number
    return step


def sse_run(
    time_s: ArrayLike, orientation_wxyz: ArrayLike, *, axis: str, step: ArrayLike | None = None,
    reference_rad: ArrayLike | None = None, step_rad: float = STEP_RAD, samples: int | None = SAMPLES,
) -> SseRun:  # fmt: skip
    """One axis' run: orientations (T, 4) of the sensor in its world, turned about its axis "roll" (x), "pitch" (y), "yaw" (z).

    Parameters
    ----------
    time_s, orientation_wxyz
        Samples.
    axis
        Of `AXES`.
    step
        (T,) the step that each sample belongs to, -1 = between steps.
    reference_rad
        (T,) the motor's angle, NaN where it is not known; None: step times `step_rad`. Its sign is chosen to fit the turn, since
        the motor may turn either way.
    samples
        How many are taken of each step, from its middle; None: all.

    Raises
    ------
    AlignmentError
        Where there are fewer than two steps, or the sensor did not turn about that axis.
    """
    if axis not in AXES:
        raise unknown_name("axis", axis, list(AXES))
    if samples is not None and samples < 1:
        raise ConfigError(f"{samples} samples of a step are none", hint="give a number above 0, or 0 for all of them")
    time, q = np.asarray(time_s, np.float64), np.asarray(orientation_wxyz, np.float64)
    marks = np.zeros(len(time), np.int64) if step is None else np.asarray(step, np.int64)
    if step is None and reference_rad is None:
        raise AlignmentError("neither steps nor a reference are given", hint="give `step` (see find_steps) or `reference_rad`")
    if reference_rad is not None:
        reference = np.asarray(reference_rad, np.float64)
        if step is None:
            marks = np.unique(reference.round(9), return_inverse=True)[1]
        marks = np.where(np.isfinite(reference), marks, -1)
    else:
        reference = marks.astype(np.float64) * step_rad
    used = np.flatnonzero((marks >= 0) & np.isfinite(q).all(axis=-1))
    if not len(used):
        raise AlignmentError("no sample of the sensor is of a step", hint="was it recorded while the motor stood still?")
    if step is not None and samples is not None:
        used = np.concatenate([_middle(used[marks[used] == k], samples) for k in np.unique(marks[used])])
    reference = reference[used] - reference[used[0]]
    if np.ptp(reference) == 0:
        raise AlignmentError("the sensor was not turned: there is but one step", hint="a run needs two steps or more")
    turned = product(conjugate(mean_orientation(q[used][marks[used] == marks[used[0]]])), q[used])
    about = turn_about(turned, AXES[axis])
    direction = 1.0 if np.cos(about - reference).sum() >= np.cos(about + reference).sum() else -1.0
    # The turn nearest to the reference: right up to half a turn of error, also where steps are large or samples were left out.
    about = direction * reference + (about - direction * reference + np.pi) % (2 * np.pi) - np.pi
    tilt = 2 * np.arccos(np.clip(np.hypot(turned[:, 0], turned[:, 1:] @ np.asarray(AXES[axis])), 0.0, 1.0))
    if np.median(tilt) > np.pi / 4:
        raise AlignmentError(
            f"the sensor did not turn about its {axis} axis: {np.degrees(np.median(tilt)):.0f}° beside it",
            hint="name the axis that was parallel to the motor's",
        )
    return SseRun(axis, time[used], marks[used], direction * reference, about, tilt)


def sse(runs: Sequence[SseRun], *, rng: np.random.Generator, resamples: int = 1000, block_s: float | None = None) -> Judgement:
    """Mean and σ of the error by axis, over any number of runs."""
    notes = [f"{run.axis}: {len(np.unique(run.step))} steps, {len(run.time_s)} samples" for run in runs]
    return judgement("sse", runs, notes, rng=rng, resamples=resamples, block_s=block_s)


def _middle(of: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    start = max((len(of) - count) // 2, 0)
    return of[start : start + count]
