"""The search over all lags: peaks of the correlation of two whole signals, and of windows of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import AlignmentError
from cabinpose.signals.correlation import Signal, correlogram
from cabinpose.signals.fitting import fit_delay

F64 = NDArray[np.float64]

_PEAKS = 3  # the best one and its rivals
_MOVING = 0.05  # of a signal's mean power: an overlap or a window with less has too little motion to be correlated
_WINDOWS, _SHORTEST_WINDOW_S = 12, 5.0


class Peak(NamedTuple):
    """A local maximum of the correlation: the lag t_b - t_a, to a sample, and r."""

    lag_s: float
    correlation: float


@dataclass(frozen=True)
class WindowDelays:
    """Delays of single windows: middle of each on clock a (W,) s, the delay there (W,) s, its interval's half, Pearson's r."""

    time_s: F64
    offset_s: F64
    half_s: F64
    correlation: F64


class LagSearch:
    """The lags within `lags` (low, high) of two signals, on the grid of the slower one."""

    def __init__(self, a: Signal, b: Signal, lags: tuple[float, float], min_overlap: float, min_correlation: float) -> None:
        self.a, self.b, self.lags = a, b, lags
        self.min_overlap, self.min_correlation = min_overlap, min_correlation
        self.step_s = max(a.period_s, b.period_s)
        self.time_a, self.time_b = (np.arange(s.time_s[0], s.time_s[-1] + 1e-9, self.step_s) for s in (a, b))
        self.on_a, self.on_b = a.curve(self.time_a), b.curve(self.time_b)

    def overlap(self, lag_s: float) -> tuple[float, float]:
        """First and last time of clock a that both signals cover at a lag."""
        return max(self.time_a[0], self.time_b[0] - lag_s), min(self.time_a[-1], self.time_b[-1] - lag_s)

    def peaks(self) -> list[Peak]:
        """The best lag first, then its rivals. Raises AlignmentError where there is no overlap, no peak, or a peak outside."""
        least = self.min_overlap * min(np.isfinite(x).all(axis=1).sum() for x in (self.on_a, self.on_b))
        lag, r = self._correlogram(slice(None), slice(None), least)
        if not np.isfinite(r).any():
            ends = [f"{name} {t[0]:.3f} to {t[-1]:.3f} s" for name, t in (("a", self.time_a), ("b", self.time_b))]
            raise AlignmentError(
                f"the signals ({', '.join(ends)}) share too little at lags of {self.lags[0]:.3f} to {self.lags[1]:.3f} s",
                hint="both have to see at least half of the motion: check the take, around_s and max_lag_s, or lower min_overlap",
            )
        top = _maxima(r)
        known = np.flatnonzero(np.isfinite(r))
        end = max(known[0], known[-1], key=lambda i: r[i])
        best = max(r[top], default=-np.inf)
        if r[end] > best and r[end] >= self.min_correlation:
            raise AlignmentError(
                f"the correlation still rises at the edge of the lags allowed, {lag[end]:.3f} s (r = {r[end]:.3f})",
                hint="widen max_lag_s, or say about where the delay lies with around_s",
            )
        if not top.size:
            raise weak_error(float(r[end]), float(lag[end]), self.min_correlation)
        order = top[np.argsort(-r[top], kind="stable")][:_PEAKS]
        return [Peak(float(lag[i]), float(r[i])) for i in order if i == order[0] or r[i] > 0.5 * best]

    def windows(self, near_s: float, window_s: float | None) -> WindowDelays:
        """The delay of each window that has motion and a clear peak; of similar peaks, the one nearest to `near_s`."""
        low, high = self.overlap(near_s)
        length = max(_SHORTEST_WINDOW_S, (high - low) / _WINDOWS) if window_s is None else window_s
        count = int((high - low) / length + 1e-6)
        rows = []
        for n in range(count if count >= 3 else 0):
            start, end = low + n * (high - low) / count, low + (n + 1) * (high - low) / count
            lag = self._window_lag(start, end, near_s)
            middle = 0.5 * (start + end)
            fit = lag is not None and fit_delay(self.a, self.b, lag, reference_s=middle, free_drift=False, span=(start, end))
            if fit and fit.correlation >= self.min_correlation:
                rows.append((middle, fit.offset_s, fit.offset_half_s, fit.correlation))
        return WindowDelays(*np.array(rows, np.float64).reshape(-1, 4).T)

    def _window_lag(self, start: float, end: float, near_s: float) -> float | None:
        of_a = slice(*np.searchsorted(self.time_a, (start, end)))
        of_b = slice(*np.searchsorted(self.time_b, (start + self.lags[0], end + self.lags[1])))
        lag, r = self._correlogram(of_a, of_b, 0.5 * (end - start) / self.step_s)
        top = _maxima(r)
        if not top.size or r[top].max() < 0.5 * self.min_correlation:
            return None
        alike = top[1 - r[top] ** 2 <= 1.5 * (1 - r[top].max() ** 2) + 1e-6]
        return float(lag[alike[np.argmin(np.abs(lag[alike] - near_s))]])

    def _correlogram(self, of_a: slice, of_b: slice, least: float) -> tuple[F64, F64]:
        """Lags (K,) allowed, and the correlation of some rows of the grids there."""
        a, b = self.on_a[of_a], self.on_b[of_b]
        if not (len(a) and len(b)):
            return np.zeros(0), np.zeros(0)
        zero = self.time_b[of_b][0] - self.time_a[of_a][0]
        first = max(int(np.ceil((self.lags[0] - zero) / self.step_s)), 1 - len(a))
        last = min(int(np.floor((self.lags[1] - zero) / self.step_s)), len(b) - 1)
        shifts = np.arange(first, last + 1)
        energy = _MOVING * max(least, 1.0) * a.shape[1]
        return zero + shifts * self.step_s, correlogram(a, b, least, shifts, energy)


def weak_error(correlation: float, lag_s: float, least: float) -> AlignmentError:
    """The refusal of signals that do not fit each other."""
    return AlignmentError(
        f"the correlation is weak: at best r = {correlation:.3f}, at a lag of {lag_s:.3f} s; {least} is asked for",
        hint="are both signals of the same motion, in the same units and the same order of channels? is around_s right?",
    )


def _maxima(r: F64) -> NDArray[np.intp]:
    """Where a row is above its neighbours, both of which are known."""
    if len(r) < 3:
        return np.zeros(0, np.intp)
    with np.errstate(invalid="ignore"):
        return np.flatnonzero((r[1:-1] > r[:-2]) & (r[1:-1] >= r[2:])) + 1
