"""Exact distance from points to triangles, with the sign of closed surfaces.

The closest point on a triangle is found by its Voronoi regions (Ericson 2005, section 5.1.5). The sign of the
distance to a closed surface is that of the angle-weighted pseudo-normal of the closest feature (Bærentzen & Aanæs
2005, "Signed distance computation using the angle weighted pseudonormal").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

WELD_M = 1e-5  # vertices closer than this are one: parts come with a vertex per face corner for hard shading
CELL_M = 0.03  # cell of the search grid, about the size of a cabin triangle


@njit(cache=True, nogil=True, inline="always")
def closest_on_triangle(px, py, pz, a, b, c):  # type: ignore[no-untyped-def]
    """Squared distance (m²), closest point and its feature: 0 face, 1-3 vertices a, b, c, 4-6 edges ab, bc, ca."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = px - a[0], py - a[1], pz - a[2]
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    bpx, bpy, bpz = px - b[0], py - b[1], pz - b[2]
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    cpx, cpy, cpz = px - c[0], py - c[1], pz - c[2]
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w, feature = 0.0, 0.0, 1
    elif d3 >= 0.0 and d4 <= d3:
        v, w, feature = 1.0, 0.0, 2
    elif d6 >= 0.0 and d5 <= d6:
        v, w, feature = 0.0, 1.0, 3
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w, feature = d1 / (d1 - d3), 0.0, 4
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w, feature = 0.0, d2 / (d2 - d6), 6
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v, feature = 1.0 - w, 5
    else:
        s = 1.0 / (va + vb + vc)
        v, w, feature = vb * s, vc * s, 0
    qx, qy, qz = a[0] + abx * v + acx * w, a[1] + aby * v + acy * w, a[2] + abz * v + acz * w
    dx, dy, dz = px - qx, py - qy, pz - qz
    return dx * dx + dy * dy + dz * dz, qx, qy, qz, feature


@njit(cache=True, nogil=True, inline="always")
def crossing(px, py, a, b, c):  # type: ignore[no-untyped-def]
    """How often, and in which sense, the vertical line through (px, py) crosses a triangle: -1, 0 or 1.

    1 where the triangle faces up. Every edge is evaluated from its lower end, so that two triangles that share it
    agree to the last bit and a closed surface never leaks along an edge.
    """
    return _edge_crossing(px, py, a, b) + _edge_crossing(px, py, b, c) + _edge_crossing(px, py, c, a)


@njit(cache=True, nogil=True, inline="always")
def _edge_crossing(px, py, a, b):  # type: ignore[no-untyped-def]
    if a[1] <= py < b[1]:
        if (b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0]) < 0.0:
            return 0
        return 1
    if b[1] <= py < a[1]:
        if (a[0] - b[0]) * (py - b[1]) - (a[1] - b[1]) * (px - b[0]) < 0.0:
            return 0
        return -1
    return 0


