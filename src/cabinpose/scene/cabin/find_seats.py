"""Finds the seats of an unknown car mesh by their shape: a cushion, a backrest behind it, and room for a sitter.

The surface is entered into a grid of voxels, and a template of a seat is held against every place of it: the share of the
cushion and of the backrest that is there, less what stands in the room of trunk, thighs and shins. At the best places straight
lines through cushion and backrest give the H-point: unpressed foam is 58 mm below it and 95 mm behind it (SAE J826's pans, less
40 mm by which foam is pressed in).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter

from cabinpose.core import Bools, Floats, Ints, distinct_rows
from cabinpose.scene.cabin.seats import PAN_BEHIND_H, PAN_BELOW_H
from cabinpose.scene.contact import sampled_surface

VOXEL = 0.03  # m
CUSHION_BELOW_H, BACK_BEHIND_H = PAN_BELOW_H - 0.04, PAN_BEHIND_H - 0.04
_RECLINES, _CUSHIONS = np.deg2rad((10.0, 17.0, 24.0, 31.0)), np.deg2rad((8.0, 16.0))
_GOOD, _GOOD_BACKWARD = 0.7, 0.9  # of 1; a console before a dashboard is much like a seat that looks backward
_SAME = 0.85  # of a place's score, across the car: still the same seat or bench
_HALF_VOXELS = 4  # of the template, beside the middle one
_HALF_WIDTH = (_HALF_VOXELS + 0.5) * VOXEL  # m
_APART_M = (0.45, 0.30)  # between seats, along the car and in height
_BENCH, _THREE = 0.80, 1.25  # m: a seat this wide is for two, for three
_FROM_EDGE_M = 0.30  # a bench's outer sitters
_TORSO, _RISE = np.deg2rad((4.0, 42.0)), np.deg2rad((0.0, 28.0))  # of a seat that somebody drives in
_SEAT_HEIGHT = (0.12, 0.75)  # H-point above the floor, m: from a sports car's seat to a bus driver's


class FoundSeat(NamedTuple):
    """A place to sit. h_point: (3,) m, vehicle axes · angles in rad · width_m: of the whole bench · floor_z: m · score: 0..1."""

    h_point: Floats
    backward: bool
    torso_angle: float
    cushion_angle: float
    width_m: float
    floor_z: float
    score: float


def find_seats(triangles: Floats) -> list[FoundSeat]:
    """The seats of a car, front to back and left to right.

    Parameters
    ----------
    triangles
        (F, 3, 3) m, axes as of the vehicle frame (x forward, y left, z up), any origin.

    Returns
    -------
    list of FoundSeat
        Empty where nothing is shaped like a seat.
    """
    points = sampled_surface(triangles, VOXEL * 2 / 3)
    seats = [seat for backward in (False, True) for seat in _looking(points, backward)]
    kept: list[FoundSeat] = []
    for seat in sorted(seats, key=lambda s: -s.score):
        if all(np.linalg.norm(seat.h_point - other.h_point) > _APART_M[0] for other in kept if other.backward != seat.backward):
            kept.append(seat)
    return sorted(kept, key=lambda s: (-round(float(s.h_point[0]) / 0.3), -s.h_point[1]))


def _looking(points: Floats, backward: bool) -> Iterator[FoundSeat]:
    """The seats that look one way."""
    turn = np.array((-1.0, -1.0, 1.0)) if backward else np.ones(3)
    seen = points * turn
    low = seen.min(axis=0) - 10 * VOXEL
    cells = np.floor((seen - low) / VOXEL).astype(int)
    taken = np.zeros(cells.max(axis=0) + 11, np.bool_)
    taken[tuple(cells.T)] = True
    score, which = _scores(taken)
    angles = tuple(product(_RECLINES, _CUSHIONS))
    reach = [int(a / VOXEL) for a in _APART_M]
    while True:
        # Smoothed, since many places may fit alike: the middle one is meant.
        best = np.unravel_index(int(gaussian_filter(score, 1.0).argmax()), score.shape)
        value = float(score[best])
        if value < (_GOOD_BACKWARD if backward else _GOOD):
            return
        x, y, z = map(int, best)
        near = (slice(max(x - 4, 0), x + 5), slice(None), slice(max(z - 2, 0), z + 3))
        across = score[near].max(axis=(0, 2)) >= _SAME * value
        first, last = _run(across, y)
        score[max(x - reach[0], 0) : x + reach[0] + 1, max(first - 4, 0) : last + 5, max(z - reach[1], 0) : z + reach[1] + 1] = (
            0.0
        )
        width = (last - first + 1) * VOXEL + 2 * _HALF_WIDTH - VOXEL
        middle = low[1] + ((first + last) / 2 + 0.5) * VOXEL
        guess = low + (np.array((x, y, z)) + 0.5) * VOXEL
        for side in _places(width):
            guess[1] = middle + side
            seat = _fitted(seen, guess, *angles[int(which[best])], width, value)
            if seat is not None:
                h = seat.h_point * turn
                yield FoundSeat(h, backward, seat.torso_angle, seat.cushion_angle, width, seat.floor_z, value)


def _places(width: float) -> tuple[float, ...]:
    """Where people sit on a seat of a width, from its middle, m."""
    if width < _BENCH:
        return (0.0,)
    outer = width / 2 - _FROM_EDGE_M
    return (outer, 0.0, -outer) if width >= _THREE else (outer, -outer)


def _run(good: Bools, at: int) -> tuple[int, int]:
    """First and last index of the unbroken run of `good` about `at`."""
    bad = np.flatnonzero(~good)
    before, after = bad[bad < at], bad[bad > at]
    return (int(before[-1]) + 1 if len(before) else 0), (int(after[0]) - 1 if len(after) else len(good) - 1)


def _scores(taken: Bools) -> tuple[Floats, Ints]:
    """The best score of a seat with its H-point in each voxel, and the number of its pair of angles."""
    near, inside = _summed_across(binary_dilation(taken)), _summed_across(taken)
    score, which = np.zeros(taken.shape), np.zeros(taken.shape, np.int64)
    for number, (recline, rise) in enumerate(product(_RECLINES, _CUSHIONS)):
        cushion, back, room = _template(recline, rise)
        there = np.minimum(_share(near, cushion), _share(near, back)) * np.clip(1 - 3 * _share(inside, room), 0, 1)
        better = there > score
        score[better], which[better] = there[better], number
    return score, which


def _template(recline: float, rise: float) -> tuple[Ints, ...]:
    """Voxels (n, 2) along x and z from the H-point's: of the cushion, of the backrest, of the sitter's room."""
    up, ahead = np.array((-np.sin(recline), np.cos(recline))), np.array((np.cos(recline), np.sin(recline)))

    def of_cushion(x: float, above: float) -> Floats:
        return np.array((x, -CUSHION_BELOW_H + np.tan(rise) * x + above))

    cushion = [of_cushion(x, 0.0) for x in np.arange(0.0, 0.32, VOXEL)]
    back = [up * k - BACK_BEHIND_H * ahead for k in np.arange(0.12, 0.52, VOXEL)]
    trunk = [up * k + ahead * t for k in np.arange(0.03, 0.68, VOXEL) for t in np.arange(0.0, 0.16, VOXEL)]
    thighs = [of_cushion(x, t) for x in np.arange(0.0, 0.32, VOXEL) for t in np.arange(0.075, 0.18, VOXEL)]
    shins = [np.array((x, z)) for x in np.arange(0.44, 0.51, VOXEL) for z in np.arange(-0.22, 0.0, VOXEL)]
    return tuple(np.unique(np.rint(np.array(xz) / VOXEL).astype(int), axis=0) for xz in (cushion, back, trunk + thighs + shins))


def _summed_across(taken: Bools) -> NDArray[np.uint16]:
    """How many voxels are taken across the template's width, for every voxel in the middle of it."""
    padded = np.pad(taken, ((0, 0), (_HALF_VOXELS, _HALF_VOXELS), (0, 0)))
    return sliding_window_view(padded, 2 * _HALF_VOXELS + 1, axis=1).sum(axis=-1, dtype=np.uint16)


