"""Errors of single joints: distances, after Procrustes alignment, of bones, of left and right, over time.

All take arrays of S samples (a person in a frame) and J joints, give (S, J), and NaN where there is nothing to measure.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def finite(points: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(...) whether points (..., D) are there."""
    return np.asarray(np.isfinite(points).all(axis=-1))


def distances(predicted: Array, true: Array) -> Array:
    """(S, J) Euclidean distances of points (S, J, D), in their unit."""
    return np.linalg.norm(predicted - true, axis=-1)


def root_relative_distances(predicted: Array, true: Array, root: int) -> Array:
    """(S, J) distances after each sample's points (S, J, D) are moved so that the root lies where it is; NaN of the root itself.

    Ionescu et al. (2014), "Human3.6M", protocol 1, of a root that has no error of its own to be averaged.
    """
    result = distances(predicted - predicted[:, [root]], true - true[:, [root]])
    result[:, root] = np.nan
    return result


def aligned_distances(predicted: Array, true: Array) -> Array:
    """(S, J) distances after the best similarity (rotation, translation, scale) of each sample's points (S, J, 3).

    Fitted to the joints that both have; NaN with fewer than three of them. Umeyama (1991), "Least-squares estimation of
    transformation parameters between two point patterns", eqs. 40-42: no reflection.
    """
    both = finite(predicted + true)  # (S, J)
    count = np.count_nonzero(both, axis=1)
    weight = (both / np.maximum(count, 1)[:, None])[..., None]  # (S, J, 1)
    source, target = (np.where(both[..., None], x, 0.0).astype(np.float64) for x in (predicted, true))
    mean_source, mean_target = ((weight * x).sum(axis=1, keepdims=True) for x in (source, target))
    source, target = source - mean_source, target - mean_target
    covariance = np.swapaxes(weight * target, 1, 2) @ source  # (S, 3, 3)
    u, d, vt = np.linalg.svd(covariance)
    sign = np.ones_like(d)
    sign[:, 2] = np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)
    rotation = (u * sign[:, None, :]) @ vt
    variance = (weight * source**2).sum(axis=(1, 2))
    scale = np.divide((d * sign).sum(axis=1), variance, out=np.zeros_like(variance), where=variance > 0)
    aligned = scale[:, None, None] * source @ np.swapaxes(rotation, 1, 2)
    return np.where(both & (count >= 3)[:, None], np.linalg.norm(aligned - target, axis=-1), np.nan)


def bone_length_errors(predicted: Array, true: Array, limbs: Sequence[tuple[int, int]]) -> Array:
    """(S, J) |predicted length - true length| of each bone (parent, child), at its child; points (S, J, 3)."""
    result = np.full(true.shape[:2], np.nan)
    for parent, child in limbs:
        found, wanted = (np.linalg.norm(x[:, child] - x[:, parent], axis=-1) for x in (predicted, true))
        result[:, child] = np.abs(found - wanted)
    return result


def swaps(predicted: Array, true: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """(S, J) whether a symmetric pair is swapped (1) or not (0), at its left joint; points (S, J, D).

    Swapped: exchanging the labels of the two predicted joints more than halves the sum of their errors. A mere
    improvement would also count pairs that were predicted close together, between the true ones.
    """
    result = np.full(true.shape[:2], np.nan)
    for left, right in pairs:
        ends = (predicted[:, left], predicted[:, right]), (true[:, left], true[:, right])
        straight = sum(np.linalg.norm(p - t, axis=-1) for p, t in zip(*ends, strict=True))
        crossed = sum(np.linalg.norm(p - t, axis=-1) for p, t in zip(ends[0], ends[1][::-1], strict=True))
        known = np.isfinite(straight + crossed)
        result[known, left] = (crossed < 0.5 * straight)[known]
    return result


def accelerations(offsets: Array, follows: NDArray[np.bool_]) -> Array:
    """(F - 2, ...) length of the second difference over time of predicted minus true points (F, ..., D), per frame squared.

    follows: (F,) whether a frame comes right after the one before it, in the same sequence; NaN where two do not.
    Kanazawa et al. (2019), "Learning 3D human dynamics from video": acceleration error.
    """
    second = np.linalg.norm(offsets[2:] - 2 * offsets[1:-1] + offsets[:-2], axis=-1)
    second[~(follows[2:] & follows[1:-1])] = np.nan
    return second
