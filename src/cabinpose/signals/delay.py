"""The delay and the drift between two clocks from a signal that both saw, and when it cannot be told.

1. Both signals pass the same filter without phase and are put on an even grid each (`signals.correlation`).
2. Their normalised cross-correlation over all lags allowed gives the peak to a sample, and its rivals (`signals.lags`).
3. The correlation of each of a dozen windows gives the delay over time; a robust line through these (Theil-Sen) the drift; a
   step in them is a clock that jumps.
4. Newton steps on the curve between samples fit one signal to the other as a whole (`signals.fitting`): delay, drift, intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError, UndeterminedError
from cabinpose.signals.correlation import known_samples, smoothed
from cabinpose.signals.fitting import Fit, fit_delay
from cabinpose.signals.lags import LagSearch, Peak, WindowDelays, weak_error

F64 = NDArray[np.float64]

# The delay is ambiguous unless a rival peak leaves at least this many times as much variance unexplained as the best one.
_CLEAR = 1.5
_PERFECT = 1e-6  # added to the unexplained part, which is 0 for exact signals, so that ratios exist
_GAP_PERIODS = 2.5  # one lost sample is bridged, two are a gap


@dataclass(frozen=True)
class Delay:
    """What clock b shows when clock a shows t_a: t_b = t_a + offset_s + drift (t_a - reference_s).

    interval_s, drift_interval: 95 % intervals (low, high) of offset and drift; both ends 0 where no drift was asked for ·
    correlation: Pearson's r of the signals laid on each other · rival: that of the next best lag; NaN where there is none ·
    reference_s: middle of the time used, on clock a, where offset and drift hardly depend on each other · windows: delays of
    single windows, empty for takes too short to be cut.
    """

    offset_s: float
    interval_s: tuple[float, float]
    drift: float
    drift_interval: tuple[float, float]
    reference_s: float
    correlation: float
    rival: float
    windows: WindowDelays

    def to_b(self, time_a_s: ArrayLike) -> F64:
        """Times (...) of clock a on clock b."""
        a = np.asarray(time_a_s, np.float64)
        return a + self.offset_s + self.drift * (a - self.reference_s)

    def to_a(self, time_b_s: ArrayLike) -> F64:
        """Times (...) of clock b on clock a."""
        b = np.asarray(time_b_s, np.float64)
        return self.reference_s + (b - self.reference_s - self.offset_s) / (1 + self.drift)


@dataclass(frozen=True, kw_only=True)
class DelaySearch:
    """Where a delay is sought, and what is taken for one.

    max_lag_s, around_s: the offset is sought in around_s ± max_lag_s; for signals that repeat (a pendulum) less than half a
    period · drift: whether the clocks run at different rates · min_overlap: part of the shorter signal's known samples that has
    to overlap · min_correlation: below it, the signals are not taken for the same motion · smoothing_s: sigma of the filter;
    None: one sample of the slower signal · max_gap_s: of a and of b, the longest pause between samples that is bridged; None: 2.5
    samples · window_s: length of the windows that tell drift and jumps; None: a twelfth of the take, at least 5 s.
    """

    max_lag_s: float
    around_s: float = 0.0
    drift: bool = False
    min_overlap: float = 0.5
    min_correlation: float = 0.7
    smoothing_s: float | None = None
    max_gap_s: tuple[float, float] | None = None
    window_s: float | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.max_lag_s) and self.max_lag_s > 0 and np.isfinite(self.around_s)):
            raise AlignmentError(f"lags {self.around_s} ± {self.max_lag_s} s", hint="max_lag_s is a number above 0")


def estimate_delay(
    time_a_s: ArrayLike, signal_a: ArrayLike, time_b_s: ArrayLike, signal_b: ArrayLike, search: DelaySearch
) -> Delay:
    """The delay of clock b against clock a, from signals that both saw.

    Channels are correlated together; levels may differ by channel, one gain is common and positive.

    Parameters
    ----------
    time_a_s, time_b_s
        (T,) s, rising strictly.
    signal_a, signal_b
        (T,) or (T, C), the same channels of both, NaN = not known.
    search
        Where it is sought, and what is taken for it.

    Returns
    -------
    Delay
        Offset and drift with their 95 % intervals.

    Raises
    ------
    AlignmentError
        Where a signal is constant or too short, where times do not rise, where too little overlaps, where the best correlation
        is weak, where another lag explains nearly as much, where the correlation still rises at the edge of what is allowed, and
        where a clock jumps.
    """
    raw_a, raw_b = known_samples(time_a_s, signal_a, "a"), known_samples(time_b_s, signal_b, "b")
    if raw_a.values.shape[1] != raw_b.values.shape[1]:
        raise AlignmentError(
            f"signal a has {raw_a.values.shape[1]} channels, b {raw_b.values.shape[1]}", hint="give the same channels of both"
        )
    sigma = max(raw_a.period_s, raw_b.period_s) if search.smoothing_s is None else search.smoothing_s
    gaps = search.max_gap_s or (_GAP_PERIODS * raw_a.period_s, _GAP_PERIODS * raw_b.period_s)
    a, b = smoothed(raw_a, sigma, gaps[0]), smoothed(raw_b, sigma, gaps[1])
    bounds, least = (search.around_s - search.max_lag_s, search.around_s + search.max_lag_s), search.min_correlation
    lags = LagSearch(a, b, bounds, search.min_overlap, least)
    peaks = lags.peaks()
    found = [c for peak in peaks if (c := _candidate(lags, peak, search.window_s, drift=search.drift))]
    if not found and peaks[0].correlation >= least:
        raise UndeterminedError(
            f"the signals are alike (r = {peaks[0].correlation:.3f}), but too short or too still to tell the delay's interval",
            hint="record at least 6 s with motion in all of them",
        )
    if not found:
        raise weak_error(peaks[0].correlation, peaks[0].lag_s, least)
    found.sort(key=lambda c: -c[0].correlation)
    fit, windows = found[0]
    rivals = [other for other, _ in found[1:] if abs(other.offset_s - fit.offset_s) > 2 * lags.step_s]
    strong = fit.correlation >= least
    if strong and rivals and rivals[0].correlation > 0 and _unexplained(rivals[0]) < _CLEAR * _unexplained(fit):
        raise AlignmentError(
            f"the delay is ambiguous: {fit.offset_s:.3f} s (r = {fit.correlation:.3f}) or {rivals[0].offset_s:.3f} s "
            f"(r = {rivals[0].correlation:.3f})",
            hint="a motion that repeats fits itself a period later: give max_lag_s below half a period, or move irregularly",
        )
    _refuse_jumps(windows, lags.step_s)  # before the weakness, whose cause a jump can be
    if not strong:
        raise weak_error(fit.correlation, fit.offset_s, least)
    interval = fit.offset_s - fit.offset_half_s, fit.offset_s + fit.offset_half_s
    drift_interval = fit.drift - fit.drift_half, fit.drift + fit.drift_half
    rival = rivals[0].correlation if rivals else float("nan")
    return Delay(fit.offset_s, interval, fit.drift, drift_interval, fit.reference_s, fit.correlation, rival, windows)


def _candidate(lags: LagSearch, peak: Peak, window_s: float | None, *, drift: bool) -> tuple[Fit, WindowDelays] | None:
    """What a peak becomes when it is refined, with the delays of its windows."""
    low, high = lags.overlap(peak.lag_s)
    windows = lags.windows(peak.lag_s, window_s)
    reference = 0.5 * (low + high)
    start, slope = peak.lag_s, 0.0
    if drift and len(windows.time_s) >= 2:
        slope = robust_slope(windows.time_s, windows.offset_s)
        start = float(np.median(windows.offset_s - slope * (windows.time_s - reference)))
    fit = fit_delay(lags.a, lags.b, start, slope, reference_s=reference, free_drift=drift)
    return None if fit is None else (fit, windows)


def robust_slope(x: F64, y: F64) -> float:
    """The median of the slopes between all pairs of points (Theil 1950, Sen 1968); up to 29 % of them may be outliers."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))


