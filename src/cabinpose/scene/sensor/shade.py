"""Where light falls on what the camera sees, and where it does not: sunlight, and the shadow of the camera's own source.

The camera's depth is all that is known of the scene: only what it sees gives shade.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from cabinpose.core import Bools, Camera, Floats32
from cabinpose.core import reproducible as rp

_SLANT = 0.3  # least cosine between the beam and the surface that it is aimed at
_SAME_SURFACE = 0.05  # share of the depth that a surface may slant within a column of what a light source sees
_NOT_BETWEEN = 0.01  # of a column, that rounding may add
_CELL_M = 0.02  # of the grid across the beam in which the first surface shades those behind it
_LEAST_COSINE = 0.1  # of a surface whose rise in a cell is allowed for
_DEEP_M = 0.02  # what is this much behind the first surface is in its shade


def light_shadow(depth: Floats32, camera: Camera, offset_m: float) -> Bools:
    """(H, W): what a light source `offset_m` to the right of the lens does not reach, for something nearer is in its way.

    depth: (H, W) along the axis, m, 0 where nothing was hit. Each row is seen from the source, in steps of a pixel; where the
    lens bends rows, the shadow is bent with them.
    """
    height, width = depth.shape
    hit = depth > 0
    # In a camera at the source, columns of the same width; a surface fills both that it lies between, so that it has no holes.
    at = (camera.rays[..., 0] - offset_m / np.where(hit, depth, np.inf)) * camera.fx + camera.cx + width
    at = np.nan_to_num(np.clip(at, 1, 3 * width))
    row = np.arange(height)[:, None] * (3 * width + 2)
    first = np.full(height * (3 * width + 2), np.inf, np.float32)
    for column in (np.floor(at + _NOT_BETWEEN), np.ceil(at - _NOT_BETWEEN)):
        np.minimum.at(first, (column.astype(np.int64) + row)[hit], depth[hit])
    return np.asarray(hit & (depth > (1 + _SAME_SURFACE) * first[np.rint(at).astype(np.int64) + row]))


def sunlit(depth: Floats32, candidates: NDArray[np.bool_], camera: Camera, width_m: float, *, rng: Generator) -> Floats32:
    """Cosine of the incidence of a beam of sunlight on each pixel's surface, 0 in the shade and outside the beam.

    The beam has a width and falls on a visible place, from a side of the surface there, both drawn evenly.

    Parameters
    ----------
    depth
        (H, W) along the axis, m, 0 where nothing was hit.
    candidates
        (H, W): the surfaces that the sun may shine on.
    camera
        Where the pixels look.
    width_m
        Diameter of the beam (m).
    rng
        Draws place and direction.

    Returns
    -------
    (H, W) float32
    """
    lit = np.zeros(depth.shape, np.float32)
    places = np.flatnonzero(candidates & (depth > 0))
    if not places.size:
        return lit
    v, u = divmod(int(places[rng.integers(places.size)]), depth.shape[1])
    direction = rng.standard_normal(3)
    cosine = rng.uniform(_SLANT, 1.0)
    points = camera.points(depth)
    # To the sun, from the place: at an angle to its normal whose cosine was drawn, about it at any other.
    top, left = max(v - 1, 0), max(u - 1, 0)
    normal = _normals(points[top : v + 2, left : u + 2])[v - top, u - left]
    aside = np.cross(normal, direction)
    aside /= max(rp.norm(aside), 1e-9)
    to_sun = cosine * normal + np.sqrt(1 - cosine**2) * aside
    offset = points - points[v, u]
    beside = np.einsum("hwk,hwk->hw", offset, offset) - (rp.matmul(offset, to_sun)) ** 2  # squared distance from the beam's axis
    inside = candidates & (depth > 0) & (beside < (width_m / 2) ** 2)
    inside[v, u] = True  # whatever rounding says of it
    rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    box = slice(max(rows[0] - 1, 0), rows[-1] + 2), slice(max(columns[0] - 1, 0), columns[-1] + 2)
    normals, offset = _normals(points[box])[inside[box]], offset[inside]
    u_axis = aside - (rp.matmul(aside, to_sun)) * to_sun
    u_axis /= max(rp.norm(u_axis), 1e-9)
    cells = np.stack(
        [np.floor(rp.matmul(offset, axis) / _CELL_M) for axis in (u_axis, np.cross(to_sun, u_axis))], axis=-1
    ).astype(np.int64)
    cells -= cells.min(axis=0)
    which = cells[:, 0] + cells[:, 1] * (int(cells[:, 0].max()) + 1)
    height, first = rp.matmul(offset, to_sun), np.full(int(which.max()) + 1, -np.inf)
    np.maximum.at(first, which, height)
    facing = np.maximum(rp.matmul(normals, to_sun), 0.0)
    rise = _CELL_M / np.maximum(facing, _LEAST_COSINE)  # of a slanted surface within a cell
    lit[inside] = np.where(height < first[which] - _DEEP_M - 1.5 * rise, 0.0, facing)
    return lit


def _normals(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(H, W, 3) unit normals of the surfaces at the pixels, towards the camera, from the nearer neighbour of each side."""

    def slope(axis: int) -> NDArray[np.float64]:
        step = np.diff(points, axis=axis)
        none = np.full_like(np.take(step, [0], axis), np.inf)
        before, after = np.concatenate((none, step), axis), np.concatenate((step, none), axis)
        nearer = np.abs(before[..., 2:]) < np.abs(after[..., 2:])
        return np.where(nearer, before, after)

    normals = np.cross(slope(0), slope(1))
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals / np.maximum(length, 1e-12)
    away = np.sum(normals * points, axis=-1, keepdims=True) > 0
    return np.where(away, -normals, normals)
