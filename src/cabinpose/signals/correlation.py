"""Signals of two clocks made comparable, and their normalised cross-correlation over all lags.

Both signals pass one Gaussian filter whose width is a sample of the slower one. The filter is symmetric, so it delays nothing; it
leaves both signals with a band that the slower one's rate can represent. Without it the estimate is biased: a spline through
white noise has less variance between samples than on them, which draws the correlation of two clocks of one rate towards half a
sample. A filtered signal is smooth, so that a cubic spline gives its value at any time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline, PPoly
from scipy.ndimage import correlate1d

from cabinpose.core import AlignmentError
from cabinpose.signals.resample import rising_times

F64 = NDArray[np.float64]

_FEWEST = 8  # samples that a signal needs in one stretch
_REACH = 4  # sigmas of the filter's kernel; beyond lies 1/16000 of it


@dataclass(frozen=True)
class Signal:
    """A filtered signal on an even grid of its own clock, centred, of unit power.

    time_s: (N,) · values: (N, C), NaN where there is none · curve, slope, bend: the spline through them and its
    derivatives, NaN in gaps · period_s: of the grid.
    """

    time_s: F64
    values: F64
    curve: PPoly
    slope: PPoly
    bend: PPoly
    period_s: float


class Raw(NamedTuple):
    """The known samples of a signal: times (T,), values (T, C), the median pause between samples."""

    name: str
    time_s: F64
    values: F64
    period_s: float


def known_samples(time_s: ArrayLike, signal: ArrayLike, name: str) -> Raw:
    """A signal (T,) or (T, C) without the rows that have a NaN. Raises AlignmentError where it is too short or constant."""
    values = np.asarray(signal, np.float64)
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2:
        raise AlignmentError(f"signal {name} is {values.shape}, not (T,) or (T, C)", hint="give one row for each sample")
    time = rising_times(time_s, len(values), f"the times of signal {name}")
    known = np.isfinite(values).all(axis=1)
    if np.count_nonzero(known) < _FEWEST:
        raise AlignmentError(
            f"signal {name} has {np.count_nonzero(known)} known samples of {len(values)}",
            hint=f"at least {_FEWEST} in a row are needed: is the source recorded, and what it looks at in view?",
        )
    period = float(np.median(np.diff(time)))  # of all samples: one that is not known is still a tick
    time, values = time[known], values[known]
    if (np.ptp(values, axis=0) <= 1e-9 * np.abs(values).max(axis=0)).all():
        raise AlignmentError(f"signal {name} is constant", hint="what is seen has to move: swing the pendulum, turn the head")
    return Raw(name, time, values, period)


def smoothed(raw: Raw, sigma_s: float, max_gap_s: float) -> Signal:
    """The signal behind a Gaussian of `sigma_s` (0: none), each stretch without a gap longer than `max_gap_s` by itself."""
    centred = raw.values - raw.values.mean(axis=0)
    centred = centred / np.sqrt(np.mean(centred**2))  # one factor for all channels: they keep their weights
    curve = pieces(raw.time_s, centred, max_gap_s)
    count = int(np.floor((raw.time_s[-1] - raw.time_s[0]) / raw.period_s)) + 1
    time = raw.time_s[0] + raw.period_s * np.arange(count)
    values = np.asarray(curve(time))
    if sigma_s > 0:
        reach = int(np.ceil(_REACH * sigma_s / raw.period_s))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * raw.period_s / sigma_s) ** 2)
        # The kernel is whole or the value is missing: a kernel cut at a gap would move the signal.
        values = correlate1d(values, kernel / kernel.sum(), axis=0, mode="constant", cval=np.nan)
        known = np.isfinite(values).all(axis=1)
        if np.count_nonzero(known) < _FEWEST:
            raise AlignmentError(
                f"signal {raw.name} has no stretch without a gap that is long enough",
                hint="gaps leave too little: keep what is looked at in view, or allow a longer max_gap_s",
            )
        curve = pieces(time[known], values[known], 1.5 * raw.period_s)
    return Signal(time, values, curve, curve.derivative(), curve.derivative(2), raw.period_s)


def pieces(time: F64, values: F64, max_gap_s: float) -> PPoly:
    """Cubic splines through each stretch without a gap, NaN elsewhere: one piecewise polynomial, evaluated at once."""
    cuts = np.flatnonzero(np.diff(time) > max_gap_s) + 1
    coefficients = np.full((4, len(time) - 1, values.shape[1]), np.nan)
    for first, end in zip([0, *cuts], [*cuts, len(time)], strict=True):
        if end - first >= 4:
            coefficients[:, first : end - 1] = CubicSpline(time[first:end], values[first:end]).c
    return PPoly(coefficients, time, extrapolate=False)


def correlogram(a: F64, b: F64, least: float, shifts: NDArray[np.int64], energy: float) -> F64:
    """Pearson's r between two signals at each shift: of a[n] with b[n + shift], over the rows that both know.

    Mean and power are those of the overlap at each shift, by FFT. Channels are centred one by one and share one power.

    Parameters
    ----------
    a, b
        (N, C) and (M, C), NaN = not known.
    least
        Fewest rows that have to overlap.
    shifts
        (K,) in samples.
    energy
        Least sum of squares about their mean of the overlapping rows, of a and of b.

    Returns
    -------
    NDArray
        (K,), NaN where the overlap is too short or too still.

    References
    ----------
    D. Padfield, "Masked object registration in the Fourier domain", IEEE Trans. Image Processing 21 (2012).
    """
    known_a, known_b = (np.asarray(np.isfinite(x).all(axis=1)) for x in (a, b))
    a, b = np.where(known_a[:, None], a, 0.0), np.where(known_b[:, None], b, 0.0)
    size = next_fast_len(len(a) + len(b) - 1, real=True)

    def spectra(x: F64) -> NDArray[np.complex128]:
        return rfft(x, size, axis=0)

    def sums(of_a: NDArray[np.complex128], of_b: NDArray[np.complex128]) -> F64:
        return irfft(np.conj(of_a) * of_b, size, axis=0)[shifts]  # negative shifts lie at the end, as numpy counts

    ma, mb = (spectra(known[:, None].astype(np.float64)) for known in (known_a, known_b))
    fa, fb = spectra(a), spectra(b)
    count = np.rint(sums(ma, mb))
    n = np.maximum(count, 1.0)
    sum_a, sum_b = sums(fa, mb), sums(ma, fb)
    both = (sums(fa, fb) - sum_a * sum_b / n).sum(axis=1)
    power_a = sums(spectra((a**2).sum(axis=1, keepdims=True)), mb)[:, 0] - (sum_a**2 / n).sum(axis=1)
    power_b = sums(ma, spectra((b**2).sum(axis=1, keepdims=True)))[:, 0] - (sum_b**2 / n).sum(axis=1)
    good = (count[:, 0] >= max(least, 3)) & (power_a > energy) & (power_b > energy)
    result = np.full(len(shifts), np.nan)
    result[good] = both[good] / np.sqrt(power_a[good] * power_b[good])
    return result
