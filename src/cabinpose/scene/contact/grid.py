"""Kernels of the clearance fields: distances at the nodes of a grid, their signs, what lies beyond, interpolation."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.scene.contact.triangles import crossing, height_over

RUN = 32  # points to a ball; meshes number neighbours near each other


@njit(cache=True, nogil=True)
def splat(corners, origin, step, below, above, distance):  # type: ignore[no-untyped-def]
    """Squared distance at the nodes within `below` of each triangle behind it, and within `above` before it.

    Of the triangles that are nearest to a node of a closed surface at least one has the node on its proper side.
    The closest point by Voronoi regions (Ericson 2005, section 5.1.5). What does not change over the nodes of a triangle
    is computed once, and a node is passed over where the triangle's plane is no nearer than what was found before.
    """
    dims = distance.shape
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    reach = max(below, above)
    within = reach * reach
    for t in range(len(corners)):
        ax, ay, az = corners[t, 0]
        bx, by, bz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
        cx, cy, cz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
        for axis in range(3):
            x = corners[t, :, axis]
            low[axis] = max(math.ceil((x.min() - reach - origin[axis]) / step), 0)
            high[axis] = min(math.floor((x.max() + reach - origin[axis]) / step), dims[axis] - 1)
        bb, bc, cc = bx * bx + by * by + bz * bz, bx * cx + by * cy + bz * cz, cx * cx + cy * cy + cz * cz
        nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        nn = nx * nx + ny * ny + nz * nz
        size, per_area = math.sqrt(nn), 1.0 / nn if nn > 0.0 else 0.0
        lowest, highest = -below * size, above * size
        rise = nz * step
        for i in range(low[0], high[0] + 1):
            x = origin[0] + i * step - ax
            for j in range(low[1], high[1] + 1):
                y = origin[1] + j * step - ay
                z0 = origin[2] - az
                # The nodes of this column between the planes at `below` and `above`.
                over = nx * x + ny * y + nz * z0
                first, last = low[2], high[2]
                if abs(rise) > 1e-9 * step * size:
                    one, two = (lowest - over) / rise, (highest - over) / rise
                    first = max(first, math.ceil(min(one, two)))
                    last = min(last, math.floor(max(one, two)))
                elif not lowest <= over <= highest:
                    continue
                for k in range(first, last + 1):
                    height = over + k * rise
                    flat = height * height * per_area
                    if flat >= distance[i, j, k]:
                        continue
                    z = z0 + k * step
                    d1, d2 = bx * x + by * y + bz * z, cx * x + cy * y + cz * z
                    d3, d4, d5, d6 = d1 - bb, d2 - bc, d1 - bc, d2 - cc
                    pp = x * x + y * y + z * z
                    if d1 <= 0.0 and d2 <= 0.0:
                        square = pp
                    elif d3 >= 0.0 and d4 <= d3:
                        square = pp - 2.0 * d1 + bb
                    elif d6 >= 0.0 and d5 <= d6:
                        square = pp - 2.0 * d2 + cc
                    elif d1 >= 0.0 and d3 <= 0.0 and d1 * d4 <= d3 * d2:
                        square = pp - d1 * d1 / bb
                    elif d2 >= 0.0 and d6 <= 0.0 and d5 * d2 <= d1 * d6:
                        square = pp - d2 * d2 / cc
                    elif d4 >= d3 and d5 >= d6 and d3 * d6 <= d5 * d4:
                        along = d4 - d3
                        square = pp - 2.0 * d1 + bb - along * along / (along + d5 - d6)
                    else:
                        square = flat
                    if square <= within and square < distance[i, j, k]:
                        distance[i, j, k] = max(square, 0.0)


@njit(cache=True, nogil=True)
def _lower_to_row(other, straight, diagonal, best):  # type: ignore[no-untyped-def]
    """Lowers `best` to the clearance in the row beside it and the way from there."""
    last = len(best) - 1
    best[0] = min(best[0], abs(other[0]) + straight, abs(other[min(1, last)]) + diagonal)
    best[last] = min(best[last], abs(other[last]) + straight, abs(other[max(last - 1, 0)]) + diagonal)
    for k in range(1, last):
        aslant = min(abs(other[k - 1]), abs(other[k + 1])) + diagonal
        best[k] = min(best[k], abs(other[k]) + straight, aslant)


@njit(cache=True, nogil=True)
def fill(values, exact, step, band):  # type: ignore[no-untyped-def]
    """Clearance at the nodes that are not exact, summed up step by step from those that are (chamfer, Borgefors 1986).

    Two passes over half of the 26 neighbours each, row by row. A path over neighbours is never shorter than the straight
    way. Nor is what one part leaves free more than what all do: exact clearance gives way to a path, exact depth does not.
    """
    ni, nj, nk = values.shape
    one, two, three = np.float32(step), np.float32(step * math.sqrt(2.0)), np.float32(step * math.sqrt(3.0))
    best = np.empty(nk, np.float32)
    for direction in (1, -1):
        for row in range(ni * nj):
            at = row if direction > 0 else ni * nj - 1 - row
            i, j = at // nj, at % nj
            best[:] = band
            before = i - direction
            if 0 <= before < ni:
                for beside in range(max(j - 1, 0), min(j + 2, nj)):
                    if beside == j:
                        _lower_to_row(values[before, beside], one, two, best)
                    else:
                        _lower_to_row(values[before, beside], two, three, best)
            if 0 <= j - direction < nj:
                _lower_to_row(values[i, j - direction], one, two, best)
            previous = np.float32(band)
            for n in range(nk):
                k = n if direction > 0 else nk - 1 - n
                own = values[i, j, k]
                if exact[i, j, k] and own <= 0.0:
                    previous = -own
                else:
                    previous = min(abs(own), best[k], previous + one)
                    values[i, j, k] = math.copysign(previous, own)


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
def merge_part(distance, winding, closed, offset, give, above, values, exact):  # type: ignore[no-untyped-def]
    """Lowers the group's clearance to that of one part: its distance where one was measured, else far outside or inside.

    Outside a closed part distances are measured up to `above` only (see `splat`).
    """
    ni, nj, nk = distance.shape
    farthest = (above * above) * (1.0 + 1e-6)  # distances are rounded to float32
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                inside = closed and winding[i, j, k] > 0
                measured = distance[i, j, k] < (np.inf if inside or not closed else farthest)
                if not measured and not inside:
                    continue
                d = math.sqrt(distance[i, j, k])
                value = (-d if inside else d) + give
                at = (i + offset[0], j + offset[1], k + offset[2])
                if value < values[at]:
                    values[at] = value
                    exact[at] = measured


@njit(cache=True, nogil=True)
def bit_rows(values, level):  # type: ignore[no-untyped-def]
    """Which nodes of (ni, nj, nk) are at least `level`: (ni, nj, ceil(nk / 64)) words of 64 nodes along the last axis."""
    ni, nj, nk = values.shape
    bits = np.zeros((ni, nj, (nk + 63) // 64), np.uint64)
    for i in range(ni):
        for j in range(nj):
            for w in range(bits.shape[2]):
                word = np.uint64(0)
                for k in range(64 * w, min(64 * w + 64, nk)):
                    word |= np.uint64(values[i, j, k] >= level) << np.uint64(k - 64 * w)
                bits[i, j, w] = word
    return bits


@njit(cache=True, nogil=True)
def _spread_along(seed, clear):  # type: ignore[no-untyped-def]
    """A word's seeds, carried over the runs of clear nodes that they lie in (parallel prefix, Kogge & Stone 1973)."""
    up, down, way_up, way_down = seed, seed, clear, clear
    for n in range(6):
        by = np.uint64(1 << n)
        up |= way_up & (up << by)
        way_up &= way_up << by
        down |= way_down & (down >> by)
        way_down &= way_down >> by
    return up | down


