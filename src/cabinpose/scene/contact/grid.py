"""Kernels of the clearance fields: distances at the nodes of a grid, their signs, what lies beyond, interpolation."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cabinpose.scene.contact.triangles import closest_on_triangle, crossing, height_over

RUN = 32  # points to a ball; meshes number neighbours near each other


@njit(cache=True, nogil=True)
def splat(corners, origin, step, reach, distance):  # type: ignore[no-untyped-def]
    """Squared distance at the nodes within `reach` of each triangle."""
    dims = distance.shape
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        for axis in range(3):
            x = corners[t, :, axis]
            low[axis] = max(math.ceil((x.min() - reach - origin[axis]) / step), 0)
            high[axis] = min(math.floor((x.max() + reach - origin[axis]) / step), dims[axis] - 1)
        nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        limit = reach * math.sqrt(nx * nx + ny * ny + nz * nz)
        for i in range(low[0], high[0] + 1):
            px = origin[0] + i * step
            for j in range(low[1], high[1] + 1):
                py = origin[1] + j * step
                for k in range(low[2], high[2] + 1):
                    pz = origin[2] + k * step
                    if abs(nx * (px - a[0]) + ny * (py - a[1]) + nz * (pz - a[2])) > limit:
                        continue
                    d2 = closest_on_triangle(px, py, pz, a, b, c)[0]
                    if d2 <= reach * reach and d2 < distance[i, j, k]:
                        distance[i, j, k] = d2


@njit(cache=True, nogil=True)
def fill(values, exact, step, band):  # type: ignore[no-untyped-def]
    """Clearance at the nodes that are not exact, summed up step by step from those that are (chamfer, Borgefors 1986).

    Two passes over half of the 26 neighbours each. A path over neighbours is never shorter than the straight way.
    """
    ni, nj, nk = values.shape
    ways = np.empty((13, 3), np.int64)
    length = np.empty(13, np.float32)
    for n in range(13):
        ways[n, 0], ways[n, 1], ways[n, 2] = n // 9 - 1, n // 3 % 3 - 1, n % 3 - 1
        length[n] = step * math.sqrt((ways[n] ** 2).sum())
    for direction in (1, -1):
        for i in range(ni) if direction > 0 else range(ni - 1, -1, -1):
            for j in range(nj) if direction > 0 else range(nj - 1, -1, -1):
                border = i in (0, ni - 1) or j in (0, nj - 1)
                for k in range(nk) if direction > 0 else range(nk - 1, -1, -1):
                    if exact[i, j, k]:
                        continue
                    size = min(abs(values[i, j, k]), band)
                    checked = border or k in (0, nk - 1)
                    for n in range(13):
                        u, v, w = i + direction * ways[n, 0], j + direction * ways[n, 1], k + direction * ways[n, 2]
                        if not checked or (0 <= u < ni and 0 <= v < nj and 0 <= w < nk):
                            size = min(size, abs(values[u, v, w]) + length[n])
                    values[i, j, k] = math.copysign(size, values[i, j, k])


@njit(cache=True, nogil=True)
def winding_at_nodes(corners, origin, step, dims):  # type: ignore[no-untyped-def]
    """How often the surface winds around each node, from its crossings with the vertical grid lines."""
    winding = np.zeros((dims[0], dims[1], dims[2]), np.int8)
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        i0 = max(math.ceil((corners[t, :, 0].min() - origin[0]) / step), 0)
        i1 = min(math.floor((corners[t, :, 0].max() - origin[0]) / step), dims[0] - 1)
        j0 = max(math.ceil((corners[t, :, 1].min() - origin[1]) / step), 0)
        j1 = min(math.floor((corners[t, :, 1].max() - origin[1]) / step), dims[1] - 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                px, py = origin[0] + i * step, origin[1] + j * step
                sense = crossing(px, py, a, b, c)
                if sense != 0:
                    top = min(math.floor((height_over(px, py, a, b, c) - origin[2]) / step), dims[2] - 1)
                    if top >= 0:
                        winding[i, j, top] += sense
    for i in range(dims[0]):
        for j in range(dims[1]):
            for k in range(dims[2] - 2, -1, -1):
                winding[i, j, k] += winding[i, j, k + 1]
    return winding


@njit(cache=True, nogil=True)
def merge_part(distance, winding, closed, offset, give, values, exact):  # type: ignore[no-untyped-def]
    """Lowers the group's clearance to that of one part: its distance where one was measured, else far outside or inside."""
    ni, nj, nk = distance.shape
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                measured = distance[i, j, k] < np.inf
                inside = closed and winding[i, j, k] > 0
                if not measured and not inside:
                    continue
                d = math.sqrt(distance[i, j, k])
                value = (-d if inside else d) + give
                at = (i + offset[0], j + offset[1], k + offset[2])
                if value < values[at]:
                    values[at] = value
                    exact[at] = measured