@njit(cache=True, nogil=True, inline="always")
def height_over(px, py, a, b, c):  # type: ignore[no-untyped-def]
    """Height (m) of a triangle's plane over (px, py); the line must cross the triangle."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    return a[2] - (nx * (px - a[0]) + ny * (py - a[1])) / nz


@njit(cache=True, nogil=True)
def _bin(corners, origin, cell, dims):  # type: ignore[no-untyped-def]
    """Triangles by grid cell, compressed rows: (cells + 1,) starts and the triangle numbers."""
    starts = np.zeros(dims[0] * dims[1] * dims[2] + 1, np.int32)
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    entries = np.empty(0, np.int32)
    for fill in range(2):
        for t in range(len(corners)):
            for axis in range(3):
                x = corners[t, :, axis]
                low[axis] = min(max(math.floor((x.min() - origin[axis]) / cell), 0), dims[axis] - 1)
                high[axis] = min(max(math.floor((x.max() - origin[axis]) / cell), 0), dims[axis] - 1)
            for i in range(low[0], high[0] + 1):
                for j in range(low[1], high[1] + 1):
                    for k in range(low[2], high[2] + 1):
                        row = (i * dims[1] + j) * dims[2] + k
                        if fill == 0:
                            starts[row + 1] += 1
                        else:
                            entries[starts[row]] = t
                            starts[row] += 1
        if fill == 0:
            starts = np.cumsum(starts).astype(np.int32)
            entries = np.empty(starts[-1], np.int32)
    starts[1:] = starts[:-1].copy()
    starts[0] = 0
    return starts, entries


@njit(cache=True, nogil=True)
def _nearest_in(row, px, py, pz, best, inside, corners, normals, starts, entries):  # type: ignore[no-untyped-def]
    """The lesser of `best` (m²) and the squared distance to the triangles of a grid cell, and on which side of them."""
    for e in range(starts[row], starts[row + 1]):
        t = entries[e]
        d2, qx, qy, qz, f = closest_on_triangle(px, py, pz, corners[t, 0], corners[t, 1], corners[t, 2])
        if d2 < best:
            best = d2
            normal = normals[t, f]
            inside = (px - qx) * normal[0] + (py - qy) * normal[1] + (pz - qz) * normal[2] < 0.0
    return best, inside


@njit(cache=True, nogil=True)
def _nearest_signed(points, radius, enough, corners, normals, closed, origin, cell, dims, starts, entries):  # type: ignore[no-untyped-def]
    result = np.full(len(points), radius)
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    own = np.empty(3, np.int64)
    stop = enough * enough
    for n in range(len(points)):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        for axis in range(3):
            low[axis] = max(math.floor((points[n, axis] - radius - origin[axis]) / cell), 0)
            high[axis] = min(math.floor((points[n, axis] + radius - origin[axis]) / cell), dims[axis] - 1)
            own[axis] = min(max(math.floor((points[n, axis] - origin[axis]) / cell), 0), dims[axis] - 1)
        row = (own[0] * dims[1] + own[1]) * dims[2] + own[2]
        best, inside = _nearest_in(row, px, py, pz, radius * radius, False, corners, normals, starts, entries)
        for i in range(low[0], high[0] + 1):
            dx = max(origin[0] + i * cell - px, px - origin[0] - (i + 1) * cell, 0.0)
            if dx * dx >= best or best <= stop:
                continue
            for j in range(low[1], high[1] + 1):
                dy = max(origin[1] + j * cell - py, py - origin[1] - (j + 1) * cell, 0.0)
                if dx * dx + dy * dy >= best or best <= stop:
                    continue
                for k in range(low[2], high[2] + 1):
                    dz = max(origin[2] + k * cell - pz, pz - origin[2] - (k + 1) * cell, 0.0)
                    if dx * dx + dy * dy + dz * dz < best and best > stop:
                        row = (i * dims[1] + j) * dims[2] + k
                        best, inside = _nearest_in(row, px, py, pz, best, inside, corners, normals, starts, entries)
        result[n] = -math.sqrt(best) if closed and inside else math.sqrt(best)
    return result


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles prepared for exact distance queries.

    corners: (F, 3, 3) float64 m · normals: (F, 7, 3) pseudo-normals of face, vertices a b c, edges ab bc ca ·
    closed: whether inside has a meaning · faces: (F, 3) int32 into vertices (V, 3), welded.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    corners: NDArray[np.float64]
    normals: NDArray[np.float64]
    closed: bool
    _origin: NDArray[np.float64]
    _dims: NDArray[np.int64]
    _starts: NDArray[np.int32]
    _entries: NDArray[np.int32]

    @property
    def low(self) -> NDArray[np.float64]:
        """(3,) lower corner of the box around the triangles, m."""
        return np.asarray(self.vertices.min(axis=0))

    @property
    def high(self) -> NDArray[np.float64]:
        """(3,) upper corner of the box around the triangles, m."""
        return np.asarray(self.vertices.max(axis=0))

    def signed_distance(self, points: NDArray[np.float64], radius: float, enough: float = 0.0) -> NDArray[np.float64]:
        """(N,) distance of points (N, 3) to the surface, m, negative inside where closed.

        Exact to rounding up to `radius`; `radius` stands for every point farther away than that, on either side. Where
        a distance is found to be at most `enough`, it is not pursued: either sign and any size up to `enough` may stand.
        """
        return np.asarray(
            _nearest_signed(
                np.ascontiguousarray(points, np.float64), radius, enough, self.corners, self.normals, self.closed,
                self._origin, CELL_M, self._dims, self._starts, self._entries,
            )
        )  # fmt: skip


def triangle_mesh(vertices: NDArray[np.floating], faces: NDArray[np.integer], *, closed: bool) -> TriangleMesh:
    """A `TriangleMesh` of vertices (V, 3) m and faces (F, 3), counter-clockwise from outside; drops slivers of no area.

    `closed` states that the triangles bound a volume; it is not verified here.
    """
    keys = np.round(np.asarray(vertices, np.float64) / WELD_M)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    welded = np.asarray(vertices, np.float64)[first]
    triangles = inverse.reshape(-1)[np.asarray(faces)].astype(np.int32)
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[distinct]
    corners = np.ascontiguousarray(welded[triangles])
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    dims = np.maximum(np.ceil((high - low) / CELL_M), 1).astype(np.int64)
    starts, entries = _bin(corners, low, CELL_M, dims)
    normals = _pseudo_normals(corners, triangles, len(welded))
    return TriangleMesh(welded, triangles, corners, normals, closed, low, dims, starts, entries)


def edge_keys(faces: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """(F, 3) one number for each undirected edge ab, bc, ca of faces (F, 3) over `count` vertices."""
    ends = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=2).astype(np.int64), axis=2)
    return np.asarray(ends[..., 0] * count + ends[..., 1])


def _pseudo_normals(corners: NDArray[np.float64], faces: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-30)
    towards_next = np.roll(corners, -1, axis=1) - corners
    towards_next /= np.maximum(np.linalg.norm(towards_next, axis=2, keepdims=True), 1e-30)
    cosine = -(towards_next * np.roll(towards_next, 1, axis=1)).sum(axis=2)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    vertex = np.zeros((count, 3))
    np.add.at(vertex, faces, angle[..., None] * face[:, None])
    _, edge_of = np.unique(edge_keys(faces, count), return_inverse=True)
    edge_of = edge_of.reshape(faces.shape)
    edge = np.zeros((edge_of.max() + 1, 3))
    np.add.at(edge, edge_of, np.broadcast_to(face[:, None], (*faces.shape, 3)))
    return np.concatenate((face[:, None], vertex[faces], edge[edge_of]), axis=1)
