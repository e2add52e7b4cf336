"""Peaks of heat maps, and people from peaks along part affinity fields.

After Cao et al. 2017, section 2.3 and 2.4: the line integral of a limb's field between two peaks says how well they belong
together; for each limb the pairs are taken greedily, best first, and what shares a joint is one person.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_SAMPLES = 10  # along a limb
_SHARE = 0.8  # of the samples that have to agree with the limb
_FLOOR = 1e-3  # of a map, before its logarithm

F64 = NDArray[np.float64]


class Peaks(NamedTuple):
    """Peaks of one map, the greatest first: xy (K, 2) cells, sub-pixel, and height (K,)."""

    xy: F64
    height: F64

    @classmethod
    def none(cls) -> Peaks:
        """No peak."""
        return cls(np.zeros((0, 2)), np.zeros(0))


def find_peaks(heat: F64, least: float, count: int) -> Peaks:
    """The `count` greatest local maxima (of 8 neighbours) of a map (h, w) that reach `least`.

    Of equal neighbours the first in reading order counts. A parabola through the logarithms of a peak and its two neighbours
    along each axis gives its place within the cell: exact for a Gaussian.
    """
    h, w = heat.shape
    padded = np.pad(heat, 1, constant_values=-np.inf)
    peak = heat >= least
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            other = padded[1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w]
            if (dy, dx) < (0, 0):
                peak &= heat > other
            elif (dy, dx) > (0, 0):
                peak &= heat >= other
    rows, columns = np.nonzero(peak)
    order = np.argsort(-heat[rows, columns], kind="stable")[:count]
    rows, columns = rows[order], columns[order]
    logs = np.log(np.maximum(np.pad(heat, 1), _FLOOR))
    at = logs[rows + 1, columns + 1]
    dx = _vertex(logs[rows + 1, columns], at, logs[rows + 1, columns + 2]) * ((columns > 0) & (columns < w - 1))
    dy = _vertex(logs[rows, columns + 1], at, logs[rows + 2, columns + 1]) * ((rows > 0) & (rows < h - 1))
    return Peaks(np.stack((columns + dx, rows + dy), axis=-1), heat[rows, columns])


def _vertex(before: F64, at: F64, after: F64) -> F64:
    """Where the parabola through three values at -1, 0, 1 has its vertex, within half a step."""
    bend = before - 2 * at + after
    return np.clip(np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0), -0.5, 0.5)


def line_scores(field: F64, a: F64, b: F64) -> tuple[F64, F64]:
    """Mean of a field (2, h, w) along the lines from a (K, 2) to b (L, 2), cells, and the share of samples above zero: (K, L).

    The field is read bilinearly at ten points of the line and multiplied with its direction.
    """
    along = b[None] - a[:, None]
    length = np.linalg.norm(along, axis=-1)
    unit = along / np.maximum(length, 1e-9)[..., None]
    steps = np.linspace(0, 1, _SAMPLES)
    points = a[:, None, None] + along[:, :, None] * steps[:, None]
    values = np.stack([_bilinear(part, points) for part in field], axis=-1)
    agreement = np.einsum("klsi,kli->kls", values, unit)
    return agreement.mean(-1), (agreement > 0).mean(-1)


def _bilinear(image: F64, xy: F64) -> F64:
    h, w = image.shape
    x, y = np.clip(xy[..., 0], 0, w - 1), np.clip(xy[..., 1], 0, h - 1)
    x0, y0 = np.minimum(x.astype(int), max(w - 2, 0)), np.minimum(y.astype(int), max(h - 2, 0))
    x1, y1 = np.minimum(x0 + 1, w - 1), np.minimum(y0 + 1, h - 1)
    fx, fy = x - x0, y - y0
    above = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    below = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return np.asarray(above * (1 - fy) + below * fy)


def assemble(peaks: Sequence[Peaks], fields: F64, limbs: Sequence[tuple[int, int]], least: float) -> NDArray[np.int64]:
    """People (P, J): for each joint the row of its peak, or -1. fields: (2C, h, w), x and y of limb c at 2c and 2c + 1.

    A pair of peaks is a limb where the mean of the field is above `least` and most of the line agrees; each peak takes part
    in one pair of a limb. Peaks that no limb ties to another are nobody's.
    """
    people: list[NDArray[np.int64]] = []
    for c, (a, b) in enumerate(limbs):
        for i, j in _pairs(peaks[a], peaks[b], fields[2 * c : 2 * c + 2], least):
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


def _pairs(first: Peaks, second: Peaks, field: F64, least: float) -> list[tuple[int, int]]:
    """Pairs of rows that make a limb, best first, no row twice."""
    if not len(first.height) or not len(second.height):
        return []
    score, share = line_scores(field, first.xy, second.xy)
    fit = (score > least) & (share >= _SHARE)
    chosen: list[tuple[int, int]] = []
    for flat in np.argsort(-score, axis=None, kind="stable"):
        i, j = (int(k) for k in np.unravel_index(flat, score.shape))
        if fit[i, j] and all(i != p and j != q for p, q in chosen):
            chosen.append((i, j))
    return chosen


def _holder(people: Sequence[NDArray[np.int64]], joint: int, row: int) -> NDArray[np.int64] | None:
    return next((person for person in people if person[joint] == row), None)
