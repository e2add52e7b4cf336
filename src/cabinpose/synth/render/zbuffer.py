"""Kernels of the z-buffer: triangles of the camera frame to nearest faces at the pixels and, of some pixels, at their parts.

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

`rasterise` looks at the pixels' centres and notes the faces that may be seen; `refine` draws these once more at the parts of
those pixels that were found to need them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.synth.render.lanes import LANES, clear, cover
from cabinpose.synth.render.projection import F32, F64, MAX_CORNERS, NEAR_M, U8, Lens, bulge, clip, pixel

_LIMIT = np.float32(1.0 / NEAR_M)
_WIDE = 3 * LANES // 2  # columns from which the rows of a triangle are bounded apart
STRIP = 4  # rows of pixels whose parts lie together
_WIDE_PARTS = 10  # the same, of pixels that are drawn in parts
_ROWS = 2  # that are bounded together
_FLAT = 1000.0  # columns a row: edges flatter than this bound no row

I16 = NDArray[np.int16]
I32 = NDArray[np.int32]
U32 = NDArray[np.uint32]


class Lattice(NamedTuple):
    """Samples in rows and columns: those of the pixels' centres, or any number of others wrapped into rows.

    row_blocks: blocks of `lanes` in a row; samples: flat, see there; rows are filled up with NaN rays. faces: the same memory
    as int32.
    """

    width: int
    height: int
    row_blocks: int
    samples: F32
    faces: I32


class Parts(NamedTuple):
    """The parts of some pixels: s x s samples each, one pixel after the other, row by row within a pixel.

    The pixels are in the order of strips of the image `STRIP` rows high, and column by column within a strip, so that those
    that a small triangle may touch lie in few places.
    lattice: where they lie, wrapped into rows · before: (strips * STRIP * W + 1,) how many of these pixels precede each pixel
    of the image in this order · per_pixel: s * s · reach: pixels from a pixel's centre to its outermost samples, along u and v.
    """

    lattice: Lattice
    before: I32
    per_pixel: int
    reach: float


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
def _range(low: float, high: float, count: int) -> tuple[int, int]:
    """First and last pixel centre between two coordinates; first > last where there is none."""
    return _first(low), _last(high, count)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _supports(hull: F64, n: int, margin: float, above: float, sides: F64) -> int:
    """Lines that bound the rows of a polygon: sides[:m] from the left, sides[m:n] from the right; returns m.

    hull: (n, 2) corners u, v that the polygon is within the margin of · above: pixels from the first to the last line of
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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _columns(sides: F64, m: int, n: int, v: float, reach: float, width: int) -> tuple[int, int]:
    """First and last pixel between the sides of `_supports` at v, with `reach` to spare."""
    left, right = -np.inf, np.inf
    for i in range(m):
        left = max(left, sides[i, 1] + sides[i, 0] * v)
    for i in range(m, n):
        right = min(right, sides[i, 1] + sides[i, 0] * v)
    return _range(left - reach, right + reach, width)


