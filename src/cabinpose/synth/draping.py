"""Blankets and jackets: cloth that is let down onto a lap or a seat, and lies on whatever is there.

What lies below is seen from straight above as a field of heights; the cloth is its upper envelope that is nowhere steeper than
cloth hangs, so that nothing comes through it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cabinpose.core import CABINPOSE, Camera, Floats, Matrix, invert, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene import Surface, merge
from cabinpose.scene.body import PosedBody
from cabinpose.scene.cabin import Seat, SeatSetting, Solid, slab
from cabinpose.scene.things import CLOTH_M, THINGS, Cloth, Piece, PlacedThing, Thing, cushion_frame, of_design
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.things import lap_frame

CELLS, CELL_M = 64, 0.015
LIFT_M = 0.006  # of the cloth's lower side over what it lies on
HIGHEST_M = 0.26  # over the thighs or the cushion: what is higher is not covered, the cloth begins before it
STEEPEST = 2.2  # of cloth that hangs
_MIDDLE = 20.0  # cells: of the field, ahead of the frame's origin
_AWAY_M = 60.0  # from where it is seen: rays are all but parallel
_SHORTEST_M = 0.22  # of a cloth, along the thighs or the cushion
_ON_INFANT_M, _SLACK_M = (0.145, 0.12, 0.13, 0.0075), 0.03  # breadth, shortest, highest and cell there; beyond the ankles
_ON_SEAT_M = (0.05, 0.46)  # along a cushion, from the backrest
_MESH_M, _FEWEST = 0.019, 6  # apart of a cloth's vertices, and along its shortest side
_FOLD_M, _FOLDS = 0.0022, ((9.0, 4.0), (-6.0, 11.0), (15.0, -7.0))  # height, and waves along and across, rad/m


def seen_from_above(surface: Surface, vehicle_from_cloth: Matrix, cell_m: float = CELL_M) -> Floats:
    """(CELLS, CELLS) m: how high a surface reaches over the x-y plane of a frame, by x and y; -inf where nothing is."""
    camera = Camera(CELLS, CELLS, _AWAY_M / cell_m, _AWAY_M / cell_m, 0.5 * (CELLS - 1), 0.5 * (CELLS - 1))
    turn = np.diag((1.0, -1.0, -1.0))
    seen = Rasteriser(camera, 1).render(
        surface, invert(rp.matmul(vehicle_from_cloth, transform(turn, (_MIDDLE * cell_m, 0.0, _AWAY_M))))
    )
    depth = seen.depth_clean.T[:, ::-1].astype(np.float64)
    return np.where(depth > 0.0, _AWAY_M - depth, -np.inf)


def envelope(heights: Floats, cell_m: float = CELL_M) -> Floats:
    """The lowest field over `heights` (N, M) that is along x and along y nowhere steeper than `STEEPEST`."""
    result, step = heights, STEEPEST * cell_m
    for _ in range(2):  # along one axis and along the other, there and back
        result = result.T.copy()
        for rows in (result, result[::-1]):
            for before, row in pairwise(rows):
                np.maximum(row, before - step, out=row)
    return result


class Ground(NamedTuple):
    """Where cloth is let down: over a seat, a lap, or the legs of an infant.

    slot: the seat · frame: (4, 4) vehicle_from_cloth, x along the cloth, z up · start, end: of the cloth along x, m · half_m: of
    its breadth, at most · shortest_m: shorter than this there is none · highest_m: what is higher is not covered, the cloth
    begins before it · cell_m: of the field of heights · over: whether somebody is below.
    """

    slot: str
    frame: Matrix
    start: float
    end: float
    half_m: float = np.inf
    shortest_m: float = _SHORTEST_M
    highest_m: float = HIGHEST_M
    cell_m: float = CELL_M
    over: bool = True

    @classmethod
    def of(cls, seat: Seat, setting: SeatSetting, body: PosedBody | None, carrier: PlacedThing | None, variant: int) -> Ground:
        """Over somebody on a seat or in a carrier, or over the seat where nobody is."""
        longer = of_design(0.06, 0.14, variant, 2)
        if body is None:
            return cls(seat.slot, cushion_frame(seat, setting), *_ON_SEAT_M, over=False)
        if carrier is None:
            frame, length = lap_frame(body)
            return cls(seat.slot, frame, 0.08, length + longer)
        at = {name: body.joints[i] for name, i in CABINPOSE.index.items()}
        start, feet = 0.5 * (at["chest"] + at["hip"]), 0.5 * (at["lankle"] + at["rankle"])
        x = (feet - start) / rp.norm(feet - start)
        y = np.cross(carrier.vehicle_from_thing[:3, 2], x)
        y /= rp.norm(y)
        frame = transform(np.column_stack((x, y, np.cross(x, y))), start)
        return cls(seat.slot, frame, 0.0, rp.norm(feet - start) + _SLACK_M, *_ON_INFANT_M)


def draped(kind: str, variant: int, ground: Ground, below: Sequence[Surface]) -> PlacedThing | None:
    """Cloth of a kind and design over its ground; below: the surfaces that it lies on.

    None where there is no room: arms before the trunk, a lap that is too short.
    """
    frame, start, end = ground.frame, ground.start, ground.end
    cell = ground.cell_m
    raw = seen_from_above(merge(list(below)), frame, cell)
    row = THINGS[kind]
    assert isinstance(row, Cloth)
    half = min(of_design(*row.half_m, variant, 3), ground.half_m)
    x, y = (cell * (np.arange(CELLS) - 0.5 * (CELLS - 1)) + middle for middle in (_MIDDLE * cell, 0.0))
    high = (raw > ground.highest_m)[:, np.abs(y) < half + 2.0 * cell].any(axis=1) & (x < end)
    start = max(start, float(x[high].max()) + 2.0 * cell if high.any() else start)
    if end - start < ground.shortest_m:
        return None
    covered = envelope(np.where((x > start - cell)[:, None], raw, -np.inf), cell) + LIFT_M
    phase = 2.0 * np.pi * of_design(0.0, 1.0, variant, 5)
    thick = of_design(*row.thick_m, variant, 4)

    def cloth(x0: float, x1: float, left: float, right: float, slant: float = 0.0, above: float = 0.0) -> Solid:
        """A piece from x0 to x1 between two sides (y, m); slant: how far it is moved to the left at its end; above: another."""
        rows, columns = (max(math.ceil(side / _MESH_M), _FEWEST) for side in (x1 - x0, right - left))
        s, t = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
        wave = 0.012 * rp.sin(9.0 * s + 7.0 * t + phase)
        px = x0 + s * (x1 - x0) + wave * (t - 0.5)
        py = left + t * (right - left) + slant * s + wave * (0.5 - np.abs(s - 0.5))
        row, column = ((p - axis[0]) / cell for p, axis in ((px, x), (py, y)))
        corners = [
            covered[np.clip(f(row).astype(int), 0, CELLS - 1), np.clip(g(column).astype(int), 0, CELLS - 1)]
            for f in (np.floor, np.ceil)
            for g in (np.floor, np.ceil)
        ]
        folds = sum(_FOLD_M * (1.0 + rp.sin(a * px + b * py + phase + k)) for k, (a, b) in enumerate(_FOLDS))
        low = np.max(corners, axis=0) + folds + above
        return slab(*(np.stack((px, py, low + up), axis=-1) for up in (0.0, thick)))

    pieces = [cloth(start, end, -half, half)]
    if row.sleeves:
        wide, ends = 0.09, (end - 0.22, end - 0.04)
        edges = ((-half, wide - half, 1.2 * half), (half - wide, half, -0.7 * half))
        pieces += [cloth(start + 0.03, x1, *edge, above=thick) for x1, edge in zip(ends, edges, strict=True)]
    made = tuple(Piece(f"cloth {n}", solid, row.material, CLOTH_M) for n, solid in enumerate(pieces))
    return PlacedThing(Thing(kind, variant, row.label, made), frame, ground.slot, "lap" if ground.over else "seat")
