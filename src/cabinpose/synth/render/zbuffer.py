"""Kernels of the z-buffer: triangles of the camera frame to nearest faces on lattices of samples.

A triangle is tested at every sample's own ray, so a distorting lens costs nothing in accuracy. With ray r = (x, y, 1) and
vertices v_i in the camera frame, the edge functions e_i = r . (v_j x v_k) / det, det = v_0 . (v_1 x v_2), are all
non-negative exactly where the ray hits, and 1/z is their sum (Olano and Greer, "Triangle scan conversion using 2D
homogeneous coordinates", 1997): linear in (x, y), and valid for vertices behind the camera too. Projected corners only bound
the samples to be tested.

Vertices, rays and 1/z are float32, the set-up of a triangle float64. An edge shared by two triangles has the same
coefficients but for the sign, and zero is inside for both: a closed mesh shows no cracks. Of equal 1/z the face with the lower
index wins, whatever the order of drawing.

Faces are drawn in their own order, straight from their vertices. A cabin with the faces turned away left out has few layers:
sorting by depth and a coarse map of what is hidden (Greene et al., "Hierarchical Z-buffer visibility", 1993) cost more time
than they saved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.synth.render.lanes import LANES, clear, cover
from cabinpose.synth.render.projection import F32, F64, MAX_CORNERS, NEAR_M, U8, Lens, bulge, clip, pixel

_LIMIT = np.float32(1.0 / NEAR_M)
_WIDE = 3 * LANES  # columns from which the rows of a triangle are bounded apart
_ROWS = 2  # that are bounded together
_FLAT = 1000.0  # columns a row: edges flatter than this bound no row

I32 = NDArray[np.int32]
U32 = NDArray[np.uint32]


class Lattice(NamedTuple):
    """Samples of the image: point i of a row or column lies at sub-pixel origin + step * i.

    (0, 1) are the sub-pixels, ((s - 1) / 2, s) the pixel centres. row_blocks: blocks of `lanes` in a row; samples: flat, see
    there; rows are filled up with NaN rays. faces: the same memory as int32.
    """

    origin: float
    step: float
    width: int
    height: int
    row_blocks: int
    samples: F32
    faces: I32


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _first(x: float) -> int:
    """The first lattice index at or after x, not negative."""
    x = max(x, 0.0)
    i = int(x)
    return i + 1 if i < x else i


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _last(x: float, count: int) -> int:
    """The last lattice index at or before x, below count; -1 where there is none."""
    return -1 if x < 0.0 else int(min(x, count - 1.0))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _range(low: float, high: float, origin: float, scale: float, count: int) -> tuple[int, int]:
    """First and last lattice index between two sub-pixel coordinates; first > last where there is none."""
    return _first((low - origin) * scale), _last((high - origin) * scale, count)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _supports(hull: F64, n: int, margin: float, above: float, sides: F64) -> int:
    """Lines that bound the rows of a polygon: sides[:m] from the left, sides[m:n] from the right; returns m.

    hull: (n, 2) corners u, v that the polygon is within the margin of · above: sub-pixels from the first to the last line of
    the rows that are bounded together · sides: (n, 2), set to slope s and base b: all u of the rows lie beyond b + s v, with v
    that of the first row. Each is parallel to an edge and has all corners on one side, whatever their order and shape.
    """
    turn = 0.0
    for i in range(2, n):
        turn += (hull[i - 1, 0] - hull[0, 0]) * (hull[i, 1] - hull[0, 1])
        turn -= (hull[i, 0] - hull[0, 0]) * (hull[i - 1, 1] - hull[0, 1])
    m, end = 0, n
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        run, rise = hull[j, 0] - hull[i, 0], hull[j, 1] - hull[i, 1]
        slope = run / rise if abs(run) < _FLAT * abs(rise) else 0.0  # a flat edge bounds no row; any slope is true
        if (rise < 0.0) == (turn > 0.0):
            base = np.inf
            for k in range(n):
                base = min(base, hull[k, 0] - slope * hull[k, 1])
            sides[m, 0], sides[m, 1] = slope, base - margin + min(-slope * margin, slope * (above + margin))
            m += 1
        else:
            base = -np.inf
            for k in range(n):
                base = max(base, hull[k, 0] - slope * hull[k, 1])
            end -= 1
            sides[end, 0], sides[end, 1] = slope, base + margin + max(-slope * margin, slope * (above + margin))
    return m


@njit(cache=True, nogil=True, error_model="numpy")
def _cover_rows(
    face: np.int32, edges: tuple[np.float32, ...], plane: tuple[np.float32, ...], r0: int, r1: int, margin: float, hull: F64,
    n: int, sides: F64, origin: float, step: float, width: int, row_blocks: int, samples: F32,
) -> None:  # fmt: skip
    """`cover` over the rows r0 .. r1 of a wide triangle, two by two, bounded by the hull (n, 2) within the margin of them.

    sides: (n, 2) work space.
    """
    scale = 1.0 / step
    m = _supports(hull, n, margin, step * (_ROWS - 1), sides)
    for r in range(r0, r1 + 1, _ROWS):
        v = origin + step * r
        left, right = -np.inf, np.inf
        for i in range(m):
            left = max(left, sides[i, 1] + sides[i, 0] * v)
        for i in range(m, n):
            right = min(right, sides[i, 1] + sides[i, 0] * v)
        c0, c1 = _range(left, right, origin, scale, width)
        if c0 <= c1:
            first = c0 // LANES
            rows = min(_ROWS, r1 + 1 - r)
            cover(samples, r * row_blocks + first, row_blocks, rows, c1 // LANES - first + 1, edges, plane, _LIMIT, face)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _coefficients(
    a: tuple[float, float, float], d: tuple[float, float, float], g: tuple[float, float, float],
    weight: tuple[float, float, float], area: float,
) -> tuple[tuple[np.float32, ...], tuple[np.float32, ...]]:  # fmt: skip
    """Edges (9) and plane (3) for `cover` from edge functions a_i x + d_i y + g_i whose weighted sum over area is 1/z."""
    t0, t1, t2 = weight[0] / area, weight[1] / area, weight[2] / area
    sign = np.float32(1.0) if area > 0.0 else np.float32(-1.0)
    edges = (
        sign * np.float32(a[0]), sign * np.float32(d[0]), sign * np.float32(g[0]),
        sign * np.float32(a[1]), sign * np.float32(d[1]), sign * np.float32(g[1]),
        sign * np.float32(a[2]), sign * np.float32(d[2]), sign * np.float32(g[2]),
    )  # fmt: skip
    plane = (
        np.float32(a[0] * t0 + a[1] * t1 + a[2] * t2),
        np.float32(d[0] * t0 + d[1] * t1 + d[2] * t2),
        np.float32(g[0] * t0 + g[1] * t1 + g[2] * t2),
    )
    return edges, plane


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_clipped(
    face: int, corners: F64, scratch: F64, hull: F64, sides: F64, crossed: int, hidden: bool, culled: bool, lens: Lens,
    sub: Lattice, centre: Lattice,
) -> None:  # fmt: skip
    """A triangle (3, 3) of the camera frame that cannot be projected whole. culled: not if it is turned away."""
    ax, ay, az = corners[0, 0], corners[0, 1], corners[0, 2]
    bx, by, bz = corners[1, 0], corners[1, 1], corners[1, 2]
    cx, cy, cz = corners[2, 0], corners[2, 1], corners[2, 2]
    a = (by * cz - bz * cy, cy * az - cz * ay, ay * bz - az * by)
    d = (bz * cx - bx * cz, cz * ax - cx * az, az * bx - ax * bz)
    g = (bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx)
    det = ax * a[0] + ay * d[0] + az * g[0]
    if det == 0.0 or (culled and det > 0.0):
        return
    k, n = clip(corners, lens.box, crossed, scratch)
    if n == 0:
        return
    polygon = scratch[k]
    top, bottom, longest = np.inf, -np.inf, 0.0
    for i in range(n):
        x, y = polygon[i, 0] / polygon[i, 2], polygon[i, 1] / polygon[i, 2]
        for j in range(i):
            longest = max(longest, (polygon[j, 0] / polygon[j, 2] - x) ** 2 + (polygon[j, 1] / polygon[j, 2] - y) ** 2)
        u, v = pixel(x, y, lens)
        hull[i, 0], hull[i, 1] = u, v
        top, bottom = min(top, v), max(bottom, v)
    edges, plane = _coefficients(a, d, g, (1.0, 1.0, 1.0), det)
    margin = bulge(longest, lens.curvature)
    for lattice in (sub, centre):
        if hidden and lattice.step == 1.0:
            continue
        r0, r1 = _range(top - margin, bottom + margin, lattice.origin, 1.0 / lattice.step, lattice.height)
        _cover_rows(
            np.int32(face), edges, plane, r0, r1, margin, hull, n, sides, lattice.origin, lattice.step, lattice.width,
            lattice.row_blocks, lattice.samples,
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def rasterise(
    p_camera: F32, projected: F32, outside: U8, faces: U32, hidden: U8, lens: Lens, sub: Lattice, centre: Lattice, closed: bool,
) -> None:  # fmt: skip
    """Nearest face and its 1/z on both lattices.

    p_camera (V, 3), projected (V, 5), outside (V,): of `to_camera` and `project` · faces: (F, 3) · hidden: (F,) bit 1: the
    sub-pixels look through it, bit 2: it has two sides · sub, centre: updated · closed: faces with one side that are turned
    away can be left out.
    """
    # Arrays are taken out of their tuples once: each access to a member of a tuple counts a reference, atomically.
    fine, coarse = sub.samples, centre.samples
    clear(fine, sub.height * sub.row_blocks)
    clear(coarse, centre.height * centre.row_blocks)
    width, height, row_blocks = centre.width, centre.height, centre.row_blocks
    sub_width, sub_height, sub_blocks = sub.width, sub.height, sub.row_blocks
    origin, step, scale, curvature = centre.origin, centre.step, 1.0 / centre.step, lens.curvature
    fold = 31 if lens.dist.any() else 1  # the planes beyond which a vertex cannot be projected
    corners, scratch, hull = np.empty((3, 3)), np.empty((2, MAX_CORNERS, 3)), np.empty((MAX_CORNERS, 2))
    sides = np.empty((MAX_CORNERS, 2))
    for f in range(len(faces)):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        if outside[i0] & outside[i1] & outside[i2]:
            continue
        culled, passed = closed and not hidden[f] & 2, (hidden[f] & 1) != 0
        crossed = outside[i0] | outside[i1] | outside[i2]
        if crossed & fold:
            for k in range(3):
                corners[0, k], corners[1, k], corners[2, k] = p_camera[i0, k], p_camera[i1, k], p_camera[i2, k]
            _draw_clipped(f, corners, scratch, hull, sides, crossed, passed, culled, lens, sub, centre)
            continue
        # The edge functions of the vertices' ideal coordinates are those of the homogeneous ones over z_j z_k.
        x0, y0 = np.float64(projected[i0, 0]), np.float64(projected[i0, 1])
        x1, y1 = np.float64(projected[i1, 0]), np.float64(projected[i1, 1])
        x2, y2 = np.float64(projected[i2, 0]), np.float64(projected[i2, 1])
        a = (y1 - y2, y2 - y0, y0 - y1)
        d = (x2 - x1, x0 - x2, x1 - x0)
        area = d[2] * a[1] - d[1] * a[2]
        # No thickness or seen edge-on; turned away: y points down, and outside is counter-clockwise.
        if area == 0.0 or (culled and area > 0.0):
            continue
        margin = bulge(max(a[0] * a[0] + d[0] * d[0], a[1] * a[1] + d[1] * d[1], a[2] * a[2] + d[2] * d[2]), curvature)
        u0, v0 = np.float64(projected[i0, 3]), np.float64(projected[i0, 4])
        u1, v1 = np.float64(projected[i1, 3]), np.float64(projected[i1, 4])
        u2, v2 = np.float64(projected[i2, 3]), np.float64(projected[i2, 4])
        left, right = min(u0, u1, u2) - margin, max(u0, u1, u2) + margin
        top, bottom = min(v0, v1, v2) - margin, max(v0, v1, v2) + margin
        c0, c1 = _range(left, right, 0.0, 1.0, sub_width)
        r0, r1 = _range(top, bottom, 0.0, 1.0, sub_height)
        b0, b1 = _range(left, right, origin, scale, width)
        q0, q1 = _range(top, bottom, origin, scale, height)
        if (c0 > c1 or r0 > r1) and (b0 > b1 or q0 > q1):
            continue
        w0, w1, w2 = np.float64(projected[i0, 2]), np.float64(projected[i1, 2]), np.float64(projected[i2, 2])
        g = (x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0)
        edges, plane = _coefficients(a, d, g, (w0, w1, w2), area)
        face = np.int32(f)
        wide = c1 - c0 >= _WIDE
        if wide:
            hull[0, 0], hull[1, 0], hull[2, 0] = u0, u1, u2
            hull[0, 1], hull[1, 1], hull[2, 1] = v0, v1, v2
        if c0 <= c1 and not passed:
            if wide:
                _cover_rows(face, edges, plane, r0, r1, margin, hull, 3, sides, 0.0, 1.0, sub_width, sub_blocks, fine)
            else:
                first, last = c0 // LANES, c1 // LANES
                cover(fine, r0 * sub_blocks + first, sub_blocks, r1 - r0 + 1, last - first + 1, edges, plane, _LIMIT, face)
        if b0 <= b1:
            if wide:
                _cover_rows(face, edges, plane, q0, q1, margin, hull, 3, sides, origin, step, width, row_blocks, coarse)
            else:
                first, last = b0 // LANES, b1 // LANES
                cover(coarse, q0 * row_blocks + first, row_blocks, q1 - q0 + 1, last - first + 1, edges, plane, _LIMIT, face)