@njit(cache=True, nogil=True, error_model="numpy")
def _cover_rows(
    face: np.int32, edges: tuple[np.float32, ...], plane: tuple[np.float32, ...], r0: int, r1: int, margin: float, hull: F64,
    n: int, sides: F64, width: int, row_blocks: int, samples: F32,
) -> None:  # fmt: skip
    """`cover` over the rows r0 .. r1 of a wide triangle, two by two, bounded by the hull (n, 2) within the margin of them.

    sides: (n, 2) work space.
    """
    m = _supports(hull, n, margin, _ROWS - 1.0, sides)
    for r in range(r0, r1 + 1, _ROWS):
        c0, c1 = _columns(sides, m, n, np.float64(r), 0.0, width)
        if c0 <= c1:
            first = c0 // LANES
            rows = min(_ROWS, r1 + 1 - r)
            cover(samples, r * row_blocks + first, row_blocks, rows, c1 // LANES - first + 1, edges, plane, _LIMIT, face)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cover_parts(
    face: np.int32, edges: tuple[np.float32, ...], plane: tuple[np.float32, ...], first: int, last: int, before: I32, count: int,
    samples: F32,
) -> None:  # fmt: skip
    """`cover` over the parts of the pixels from first to before last, in their order. Blocks may hold neighbours: no harm."""
    start, end = before[first] * count, before[last] * count
    if start < end:
        block = start // LANES
        cover(samples, block, 0, 1, (end - 1) // LANES - block + 1, edges, plane, _LIMIT, face)


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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _homogeneous(corners: F64) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], float]:
    """Edge functions a, d, g and determinant of a triangle (3, 3) of the camera frame."""
    ax, ay, az = corners[0, 0], corners[0, 1], corners[0, 2]
    bx, by, bz = corners[1, 0], corners[1, 1], corners[1, 2]
    cx, cy, cz = corners[2, 0], corners[2, 1], corners[2, 2]
    a = (by * cz - bz * cy, cy * az - cz * ay, ay * bz - az * by)
    d = (bz * cx - bx * cz, cz * ax - cx * az, az * bx - ax * bz)
    g = (bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx)
    return a, d, g, ax * a[0] + ay * d[0] + az * g[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _clipped_hull(corners: F64, scratch: F64, hull: F64, crossed: int, lens: Lens) -> tuple[int, float, float, float]:
    """Pixels of the corners of what the image may see of a triangle (3, 3) of the camera frame that crosses its limits.

    hull: set to (n, 2) u, v · returns n, the margin around the hull, and its least and greatest v.
    """
    k, n = clip(corners, lens.box, crossed, scratch)
    polygon = scratch[k]
    top, bottom, longest = np.inf, -np.inf, 0.0
    for i in range(n):
        x, y = polygon[i, 0] / polygon[i, 2], polygon[i, 1] / polygon[i, 2]
        for j in range(i):
            longest = max(longest, (polygon[j, 0] / polygon[j, 2] - x) ** 2 + (polygon[j, 1] / polygon[j, 2] - y) ** 2)
        u, v = pixel(x, y, lens)
        hull[i, 0], hull[i, 1] = u, v
        top, bottom = min(top, v), max(bottom, v)
    return n, bulge(longest, lens.curvature), top, bottom


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _take_corners(p_camera: F32, i0: int, i1: int, i2: int, corners: F64) -> None:
    for k in range(3):
        corners[0, k], corners[1, k], corners[2, k] = p_camera[i0, k], p_camera[i1, k], p_camera[i2, k]


@njit(cache=True, nogil=True, error_model="numpy")
def rasterise(
    p_camera: F32, projected: F32, outside: U8, faces: U32, hidden: U8, lens: Lens, centre: Lattice, reach: float, closed: bool,
    noted: I32, boxes: I16,
) -> int:  # fmt: skip
    """Nearest face and its 1/z at the pixels' centres; returns how many faces are noted for `refine`.

    p_camera (V, 3), projected (V, 5), outside (V,): of `to_camera` and `project` · faces: (F, 3) · hidden: (F,) bit 1: the
    parts of pixels look through it, bit 2: it has two sides · centre: updated · reach: of `Parts` · closed: faces with one
    side that are turned away can be left out · noted, boxes: (F,), (F, 4) set to the faces that parts may see, and to first and
    last column and row of the pixels that may see them; ~face where the triangle has to be clipped.
    """
    # Arrays are taken out of their tuples once: each access to a member of a tuple counts a reference, atomically.
    samples = centre.samples
    clear(samples, centre.height * centre.row_blocks)
    width, height, row_blocks, curvature = centre.width, centre.height, centre.row_blocks, lens.curvature
    fold = 31 if lens.dist.any() else 1  # the planes beyond which a vertex cannot be projected
    corners, scratch, hull = np.empty((3, 3)), np.empty((2, MAX_CORNERS, 3)), np.empty((MAX_CORNERS, 2))
    sides = np.empty((MAX_CORNERS, 2))
    count = 0
    for f in range(len(faces)):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        if outside[i0] & outside[i1] & outside[i2]:
            continue
        culled, passed = closed and not hidden[f] & 2, (hidden[f] & 1) != 0
        crossed = outside[i0] | outside[i1] | outside[i2]
        face = np.int32(f)
        if crossed & fold:
            _take_corners(p_camera, i0, i1, i2, corners)
            a, d, g, det = _homogeneous(corners)
            if det == 0.0 or (culled and det > 0.0):
                continue
            n, margin, top, bottom = _clipped_hull(corners, scratch, hull, crossed, lens)
            edges, plane = _coefficients(a, d, g, (1.0, 1.0, 1.0), det)
            q0, q1 = _range(top - margin, bottom + margin, height)
            _cover_rows(face, edges, plane, q0, q1, margin, hull, n, sides, width, row_blocks, samples)
            q0, q1 = _range(top - margin - reach, bottom + margin + reach, height)
            if n > 0 and q0 <= q1 and not passed:
                noted[count] = ~face
                boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = 0, width - 1, q0, q1
                count += 1
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
        c0, c1 = _range(left - reach, right + reach, width)
        r0, r1 = _range(top - reach, bottom + reach, height)
        if c0 > c1 or r0 > r1:
            continue
        if not passed:
            noted[count] = face
            boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = c0, c1, r0, r1
            count += 1
        b0, b1 = _range(left, right, width)
        q0, q1 = _range(top, bottom, height)
        if b0 > b1 or q0 > q1:
            continue
        w0, w1, w2 = np.float64(projected[i0, 2]), np.float64(projected[i1, 2]), np.float64(projected[i2, 2])
        g = (x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0)
        edges, plane = _coefficients(a, d, g, (w0, w1, w2), area)
        if b1 - b0 >= _WIDE:
            hull[0, 0], hull[1, 0], hull[2, 0] = u0, u1, u2
            hull[0, 1], hull[1, 1], hull[2, 1] = v0, v1, v2
            _cover_rows(face, edges, plane, q0, q1, margin, hull, 3, sides, width, row_blocks, samples)
        else:
            first, last = b0 // LANES, b1 // LANES
            cover(samples, q0 * row_blocks + first, row_blocks, q1 - q0 + 1, last - first + 1, edges, plane, _LIMIT, face)
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def refine(
    p_camera: F32, projected: F32, outside: U8, faces: U32, lens: Lens, width: int, noted: I32, boxes: I16, number: int,
    parts: Parts,
) -> None:  # fmt: skip
    """Nearest face and its 1/z at the parts of some pixels, of the first `number` faces that `rasterise` noted.

    width: pixels of the image · parts: updated.
    """
    samples, before, per_pixel, reach = parts.lattice.samples, parts.before, parts.per_pixel, parts.reach
    clear(samples, parts.lattice.height * parts.lattice.row_blocks)
    corners, scratch, hull = np.empty((3, 3)), np.empty((2, MAX_CORNERS, 3)), np.empty((MAX_CORNERS, 2))
    sides = np.empty((MAX_CORNERS, 2))
    for k in range(number):
        c0, c1 = np.int64(boxes[k, 0]), np.int64(boxes[k, 1])
        t0, t1 = np.int64(boxes[k, 2]) // STRIP, np.int64(boxes[k, 3]) // STRIP
        while t0 <= t1 and before[(t0 * width + c0) * STRIP] == before[(t0 * width + c1 + 1) * STRIP]:
            t0 += 1
        if t0 > t1:
            continue
        f = np.int64(noted[k])
        face = np.int32(f if f >= 0 else ~f)
        i0, i1, i2 = faces[face, 0], faces[face, 1], faces[face, 2]
        n = 3
        if f < 0:
            _take_corners(p_camera, i0, i1, i2, corners)
            a, d, g, det = _homogeneous(corners)
            n, margin, _, _ = _clipped_hull(corners, scratch, hull, outside[i0] | outside[i1] | outside[i2], lens)
            edges, plane = _coefficients(a, d, g, (1.0, 1.0, 1.0), det)
        else:
            x0, y0 = np.float64(projected[i0, 0]), np.float64(projected[i0, 1])
            x1, y1 = np.float64(projected[i1, 0]), np.float64(projected[i1, 1])
            x2, y2 = np.float64(projected[i2, 0]), np.float64(projected[i2, 1])
            a = (y1 - y2, y2 - y0, y0 - y1)
            d = (x2 - x1, x0 - x2, x1 - x0)
            g = (x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0)
            w0, w1, w2 = np.float64(projected[i0, 2]), np.float64(projected[i1, 2]), np.float64(projected[i2, 2])
            edges, plane = _coefficients(a, d, g, (w0, w1, w2), d[2] * a[1] - d[1] * a[2])
            margin = bulge(max(a[0] * a[0] + d[0] * d[0], a[1] * a[1] + d[1] * d[1], a[2] * a[2] + d[2] * d[2]), lens.curvature)
            hull[0, 0], hull[0, 1] = projected[i0, 3], projected[i0, 4]
            hull[1, 0], hull[1, 1] = projected[i1, 3], projected[i1, 4]
            hull[2, 0], hull[2, 1] = projected[i2, 3], projected[i2, 4]
        m = 0
        wide = c1 - c0 >= _WIDE_PARTS
        if wide:
            m = _supports(hull, n, margin, STRIP - 1 + 2.0 * reach, sides)
        for t in range(t0, t1 + 1):
            if wide:
                c0, c1 = _columns(sides, m, n, t * STRIP - reach, reach, width)
            if c0 <= c1:
                first, last = (t * width + c0) * STRIP, (t * width + c1 + 1) * STRIP
                _cover_parts(face, edges, plane, first, last, before, per_pixel, samples)