def _share(summed: NDArray[np.uint16], cells: Ints) -> Floats:
    """For every voxel the share of the cells (n, 2) in x and z from it, as wide as the template, that are taken.

    summed: `_summed_across` of what is taken; beyond the grid nothing is.
    """
    reach = np.abs(cells).max()
    padded = np.pad(summed, ((reach, reach), (0, 0), (reach, reach)))
    total = np.zeros(summed.shape, np.uint16)
    nx, _, nz = summed.shape
    for x, z in reach + cells:
        total += padded[x : x + nx, :, z : z + nz]
    return total / (len(cells) * (2 * _HALF_VOXELS + 1))


def _fitted(points: Floats, guess: Floats, recline: float, rise: float, width: float, score: float) -> FoundSeat | None:
    """The seat at a guess, by lines through what is seen of cushion and backrest; None where its floor is not that of a seat."""
    slab = points[np.abs(points[:, 1] - guess[1]) < 0.06] - guess
    x, z = slab[:, 0], slab[:, 2]
    over = np.tan(rise) * x - CUSHION_BELOW_H
    cushion = _outermost(x, z - over, (-0.02, 0.27), 0.065)
    behind = -np.tan(recline) * z - BACK_BEHIND_H / np.cos(recline)
    back = _outermost(z, x - behind, (0.12, 0.52), 0.075)
    if len(cushion) < 4 or len(back) < 4:
        return None
    slope, level = np.polyfit(cushion[:, 0], cushion[:, 1], 1) + (np.tan(rise), -CUSHION_BELOW_H)
    lean, place = np.polyfit(back[:, 0], back[:, 1], 1) + (-np.tan(recline), -BACK_BEHIND_H / np.cos(recline))
    torso = float(np.arctan(-lean))
    # H: CUSHION_BELOW_H above the cushion's line z = level + slope x, BACK_BEHIND_H before the back's line x = place + lean z.
    matrix = np.array(((-slope, 1.0), (1.0, -lean)))
    offset = np.linalg.solve(matrix, (level + CUSHION_BELOW_H, place + BACK_BEHIND_H / np.cos(torso)))
    h = guess + (offset[0], 0.0, offset[1])
    floor = _floor_before(points, h)
    if not _TORSO[0] <= torso <= _TORSO[1] or not _RISE[0] <= np.arctan(slope) <= _RISE[1]:
        return None
    if floor is None or not _SEAT_HEIGHT[0] <= h[2] - floor <= _SEAT_HEIGHT[1] or np.abs(offset).max() > 0.10:
        return None
    return FoundSeat(h, False, torso, float(np.arctan(slope)), width, floor, score)


