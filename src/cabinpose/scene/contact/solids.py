"""A body as closed solids, one per segment group, for contact with itself, with others and with thin cabin parts.

The skin's triangles of a segment are closed by a fan over each open ring (to the ring's centre of mass), so that
"inside" is the winding number along a vertical ray, exact for the posed triangles. Depth is the distance to the
nearest triangle of the solid's own skin, the fans left out: it can only be overstated, so nothing too deep passes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.core.skeleton import INDEX
from cabinpose.scene.contact.pairs import FLESH_M, PAIRS, SOLID_OF_SEGMENT, SOLIDS, Pair
from cabinpose.scene.contact.triangles import closest_on_triangle, crossing, height_over

SPACING_M = 0.025  # torso and thighs have edges up to 75 mm
LEAF = 32  # triangles to a box in the search for the nearest


@dataclass(frozen=True)
class SolidTopology:
    """How a skin mesh is cut into `SOLIDS`; rows of (start, end) per solid.

    faces: (F, 3) int32 of all solids, their skin first, then their fans · skin_rows, all_rows: (S, 2) into faces ·
    vertices: skin vertices of each solid (for its box), vertex_rows (S, 2) · own: vertices that belong to one solid each,
    own_rows (S, 2) · ring_vertices, ring_rows (C, 2): rings whose centres are vertices V, V+1, ... ·
    edges: (E, 2) of the skin, each once · order: (V,) skin vertices, neighbours near each other
    """

    faces: NDArray[np.int32]
    skin_rows: NDArray[np.int64]
    all_rows: NDArray[np.int64]
    vertices: NDArray[np.int32]
    vertex_rows: NDArray[np.int64]
    own: NDArray[np.int32]
    own_rows: NDArray[np.int64]
    ring_vertices: NDArray[np.int32]
    ring_rows: NDArray[np.int64]
    edges: NDArray[np.int32]
    order: NDArray[np.int32]


def _rows(parts: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    ends = np.cumsum([len(p) for p in parts])
    return np.stack((ends - [len(p) for p in parts], ends), axis=1).astype(np.int64)


def open_edges(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """(E, 2) directed edges (u, v) of faces (F, 3) whose opposite (v, u) is missing."""
    edges = np.stack((faces, np.roll(faces, -1, axis=1)), axis=2).reshape(-1, 2)
    count = int(faces.max()) + 1
    forward = edges[:, 0].astype(np.int64) * count + edges[:, 1]
    backward = edges[:, 1].astype(np.int64) * count + edges[:, 0]
    return np.asarray(edges[~np.isin(forward, backward)])


def _edges(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    ends = np.sort(np.concatenate((faces[:, (0, 1)], faces[:, (1, 2)], faces[:, (2, 0)])), axis=1)
    return np.ascontiguousarray(np.unique(ends, axis=0), np.int32)


def _components(edges: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """The edges of each connected ring."""
    label = {int(v): int(v) for v in np.unique(edges)}

    def root(v: int) -> int:
        while label[v] != v:
            label[v] = label[label[v]]
            v = label[v]
        return v

    for u, v in edges:
        label[root(int(u))] = root(int(v))
    roots = np.array([root(int(u)) for u in edges[:, 0]])
    return [edges[roots == r] for r in np.unique(roots)]


def _by_place(points: NDArray[np.floating], run: int = LEAF) -> NDArray[np.intp]:
    """An order of points (N, 3) in which every run is close together: halves along the widest axis, again and again."""
    order = np.arange(len(points))
    pending = [(0, len(points))]
    while pending:
        start, end = pending.pop()
        if end - start > run:
            part = order[start:end]
            axis = int(np.argmax(np.ptp(points[part], axis=0)))
            order[start:end] = part[np.argsort(points[part, axis], kind="stable")]
            middle = start + run * ((end - start) // (2 * run) or 1)
            pending += [(start, middle), (middle, end)]
    return order


def solid_topology(
    faces: NDArray[np.int32], segment: NDArray[np.uint8], segments: Sequence[str], skin: NDArray[np.floating]
) -> SolidTopology:
    """Cuts a skin (faces (F, 3), segment (V,) as index into `segments`) into `SOLIDS`, each closed by fans.

    skin: (V, 3) m, the vertices of any pose, to list triangles near each other together; results do not depend on it.
    """
    solid = np.array([SOLIDS.index(SOLID_OF_SEGMENT[name]) for name in segments])[segment]
    corner = solid[faces]
    # A face belongs where most of its corners do, one with three homes to the first.
    of_face = np.where(corner[:, 1] == corner[:, 2], corner[:, 1], corner[:, 0])
    skins, alls, vertices, owns, rings = [], [], [], [], []
    centre = len(segment)
    for s in range(len(SOLIDS)):
        own = faces[of_face == s]
        own = own[_by_place(skin[own].mean(axis=1))]
        closed = [own]
        if len(own):
            for ring in _components(open_edges(own)):
                fan = np.column_stack((ring[:, 1], ring[:, 0], np.full(len(ring), centre)))
                closed.append(fan.astype(np.int32))
                rings.append(np.unique(ring).astype(np.int32))
                centre += 1
        skins.append(own)
        alls.append(np.concatenate(closed))
        vertices.append(np.unique(own).astype(np.int32))
        owns.append(np.flatnonzero(solid == s).astype(np.int32))
    all_rows, edges = _rows(alls), _edges(faces)
    skin_rows = np.stack((all_rows[:, 0], all_rows[:, 0] + np.array([len(p) for p in skins], np.int64)), axis=1)
    return SolidTopology(
        np.ascontiguousarray(np.concatenate(alls), np.int32), skin_rows, all_rows,
        np.concatenate(vertices), _rows(vertices), np.concatenate(owns), _rows(owns),
        np.concatenate(rings) if rings else np.empty(0, np.int32), _rows(rings) if rings else np.empty((0, 2), np.int64),
        edges[_by_place(skin[edges].mean(axis=1))], _by_place(skin).astype(np.int32),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _close(skin, ring_vertices, ring_rows, vertices, vertex_rows):  # type: ignore[no-untyped-def]
    """The skin with the centres of its rings appended, and the box of each solid (S, 2, 3)."""
    count = len(skin)
    closed = np.empty((count + len(ring_rows), 3), np.float32)
    closed[:count] = skin
    for c in range(len(ring_rows)):
        x, y, z = 0.0, 0.0, 0.0
        for r in range(ring_rows[c, 0], ring_rows[c, 1]):
            v = ring_vertices[r]
            x, y, z = x + skin[v, 0], y + skin[v, 1], z + skin[v, 2]
        n = ring_rows[c, 1] - ring_rows[c, 0]
        closed[count + c, 0], closed[count + c, 1], closed[count + c, 2] = x / n, y / n, z / n
    boxes = np.empty((len(vertex_rows), 2, 3), np.float32)
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    for s in range(len(vertex_rows)):
        for r in range(vertex_rows[s, 0], vertex_rows[s, 1]):
            v = vertices[r]
            for axis in range(3):
                boxes[s, 0, axis] = min(boxes[s, 0, axis], skin[v, axis])
                boxes[s, 1, axis] = max(boxes[s, 1, axis], skin[v, axis])
    return closed, boxes


@njit(cache=True, nogil=True)
def _inside_box(points, index, box, centre, radius):  # type: ignore[no-untyped-def]
    """Which of the indexed points are in the box and not in the sphere."""
    chosen = np.empty(len(index), np.int32)
    n = 0
    keep_out = radius * radius
    for v in index:
        x, y, z = points[v, 0], points[v, 1], points[v, 2]
        if box[0, 0] < x < box[1, 0] and box[0, 1] < y < box[1, 1] and box[0, 2] < z < box[1, 2]:
            dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
            if dx * dx + dy * dy + dz * dz >= keep_out:
                chosen[n] = v
                n += 1
    return chosen[:n]


@njit(cache=True, nogil=True)
def _over(points, index, vertices, faces):  # type: ignore[no-untyped-def]
    """The faces that some vertical ray from the indexed points upwards can meet, with x0, x1, y0, y1, z1; and the area."""
    low_x, low_y, low_z, high_x, high_y = np.inf, np.inf, np.inf, -np.inf, -np.inf
    for v in index:
        x, y, z = points[v, 0], points[v, 1], points[v, 2]
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
        low_z = min(low_z, z)
    chosen = np.empty(len(faces), np.int32)
    bounds = np.empty((len(faces), 5), np.float32)
    n = 0
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        x0, x1 = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        y0, y1 = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        z1 = max(a[2], b[2], c[2])
        if x1 >= low_x and x0 <= high_x and y1 >= low_y and y0 <= high_y and z1 >= low_z:
            chosen[n] = f
            bounds[n, 0], bounds[n, 1], bounds[n, 2], bounds[n, 3], bounds[n, 4] = x0, x1, y0, y1, z1
            n += 1
    return chosen[:n], bounds[:n], (low_x, low_y, high_x, high_y)


@njit(cache=True, nogil=True)
def _columns(bounds, area, cell, nx, ny):  # type: ignore[no-untyped-def]
    """Rows of `bounds` by the column of an nx x ny grid that they cover, compressed rows."""
    starts = np.zeros(nx * ny + 1, np.int32)
    entries = np.empty(0, np.int32)
    for fill in range(2):
        for n in range(len(bounds)):
            i0 = min(max(int((bounds[n, 0] - area[0]) / cell), 0), nx - 1)
            i1 = min(max(int((bounds[n, 1] - area[0]) / cell), 0), nx - 1)
            j0 = min(max(int((bounds[n, 2] - area[1]) / cell), 0), ny - 1)
            j1 = min(max(int((bounds[n, 3] - area[1]) / cell), 0), ny - 1)
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    row = i * ny + j
                    if fill == 0:
                        starts[row + 1] += 1
                    else:
                        entries[starts[row]] = n
                        starts[row] += 1
        if fill == 0:
            for row in range(nx * ny):
                starts[row + 1] += starts[row]
            entries = np.empty(starts[-1], np.int32)
    for row in range(nx * ny, 0, -1):
        starts[row] = starts[row - 1]
    starts[0] = 0
    return starts, entries


@njit(cache=True, nogil=True)
def _leaf_boxes(vertices, faces):  # type: ignore[no-untyped-def]
    """Boxes (n, 2, 3) around every `LEAF` consecutive faces."""
    boxes = np.empty(((len(faces) + LEAF - 1) // LEAF, 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    for f in range(len(faces)):
        for corner in range(3):
            for axis in range(3):
                x = vertices[faces[f, corner], axis]
                boxes[f // LEAF, 0, axis] = min(boxes[f // LEAF, 0, axis], x)
                boxes[f // LEAF, 1, axis] = max(boxes[f // LEAF, 1, axis], x)
    return boxes


@njit(cache=True, nogil=True)
def _depth(x, y, z, vertices, faces, boxes, hint, enough):  # type: ignore[no-untyped-def]
    """Distance to the nearest face and its number; stops as soon as it is known to be at most `enough`."""
    a, b, c = vertices[faces[hint, 0]], vertices[faces[hint, 1]], vertices[faces[hint, 2]]
    best, face = closest_on_triangle(x, y, z, a, b, c)[0], hint
    stop = enough * enough
    for leaf in range(len(boxes)):
        if best <= stop:
            break
        box = boxes[leaf]
        dx = max(box[0, 0] - x, x - box[1, 0], 0.0)
        dy = max(box[0, 1] - y, y - box[1, 1], 0.0)
        dz = max(box[0, 2] - z, z - box[1, 2], 0.0)
        if dx * dx + dy * dy + dz * dz >= best:
            continue
        for f in range(leaf * LEAF, min((leaf + 1) * LEAF, len(faces))):
            a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
            d2 = closest_on_triangle(x, y, z, a, b, c)[0]
            if d2 < best:
                best, face = d2, f
    return math.sqrt(best), face


@njit(cache=True, nogil=True)
def _deepest(points, index, box, centre, radius, vertices, faces, skin_count, limits):  # type: ignore[no-untyped-def]
    """Excess of the worst indexed point in a solid beyond its own limit (m), its number and its depth; -1 where none.

    vertices, faces: the closed solid, whose first `skin_count` faces are skin. limits: (N,) depth allowed per point, or
    (1,) for all. Depths within the limit are not told apart.
    """
    nothing = (0.0, -1, 0.0)
    inside_box = _inside_box(points, index, box, centre, radius)
    if len(inside_box) == 0 or skin_count == 0:
        return nothing
    over, bounds, area = _over(points, inside_box, vertices, faces)
    if len(over) == 0:
        return nothing
    cell = max(0.012, math.sqrt((area[2] - area[0]) * (area[3] - area[1]) / 4096.0))
    nx, ny = int((area[2] - area[0]) / cell) + 1, int((area[3] - area[1]) / cell) + 1
    starts, entries = _columns(bounds, area, cell, nx, ny)
    worst, worst_point, worst_depth, hint = 0.0, -1, 0.0, 0
    boxes = np.empty((0, 2, 3))
    for v in inside_box:
        x, y, z = points[v, 0], points[v, 1], points[v, 2]
        row = min(int((x - area[0]) / cell), nx - 1) * ny + min(int((y - area[1]) / cell), ny - 1)
        winding = 0
        for e in range(starts[row], starts[row + 1]):
            n = entries[e]
            if z > bounds[n, 4] or x < bounds[n, 0] or x > bounds[n, 1] or y < bounds[n, 2] or y > bounds[n, 3]:
                continue
            f = over[n]
            a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
            sense = crossing(x, y, a, b, c)
            if sense != 0 and height_over(x, y, a, b, c) > z:
                winding += sense
        if winding > 0:
            limit = limits[v] if len(limits) > 1 else limits[0]
            if len(boxes) == 0:
                boxes = _leaf_boxes(vertices, faces[:skin_count])
            depth, hint = _depth(x, y, z, vertices, faces[:skin_count], boxes, hint, limit + worst)
            if depth - limit > worst:
                worst, worst_point, worst_depth = depth - limit, v, depth
    return worst, worst_point, worst_depth


@njit(cache=True, nogil=True)
def _sampled_skin(skin, order, edges, spacing):  # type: ignore[no-untyped-def]
    """The vertices in `order`, then points along the edges longer than `spacing`; and a vertex near each point."""
    count = len(order)
    square = np.float32(spacing * spacing)
    for e in range(len(edges)):
        a, b = skin[edges[e, 0]], skin[edges[e, 1]]
        s = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2
        if s > square:
            count += math.ceil(math.sqrt(s) / spacing) - 1
    points = np.empty((count, 3), np.float32)
    owner = np.empty(count, np.int32)
    for n in range(len(order)):
        owner[n] = order[n]
        points[n, 0], points[n, 1], points[n, 2] = skin[order[n], 0], skin[order[n], 1], skin[order[n], 2]
    at = len(order)
    for e in range(len(edges)):
        a, b = skin[edges[e, 0]], skin[edges[e, 1]]
        s = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2
        if s > square:
            pieces = math.ceil(math.sqrt(s) / spacing)
            for n in range(1, pieces):
                t = n / pieces
                for axis in range(3):
                    points[at, axis] = a[axis] + t * (b[axis] - a[axis])
                owner[at] = edges[e, 0]
                at += 1
    return points, owner


class SolidContact(NamedTuple):
    """A point in a solid: which solid, depth (m) and excess over what is allowed (m), number and place of the point."""

    solid: str
    depth_m: float
    excess_m: float
    point: int
    where: NDArray[np.float64]


_NOWHERE = np.zeros(3)


@dataclass(frozen=True)
class PosedSolids:
    """The solids of one posed body, vehicle frame. vertices: (V + C, 3) float32 · boxes: (S, 2, 3) · box: (2, 3)."""

    topology: SolidTopology
    vertices: NDArray[np.float32]
    boxes: NDArray[np.float32]
    box: NDArray[np.float32]

    @classmethod
    def of(cls, topology: SolidTopology, skin: NDArray[np.float32]) -> PosedSolids:
        """The solids of a skin (V, 3) m."""
        t = topology
        vertices, boxes = _close(skin, t.ring_vertices, t.ring_rows, t.vertices, t.vertex_rows)
        return cls(topology, vertices, boxes, np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0))))

    def deepest(
        self,
        solid: int,
        points: NDArray[np.float32],
        index: NDArray[np.int32],
        limits: NDArray[np.float64],
        centre: NDArray[np.float64] = _NOWHERE,
        radius: float = 0.0,
    ) -> SolidContact | None:
        """The indexed point of (N, 3) that goes farthest beyond its limit into a solid; None where none does.

        Points within `radius` of `centre` are left out.
        """
        t = self.topology
        (start, end), skin_end = t.all_rows[solid], t.skin_rows[solid, 1]
        excess, point, depth = _deepest(
            points, index, self.boxes[solid], centre, radius, self.vertices, t.faces[start:end], skin_end - start, limits
        )
        if point < 0:
            return None
        return SolidContact(SOLIDS[solid], depth, excess, point, points[point].astype(np.float64))

    def solid_of(self, vertex: int) -> str:
        """The solid that a skin vertex belongs to."""
        t = self.topology
        at = int(np.flatnonzero(t.own == vertex)[0])
        return SOLIDS[int(np.searchsorted(t.own_rows[:, 1], at, side="right"))]

    def skin_points(self) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Points (N, 3) of the skin no farther apart than `SPACING_M` along its edges, and a vertex (N,) near each."""
        points, vertex = _sampled_skin(self.vertices, self.topology.order, self.topology.edges, SPACING_M)
        return points, vertex

    def own(self, solid: int) -> NDArray[np.int32]:
        """The skin vertices that belong to a solid."""
        start, end = self.topology.own_rows[solid]
        return self.topology.own[start:end]