@njit(cache=True, nogil=True)
def flood(clear, seeds, nk):  # type: ignore[no-untyped-def]
    """Nodes reached from the seeds (S, 3) over faces of clear ones, as `bit_rows`; and whether the grid's border was reached."""
    ni, nj, words = clear.shape
    reached = np.zeros(clear.shape, np.uint64)
    queue, queued = np.empty(ni * nj, np.int64), np.zeros(ni * nj, np.bool_)
    head = waiting = 0
    one, high = np.uint64(1), np.uint64(63)
    for s in range(len(seeds)):
        i, j, k = seeds[s]
        if 0 <= i < ni and 0 <= j < nj and 0 <= k < nk:
            reached[i, j, k // 64] |= clear[i, j, k // 64] & (one << np.uint64(k % 64))
            if not queued[i * nj + j]:
                queued[i * nj + j] = True
                queue[waiting] = i * nj + j
                waiting += 1
    open_border = False
    while waiting:
        row = queue[head]
        head, waiting = (head + 1) % len(queue), waiting - 1
        queued[row] = False
        i, j = row // nj, row % nj
        own = reached[i, j]
        for n in range(2 * words):
            w = n if n < words else 2 * words - 1 - n
            seed = own[w]
            if w > 0:
                seed |= clear[i, j, w] & (own[w - 1] >> high)
            if w < words - 1:
                seed |= clear[i, j, w] & (own[w + 1] << high)
            own[w] = _spread_along(seed, clear[i, j, w])
        open_border |= i == 0 or j == 0 or i == ni - 1 or j == nj - 1
        open_border |= (own[0] & one) != 0 or (own[words - 1] >> np.uint64((nk - 1) % 64)) != 0
        for way in range(4):
            a, b = i + (way == 0) - (way == 1), j + (way == 2) - (way == 3)
            if 0 <= a < ni and 0 <= b < nj:
                grown = False
                for w in range(words):
                    more = own[w] & clear[a, b, w] & ~reached[a, b, w]
                    reached[a, b, w] |= more
                    grown |= more != 0
                if grown and not queued[a * nj + b]:
                    queued[a * nj + b] = True
                    queue[(head + waiting) % len(queue)] = a * nj + b
                    waiting += 1
    return reached, open_border


def grow(reached: NDArray[np.uint64], allowed: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Nodes of `bit_rows`, and those allowed ones that touch them over a face, edge or corner."""
    wide = reached | reached << np.uint64(1) | reached >> np.uint64(1)
    wide[..., 1:] |= reached[..., :-1] >> np.uint64(63)
    wide[..., :-1] |= reached[..., 1:] << np.uint64(63)
    for axis in (0, 1):
        rows = np.moveaxis(wide, axis, 0)
        before = rows.copy()
        rows[1:] |= before[:-1]
        rows[:-1] |= before[1:]
    return np.asarray(reached | wide & allowed)


@njit(cache=True, nogil=True)
def shut_off(values, reached, level):  # type: ignore[no-untyped-def]
    """Turns the clearance of nodes that are at least `level` but not reached into as much depth."""
    ni, nj, nk = values.shape
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                if values[i, j, k] >= level and not (reached[i, j, k // 64] >> np.uint64(k % 64)) & np.uint64(1):
                    values[i, j, k] = -values[i, j, k]


@njit(cache=True, nogil=True)
def levels(values, quantum):  # type: ignore[no-untyped-def]
    """Clearance (m) as int8, whole quanta rounded down and cut at 127."""
    result = np.empty(values.shape, np.int8)
    flat, out = values.reshape(-1), result.reshape(-1)
    per = np.float32(1.0 / quantum)
    for n in range(len(flat)):
        scaled = max(min(flat[n] * per, np.float32(127.0)), np.float32(-127.0))
        out[n] = np.int8(math.floor(scaled))
    return result


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
def points_in_boxes(points, balls, vehicle_from_group, box, boxes):  # type: ignore[no-untyped-def]
    """The points of a group in a box of the vehicle frame: (n, 3) float32 there, their numbers, which `boxes` hold any.

    balls: `balls_of(points)`.
    """
    m = vehicle_from_group
    inside = np.empty((len(points), 3), np.float32)
    chosen = np.empty(len(points), np.int32)
    met = np.zeros(len(boxes), np.bool_)
    n = 0
    for ball in range(len(balls)):
        x, y, z, r = balls[ball]
        r += 1e-6  # rounding
        u = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        v = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if u + r < box[0, 0] or u - r > box[1, 0] or v + r < box[0, 1] or v - r > box[1, 1]:
            continue
        if w + r < box[0, 2] or w - r > box[1, 2]:
            continue
        for p in range(ball * RUN, min((ball + 1) * RUN, len(points))):
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