def _unexplained(fit: Fit) -> float:
    return 1 - fit.correlation**2 + _PERFECT


def _refuse_jumps(windows: WindowDelays, step_s: float) -> None:
    """Raises AlignmentError where the delay of the windows steps by what neither drift nor their scatter explains."""
    time, offset = windows.time_s, _without_outliers(windows.offset_s)
    if len(time) < 4:
        return
    pause = np.diff(time)
    steps = np.diff(offset)
    steps = steps - np.median(steps / pause) * pause
    scatter = 1.4826 * float(np.median(np.abs(steps)))
    allowed = np.maximum(max(0.5 * step_s, 8 * scatter), windows.half_s[1:] + windows.half_s[:-1])
    worst = int(np.argmax(np.abs(steps) - allowed))
    if abs(steps[worst]) > allowed[worst]:
        raise AlignmentError(
            f"a clock jumps by {steps[worst] * 1e3:.1f} ms between {time[worst]:.1f} s and {time[worst + 1]:.1f} s of clock a",
            hint="a device restarted, or samples were lost without a gap in the times: cut the take there and align each part",
        )


def _without_outliers(values: F64) -> F64:
    """The median of three neighbours, ends unchanged: it removes one bad window and keeps a step where it is."""
    result = values.copy()
    if len(values) >= 3:
        result[1:-1] = np.median(np.stack((values[:-2], values[1:-1], values[2:])), axis=0)
    return result
