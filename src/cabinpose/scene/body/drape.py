"""How cloth lies on what is under it: stretched over hollows, hanging from what stands out.

Both act on the skin's mesh at rest, before it is refined; `garments` adds thickness, looseness and folds.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Index = NDArray[np.int32]
_TETHER = np.float32(0.2)  # share of a vertex' slip along the body that is taken back in each sweep
_SECTORS, _ROW_M = 48, 0.015  # of the table of radii of `hang`


@njit(cache=True, nogil=True)
def relax(points: Array32, start: Index, near: Index, share: Array32, sweeps: int) -> Array32:
    """Laplacian smoothing in place order (Gauss-Seidel) of points (V, 3); share (V,) of each step that is taken."""
    out = points.copy()
    for _ in range(sweeps):
        for v in range(len(out)):
            if share[v] <= 0:
                continue
            x = y = z = np.float32(0)
            for k in range(start[v], start[v + 1]):
                x += out[near[k], 0]
                y += out[near[k], 1]
                z += out[near[k], 2]
            n = share[v] / (start[v + 1] - start[v])
            out[v, 0] = (np.float32(1) - share[v]) * out[v, 0] + n * x
            out[v, 1] = (np.float32(1) - share[v]) * out[v, 1] + n * y
            out[v, 2] = (np.float32(1) - share[v]) * out[v, 2] + n * z
    return out


@njit(cache=True, nogil=True)
def stretch(
    under: Array32, normals: Array32, gap: Array32, start: Index, near: Index, share: Array32, sweeps: int
) -> Array32:  # fmt: skip
    """An elastic membrane over `under` (V, 3): it bridges hollows and rests on what stands out.

    The obstacle problem by projected Gauss-Seidel: each vertex goes to the middle of its neighbours, but stays at least
    gap (V,) m off its place on the body along the normals (V, 3) there. share: (V,) 0 where cloth is pinned.
    """
    out = under.copy()
    for v in range(len(out)):
        for i in range(3):
            out[v, i] += gap[v] * normals[v, i]
    for _ in range(sweeps):
        for v in range(len(out)):
            if share[v] <= 0:
                continue
            x = y = z = np.float32(0)
            for k in range(start[v], start[v + 1]):
                x += out[near[k], 0]
                y += out[near[k], 1]
                z += out[near[k], 2]
            n = np.float32(1) / (start[v + 1] - start[v])
            x = out[v, 0] + share[v] * (x * n - out[v, 0]) - under[v, 0]
            y = out[v, 1] + share[v] * (y * n - out[v, 1]) - under[v, 1]
            z = out[v, 2] + share[v] * (z * n - out[v, 2]) - under[v, 2]
            off = x * normals[v, 0] + y * normals[v, 1] + z * normals[v, 2]
            keep = np.float32(1) - _TETHER
            further = max(off, gap[v]) - keep * off
            out[v, 0] = under[v, 0] + keep * x + further * normals[v, 0]
            out[v, 1] = under[v, 1] + keep * y + further * normals[v, 1]
            out[v, 2] = under[v, 2] + keep * z + further * normals[v, 2]
    return out


def hang(down: Array, radius: Array, angle: Array, narrowing: Array) -> Array:
    """Radius (N,) m of cloth hanging about an axis, for points at `down` (N,) m along it, `radius` off it at `angle` rad.

    Going down, the radius shrinks by no more than `narrowing` (_SECTORS,) m/m from what stands out above.
    """
    row = (down - down.min()) / _ROW_M
    sector = (angle / (2 * np.pi) + 0.5) * _SECTORS
    rows = int(row.max()) + 2
    table = np.zeros((rows, _SECTORS))
    np.maximum.at(table, (row.round().astype(int), sector.round().astype(int) % _SECTORS), radius)
    for _ in range(3):  # places that no vertex fell into
        besides = np.maximum(np.roll(table, 1, axis=1), np.roll(table, -1, axis=1))
        table = np.where(table > 0, table, besides)
    for k in range(1, rows):
        table[k] = np.maximum(table[k], table[k - 1] - narrowing * _ROW_M)
    table = gaussian_filter1d(gaussian_filter1d(table, 1.2, axis=1, mode="wrap"), 1.5, axis=0, mode="nearest")
    ring = np.concatenate([table, table[:, :1]], axis=1)
    return np.asarray(map_coordinates(ring, [row, sector % _SECTORS], order=1, mode="nearest"))


def sectors() -> Array:
    """(_SECTORS,) angle of each sector of `hang`, rad from -pi."""
    return (np.arange(_SECTORS) / _SECTORS - 0.5) * 2 * np.pi