def self_contact(body: PosedSolids, joints: NDArray[np.float64]) -> tuple[Pair, SolidContact] | None:
    """The first pair of `PAIRS` whose solids overlap beyond its tolerance, and where; None where none does.

    joints: (20, 3) m of the same body in the order of `core.skeleton.JOINTS`.
    """
    meet = _meet(body.boxes, body.boxes)
    for pair, limits, one, two in _INDEXED_PAIRS:
        if not meet[one, two]:
            continue
        centre, radius = _NOWHERE, 0.0
        if pair.joint:
            centre = joints[INDEX[pair.joint]]
            radius = pair.zone * float(np.linalg.norm(joints[INDEX[pair.end]] - centre))
        for into, of in ((one, two), (two, one)):
            found = body.deepest(into, body.vertices, body.own(of), limits, centre, radius)
            if found is not None:
                return pair, found
    return None


_INDEXED_PAIRS = tuple((p, np.array([p.tolerance_m]), SOLIDS.index(p.one), SOLIDS.index(p.two)) for p in PAIRS)
_FLESH = np.array([FLESH_M])


def person_contact(one: PosedSolids, two: PosedSolids) -> tuple[str, SolidContact] | None:
    """Where two bodies overlap deeper than `FLESH_M`: the solid that goes in and the contact; None where they do not."""
    if not _meet(one.box[None], two.box[None])[0, 0]:
        return None
    for body, other in ((one, two), (two, one)):
        for into, of in np.argwhere(_meet(body.boxes, other.boxes)):
            found = body.deepest(into, other.vertices, other.own(of), _FLESH)
            if found is not None:
                return SOLIDS[of], found
    return None


def _meet(one: NDArray[np.float32], two: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(A, B) whether boxes one (A, 2, 3) and two (B, 2, 3) overlap."""
    return np.asarray(((one[:, None, 0] < two[None, :, 1]) & (two[None, :, 0] < one[:, None, 1])).all(axis=2))