def _outermost(along: Floats, off: Floats, span: tuple[float, float], reach: float) -> Floats:
    """(n, 2): in every 2 cm of `along` in a span, the highest `off` (the surface that a body meets) no farther than `reach`."""
    use = (along >= span[0]) & (along < span[1]) & (np.abs(off) < reach)
    step = np.floor((along[use] - span[0]) / 0.02).astype(int)
    return np.array([((s + 0.5) * 0.02 + span[0], off[use][step == s].max()) for s in np.unique(step)])


def _floor_before(points: Floats, h: Floats) -> float | None:
    """Height (m) of the floor under the heels of a person with the H-point `h` (3,); None where there is no surface.

    The 10 % quantile of the highest points of each column below the knees, since a seat in front or a toe board may be there too.
    """
    from_h = points - h
    ahead = (from_h[:, 0] > 0.40) & (from_h[:, 0] < 0.75) & (np.abs(from_h[:, 1]) < 0.15) & (from_h[:, 2] < -0.05)
    if not ahead.any():
        return None
    column = np.floor(from_h[ahead][:, :2] / VOXEL).astype(int)
    _, group = distinct_rows(column)
    top = np.full(group.max() + 1, -np.inf)
    np.maximum.at(top, group, points[ahead][:, 2])
    return float(np.quantile(top, 0.1))
