"""Kernels of the z-buffer: triangles of the camera frame to nearest faces on lattices of samples.

Two ways to scan a triangle, one result. `scan` walks the rows of the projected triangle between its edges, for a pinhole
and a triangle wholly beyond the near limit. `scan_rays` evaluates homogeneous edge functions at every sample's own ray
(Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997) and so needs neither straight
projected edges (lens distortion) nor vertices in front of the camera: with ray r = (x, y, 1) and vertices v_i,
e_i = r . (v_j x v_k) has the sign of det = v_0 . (v_1 x v_2) for all i where the ray hits, and 1/z = sum(e_i) / det.

Both keep 1/z, which is linear in the image, in float32 (relative error about 1e-7, that is 0.0005 mm at 4 m); all that
leads to it is float64. Both edges of a span are inclusive and an edge shared by two triangles is computed in the same
way for both, so a closed mesh shows no cracks. Equal 1/z: the face with the lower index wins.

Samples on a lattice: lattice point i lies at sub-pixel `origin + step * i`, so that one triangle set-up serves the
sub-pixels (0, 1) and the pixel centres ((s - 1) / 2, s).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

NEAR_M = 0.01  # surfaces closer to the camera plane than this are not seen
_MAX_CLIPPED = 12  # a triangle cut by five planes has at most eight corners

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]


@njit(cache=True, nogil=True, error_model="numpy")
def to_camera(vertices: F32, camera_from_vehicle: F64, out: F32) -> None:
    """Vertices (V, 3) of the vehicle frame to the camera frame, metres."""
    m = camera_from_vehicle
    for i in range(len(vertices)):
        x, y, z = np.float64(vertices[i, 0]), np.float64(vertices[i, 1]), np.float64(vertices[i, 2])
        out[i, 0] = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        out[i, 1] = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        out[i, 2] = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def project(p_camera: F32, intrinsics: F64, dist: F64, box: F64, out: F64) -> None:
    """Vertices (V, 3) of the camera frame to (V, 3): sub-pixel u, v and 1/z.

    1/z is 0 for a vertex that cannot be projected: nearer than `NEAR_M`, or, through a distorting lens, outside `box`
    (x min, y min, x max, y max of the ideal rays of the image), where the distortion polynomial may fold over.
    intrinsics: (fx, fy, cx, cy) of the sub-pixel camera.
    """
    fx, fy, cx, cy = intrinsics
    distorted = is_distorted(dist)
    for i in range(len(p_camera)):
        z = np.float64(p_camera[i, 2])
        if z < NEAR_M:
            out[i, 2] = 0.0
            continue
        inverse = 1.0 / z
        x, y = p_camera[i, 0] * inverse, p_camera[i, 1] * inverse
        if distorted:
            if x < box[0] or y < box[1] or x > box[2] or y > box[3]:
                out[i, 2] = 0.0
                continue
            x, y = _distort(x, y, dist)
        out[i, 0] = fx * x + cx
        out[i, 1] = fy * y + cy
        out[i, 2] = inverse


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def is_distorted(dist: F64) -> bool:
    """Whether any of the five coefficients is not zero."""
    return dist[0] != 0.0 or dist[1] != 0.0 or dist[2] != 0.0 or dist[3] != 0.0 or dist[4] != 0.0  # type: ignore[no-any-return]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _distort(x: float, y: float, dist: F64) -> tuple[float, float]:
    k1, k2, p1, p2, k3 = dist
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _ceil(x: float) -> int:
    """Ceiling of a number that is not negative."""
    i = int(x)
    return i + 1 if i < x else i


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _floor(x: float, count: int) -> int:
    """Floor of a number, at most count - 1; -1 for negative ones."""
    return -1 if x < 0.0 else int(min(x, count - 1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def scan(
    face: int, uvw: F64, i0: int, i1: int, i2: int, s: int, visible: bool,
    sub_inverse_z: F32, sub_nearest: I32, inverse_z: F32, nearest: I32,
) -> None:  # fmt: skip
    """One projected triangle of a pinhole: rows between its edges, on both lattices.

    uvw: (n, 3) sub-pixel u, v and 1/z, of which i0, i1, i2 are the corners · s: supersampling · visible: whether the
    sub-pixels see it at all. The other arrays are updated.
    """
    sub_height, sub_width = sub_nearest.shape
    u0, u1, u2 = uvw[i0, 0], uvw[i1, 0], uvw[i2, 0]
    v0, v1, v2 = uvw[i0, 1], uvw[i1, 1], uvw[i2, 1]
    left, right, top, bottom = min(u0, u1, u2), max(u0, u1, u2), min(v0, v1, v2), max(v0, v1, v2)
    if right < 0.0 or bottom < 0.0 or left > sub_width - 1.0 or top > sub_height - 1.0:
        return
    origin = (s - 1) * 0.5
    per_pixel = 1.0 / s
    row0, row1 = _ceil(max(top, 0.0)), int(min(bottom, sub_height - 1.0))
    in_sub = visible and row0 <= row1 and _ceil(max(left, 0.0)) <= int(right)
    height, width = nearest.shape
    pixel_row0, pixel_row1 = _ceil(max((top - origin) * per_pixel, 0.0)), _floor((bottom - origin) * per_pixel, height)
    pixel_left, pixel_right = (left - origin) * per_pixel, (right - origin) * per_pixel
    in_pixel = pixel_row0 <= pixel_row1 and _ceil(max(pixel_left, 0.0)) <= _floor(pixel_right, width)
    if not (in_sub or in_pixel):
        return
    area = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
    if abs(area) < 1e-7:  # seen edge-on: holds no sample but by chance
        return
    w0, w1, w2 = uvw[i0, 2], uvw[i1, 2], uvw[i2, 2]
    inverse_area = 1.0 / area
    wu = ((w1 - w0) * (v2 - v0) - (w2 - w0) * (v1 - v0)) * inverse_area
    wv = ((w2 - w0) * (u1 - u0) - (w1 - w0) * (u2 - u0)) * inverse_area
    if v1 < v0 or (v1 == v0 and u1 < u0):
        u0, u1, v0, v1, w0, w1 = u1, u0, v1, v0, w1, w0
    if v2 < v1 or (v2 == v1 and u2 < u1):
        u1, u2, v1, v2 = u2, u1, v2, v1
        if v1 < v0 or (v1 == v0 and u1 < u0):
            u0, u1, v0, v1, w0 = u1, u0, v1, v0, w2
    long_slope = (u2 - u0) / (v2 - v0)
    upper_slope = (u1 - u0) / (v1 - v0) if v1 > v0 else 0.0
    lower_slope = (u2 - u1) / (v2 - v1) if v2 > v1 else 0.0
    if in_sub:
        step = np.float32(wu)
        for r in range(row0, row1 + 1):
            dy = r - v0
            a = u0 + dy * long_slope
            b = u0 + dy * upper_slope if r < v1 else u1 + (r - v1) * lower_slope
            c0, c1 = _ceil(max(min(a, b), 0.0)), _floor(max(a, b), sub_width)
            w = np.float32(w0 + wv * dy + wu * (c0 - u0))
            for c in range(c0, c1 + 1):
                candidate = w + step * np.float32(c - c0)
                if candidate > sub_inverse_z[r, c]:
                    sub_inverse_z[r, c] = candidate
                    sub_nearest[r, c] = face
    if in_pixel:
        step = np.float32(wu * s)
        for r in range(pixel_row0, pixel_row1 + 1):
            y = origin + s * r
            dy = y - v0
            a = u0 + dy * long_slope
            b = u0 + dy * upper_slope if y < v1 else u1 + (y - v1) * lower_slope
            c0, c1 = _ceil(max((min(a, b) - origin) * per_pixel, 0.0)), _floor((max(a, b) - origin) * per_pixel, width)
            w = np.float32(w0 + wv * dy + wu * (origin + s * c0 - u0))
            for c in range(c0, c1 + 1):
                candidate = w + step * np.float32(c - c0)
                if candidate > inverse_z[r, c]:
                    inverse_z[r, c] = candidate
                    nearest[r, c] = face


@njit(cache=True, nogil=True, error_model="numpy")
def scan_rays(
    face: int, corners: F64, bounds: tuple[float, float, float, float], origin: float, step: float,
    rays: F64, inverse_z: F32, nearest: I32,
) -> None:  # fmt: skip
    """One triangle (3, 3) of the camera frame at the rays (rows, columns, 2) of a lattice within `bounds` (sub-pixels)."""
    height, width = nearest.shape
    c0, r0 = max((bounds[0] - origin) / step, 0.0), max((bounds[1] - origin) / step, 0.0)
    c1, r1 = min((bounds[2] - origin) / step, width - 1.0), min((bounds[3] - origin) / step, height - 1.0)
    if not (c0 <= c1 and r0 <= r1):
        return
    e = np.empty((3, 3))
    for i in range(3):
        a, b = corners[(i + 1) % 3], corners[(i + 2) % 3]
        e[i, 0] = a[1] * b[2] - a[2] * b[1]
        e[i, 1] = a[2] * b[0] - a[0] * b[2]
        e[i, 2] = a[0] * b[1] - a[1] * b[0]
    det = corners[0, 0] * e[0, 0] + corners[0, 1] * e[0, 1] + corners[0, 2] * e[0, 2]
    if det == 0.0:
        return
    if det < 0.0:
        e[:] = -e
        det = -det
    e00, e01, e02 = e[0]
    e10, e11, e12 = e[1]
    e20, e21, e22 = e[2]
    for r in range(_ceil(r0), int(r1) + 1):
        for c in range(_ceil(c0), int(c1) + 1):
            x, y = rays[r, c, 0], rays[r, c, 1]
            a0 = e00 * x + e01 * y + e02
            a1 = e10 * x + e11 * y + e12
            a2 = e20 * x + e21 * y + e22
            if a0 >= 0.0 and a1 >= 0.0 and a2 >= 0.0:
                w = np.float32((a0 + a1 + a2) / det)
                if w > inverse_z[r, c] and w <= 1.0 / NEAR_M:
                    inverse_z[r, c] = w
                    nearest[r, c] = face


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def bulge(longest_squared: float, curvature: float) -> float:
    """How far (sub-pixels) the lens may move a point of a convex region out of the box around its projected corners.

    By Taylor's theorem sum(b_i f(v_i)) - f(sum(b_i v_i)) is at most M / 2 sum(b_i |v_i - p|^2) <= M L^2 / 6 on a triangle
    with longest edge L, where M (`curvature`) bounds the second derivative of the projection f.
    """
    return curvature * longest_squared / 6.0 + 1e-3


@njit(cache=True, nogil=True, error_model="numpy")
def clip(corners: F64, box: F64, planes: int, scratch: F64) -> tuple[F64, int]:
    """What of a triangle (3, 3) of the camera frame can be projected: a polygon (n, 3) in scratch, and n (0: nothing).

    Cut at the near limit and, for 5 planes, at the four planes through `box` (Sutherland and Hodgman, 1974).
    scratch: (2, _MAX_CLIPPED, 3).
    """
    polygon, other = scratch[0], scratch[1]
    polygon[:3] = corners
    n = 3
    for plane in range(planes):
        m = 0
        for i in range(n):
            p, q = polygon[i], polygon[(i + 1) % n]
            dp, dq = _inside(p, plane, box), _inside(q, plane, box)
            if dp >= 0.0:
                other[m] = p
                m += 1
            if (dp >= 0.0) != (dq >= 0.0):
                t = dp / (dp - dq)
                for k in range(3):
                    other[m, k] = p[k] + (q[k] - p[k]) * t
                m += 1
        polygon, other, n = other, polygon, m
    return polygon, n


@njit(cache=True, nogil=True, error_model="numpy")
def distorted_bounds(polygon: F64, n: int, intrinsics: F64, dist: F64, curvature: float) -> tuple[float, float, float, float]:
    """Bounds (u min, v min, u max, v max; sub-pixels) of a convex polygon's image, with the margin of `bulge`."""
    fx, fy, cx, cy = intrinsics
    longest = 0.0
    u0, v0, u1, v1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(n):
        x, y = polygon[i, 0] / polygon[i, 2], polygon[i, 1] / polygon[i, 2]
        for j in range(i):
            longest = max(longest, (polygon[j, 0] / polygon[j, 2] - x) ** 2 + (polygon[j, 1] / polygon[j, 2] - y) ** 2)
        x, y = _distort(x, y, dist)
        u, v = fx * x + cx, fy * y + cy
        u0, v0, u1, v1 = min(u0, u), min(v0, v), max(u1, u), max(v1, v)
    margin = bulge(longest, curvature)
    return u0 - margin, v0 - margin, u1 + margin, v1 + margin


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _inside(p: F64, plane: int, box: F64) -> float:
    """Signed distance-like value of a point to plane 0 (near) or 1..4 (sides of the box), not negative inside."""
    if plane == 0:
        return p[2] - NEAR_M  # type: ignore[no-any-return]
    if plane == 1:
        return p[0] - box[0] * p[2]  # type: ignore[no-any-return]
    if plane == 2:
        return p[1] - box[1] * p[2]  # type: ignore[no-any-return]
    if plane == 3:
        return box[2] * p[2] - p[0]  # type: ignore[no-any-return]
    return box[3] * p[2] - p[1]  # type: ignore[no-any-return]


