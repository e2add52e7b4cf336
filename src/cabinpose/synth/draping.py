"""Blankets and jackets: cloth that is let down onto a lap or a seat, and lies on whatever is there.

What lies below is seen from straight above as a field of heights; the cloth is its upper envelope that is nowhere steeper than
cloth hangs, so that nothing comes through it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cabinpose.core import Camera, Floats, Matrix, invert, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene import Surface, merge
from cabinpose.scene.body import PosedBody
from cabinpose.scene.cabin import Cabin, SeatSetting, Solid, slab
from cabinpose.scene.things import CLOTH_M, THINGS, Cloth, Piece, PlacedThing, Thing, cushion_frame, of_design
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.things import lap_frame

CELLS, CELL_M = 64, 0.015
LIFT_M = 0.006  # of the cloth's lower side over what it lies on
HIGHEST_M = 0.26  # over the thighs or the cushion: what is higher is not covered, the cloth begins before it
STEEPEST = 2.2  # of cloth that hangs
_MIDDLE_M = 0.3  # of the field, ahead of the frame's origin
_AWAY_M = 60.0  # from where it is seen: rays are all but parallel
_SHORTEST_M = 0.22  # of a cloth, along the thighs or the cushion
_ON_SEAT_M = (0.05, 0.46)  # along a cushion, from the backrest
_FOLD_M, _FOLDS = 0.0022, ((9.0, 4.0), (-6.0, 11.0), (15.0, -7.0))  # height, and waves along and across, rad/m


def seen_from_above(surface: Surface, vehicle_from_cloth: Matrix) -> Floats:
    """(CELLS, CELLS) m: how high a surface reaches over the x-y plane of a frame, by x and y; -inf where nothing is."""
    camera = Camera(CELLS, CELLS, _AWAY_M / CELL_M, _AWAY_M / CELL_M, 0.5 * (CELLS - 1), 0.5 * (CELLS - 1))
    turn = np.diag((1.0, -1.0, -1.0))
    seen = Rasteriser(camera, 1).render(
        surface, invert(rp.matmul(vehicle_from_cloth, transform(turn, (_MIDDLE_M, 0.0, _AWAY_M))))
    )
    depth = seen.depth_clean.T[:, ::-1].astype(np.float64)
    return np.where(depth > 0.0, _AWAY_M - depth, -np.inf)


def envelope(heights: Floats) -> Floats:
    """The lowest field over `heights` (N, M) that is nowhere steeper than `STEEPEST`."""
    result = heights.copy()
    for _ in range(CELLS):
        padded = np.pad(result, 1, constant_values=-np.inf) - STEEPEST * CELL_M
        for i, j in ((0, 1), (2, 1), (1, 0), (1, 2)):
            result = np.maximum(result, padded[i : i + len(heights), j : j + heights.shape[1]])
    return result


def draped(
    kind: str, variant: int, slot: str, cabin: Cabin, setting: SeatSetting, body: PosedBody | None, worn: Sequence[Surface]
) -> PlacedThing | None:
    """Cloth over a lap, or over a seat.

    Parameters
    ----------
    kind, variant
        Which design.
    slot, cabin, setting
        The seat.
    body, worn
        Who sits there, and the surfaces of clothes and belt; None and none where nobody does.

    Returns
    -------
    PlacedThing or None
        None where there is no room: arms before the trunk, a lap that is too short.
    """
    seat, at = cabin.seats[slot], cabin.group_transforms({slot: setting})
    parts = [part for part in cabin.parts if part.group.startswith(f"seat:{slot}/") and not part.name.endswith("buckle")]
    below = [part.surface.moved(at[part.group]) for part in parts]
    frame, (start, end) = cushion_frame(seat, setting), _ON_SEAT_M
    if body is not None:
        frame, length = lap_frame(body)
        start, end = 0.08, length + of_design(0.06, 0.14, variant, 2)
    raw = seen_from_above(merge([*below, *worn]), frame)
    row = THINGS[kind]
    assert isinstance(row, Cloth)
    half = of_design(*row.half_m, variant, 3)
    x, y = (CELL_M * (np.arange(CELLS) - 0.5 * (CELLS - 1)) + middle for middle in (_MIDDLE_M, 0.0))
    high = (raw > HIGHEST_M)[:, np.abs(y) < half + 2.0 * CELL_M].any(axis=1) & (x < end)
    start = max(start, float(x[high].max()) + 2.0 * CELL_M if high.any() else start)
    if end - start < _SHORTEST_M:
        return None
    covered = envelope(np.where((x > start - CELL_M)[:, None], raw, -np.inf)) + LIFT_M
    phase = 2.0 * np.pi * of_design(0.0, 1.0, variant, 5)
    thick = of_design(*row.thick_m, variant, 4)

    def cloth(x0: float, x1: float, left: float, right: float, slant: float = 0.0, above: float = 0.0) -> Solid:
        """A piece from x0 to x1 between two sides (y, m); slant: how far it is moved to the left at its end; above: another."""
        s, t = np.meshgrid(np.linspace(0.0, 1.0, 24), np.linspace(0.0, 1.0, 28), indexing="ij")
        wave = 0.012 * rp.sin(9.0 * s + 7.0 * t + phase)
        px = x0 + s * (x1 - x0) + wave * (t - 0.5)
        py = left + t * (right - left) + slant * s + wave * (0.5 - np.abs(s - 0.5))
        row, column = ((p - axis[0]) / CELL_M for p, axis in ((px, x), (py, y)))
        corners = [
            covered[np.clip(f(row).astype(int), 0, CELLS - 1), np.clip(g(column).astype(int), 0, CELLS - 1)]
            for f in (np.floor, np.ceil)
            for g in (np.floor, np.ceil)
        ]
        folds = sum(_FOLD_M * (1.0 + rp.sin(a * px + b * py + phase + k)) for k, (a, b) in enumerate(_FOLDS))
        low = np.max(corners, axis=0) + folds + above
        return slab(*(np.stack((px, py, low + up), axis=-1) for up in (0.0, thick))).outward()

    pieces = [cloth(start, end, -half, half)]
    if row.sleeves:
        wide, ends = 0.09, (end - 0.22, end - 0.04)
        edges = ((-half, wide - half, 1.2 * half), (half - wide, half, -0.7 * half))
        pieces += [cloth(start + 0.03, x1, *edge, above=thick) for x1, edge in zip(ends, edges, strict=True)]
    made = tuple(Piece(f"cloth {n}", solid, row.material, CLOTH_M) for n, solid in enumerate(pieces))
    return PlacedThing(Thing(kind, variant, row.label, made), frame, slot, "seat" if body is None else "lap")
