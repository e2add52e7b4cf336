"""Intervals by the bootstrap: frames are drawn with replacement, as many as there are (Efron and Tibshirani 1993, ch. 6, 13).

Frames of one sequence resemble each other, so that intervals over few long sequences are too narrow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Weights = NDArray[np.uint8]  # (B, F): how often each frame was drawn in each of B resamples

LEVEL = 0.95
_BLOCK = 4096  # frames at a time, so that weights are floats only block by block
_ELEMENTS = 1 << 20  # of several resamples at a time, so that few frames cost few calls


def frame_weights(frames: int, resamples: int, *, rng: np.random.Generator) -> Weights:
    """(B, F) how often each of `frames` frames is drawn in each of `resamples` resamples."""
    weights = np.empty((resamples, frames), np.uint8)
    for row in weights:
        row[:] = np.bincount(rng.integers(frames, size=frames), minlength=frames)
    return weights


def weighted_sums(weights: Weights, per_frame: Array) -> Array:
    """(B, J) sums of per-frame values (F, J) over each resample."""
    sums = np.zeros((len(weights), per_frame.shape[1]))
    for start in range(0, len(per_frame), _BLOCK):
        block = slice(start, start + _BLOCK)
        sums += weights[:, block].astype(np.float64) @ per_frame[block]
    return sums


def weighted_quantiles(values: Array, at: NDArray[np.int64], weights: Weights, shares: Array) -> Array:
    """(B, Q) quantiles of values (n,) of the frames `at` (n,), each as often as its frame was drawn; NaN without values."""
    order = np.argsort(values, kind="stable")
    ordered, frames = values[order], at[order]
    result = np.full((len(weights), len(shares)), np.nan)
    if not len(values):
        return result
    rows = max(_ELEMENTS // len(values), 1)
    for start in range(0, len(weights), rows):
        masses = np.cumsum(weights[start : start + rows, frames], axis=1, dtype=np.int64)
        for row, mass in zip(result[start : start + rows], masses, strict=True):
            if mass[-1]:
                place = np.searchsorted(mass, shares * mass[-1], side="left")
                row[:] = ordered[np.minimum(place, len(ordered) - 1)]
    return result


def interval(resampled: Array, level: float = LEVEL) -> tuple[Array, Array]:
    """The percentile interval over the first axis, ignoring resamples without a value; NaN where none has one."""
    low, high = np.full(resampled.shape[1:], np.nan), np.full(resampled.shape[1:], np.nan)
    if not len(resampled):
        return low, high
    tails = (1 - level) / 2, (1 + level) / 2
    known = np.isfinite(resampled)
    whole, some = known.all(axis=0), known.any(axis=0)
    low[whole], high[whole] = np.quantile(resampled[:, whole], tails, axis=0)
    if (partly := some & ~whole).any():
        low[partly], high[partly] = np.nanquantile(resampled[:, partly], tails, axis=0)
    return low, high
