"""How far inference lies from truth over the frames: of each joint, d(t, j), and on average over the joints, d(t)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.samples import Samples

Float = NDArray[np.float64]
UNITS = {"2d": "px", "3d": "cm"}


def joint_distances(samples: Samples, space: str) -> Float:
    """(S, J) distances of the joints that count and were found, NaN elsewhere; "3d" in cm, "2d" in px."""
    where, factor = samples.space(space), 1.0 if space == "2d" else 100.0
    return np.where(samples.counts & where.found, where.error, np.nan) * factor


@dataclass(frozen=True)
class FrameDistances:
    """Distances over F frames and J joints, in cm ("3d") or px ("2d"), over the people of a frame on average.

    frames: (F,) numbers · by_joint: (F, J) of the joints found, infinite where a joint counts and was not found in anybody, NaN
    where it does not count · mean: (F,) over all joints found in a frame, infinite and NaN alike · threshold: up to which a joint
    is a hit.
    """

    space: str
    joints: tuple[str, ...]
    frames: NDArray[np.int64]
    by_joint: Float
    mean: Float
    threshold: float

    @property
    def unit(self) -> str:
        """Of the distances."""
        return UNITS[self.space]

    def binned(self, most: int) -> FrameDistances:
        """At most so many stretches of as many frames each: each joint's greatest distance, the mean of d(t).

        A joint that was missed anywhere in a stretch is missed in it. frames: the first of each stretch.
        """
        step = -(-len(self.frames) // most)
        if step <= 1:
            return self
        starts = np.arange(0, len(self.frames), step)
        worst = np.fmax.reduceat(self.by_joint, starts, axis=0)
        found = np.isfinite(self.mean)
        sums, counts = (np.add.reduceat(x, starts) for x in (np.where(found, self.mean, 0.0), found.astype(float)))
        none = np.fmax.reduceat(self.mean, starts)  # infinite or NaN where nothing was found
        mean = np.divide(sums, counts, out=none, where=counts > 0)
        return FrameDistances(self.space, self.joints, self.frames[starts], worst, mean, self.threshold)


def frame_distances(samples: Samples, space: str, options: EvaluationOptions) -> FrameDistances:
    """The distances of one model over the frames of its samples.

    Parameters
    ----------
    samples
        Of `samples_of`.
    space
        "2d" or "3d".
    options
        Whose threshold is kept beside them.

    Returns
    -------
    FrameDistances
        In cm or px.
    """
    error, count = joint_distances(samples, space), len(samples.frames)
    found = np.isfinite(error)
    sums, hits, counted = (np.zeros((count, error.shape[1])) for _ in range(3))
    np.add.at(sums, samples.at, np.where(found, error, 0.0))
    np.add.at(hits, samples.at, found)
    np.add.at(counted, samples.at, samples.counts & samples.space(space).known)
    return FrameDistances(
        space, tuple(samples.skeleton.joints), samples.frames, _average(sums, hits, counted),
        _average(sums.sum(axis=1), hits.sum(axis=1), counted.sum(axis=1)),
        options.hit_px if space == "2d" else 100 * options.hit_m,
    )  # fmt: skip


def _average(sums: Float, found: Float, counted: Float) -> Float:
    """Means of what was found; infinite where nothing of what counts was, NaN where nothing counts."""
    with np.errstate(invalid="ignore"):
        return np.where((found == 0) & (counted > 0), np.inf, sums / found)
