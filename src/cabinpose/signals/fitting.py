"""The delay and the drift that fit one signal to another: robust least squares on the curve between samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from cabinpose.signals.correlation import Signal

F64 = NDArray[np.float64]

_HUBER = 2.5  # sigmas from which a residual counts by its size, not its square
_STEPS, _SCALE_STEPS = 40, 4
_SETTLED_S = 1e-10
_FAR = 20  # samples from the first guess: the fit has left the peak that it was to refine
_FEWEST = 8
_LEVEL = 0.95
_BLOCK_S, _BLOCKS = 2.0, (6, 30)  # motions repeat after a second or two: blocks are no shorter, if the take lasts


class Fit(NamedTuple):
    """t_b = t_a + offset_s + drift (t_a - reference_s), Pearson's r there, the halves of the 95 % intervals, the pairs used."""

    offset_s: float
    drift: float
    reference_s: float
    correlation: float
    offset_half_s: float
    drift_half: float
    pairs: int


class _Pairs(NamedTuple):
    """Samples x (N, C) of the slower signal, the other's y at the same instant, y's two derivatives by the offset.

    since (N, 1): time on clock a since the reference; a derivative by the drift is that by the offset times it.
    """

    since: F64
    x: F64
    y: F64
    by_offset: F64
    twice: F64


def fit_delay(
    a: Signal,
    b: Signal,
    offset_s: float,
    drift: float = 0.0,
    *,
    reference_s: float,
    free_drift: bool,
    span: tuple[float, float] | None = None,
) -> Fit | None:
    """The delay and drift near a first guess.

    Newton's steps on x - (level of each channel) - gain * y(t), x the samples of the slower signal, y the curve of the other,
    with Huber's weights, since a camera takes a reflection for its marker now and then. The residuals of neighbouring samples
    are alike, so that the curvature alone would give intervals that are too narrow: they come from the scores of blocks of time
    (a clustered sandwich estimate), with Student's t for the few blocks.

    Parameters
    ----------
    a, b
        The filtered signals.
    offset_s, drift
        The first guess, at `reference_s`.
    reference_s
        The time of clock a at which the offset holds.
    free_drift
        Whether the drift is fitted too.
    span
        First and last time of clock a to be used; None: all.

    Returns
    -------
    Fit or None
        None where the signals do not determine it.

    References
    ----------
    K.-Y. Liang, S. L. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73 (1986).
    """
    reach = max(a.period_s, b.period_s)
    half = max(0.5 * (a.time_s[-1] - a.time_s[0]), reach)
    clock, free = np.array((offset_s, drift)), 2 if free_drift else 1
    longest = reach * np.array((1, 1 / half))  # a step: the peak is known to a sample
    pairs = _pairs(a, b, clock, reference_s, span)
    level = _first_level(pairs)
    if level is None:
        return None
    scale = np.inf
    for n in range(_STEPS):
        # The scale of the residuals settles with them, and then has to hold still for the steps to converge.
        scale = _scale(pairs, level) if n < _SCALE_STEPS else scale
        step = _step(pairs, level, free, scale)
        if step is None:
            return None
        step[:free] = np.clip(step[:free], -longest[:free], longest[:free])
        clock[:free] += step[:free]
        level = level + step[free:]
        if abs(clock[0] - offset_s) > _FAR * reach:
            return None
        pairs = _pairs(a, b, clock, reference_s, span)
        if len(pairs.x) < _FEWEST:
            return None
        if np.abs(step[:free] / longest[:free]).max() < _SETTLED_S / reach and n >= _SCALE_STEPS:
            break
    halves = _halves(pairs, level, free, scale)
    if halves is None:
        return None
    return Fit(float(clock[0]), float(clock[1]), reference_s, _pearson(pairs), *halves, len(pairs.x))


def _pairs(a: Signal, b: Signal, theta: F64, reference: float, span: tuple[float, float] | None) -> _Pairs:
    offset, drift = theta
    if a.period_s >= b.period_s:
        time_a, x = a.time_s, a.values
        at, other, turn = time_a + offset + drift * (time_a - reference), b, 1.0
    else:
        x = b.values
        time_a = reference + (b.time_s - reference - offset) / (1 + drift)
        at, other, turn = time_a, a, -1.0 / (1 + drift)
    keep = np.isfinite(x).all(axis=1)
    if span is not None:
        keep &= (time_a >= span[0]) & (time_a <= span[1])
    at, x, time_a = at[keep], x[keep], time_a[keep]
    y = other.curve(at)
    known = np.isfinite(y).all(axis=1)
    at = at[known]
    return _Pairs((time_a[known] - reference)[:, None], x[known], y[known], turn * other.slope(at), turn**2 * other.bend(at))


