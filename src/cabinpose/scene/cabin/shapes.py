"""Closed solids that a cabin is made of: rounded boxes, tubes, lofts and slabs, and what bends them.

A `Solid` is watertight with faces counter-clockwise seen from outside. Deformations are maps of points, so that
topology, and with it watertightness, survives them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cabinpose.core import Floats, Ints, Ints32, axis_rotation
from cabinpose.core import reproducible as rp


@dataclass(frozen=True)
class Solid:
    """A closed triangle mesh: vertices (V, 3) float64 m, faces (F, 3) int32."""

    vertices: Floats
    faces: Ints32

    def volume(self) -> float:
        """The enclosed volume in m^3; negative where the faces look inwards."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    def flipped(self) -> Solid:
        return Solid(self.vertices, np.ascontiguousarray(self.faces[:, ::-1]))

    def outward(self) -> Solid:
        """The same solid with its faces looking out."""
        return self.flipped() if self.volume() < 0 else self

    def moved(self, a_from_b: ArrayLike) -> Solid:
        """The solid in frame a, by a rigid 4x4 transform."""
        m = np.asarray(a_from_b, dtype=np.float64)
        return Solid(rp.matmul(self.vertices, m[:3, :3].T) + m[:3, 3], self.faces)

    def shifted(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
        return Solid(self.vertices + (x, y, z), self.faces)

    def turned(self, axis: str, angle: float) -> Solid:
        """The solid turned about a coordinate axis through the origin, right-handed, radians."""
        return Solid(rp.matmul(self.vertices, axis_rotation(axis, angle).T), self.faces)

    def deformed(self, bend: Callable[[Floats], Floats]) -> Solid:
        """The solid with its vertices (V, 3) moved by `bend`."""
        return Solid(bend(self.vertices), self.faces).outward()

    def mirrored(self) -> Solid:
        """The mirror image in the plane y = 0, faces still looking out."""
        return Solid(self.vertices * (1.0, -1.0, 1.0), self.faces).flipped()


def smoothstep(x: ArrayLike, low: float, high: float) -> Floats:
    """0 below `low`, 1 above `high`, and a cubic without corners between."""
    t = np.clip((np.asarray(x, dtype=np.float64) - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def join(solids: Sequence[Solid]) -> Solid:
    """Several solids as one mesh; they may overlap."""
    offsets = np.cumsum([0] + [len(s.vertices) for s in solids[:-1]])
    faces = [s.faces + np.int32(o) for s, o in zip(solids, offsets, strict=True)]
    return Solid(np.concatenate([s.vertices for s in solids]), np.concatenate(faces).astype(np.int32))


def _axis_lattice(length: float, radius: float, cells: int, corner: int) -> Floats:
    """Coordinates along one edge of a rounded box: `corner` steps of even angle at each end, `cells` between."""
    half = length / 2
    arc = radius * rp.tan(np.linspace(-np.pi / 4, 0, corner + 1))  # on the face of the box; even in angle once projected
    start = -half + radius + arc
    middle = np.linspace(-half + radius, half - radius, cells + 1)[1:-1]
    return np.concatenate((start, middle, -start[::-1]))


def rounded_box(
    size: Sequence[float], radius: float | Sequence[float], cells: Sequence[int] = (1, 1, 1), corner: int = 2
) -> Solid:
    """A box of full `size` (m) about the origin with elliptic edges of `radius` (m, or one per axis).

    cells: facets along the flat part of each axis; corner: facets of half an edge's quarter turn.
    """
    lengths = np.asarray(size, dtype=np.float64)
    radii = np.minimum(np.broadcast_to(np.asarray(radius, dtype=np.float64), 3), 0.499 * lengths)
    axes = [_axis_lattice(lengths[i], radii[i], cells[i], corner) for i in range(3)]
    counts = [len(a) for a in axes]
    index = np.full(counts, -1, dtype=np.int64)
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1)
    shell = np.zeros(counts, dtype=bool)
    for axis in range(3):
        shell |= (grid[..., axis] == 0) | (grid[..., axis] == counts[axis] - 1)
    index[shell] = np.arange(int(shell.sum()))
    lattice = grid[shell]
    p = np.stack([axes[i][lattice[:, i]] for i in range(3)], axis=-1)
    core = np.clip(p, -lengths / 2 + radii, lengths / 2 - radii)
    # On the outside of the box |p - core| >= radius in at least one axis, so the direction below never vanishes.
    # At an arc point of one face the other component is radius * tan(angle), so the angle comes out even.
    out = (p - core) / radii
    vertices = core + radii * out / np.linalg.norm(out, axis=-1, keepdims=True)
    quads = []
    for axis in range(3):
        for end in (0, counts[axis] - 1):
            face = np.take(index, end, axis=axis)
            quad = np.stack((face[:-1, :-1], face[1:, :-1], face[1:, 1:], face[:-1, 1:]), axis=-1).reshape(-1, 4)
            # (i, j) = the two other axes in increasing order: their cross product is +axis, but -y for (x, z).
            quads.append(quad if (end > 0) != (axis == 1) else quad[:, ::-1])
    return Solid(vertices, _triangles(np.concatenate(quads)))


def block(size: Sequence[float]) -> Solid:
    """A box of full `size` (m) about the origin, with sharp edges."""
    grid = np.array([[(x, y) for y in (-0.5, 0.5)] for x in (-0.5, 0.5)])
    low, high = (np.concatenate((grid, np.full((2, 2, 1), z)), axis=-1) * np.asarray(size) for z in (-0.5, 0.5))
    return slab(high, low)


def _triangles(quads: Ints) -> Ints32:
    return np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]])).astype(np.int32)


