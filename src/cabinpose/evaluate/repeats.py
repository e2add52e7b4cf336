"""Numbers over repeats of a training: the mean over models that differ in their seed alone, judged on the same frames.

The interval is that of a bootstrap over both: models are drawn with replacement, and so are sequences and single frames, the same
ones for all models.
With two or three models it says little of how models differ: beside it stand the least and the greatest model. How far two
trainings differ has an interval of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import intersection_over_union, whole_person
from cabinpose.evaluate.bootstrap import clusters_of, frame_weights, interval, weighted_sums
from cabinpose.evaluate.metrics import area_to_half, within_head
from cabinpose.evaluate.samples import Samples

Array = NDArray[np.float64]
Measure = Literal[
    "pckh", "auc", "pck", "mean_error", "root_relative_error", "presence_precision", "presence_recall", "iou", "person_iou"
]
"""Of joints: shares within a part of the head size, its area from 0 to 0.5, shares within a distance (%), mean error of those
found, in 3D also relative to the root, how many of those that were found are in the image and how many of those in the image
were found (%); of body parts: mean intersection over union, that of people as a whole (%)."""


class ModelErrors(NamedTuple):
    """What a model's numbers are made of, over F frames: S people with J joints, or pixels by C true and found classes.

    cluster: (F,) what a frame is drawn with, see `clusters_of` · at: (S,) the frame of each person ·
    error_px, error_m: (S, J) distance to the truth, infinite where the joint was not found, NaN where it does not count ·
    relative_m: (S, J) the same from the root, NaN where one of both does not count or was not found ·
    head_px, head_m: (S,) head size · presence: (S, J) 3 of joints that count and were found, 2 not found, 1 of joints that a
    right prediction leaves out and were found, 0 left out, NaN of those too hidden to judge · confusion: (F, C, C) or (0, 0, 0).
    """

    cluster: NDArray[np.int64]
    at: NDArray[np.int64]
    error_px: Array
    error_m: Array
    relative_m: Array
    head_px: Array
    head_m: Array
    presence: Array
    confusion: NDArray[np.int64]

    @property
    def frames(self) -> int:
        """F."""
        return len(self.cluster)


class OverRepeats(NamedTuple):
    """A number over repeats: the mean, its 95 % interval, and the number of each repeat."""

    value: float
    low: float
    high: float
    each: tuple[float, ...]


class RowDifference(NamedTuple):
    """How far the mean over the repeats of a training is above that of another, and its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def sure(self) -> bool:
        """Whether the interval is on one side of 0."""
        return self.low > 0.0 or self.high < 0.0


def errors_of(samples: Samples, joints: Sequence[str] | None = None) -> ModelErrors:
    """The errors of the samples of one model; joints: their columns, NaN of those that were not judged; default: all judged."""
    spaces = [np.where(s.found, s.error.astype(np.float64), np.inf) for s in (samples.px, samples.m)]
    px, m = (np.where(samples.counts & s.known, error, np.nan) for s, error in zip((samples.px, samples.m), spaces, strict=True))
    relative = samples.m.relative.astype(np.float64)
    presence = np.where(samples.counts | samples.absent, 2.0 * samples.counts + samples.found, np.nan)
    if joints is not None:
        columns = [joints.index(joint) for joint in samples.skeleton.joints]
        px, m, relative, presence = (_spread(values, columns, len(joints)) for values in (px, m, relative, presence))
    heads = (samples.px.head.astype(np.float64), samples.m.head.astype(np.float64))
    drawn_with = clusters_of(samples.sequence, samples.sync_ns)
    return ModelErrors(drawn_with, samples.at, px, m, relative, *heads, presence, np.zeros((0, 0, 0), np.int64))


def _spread(values: Array, columns: list[int], count: int) -> Array:
    result = np.full((len(values), count), np.nan)
    result[:, columns] = values
    return result


def joined_errors(parts: Sequence[ModelErrors]) -> ModelErrors:
    """The errors on several datasets, one after the other, as those on one."""
    firsts = np.cumsum([0, *(part.frames for part in parts)])
    at = np.concatenate([part.at + first for part, first in zip(parts, firsts, strict=False)])
    counts = np.cumsum([0, *(part.cluster.max(initial=-1) + 1 for part in parts)])
    cluster = np.concatenate([part.cluster + count for part, count in zip(parts, counts, strict=False)])
    rest = zip(*(part[2:] for part in parts), strict=True)
    return ModelErrors(cluster, at, *(np.concatenate(arrays) for arrays in rest))


