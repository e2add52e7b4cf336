"""Exact distance from points to triangles, with the sign of closed surfaces.

The sign of the distance to a closed surface is that of the angle-weighted pseudo-normal of the closest feature (Bærentzen &
Aanæs 2005, "Signed distance computation using the angle weighted pseudonormal").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import contact as native
from cabinpose.core import Floats, Ints, Ints32, distinct_rows
from cabinpose.core import reproducible as rp

_WELD_M = 1e-5  # vertices closer than this are one: parts come with a vertex per face corner for hard shading
CELL_M = 0.03  # cell of the search grid, about the size of a cabin triangle


class SearchGrid(NamedTuple):
    """The triangles in each cell of a grid.

    origin: (3,) m of its corner · cell: side, m · dims: (3,) cells along each axis · starts: (cells + 1,) of each one's entries,
    which are numbers of triangles.
    """

    origin: Floats
    cell: float
    dims: Ints
    starts: Ints32
    entries: Ints32


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles prepared for exact distance queries.

    corners: (F, 3, 3) float64 m · normals: (F, 7, 3) pseudo-normals of face, vertices a b c, edges ab bc ca, of open ones
    those of faces alone · closed: whether inside has a meaning · faces: (F, 3) int32 into vertices (V, 3), welded · grid: where
    to search.
    """

    vertices: Floats
    faces: Ints32
    corners: Floats
    normals: Floats
    closed: bool
    grid: SearchGrid

    @property
    def low(self) -> Floats:
        """(3,) lower corner of the box around the triangles, m."""
        return np.asarray(self.vertices.min(axis=0))

    @property
    def high(self) -> Floats:
        """(3,) upper corner of the box around the triangles, m."""
        return np.asarray(self.vertices.max(axis=0))

    def signed_distance(self, points: Floats, radius: float, enough: float = 0.0) -> Floats:
        """(N,) distance of points (N, 3) to the surface, m, negative inside where closed.

        Exact to rounding up to `radius`; `radius` stands for every point farther away than that, on either side. Where
        a distance is found to be at most `enough`, it is not pursued: either sign and any size up to `enough` may stand.
        """
        distance = np.empty(len(points))
        native.signed_distance(np.ascontiguousarray(points, np.float64), radius=radius, enough=enough, mesh=self, out=distance)
        return distance


def welded(points: Floats) -> tuple[Ints, Ints]:
    """Which of the points (N, 3) m are the first at their place, and for each point which of those it is, as `distinct_rows`."""
    return distinct_rows(np.round(points / _WELD_M))


def triangle_mesh(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, closed: bool, cell_m: float = CELL_M
) -> TriangleMesh:
    """A `TriangleMesh` of vertices (V, 3) m and faces (F, 3), counter-clockwise from outside; drops slivers of no area.

    `closed` states that the triangles bound a volume; it is not verified here. cell_m: side of the search grid's cells; wider
    ones where points are far off, of which each looks into as many cells as are nearer than what it finds.
    """
    every = np.asarray(vertices, np.float64)
    first, which = welded(every)
    corner_points = every[first]
    triangles = which[np.asarray(faces)].astype(np.int32)
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[distinct]
    corners = np.ascontiguousarray(corner_points[triangles])
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    dims = np.maximum(np.ceil((high - low) / cell_m), 1).astype(np.int64)
    normals = _pseudo_normals(corners, triangles, len(corner_points), closed=closed)
    grid = SearchGrid(low, cell_m, dims, *native.bin_triangles(corners, low, cell_m, dims))
    return TriangleMesh(corner_points, triangles, corners, normals, closed, grid)


def edge_keys(faces: Ints32, count: int) -> Ints:
    """(F, 3) one number for each undirected edge ab, bc, ca of faces (F, 3) over `count` vertices."""
    ends = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=2).astype(np.int64), axis=2)
    return np.asarray(ends[..., 0] * count + ends[..., 1])


def _pseudo_normals(corners: Floats, faces: Ints32, count: int, *, closed: bool) -> Floats:
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-30)
    if not closed:  # which have no sign to decide at vertices and edges
        alone = np.zeros((len(faces), 7, 3))
        alone[:, 0] = face
        return alone
    towards_next = np.roll(corners, -1, axis=1) - corners
    towards_next /= np.maximum(np.linalg.norm(towards_next, axis=2, keepdims=True), 1e-30)
    cosine = -(towards_next * np.roll(towards_next, 1, axis=1)).sum(axis=2)
    angle = rp.arccos(np.clip(cosine, -1.0, 1.0))
    vertex = np.zeros((count, 3))
    np.add.at(vertex, faces, angle[..., None] * face[:, None])
    _, edge_of = np.unique(edge_keys(faces, count), return_inverse=True)
    edge_of = edge_of.reshape(faces.shape)
    edge = np.zeros((edge_of.max() + 1, 3))
    np.add.at(edge, edge_of, np.broadcast_to(face[:, None], (*faces.shape, 3)))
    return np.concatenate((face[:, None], vertex[faces], edge[edge_of]), axis=1)


def sampled_surface(corners: Floats, spacing: float) -> Floats:
    """Points (N, 3) over triangles (F, 3, 3), no farther apart than `spacing` (all in m), those on shared edges once."""
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    pieces = np.maximum(np.ceil(longest / spacing).astype(int), 1)  # of a triangle that is a point, its corners
    points = []
    for n in np.unique(pieces):
        i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
        weights = np.stack((n - i - j, i, j), axis=1) / n
        points.append(rp.matmul(weights, corners[pieces == n]).reshape(-1, 3))
    every = np.concatenate(points)
    first, _ = welded(every)
    # In order of place: the nearest triangle of one point is then a good guess for the next.
    every = every[np.sort(first)]
    return every[np.lexsort(np.floor(every / (2.0 * spacing)).T)]


def first_crossings(starts: Floats, ends: Floats, triangles: Floats) -> tuple[Floats, Ints]:
    """Where line segments first meet triangles.

    Parameters
    ----------
    starts, ends
        (N, 3) m.
    triangles
        (F, 3, 3) m, in the same frame.

    Returns
    -------
    share, triangle
        (N,) the share of the way from start to end, inf where nothing is met; (N,) the number of the triangle, -1 there.

    References
    ----------
    Moeller and Trumbore 1997, "Fast, minimum storage ray/triangle intersection".
    """
    share, which = np.full(len(starts), np.inf), np.full(len(starts), -1, np.int64)
    corner = triangles[:, 0]
    one, two = triangles[:, 1] - corner, triangles[:, 2] - corner
    for n, (start, way) in enumerate(zip(starts, ends - starts, strict=True)):
        p = np.cross(way, two)
        determinant = np.einsum("ij,ij->i", one, p)
        with np.errstate(divide="ignore", invalid="ignore"):  # a segment along a triangle's plane does not cross it
            from_corner = start - corner
            u = np.einsum("ij,ij->i", from_corner, p) / determinant
            q = np.cross(from_corner, one)
            v = (rp.matmul(q, way)) / determinant
            t = np.einsum("ij,ij->i", two, q) / determinant
            inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
        hits = np.flatnonzero(inside)
        if len(hits):
            which[n] = hits[np.argmin(t[hits])]
            share[n] = t[which[n]]
    return share, which