@njit(cache=True, nogil=True, error_model="numpy")
def rasterise(
    p_camera: F32, uvw: F64, faces: I32, hidden: U8, s: int, intrinsics: F64, dist: F64, box: F64, curvature: float,
    sub_rays: F64, sub_inverse_z: F32, sub_nearest: I32, rays: F64, inverse_z: F32, nearest: I32,
) -> None:  # fmt: skip
    """Nearest face and its 1/z at every sub-pixel and at every pixel centre; -1 and 0 where nothing is hit.

    p_camera, uvw: (V, 3) of `to_camera` and `project` · faces: (F, 3) · hidden: (F,) faces that the sub-pixels look
    through · s: supersampling · sub_rays, rays: (H s, W s, 2), (H, W, 2) ideal coordinates, read only with distortion.
    """
    sub_inverse_z[:] = 0.0
    sub_nearest[:] = -1
    inverse_z[:] = 0.0
    nearest[:] = -1
    fx, fy, cx, cy = intrinsics
    distorted = is_distorted(dist)
    corners = np.empty((3, 3))
    scratch = np.empty((2, _MAX_CLIPPED, 3))
    for f in range(len(faces)):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        whole = uvw[i0, 2] > 0.0 and uvw[i1, 2] > 0.0 and uvw[i2, 2] > 0.0
        if whole and not distorted:
            scan(f, uvw, i0, i1, i2, s, hidden[f] == 0, sub_inverse_z, sub_nearest, inverse_z, nearest)
            continue
        if p_camera[i0, 2] < NEAR_M and p_camera[i1, 2] < NEAR_M and p_camera[i2, 2] < NEAR_M:
            continue
        for k in range(3):
            corners[0, k], corners[1, k], corners[2, k] = p_camera[i0, k], p_camera[i1, k], p_camera[i2, k]
        if not distorted:
            polygon, n = clip(corners, box, 1, scratch)
            for i in range(n):
                w = 1.0 / polygon[i, 2]
                polygon[i, 0] = fx * polygon[i, 0] * w + cx
                polygon[i, 1] = fy * polygon[i, 1] * w + cy
                polygon[i, 2] = w
            for i in range(2, n):
                scan(f, polygon, 0, i - 1, i, s, hidden[f] == 0, sub_inverse_z, sub_nearest, inverse_z, nearest)
            continue
        if whole:
            polygon, n = corners, 3
        else:
            polygon, n = clip(corners, box, 5, scratch)
        bounds = distorted_bounds(polygon, n, intrinsics, dist, curvature)
        if hidden[f] == 0:
            scan_rays(f, corners, bounds, 0.0, 1.0, sub_rays, sub_inverse_z, sub_nearest)
        scan_rays(f, corners, bounds, (s - 1) / 2.0, float(s), rays, inverse_z, nearest)