def over_repeats(
    runs: Sequence[ModelErrors], measure: Measure, *, space: str = "2d", threshold: float = 0.5,
    joints: Sequence[int] | None = None, resamples: int = 1000, seed: int = 0,
) -> OverRepeats:  # fmt: skip
    """A number over the repeats of a training.

    Parameters
    ----------
    runs
        The errors of each model on the same frames.
    measure
        What is measured; see `Measure`.
    space
        "2d" (px) or "3d" (m); of joints.
    threshold
        Of pckh in head sizes, of pck in px or m.
    joints
        Columns of the joints that count; default: all.
    resamples, seed
        Of the bootstrap; 0: no interval.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    weights = frame_weights(runs[0].cluster, resamples, rng=rng)
    drawn = np.stack([_resampled(run, measure, weights, space, threshold, joints) for run in runs])  # (R, 1 + B)
    chosen = rng.integers(len(runs), size=(resamples, len(runs)))
    means = drawn[chosen, 1 + np.arange(resamples)[:, None]].mean(axis=1)
    low, high = interval(means[:, None])
    each = tuple(drawn[:, 0].tolist())
    return OverRepeats(float(np.mean(each)), float(low[0]), float(high[0]), each)


def row_differences(
    rows: Mapping[str, Sequence[ModelErrors]], measure: Measure, *, space: str = "2d", threshold: float = 0.5,
    joints: Mapping[str, Sequence[int]] | None = None, resamples: int = 1000, seed: int = 0,
) -> dict[tuple[str, str], RowDifference]:  # fmt: skip
    """How far trainings differ that were judged on the same frames: by each two of them, the first less the second.

    All are drawn with the same sequences and frames, which are as hard for one as for the other. Two or three repeats do not tell
    how far trainings of one row differ: that is taken from the repeats of all rows, each less the mean of its own and widened by
    sqrt(R / (R - 1)) (Davison and Hinkley 1997, 2.3 and 6.2.3). Where no row is repeated the interval is over frames alone.

    Parameters
    ----------
    rows
        By name the errors of each repeat, all on the same frames.
    measure, space, threshold, resamples, seed
        As of `over_repeats`.
    joints
        By row the columns of the joints that count; default: all.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    weights = frame_weights(next(iter(rows.values()))[0].cluster, resamples, rng=rng) if rows else np.empty((0, 0), np.uint8)
    means, spread = {}, [np.zeros(0)]
    for name, runs in rows.items():
        columns = None if joints is None else joints[name]
        drawn = np.stack([_resampled(run, measure, weights, space, threshold, columns) for run in runs])  # (R, 1 + B)
        means[name] = drawn.mean(axis=0)
        if len(runs) > 1:
            spread.append((drawn[:, 0] - means[name][0]) * np.sqrt(len(runs) / (len(runs) - 1)))
    residuals = np.concatenate(spread)
    if residuals.size:
        for name, runs in rows.items():
            means[name][1:] += residuals[rng.integers(len(residuals), size=(resamples, len(runs)))].mean(axis=1)
    found = {}
    for a, b in permutations(means, 2):
        away = means[a] - means[b]
        low, high = interval(away[1:, None])
        found[a, b] = RowDifference(float(away[0]), float(low[0]), float(high[0]))
    return found


def accuracy_curve(run: ModelErrors, thresholds: Array, space: str, joints: Sequence[int] | None = None) -> Array:
    """(T,) per cent of the joints that count within each of some thresholds (head sizes)."""
    errors, head = _joint_errors(run, space, joints)
    shares = errors / head
    known = np.sort(shares[np.isfinite(shares)])
    total = max(int((~np.isnan(errors) & np.isfinite(head)).sum()), 1)
    return np.asarray(100.0 * np.searchsorted(known, thresholds, side="right") / total)


def _joint_errors(run: ModelErrors, space: str, joints: Sequence[int] | None) -> tuple[Array, Array]:
    """(S, J) errors of some joints in a space, and (S, 1) head sizes."""
    errors, head = (run.error_px, run.head_px) if space == "2d" else (run.error_m, run.head_m)
    return _of(errors, joints), head[:, None]


def _of(values: Array, joints: Sequence[int] | None) -> Array:
    """Those (S, J) of some joints."""
    return values if joints is None else values[:, list(joints)]


def _resampled(
    run: ModelErrors, measure: Measure, weights: NDArray[np.uint8], space: str, threshold: float, joints: Sequence[int] | None
) -> Array:
    """(1 + B,) the number over all frames, then over those of each resample."""
    if measure in ("iou", "person_iou"):
        classes = run.confusion.shape[-1]
        by_frame = run.confusion.reshape(run.frames, -1).astype(np.float64)
        totals = np.concatenate((by_frame.sum(axis=0)[None], weighted_sums(weights, by_frame))).reshape(-1, classes, classes)
        if measure == "person_iou":
            return np.asarray(100.0 * intersection_over_union(whole_person(totals))[:, 1])
        return np.asarray(100.0 * np.nanmean(intersection_over_union(totals)[:, 1:], axis=1))
    errors, head = _joint_errors(run, space, joints)
    if measure == "root_relative_error":
        errors = _of(run.relative_m, joints)
    counts = ~np.isnan(errors)
    if measure in ("pckh", "auc"):
        counts &= np.isfinite(head)
        top = within_head(errors, head, threshold) if measure == "pckh" else area_to_half(errors, head)
    elif measure == "pck":
        top = errors <= np.float32(threshold)
    elif measure in ("presence_precision", "presence_recall"):
        presence = _of(run.presence, joints)
        top = presence == 3.0
        counts = top | (presence == (1.0 if measure == "presence_precision" else 2.0))
    else:
        counts &= np.isfinite(errors)
        top = np.where(counts, errors, 0.0)
    unit = (1.0 if space == "2d" else 100.0) if measure == "mean_error" else 100.0
    sums = []
    for values in (np.where(counts, top, 0.0), counts):
        by_frame = np.zeros((run.frames, 1))
        np.add.at(by_frame[:, 0], run.at, values.sum(axis=1))
        sums.append(np.concatenate((by_frame.sum(axis=0), weighted_sums(weights, by_frame)[:, 0])))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(unit * sums[0] / sums[1])
