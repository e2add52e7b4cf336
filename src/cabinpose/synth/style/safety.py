"""What styling may do to a frame whose labels stay: by construction, and measured."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cabinpose.core import Bools, Bytes, Floats32, Ints

EDGE_M, EDGE_SHARE = 0.06, 0.04  # steps of more than 6 cm and 4 % of the depth are edges
_REACH = 5  # px on either side of a border of labels in which its edge is looked for
_FEWEST_PX = 20  # of a part whose mean is compared


class LabelShift(NamedTuple):
    """How far a frame moved against its labels.

    edge_px: 95 of 100 depth edges at labels' borders moved no farther · part_mm: the most that the mean depth of a part moved ·
    lost: share of the valid pixels that became invalid.
    """

    edge_px: float
    part_mm: float
    lost: float


def parts_of(labels: Bytes, instance: Bytes) -> Ints:
    """(H, W) a number for each class of each person."""
    return instance.astype(np.int64) * 256 + labels


def without_part_means(change: Floats32, where: Bools, parts: Ints) -> Floats32:
    """A change of depth (H, W) whose mean over each part's pixels in `where` is 0, and that is 0 elsewhere."""
    mean = _means(change, where, parts)
    return np.where(where, change - mean[parts], 0).astype(np.float32)


def label_shift(before: Floats32, after: Floats32, labels: Bytes, instance: Bytes) -> LabelShift:
    """Compare a frame (H, W), m, NaN where invalid, with its styled self."""
    parts = parts_of(labels, instance)
    both = np.isfinite(before) & np.isfinite(after)
    many = np.bincount(parts[both], minlength=parts.max() + 1) >= _FEWEST_PX
    moved = np.abs(_means(np.nan_to_num(after - before), both, parts))[many]
    shifts = np.concatenate([_edge_shifts(before, after, parts), _edge_shifts(before.T, after.T, parts.T)])
    valid = np.isfinite(before)
    return LabelShift(
        edge_px=float(np.percentile(shifts, 95)) if shifts.size else 0.0,
        part_mm=1e3 * float(moved.max(initial=0.0)),
        lost=1.0 - float(both.sum() / max(valid.sum(), 1)),
    )


def _means(values: Floats32, where: Bools, parts: Ints) -> Any:
    """The mean by part number over the pixels in `where`; 0 for parts that have none there."""
    count = np.bincount(parts[where], minlength=parts.max() + 1)
    total = np.bincount(parts[where], values[where], minlength=parts.max() + 1)
    return total / np.maximum(count, 1)


def _edge_shifts(before: Floats32, after: Floats32, parts: Ints) -> Any:
    """By how many pixels the depth edges at borders of parts move along the rows.

    Around each border the edge is where depth crosses the mean of its two sides: as many pixels of the profile are nearer than
    that as there are before the edge. A pixel without depth counts half.
    """
    y, x = np.nonzero(parts[:, _REACH:-_REACH] != parts[:, _REACH - 1 : -_REACH - 1])
    at = x[:, None] + np.arange(2 * _REACH)
    old, new = before[y[:, None], at], after[y[:, None], at]  # (n, 2 reach), the border in the middle
    sides = np.isfinite(old[:, :_REACH]).sum(axis=1), np.isfinite(old[:, _REACH:]).sum(axis=1)
    enough = np.minimum(*sides) >= 2
    old, new = old[enough], new[enough]
    left, right = np.nanmedian(old[:, :_REACH], axis=1), np.nanmedian(old[:, _REACH:], axis=1)
    steps = np.abs(left - right) > EDGE_M + EDGE_SHARE * np.minimum(left, right)
    middle = 0.5 * (left + right)[steps, None]
    near_old, near_new = (np.where(np.isfinite(d[steps]), d[steps] < middle, 0.5).sum(axis=1) for d in (old, new))
    return np.abs(near_new - near_old)