def _grid_quads(rows: int, columns: int, wrap: bool) -> Ints:
    """Quads of a (rows, columns) grid of vertices numbered row by row; `wrap` closes the columns."""
    index = np.arange(rows * columns).reshape(rows, columns)
    if wrap:
        index = np.concatenate((index, index[:, :1]), axis=1)
    return np.stack((index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]), axis=-1).reshape(-1, 4)


def loft(rings: ArrayLike, closed: bool = False) -> Solid:
    """The solid through rings (S, N, 3) of points; its ends are capped by fans unless the rings close on themselves."""
    r = np.asarray(rings, dtype=np.float64)
    s, n = r.shape[:2]
    if closed:
        r = np.concatenate((r, r[:1]))
        quads = _grid_quads(s + 1, n, wrap=True) % (s * n)
        return Solid(r[:s].reshape(-1, 3), _triangles(quads)).outward()
    faces = [_triangles(_grid_quads(s, n, wrap=True))]
    centres = np.stack((r[0].mean(axis=0), r[-1].mean(axis=0)))
    i = np.arange(n)
    j = (i + 1) % n
    first, last = s * n, s * n + 1
    faces.append(np.stack((j, i, np.full(n, first)), axis=-1).astype(np.int32)[:, ::-1])
    faces.append(np.stack(((s - 1) * n + i, (s - 1) * n + j, np.full(n, last)), axis=-1).astype(np.int32)[:, ::-1])
    return Solid(np.concatenate((r.reshape(-1, 3), centres)), np.concatenate(faces)).outward()


def path_frames(path: Floats, closed: bool, up: ArrayLike | None = None) -> tuple[Floats, Floats, Floats]:
    """Tangent, normal and binormal (P, 3) along a path, carried without twist; `up` fixes the first normal."""
    if closed:
        tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    else:
        tangent = np.gradient(path, axis=0)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    seed = np.asarray(up if up is not None else np.eye(3)[np.argmin(np.abs(tangent[0]))], dtype=np.float64)
    normals = np.empty_like(path)
    for k, t in enumerate(tangent):
        seed = seed - t * float(rp.matmul(seed, t))
        seed = seed / rp.norm(seed)
        normals[k] = seed
    return tangent, normals, np.cross(tangent, normals)


def sweep(path: ArrayLike, sections: ArrayLike, *, closed: bool = False, up: ArrayLike | None = None) -> Solid:
    """The solid of closed sections (P or 1, N, 2) along a path (P, 3): first section axis along `up`, second across."""
    p = np.asarray(path, dtype=np.float64)
    section = np.broadcast_to(np.asarray(sections, dtype=np.float64), (len(p), *np.shape(sections)[-2:]))
    _, normal, binormal = path_frames(p, closed, up)
    return loft(p[:, None] + section[..., :1] * normal[:, None] + section[..., 1:] * binormal[:, None], closed)