@njit(cache=True, nogil=True, error_model="numpy")
def shade(
    nearest: I32, inverse_z: F32, rays: F32, ray_length: F32, p_camera: F32, normals: F32, rotation: F64, faces: I32,
    material: U8, coefficients: F32, shaded: I32, frame: int, depth: F32, cosine: F32, out_material: U8,
) -> None:  # fmt: skip
    """Depth z (m), |cos| of incidence and material at every sub-pixel; 0 where nothing is hit.

    The normal at a hit is sum(b_i n_i) with barycentric b_i proportional to r . (v_j x v_k): a 3x3 matrix times the ray,
    kept per face in `coefficients` (F, 9), filled for the faces that are seen (`shaded[f] == frame`).
    normals: (V, 3) of the vehicle frame · rotation: camera from vehicle.
    """
    height, width = nearest.shape
    for r in range(height):
        for c in range(width):
            f = nearest[r, c]
            if f < 0:
                depth[r, c] = 0.0
                cosine[r, c] = 0.0
                out_material[r, c] = 0
                continue
            if shaded[f] != frame:
                shaded[f] = frame
                _normal_matrix(p_camera, normals, rotation, faces[f], coefficients[f])
            m = coefficients[f]
            x, y = rays[r, c, 0], rays[r, c, 1]
            nx = m[0] * x + m[1] * y + m[2]
            ny = m[3] * x + m[4] * y + m[5]
            nz = m[6] * x + m[7] * y + m[8]
            length = np.sqrt(nx * nx + ny * ny + nz * nz) * ray_length[r, c]
            along = abs(nx * x + ny * y + nz)
            depth[r, c] = np.float32(1.0) / inverse_z[r, c]
            cosine[r, c] = min(along / length, np.float32(1.0)) if length > 0.0 else np.float32(0.0)
            out_material[r, c] = material[f]


