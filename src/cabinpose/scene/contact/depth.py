"""Kernels of the closed solids of a posed body: which points are inside one, and how deep.

Inside is the winding number along a vertical ray, depth the distance to the nearest triangle of a solid's own skin.
Both searches pass over runs of `LEAF` neighbouring triangles whose box is out of the way.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.scene.contact.grid import points_in_boxes
from cabinpose.scene.contact.triangles import closest_on_triangle, crossing, height_over

LEAF = 32  # triangles to a box in the search for the nearest


class SolidArrays(NamedTuple):
    """A posed body for the kernels; S solids, rows of (start, end).

    vertices: (V, 3) float32 m · boxes: (S, 2, 3) · faces, all_rows, skin_rows, own, own_rows: of `SolidTopology` ·
    leaf_rows: (S, 2) into leaves (L, 2, 3), boxes around every `LEAF` faces of a solid, made when they are first asked
    for: ready (S,).
    """

    vertices: NDArray[np.float32]
    boxes: NDArray[np.float32]
    faces: NDArray[np.int32]
    all_rows: NDArray[np.int64]
    skin_rows: NDArray[np.int64]
    own: NDArray[np.int32]
    own_rows: NDArray[np.int64]
    leaf_rows: NDArray[np.int64]
    leaves: NDArray[np.float64]
    ready: NDArray[np.bool_]


@njit(cache=True, nogil=True)
def close_solids(skin, ring_vertices, ring_rows, vertices, vertex_rows):  # type: ignore[no-untyped-def]
    """The skin with the centres of its rings appended, the box of each solid (S, 2, 3) and that of all (2, 3)."""
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
    box = np.empty((2, 3), np.float32)
    box[0], box[1] = np.inf, -np.inf
    for s in range(len(vertex_rows)):
        for r in range(vertex_rows[s, 0], vertex_rows[s, 1]):
            v = vertices[r]
            for axis in range(3):
                boxes[s, 0, axis] = min(boxes[s, 0, axis], skin[v, axis])
                boxes[s, 1, axis] = max(boxes[s, 1, axis], skin[v, axis])
        for axis in range(3):
            box[0, axis], box[1, axis] = min(box[0, axis], boxes[s, 0, axis]), max(box[1, axis], boxes[s, 1, axis])
    return closed, boxes, box


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
def _over(points, index, vertices, faces, leaves):  # type: ignore[no-untyped-def]
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
    for leaf in range(len(leaves)):
        box = leaves[leaf]
        if box[1, 0] < low_x or box[0, 0] > high_x or box[1, 1] < low_y or box[0, 1] > high_y or box[1, 2] < low_z:
            continue
        for f in range(leaf * LEAF, min((leaf + 1) * LEAF, len(faces))):
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
def _leaves_of(body, solid):  # type: ignore[no-untyped-def]
    """Boxes (n, 2, 3) around every `LEAF` consecutive faces of a solid."""
    first = body.leaf_rows[solid, 0]
    boxes = body.leaves[first : body.leaf_rows[solid, 1]]
    if body.ready[solid]:
        return boxes
    body.ready[solid] = True
    start, end = body.all_rows[solid]
    for leaf in range(len(boxes)):
        low_x, low_y, low_z, high_x, high_y, high_z = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
        for f in range(start + leaf * LEAF, min(start + (leaf + 1) * LEAF, end)):
            for corner in range(3):
                v = body.faces[f, corner]
                x, y, z = body.vertices[v, 0], body.vertices[v, 1], body.vertices[v, 2]
                low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
                high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
        boxes[leaf, 0, 0], boxes[leaf, 0, 1], boxes[leaf, 0, 2] = low_x, low_y, low_z
        boxes[leaf, 1, 0], boxes[leaf, 1, 1], boxes[leaf, 1, 2] = high_x, high_y, high_z
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
def deepest_in(points, index, solid, centre, radius, limits, body):  # type: ignore[no-untyped-def]
    """Excess of the worst indexed point in a solid beyond its own limit (m), its number and its depth; -1 where none.

    limits: (N,) depth allowed per point, or (1,) for all. Points within `radius` of `centre` are left out. Depths
    within the limit are not told apart.
    """
    nothing = (0.0, -1, 0.0)
    start, end = body.all_rows[solid]
    skin_count = body.skin_rows[solid, 1] - start
    inside_box = _inside_box(points, index, body.boxes[solid], centre, radius)
    if len(inside_box) == 0 or skin_count == 0:
        return nothing
    vertices, faces, leaves = body.vertices, body.faces[start:end], _leaves_of(body, solid)
    over, bounds, area = _over(points, inside_box, vertices, faces, leaves)
    if len(over) == 0:
        return nothing
    cell = max(0.012, math.sqrt((area[2] - area[0]) * (area[3] - area[1]) / 4096.0))
    nx, ny = int((area[2] - area[0]) / cell) + 1, int((area[3] - area[1]) / cell) + 1
    starts, entries = _columns(bounds, area, cell, nx, ny)
    worst, worst_point, worst_depth, hint = 0.0, -1, 0.0, 0
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
            # The last leaf may hold some of the fan: its box is then larger than it need be.
            limit = limits[v] if len(limits) > 1 else limits[0]
            depth, hint = _depth(x, y, z, vertices, faces[:skin_count], leaves, hint, limit + worst)
            if depth - limit > worst:
                worst, worst_point, worst_depth = depth - limit, v, depth
    return worst, worst_point, worst_depth


@njit(cache=True, nogil=True, inline="always")
def _meet(one, two):  # type: ignore[no-untyped-def]
    """Whether two boxes (2, 3) overlap."""
    x = one[0, 0] < two[1, 0] and two[0, 0] < one[1, 0]
    y = one[0, 1] < two[1, 1] and two[0, 1] < one[1, 1]
    return x and y and one[0, 2] < two[1, 2] and two[0, 2] < one[1, 2]


@njit(cache=True, nogil=True)
def first_of_pairs(body, pairs, tolerances, joint_ends, zones, joints):  # type: ignore[no-untyped-def]
    """The first of `pairs` (P, 2) that overlaps beyond its tolerance: its number, the solid gone into, `deepest_in`; -1.

    joint_ends: (P, 2) joint and end of the zone (radius `zones` times their distance) that is left out, or -1.
    """
    nowhere = np.zeros(3)
    limits = np.empty(1)
    for p in range(len(pairs)):
        if not _meet(body.boxes[pairs[p, 0]], body.boxes[pairs[p, 1]]):
            continue
        centre, radius = nowhere, 0.0
        if joint_ends[p, 0] >= 0:
            centre = joints[joint_ends[p, 0]]
            way = joints[joint_ends[p, 1]] - centre
            radius = zones[p] * math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
        limits[0] = tolerances[p]
        for side in range(2):
            into, of = pairs[p, side], pairs[p, 1 - side]
            own = body.own[body.own_rows[of, 0] : body.own_rows[of, 1]]
            excess, point, depth = deepest_in(body.vertices, own, into, centre, radius, limits, body)
            if point >= 0:
                return p, into, excess, point, depth
    return -1, -1, 0.0, -1, 0.0


@njit(cache=True, nogil=True)
def first_between(body, other, limits):  # type: ignore[no-untyped-def]
    """The first solid of `body` with a point of a solid of `other` deeper than `limits` (1,): both, `deepest_in`; -1."""
    nowhere = np.zeros(3)
    for into in range(len(body.boxes)):
        for of in range(len(other.boxes)):
            if not _meet(body.boxes[into], other.boxes[of]):
                continue
            own = other.own[other.own_rows[of, 0] : other.own_rows[of, 1]]
            excess, point, depth = deepest_in(other.vertices, own, into, nowhere, 0.0, limits, body)
            if point >= 0:
                return into, of, excess, point, depth
    return -1, -1, 0.0, -1, 0.0


@njit(cache=True, nogil=True)
def first_probe(probes, balls, gives, vehicle_from_group, box, tolerance, body):  # type: ignore[no-untyped-def]
    """The first solid that a probe of a group goes into deeper than its give + `tolerance`.

    Its number, the probe's number and place (3,), depth and excess; -1 where there is none. box: (2, 3) around the body
    · balls: `balls_of(probes)`.
    """
    points, chosen, met = points_in_boxes(probes, balls, vehicle_from_group, box, body.boxes)
    nowhere = np.zeros(3)
    if len(chosen) == 0:
        return -1, -1, nowhere, 0.0, 0.0
    limits, index = np.empty(len(chosen)), np.arange(len(chosen)).astype(np.int32)
    for n in range(len(chosen)):
        limits[n] = gives[chosen[n]] + tolerance
    least = limits.min()
    for solid in range(len(met)):
        # Nothing is deeper in a body than half its least extent: a hand need not be asked about foam.
        extent = body.boxes[solid, 1] - body.boxes[solid, 0]
        if met[solid] and np.float32(0.5) * extent.min() > least:
            excess, point, depth = deepest_in(points, index, solid, nowhere, 0.0, limits, body)
            if point >= 0:
                return solid, chosen[point], points[point].astype(np.float64), depth, excess
    return -1, -1, nowhere, 0.0, 0.0


@njit(cache=True, nogil=True)
def sampled_skin(skin, order, edges, spacing):  # type: ignore[no-untyped-def]
    """The vertices in `order`, then points along the edges longer than `spacing`; and a vertex near each point."""
    count = len(order)
    square = np.float32(spacing * spacing)
    long = np.empty(len(edges), np.int32)
    n_long = 0
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        s = (skin[j, 0] - skin[i, 0]) ** 2 + (skin[j, 1] - skin[i, 1]) ** 2 + (skin[j, 2] - skin[i, 2]) ** 2
        if s > square:
            count += math.ceil(math.sqrt(s) / spacing) - 1
            long[n_long] = e
            n_long += 1
    points = np.empty((count, 3), np.float32)
    owner = np.empty(count, np.int32)
    for n in range(len(order)):
        owner[n] = order[n]
        points[n, 0], points[n, 1], points[n, 2] = skin[order[n], 0], skin[order[n], 1], skin[order[n], 2]
    at = len(order)
    for e in long[:n_long]:
        a, b = skin[edges[e, 0]], skin[edges[e, 1]]
        s = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2
        pieces = math.ceil(math.sqrt(s) / spacing)
        for n in range(1, pieces):
            t = n / pieces
            for axis in range(3):
                points[at, axis] = a[axis] + t * (b[axis] - a[axis])
            owner[at] = edges[e, 0]
            at += 1
    return points, owner