def ellipse(a: ArrayLike, b: ArrayLike, sides: int, power: float = 2.0) -> Floats:
    """Superellipses (..., sides, 2) with half axes a, b (m); power 2 is an ellipse, more is squarer."""
    t = 2 * np.pi * np.arange(sides) / sides
    c, s = rp.cos(t), rp.sin(t)
    unit = np.stack((np.sign(c) * rp.power(np.abs(c), 2 / power), np.sign(s) * rp.power(np.abs(s), 2 / power)), axis=-1)
    half = np.stack((np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)), axis=-1)
    return np.asarray(unit * half[..., None, :])


def tube(path: ArrayLike, radius: float | Sequence[float], sides: int = 8, *, rounded: bool = True) -> Solid:
    """A round bar of `radius` (m, or one per point) along a path (P, 3); `rounded` closes its ends with domes."""
    p = np.asarray(path, dtype=np.float64)
    r = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(p)).copy()
    if rounded:
        first, last = p[0] - p[1], p[-1] - p[-2]
        first, last = first / rp.norm(first) * r[0], last / rp.norm(last) * r[-1]
        p = np.concatenate(([p[0] + 0.9 * first, p[0] + 0.55 * first], p, [p[-1] + 0.55 * last, p[-1] + 0.9 * last]))
        r = np.concatenate(([r[0] * 0.4, r[0] * 0.84], r, [r[-1] * 0.84, r[-1] * 0.4]))
    return sweep(p, ellipse(r, r, sides))


def slab_faces(rows: int, columns: int) -> Ints32:
    """Triangles (F, 3) of the solid between two grids of vertices, numbered row by row, the second after the first."""
    count = rows * columns
    index = np.arange(count).reshape(rows, columns)
    rim = np.concatenate((index[0, :], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]))
    following = np.roll(rim, -1)
    sheet = _grid_quads(rows, columns, wrap=False)
    side = np.stack((rim, following, following + count, rim + count), axis=-1)
    return _triangles(np.concatenate((sheet, sheet[:, ::-1] + count, side)))


def slab(inner: ArrayLike, outer: ArrayLike) -> Solid:
    """The solid between two grids (M, N, 3) of facing points."""
    a, b = np.asarray(inner, dtype=np.float64), np.asarray(outer, dtype=np.float64)
    return Solid(np.concatenate((a.reshape(-1, 3), b.reshape(-1, 3))), slab_faces(*a.shape[:2])).outward()


def prism(profile: ArrayLike, y_low: ArrayLike, y_high: ArrayLike) -> Solid:
    """A closed outline (N, 2) in x, z, pulled from `y_low` to `y_high` (m, one value or one per point)."""
    outline = np.asarray(profile, dtype=np.float64)
    ends = (np.broadcast_to(np.asarray(y, dtype=np.float64), len(outline)) for y in (y_low, y_high))
    return loft(np.stack([np.stack((outline[:, 0], y, outline[:, 1]), axis=-1) for y in ends]))


def smooth_curve(points: ArrayLike, count: int, *, closed: bool = False) -> Floats:
    """`count` points of a centripetal Catmull-Rom spline through points (P, D)."""
    p = np.asarray(points, dtype=np.float64)
    ring = np.concatenate((p[-1:], p, p[:2])) if closed else np.concatenate((2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]))
    steps = np.sqrt(np.linalg.norm(np.diff(ring, axis=0), axis=1)).clip(1e-6)
    knots = np.concatenate(([0.0], np.cumsum(steps)))
    t = np.linspace(knots[1], knots[-2], count, endpoint=not closed)
    k = np.clip(np.searchsorted(knots, t, side="right") - 1, 1, len(ring) - 3)
    t0, t1, t2, t3 = (knots[k + i][:, None] for i in (-1, 0, 1, 2))
    p0, p1, p2, p3 = (ring[k + i] for i in (-1, 0, 1, 2))
    u = t[:, None]
    a1 = (t1 - u) / (t1 - t0) * p0 + (u - t0) / (t1 - t0) * p1
    a2 = (t2 - u) / (t2 - t1) * p1 + (u - t1) / (t2 - t1) * p2
    a3 = (t3 - u) / (t3 - t2) * p2 + (u - t2) / (t3 - t2) * p3
    b1 = (t2 - u) / (t2 - t0) * a1 + (u - t0) / (t2 - t0) * a2
    b2 = (t3 - u) / (t3 - t1) * a2 + (u - t1) / (t3 - t1) * a3
    return np.asarray((t2 - u) / (t2 - t1) * b1 + (u - t1) / (t2 - t1) * b2)
