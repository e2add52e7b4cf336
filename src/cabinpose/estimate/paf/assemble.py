"""Peaks of heat maps, and people from peaks along part affinity fields.

After Cao et al. 2017, section 2.3 and 2.4: the line integral of a limb's field between two peaks says how well they belong
together; for each limb the pairs are taken greedily, best first, and pairs that share a joint are one person.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_STEPS = np.linspace(0, 1, 10)  # samples along a limb
_SHARE = 0.8  # of the samples that have to agree with the limb
_FLOOR = 1e-3  # of a map, before its logarithm
_AROUND = np.indices((3, 3)).reshape(2, 9)  # rows and columns of a cell and its neighbours, in a map padded by one

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Peaks(NamedTuple):
    """Peaks of one map, the greatest first: xy (K, 2) cells, sub-pixel, and height (K,)."""

    xy: F64
    height: F64

    @classmethod
    def none(cls) -> Peaks:
        """No peak."""
        return cls(np.zeros((0, 2)), np.zeros(0))


def find_peaks(heat: F64, least: float, count: int) -> list[Peaks]:
    """For each map of heat (J, h, w) the `count` greatest local maxima (of 8 neighbours) that reach `least`.

    Of equal neighbours the first in reading order counts. A parabola through the logarithms of a peak and its two neighbours
    along each axis gives its place within the cell: exact for a Gaussian.
    """
    joints, h, w = heat.shape
    padded = np.full((joints, h + 2, w + 2), -np.inf)
    padded[:, 1:-1, 1:-1] = heat
    joint, rows, columns = np.nonzero(heat >= least)
    around = padded[joint[:, None], rows[:, None] + _AROUND[0], columns[:, None] + _AROUND[1]]  # (K, 9) in reading order
    height = around[:, 4]
    peak = (height[:, None] > around[:, :4]).all(axis=1) & (height[:, None] >= around[:, 5:]).all(axis=1)
    order = np.flatnonzero(peak)
    order = order[np.lexsort((-height[order], joint[order]))]  # stable: equal peaks of a map stay in reading order
    joint, rows, columns, height = joint[order], rows[order], columns[order], height[order]
    logs = np.log(np.maximum(around[order], _FLOOR))
    dx = _vertex(logs[:, 3], logs[:, 4], logs[:, 5]) * ((columns > 0) & (columns < w - 1))
    dy = _vertex(logs[:, 1], logs[:, 4], logs[:, 7]) * ((rows > 0) & (rows < h - 1))
    xy = np.stack((columns + dx, rows + dy), axis=-1)
    first = np.searchsorted(joint, np.arange(joints + 1)).tolist()
    kept = [slice(i, min(i + count, j)) for i, j in pairwise(first)]
    return [Peaks(xy[of_joint], height[of_joint]) for of_joint in kept]


def _vertex(before: F64, at: F64, after: F64) -> F64:
    """Where the parabola through three values at -1, 0, 1 has its vertex, within half a step."""
    bend = before - 2 * at + after
    return np.clip(np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0), -0.5, 0.5)


def line_scores(fields: F64, limb: I64, a: F64, b: F64) -> tuple[F64, F64]:
    """Means of fields (C, 2, h, w) along P lines, and the shares of their samples above zero: (P,) each.

    Line p runs through the field of limb[p] from a[p] to b[p] (P, 2), cells. The field is read bilinearly at ten points of the
    line and multiplied with its direction.
    """
    along = b - a
    length = np.linalg.norm(along, axis=-1)
    unit = along / np.maximum(length, 1e-9)[:, None]
    points = a[:, None] + along[:, None] * _STEPS[:, None]
    agreement = np.einsum("psi,pi->ps", _bilinear(fields, limb[:, None], points), unit)
    return agreement.mean(-1), (agreement > 0).mean(-1)


def _bilinear(fields: F64, which: I64, xy: F64) -> F64:
    """fields[which] (..., 2), of fields (C, 2, h, w), at xy (..., 2), clipped to the map."""
    h, w = fields.shape[2:]
    x, y = np.clip(xy[..., 0], 0, w - 1), np.clip(xy[..., 1], 0, h - 1)
    x0, y0 = np.minimum(x.astype(int), max(w - 2, 0)), np.minimum(y.astype(int), max(h - 2, 0))
    x1, y1 = np.minimum(x0 + 1, w - 1), np.minimum(y0 + 1, h - 1)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    above = fields[which, :, y0, x0] * (1 - fx) + fields[which, :, y0, x1] * fx
    below = fields[which, :, y1, x0] * (1 - fx) + fields[which, :, y1, x1] * fx
    return np.asarray(above * (1 - fy) + below * fy)


def assemble(peaks: Sequence[Peaks], fields: F64, limbs: Sequence[tuple[int, int]], least: float) -> NDArray[np.int64]:
    """People (P, J): for each joint the row of its peak, or -1. fields: (2C, h, w), x and y of limb c at 2c and 2c + 1.

    A pair of peaks is a limb where the mean of the field is above `least` and most of the line agrees; each peak takes part
    in one pair of a limb. Peaks that no limb connects to another are dropped.
    """
    people: list[NDArray[np.int64]] = []
    for (a, b), pairs in zip(limbs, _pairs(peaks, fields, limbs, least), strict=True):
        for i, j in pairs:
            first = _holder(people, a, i)
            second = _holder(people, b, j)
            if first is None and second is None:
                first = np.full(len(peaks), -1, dtype=np.int64)
                people.append(first)
            elif first is None:
                first = second
            elif second is not None and second is not first:
                if ((first >= 0) & (second >= 0)).any():
                    continue  # two people who both have some joint stay two
                first[second >= 0] = second[second >= 0]
                people = [person for person in people if person is not second]
            assert first is not None
            if first[a] in (-1, i) and first[b] in (-1, j):
                first[a], first[b] = i, j
    return np.array(people, dtype=np.int64).reshape(-1, len(peaks))


def _pairs(peaks: Sequence[Peaks], fields: F64, limbs: Sequence[tuple[int, int]], least: float) -> list[list[tuple[int, int]]]:
    """For each limb the pairs of rows that make one, best first, no row twice."""
    sizes = [(len(peaks[a].height), len(peaks[b].height)) for a, b in limbs]
    rows = [np.divmod(np.arange(k * n), max(n, 1)) for k, n in sizes]
    starts = np.concatenate([peaks[a].xy[i] for (a, _), (i, _) in zip(limbs, rows, strict=True)])
    ends = np.concatenate([peaks[b].xy[j] for (_, b), (_, j) in zip(limbs, rows, strict=True)])
    counts = [k * n for k, n in sizes]
    limb = np.repeat(np.arange(len(limbs)), counts)
    score, share = line_scores(fields.reshape(len(limbs), 2, *fields.shape[1:]), limb, starts, ends)
    fit = np.flatnonzero((score > least) & (share >= _SHARE))
    chosen: list[list[tuple[int, int]]] = [[] for _ in limbs]
    before = np.concatenate(([0], np.cumsum(counts)))
    for p in fit[np.argsort(-score[fit], kind="stable")].tolist():
        of_limb = chosen[limb[p]]
        i, j = divmod(p - int(before[limb[p]]), sizes[limb[p]][1])
        if all(i != taken and j != other for taken, other in of_limb):
            of_limb.append((i, j))
    return chosen


def _holder(people: Sequence[NDArray[np.int64]], joint: int, row: int) -> NDArray[np.int64] | None:
    return next((person for person in people if person[joint] == row), None)