@njit(cache=True, nogil=True)
def reach_free(values, seeds, free_level, pass_level, steps):  # type: ignore[no-untyped-def]
    """Nodes reached from the seeds through the clear, and `steps` nodes on; and whether the grid's border was reached."""
    ni, nj, nk = values.shape
    free = np.zeros(values.shape, np.bool_)
    queue = np.empty((values.size, 3), np.int16)
    last = 0
    for s in range(len(seeds)):
        i, j, k = seeds[s]
        if 0 <= i < ni and 0 <= j < nj and 0 <= k < nk and values[i, j, k] >= free_level and not free[i, j, k]:
            free[i, j, k] = True
            queue[last, 0], queue[last, 1], queue[last, 2] = i, j, k
            last += 1
    open_border = False
    head = 0
    while head < last:
        i, j, k = np.int64(queue[head, 0]), np.int64(queue[head, 1]), np.int64(queue[head, 2])
        head += 1
        open_border = open_border or i == 0 or j == 0 or k == 0 or i == ni - 1 or j == nj - 1 or k == nk - 1
        for n in range(6):
            a, b, c = i, j, k
            d = 1 - 2 * (n & 1)
            if n < 2:
                a += d
            elif n < 4:
                b += d
            else:
                c += d
            if 0 <= a < ni and 0 <= b < nj and 0 <= c < nk and not free[a, b, c] and values[a, b, c] >= free_level:
                free[a, b, c] = True
                queue[last, 0], queue[last, 1], queue[last, 2] = a, b, c
                last += 1
    first = 0
    for _ in range(steps):
        start = last
        for n in range(first, start):
            i, j, k = np.int64(queue[n, 0]), np.int64(queue[n, 1]), np.int64(queue[n, 2])
            for way in range(27):
                a, b, c = i + way // 9 - 1, j + way // 3 % 3 - 1, k + way % 3 - 1
                on_grid = 0 <= a < ni and 0 <= b < nj and 0 <= c < nk
                if on_grid and not free[a, b, c] and values[a, b, c] >= pass_level:
                    free[a, b, c] = True
                    queue[last, 0], queue[last, 1], queue[last, 2] = a, b, c
                    last += 1
        first = start
    return free, open_border


@njit(cache=True, nogil=True, inline="always")
def _interpolate(x, y, z, m, origin, step, outside, values):  # type: ignore[no-untyped-def]
    """Trilinear value at a point of the vehicle frame, `outside` beyond the grid."""
    ni, nj, nk = values.shape
    u = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] - origin[0]) / step
    v = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] - origin[1]) / step
    w = (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3] - origin[2]) / step
    if not (0.0 <= u < ni - 1 and 0.0 <= v < nj - 1 and 0.0 <= w < nk - 1):
        return outside
    i, j, k = int(u), int(v), int(w)
    fu, fv, fw = u - i, v - j, w - k
    low = (values[i, j, k] * (1.0 - fu) + values[i + 1, j, k] * fu) * (1.0 - fv)
    low += (values[i, j + 1, k] * (1.0 - fu) + values[i + 1, j + 1, k] * fu) * fv
    high = (values[i, j, k + 1] * (1.0 - fu) + values[i + 1, j, k + 1] * fu) * (1.0 - fv)
    high += (values[i, j + 1, k + 1] * (1.0 - fu) + values[i + 1, j + 1, k + 1] * fu) * fv
    return low * (1.0 - fw) + high * fw


