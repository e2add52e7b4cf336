"""How constant distances within a body are over a recording: a bone is rigid, so a changing length is an error of the system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import minimum_spanning_tree

from cabinpose.core import MVN_JOINTS, AlignmentError

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Bone:
    """The distance of two points over time, metres: mean, standard deviation, range, and in how many frames both are known."""

    start: str
    end: str
    mean_m: float
    sd_m: float
    range_m: float
    frames: int


def bone_lengths(position_m: ArrayLike, names: Sequence[str], pairs: Sequence[tuple[str, str]]) -> tuple[Bone, ...]:
    """The lengths between named points (T, N, 3); raises AlignmentError for a point that is not there."""
    position = np.asarray(position_m, np.float64)
    if absent := sorted({name for pair in pairs for name in pair if name not in names}):
        raise AlignmentError(f"there is no {', '.join(absent)}", hint=f"there are: {', '.join(names)}")
    index = {name: i for i, name in enumerate(names)}
    bones = []
    for start, end in pairs:
        length = np.linalg.norm(position[:, index[start]] - position[:, index[end]], axis=-1)
        length = length[np.isfinite(length)]
        if length.size:
            bones.append(Bone(start, end, float(length.mean()), float(length.std()), float(np.ptp(length)), length.size))
    return tuple(bones)


def mvn_bones(names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of MVN segments' origins, parent and child, that `names` has."""
    return [(parent, child) for _, parent, child in MVN_JOINTS if parent in names and child in names]


def rigid_pairs(position_m: ArrayLike, names: Sequence[str], *, least_frames: int = 10) -> list[tuple[str, str]]:
    """The N - 1 pairs of points (T, N, 3) whose distances vary least, so that all are linked: a minimum spanning tree.

    Of markers on a body these are neighbours on one bone, and one link over each joint. Points seen together in fewer than
    `least_frames` frames are not linked.
    """
    position = np.asarray(position_m, np.float64)
    count = len(names)
    cost = np.zeros((count, count))
    for i in range(count):
        length = np.linalg.norm(position[:, i, None] - position[:, i + 1 :], axis=-1)
        known = np.isfinite(length)
        seen = known.sum(axis=0)
        with np.errstate(invalid="ignore"):
            mean = np.where(known, length, 0).sum(axis=0) / seen
            spread = np.sqrt(np.where(known, (length - mean) ** 2, 0).sum(axis=0) / seen)
        cost[i, i + 1 :] = np.where(seen >= least_frames, spread + 1e-12, 0.0)  # 0: no link
    tree = minimum_spanning_tree(cost).tocoo()
    return [(names[i], names[j]) for i, j in sorted(zip(tree.row.tolist(), tree.col.tolist(), strict=True))]