def _first_level(pairs: _Pairs) -> F64 | None:
    """(1 + C,) gain and levels by plain least squares; None without enough pairs or motion."""
    if len(pairs.x) < _FEWEST:
        return None
    x_mean, y_mean = pairs.x.mean(axis=0), pairs.y.mean(axis=0)
    y = pairs.y - y_mean
    power = float((y * y).sum())
    if not power > 1e-12 * y.size:
        return None
    gain = float(((pairs.x - x_mean) * y).sum()) / power
    return np.concatenate(([gain], x_mean - gain * y_mean))


def _scale(pairs: _Pairs, level: F64) -> float:
    """Sigma of the residuals where the signal moves, by their median: at rest there are none."""
    size = np.abs(pairs.by_offset)
    fast = size >= np.median(size)
    return max(1.4826 * float(np.median(np.abs((pairs.x - level[1:] - level[0] * pairs.y)[fast]))), 1e-9)


def _scored(pairs: _Pairs, level: F64, free: int, scale: float) -> tuple[F64, F64, F64]:
    """The scores (N, C, P) of Huber's loss, the matrix of its second derivatives (P, P), and the part of that without residuals.

    Parameters: offset, drift (if two are free), gain, the level of each channel. The second derivatives of the curve count: noise
    on it has slopes of its own, which the first ones alone take for signal, and promise intervals that are too narrow.
    """
    n, channels = pairs.x.shape
    powers = np.concatenate((np.ones_like(pairs.since), pairs.since), axis=1)[:, None, :free]  # (N, 1, free)
    design = np.zeros((n, channels, free + 1 + channels))
    design[..., :free] = level[0] * pairs.by_offset[..., None] * powers
    design[..., free] = pairs.y
    design[:, range(channels), range(free + 1, free + 1 + channels)] = 1.0
    residual = pairs.x - level[1:] - level[0] * pairs.y
    cut = np.clip(residual, -_HUBER * scale, _HUBER * scale)
    inside = design[np.abs(residual) <= _HUBER * scale]
    squares = inside.T @ inside
    second = np.zeros_like(squares)
    bend = level[0] * (cut * pairs.twice).sum(axis=1)
    second[:free, :free] = (powers[:, 0] * bend[:, None]).T @ powers[:, 0]
    second[:free, free] = second[free, :free] = ((cut * pairs.by_offset).sum(axis=1)[:, None] * powers[:, 0]).sum(axis=0)
    return design * cut[..., None], squares - second, squares


def _step(pairs: _Pairs, level: F64, free: int, scale: float) -> F64 | None:
    """Newton's step; without the second derivatives (Gauss-Newton) where the loss is not convex."""
    scores, hessian, squares = _scored(pairs, level, free, scale)
    gradient = scores.sum(axis=(0, 1))
    step = _solve(hessian, gradient)
    return _solve(squares, gradient) if step is None else step


def _solve(matrix: F64, right: F64) -> F64 | None:
    """The solution of a positive definite system, None for others; scaled to a unit diagonal, as no clock drifts by 1."""
    diagonal = np.diag(matrix)
    if not (diagonal > 0).all():
        return None
    scale = 1 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    if values[0] < 1e-12:
        return None
    return ((vectors / values) @ (vectors.T @ (right.T * scale).T)).T @ np.diag(scale)


def _halves(pairs: _Pairs, level: F64, free: int, scale: float) -> tuple[float, float] | None:
    """Halves of the intervals of delay and drift (0 where it is not free)."""
    scores, hessian, _ = _scored(pairs, level, free, scale)
    inverse = _solve(hessian, np.eye(len(hessian)))
    if inverse is None:
        return None
    since = pairs.since[:, 0]
    duration = max(float(since[-1] - since[0]), 1e-9)
    count = int(np.clip(duration / _BLOCK_S, *_BLOCKS))
    block = np.minimum(((since - since[0]) / duration * count).astype(np.intp), count - 1)
    sums = np.zeros((count, len(hessian)))
    np.add.at(sums, block, scores.sum(axis=1))
    used = len(np.unique(block))
    if used < 3:
        return None
    sigma = np.sqrt(((sums @ inverse) ** 2).sum(axis=0) * used / (used - 1))
    quantile = float(stdtrit(used - 1, 0.5 + _LEVEL / 2))
    return quantile * float(sigma[0]), quantile * float(sigma[1]) if free == 2 else 0.0


def _pearson(pairs: _Pairs) -> float:
    x, y = pairs.x - pairs.x.mean(axis=0), pairs.y - pairs.y.mean(axis=0)
    power = float((x * x).sum() * (y * y).sum())
    return float((x * y).sum()) / np.sqrt(power) if power > 0 else 0.0
