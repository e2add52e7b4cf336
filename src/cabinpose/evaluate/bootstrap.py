"""Intervals by the cluster bootstrap: sequences, and frames of none, are drawn with replacement, as many as there are.

Frames of one sequence resemble each other, and are drawn together. See Efron and Tibshirani 1993, ch. 6, 13; Davison and Hinkley
1997, 3.8: clusters are drawn, and nothing within them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Weights = NDArray[np.uint8]  # (B, F): how often each frame was drawn in each of B resamples

LEVEL = 0.95
_BLOCK = 4096  # frames at a time, so that weights are floats only block by block
_ELEMENTS = 1 << 20  # of several resamples at a time, so that few frames cost few calls


def clusters_of(sequence: NDArray[np.int64], sync_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F,) the cluster of each frame, numbered from 0: its sequence, or itself where all frames of its sequence are of one time.

    Of a single sequence, which nothing can be drawn from, stretches of frames in a row are clusters, as many as each has frames.
    """
    names, of = np.unique(sequence, return_inverse=True)
    first, last = np.full(len(names), np.iinfo(np.int64).max), np.full(len(names), np.iinfo(np.int64).min)
    np.minimum.at(first, of, sync_ns)
    np.maximum.at(last, of, sync_ns)
    moving, own = (first < last)[of], np.arange(len(of))
    if len(names) == 1 and moving.all():
        return own // max(math.isqrt(len(of)), 1)
    return np.unique(np.where(moving, of, len(names) + own), return_inverse=True)[1]


def frame_weights(cluster: NDArray[np.int64], resamples: int, *, rng: np.random.Generator) -> Weights:
    """(B, F) how often each frame is drawn in each of `resamples` resamples, with all others of its cluster (F,)."""
    clusters = int(cluster.max(initial=-1)) + 1
    weights = np.empty((resamples, len(cluster)), np.uint8)
    for row in weights:
        row[:] = np.bincount(rng.integers(clusters, size=clusters), minlength=clusters)[cluster]
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