@njit(cache=True, nogil=True)
def sample(points, group_from_vehicle, origin, step, quantum, outside, values, clearance):  # type: ignore[no-untyped-def]
    """Lowers `clearance` (N,) at points (N, 3) to the field's value; `outside` (m) beyond the grid."""
    for n in range(len(points)):
        value = _interpolate(
            points[n, 0], points[n, 1], points[n, 2], group_from_vehicle, origin, step, outside / quantum, values
        )
        clearance[n] = min(clearance[n], value * quantum)


@njit(cache=True, nogil=True)
def balls_of(points):  # type: ignore[no-untyped-def]
    """Centre and radius (ceil(N / RUN), 4) of balls around every `RUN` consecutive points of (N, 3)."""
    balls = np.empty(((len(points) + RUN - 1) // RUN, 4))
    for b in range(len(balls)):
        start, end = b * RUN, min((b + 1) * RUN, len(points))
        low_x, low_y, low_z = points[start, 0], points[start, 1], points[start, 2]
        high_x, high_y, high_z = low_x, low_y, low_z
        for n in range(start + 1, end):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
            high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
        balls[b, 0], balls[b, 1], balls[b, 2] = (low_x + high_x) / 2.0, (low_y + high_y) / 2.0, (low_z + high_z) / 2.0
        balls[b, 3] = math.sqrt((high_x - low_x) ** 2 + (high_y - low_y) ** 2 + (high_z - low_z) ** 2) / 2.0
    return balls


@njit(cache=True, nogil=True)
def points_below(points, balls, group_from_vehicle, origin, step, quantum, outside, values, threshold, seal):  # type: ignore[no-untyped-def]
    """The points (N, 3) whose value is below `threshold` (m): their numbers and their values (m)."""
    index = np.empty(len(points), np.int64)
    clearance = np.empty(len(points))
    count = 0
    m = group_from_vehicle
    ends = np.array(values.shape) * step
    for b in range(len(balls)):
        x, y, z, r = balls[b]
        u = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] - origin[0]
        v = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] - origin[1]
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3] - origin[2]
        if outside >= threshold and not (-r < u < ends[0] + r and -r < v < ends[1] + r and -r < w < ends[2] + r):
            continue
        # Clearance changes by no more than the way there: a ball whose centre is clear enough has no point below, nor
        # one behind a gap that counts as closed.
        centre = _interpolate(x, y, z, m, origin, step, -np.inf, values) * quantum
        if centre - step - r >= max(threshold, seal):
            continue
        for n in range(b * RUN, min((b + 1) * RUN, len(points))):
            value = quantum * _interpolate(points[n, 0], points[n, 1], points[n, 2], m, origin, step, outside / quantum, values)
            if value < threshold:
                index[count], clearance[count] = n, value
                count += 1
    return index[:count], clearance[:count]


@njit(cache=True, nogil=True)
def points_in_boxes(points, vehicle_from_group, box, boxes):  # type: ignore[no-untyped-def]
    """The points of a group in a box of the vehicle frame: (n, 3) float32 there, their numbers, which `boxes` hold any."""
    m = vehicle_from_group
    inside = np.empty((len(points), 3), np.float32)
    chosen = np.empty(len(points), np.int32)
    met = np.zeros(len(boxes), np.bool_)
    n = 0
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        u = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        v = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if not (box[0, 0] < u < box[1, 0] and box[0, 1] < v < box[1, 1] and box[0, 2] < w < box[1, 2]):
            continue
        inside[n, 0], inside[n, 1], inside[n, 2] = u, v, w
        chosen[n] = p
        n += 1
        for s in range(len(boxes)):
            met[s] = met[s] or (
                boxes[s, 0, 0] < u < boxes[s, 1, 0]
                and boxes[s, 0, 1] < v < boxes[s, 1, 1]
                and boxes[s, 0, 2] < w < boxes[s, 1, 2]
            )
    return inside[:n], chosen[:n], met