@njit(cache=True, nogil=True, error_model="numpy")
def _normal_matrix(p_camera: F32, normals: F32, rotation: F64, face: I32, out: F32) -> None:
    """Row-major 3x3 matrix (9,) that takes a ray of the image to the interpolated normal, times any scale."""
    for k in range(9):
        out[k] = 0.0
    for i in range(3):
        a, b, n = p_camera[face[(i + 1) % 3]], p_camera[face[(i + 2) % 3]], normals[face[i]]
        ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
        bx, by, bz = np.float64(b[0]), np.float64(b[1]), np.float64(b[2])
        ex, ey, ez = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for k in range(3):
            nk = rotation[k, 0] * n[0] + rotation[k, 1] * n[1] + rotation[k, 2] * n[2]
            out[3 * k] += np.float32(nk * ex)
            out[3 * k + 1] += np.float32(nk * ey)
            out[3 * k + 2] += np.float32(nk * ez)


@njit(cache=True, nogil=True, error_model="numpy")
def classify(nearest: I32, inverse_z: F32, label: U8, instance: U8, depth: F32, out_label: U8, out_instance: U8) -> None:
    """Depth z (m), label and instance at every pixel from its nearest face; 0 where nothing is hit."""
    height, width = nearest.shape
    for r in range(height):
        for c in range(width):
            f = nearest[r, c]
            if f < 0:
                depth[r, c] = 0.0
                out_label[r, c] = 0
                out_instance[r, c] = 0
            else:
                depth[r, c] = np.float32(1.0) / inverse_z[r, c]
                out_label[r, c] = label[f]
                out_instance[r, c] = instance[f]
