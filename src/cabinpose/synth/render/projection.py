"""From the vehicle frame to the image: vertices through the lens, and what of a triangle the image may see."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError

NEAR_M = 0.01  # surfaces closer to the camera plane than this are not seen
MAX_CORNERS = 8  # of a triangle cut by five planes

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


class Lens(NamedTuple):
    """The projection of a camera, for kernels.

    fx, fy, cx, cy: pixels · dist: (5,) of the camera · box: (4,) x min, y min, x max, y max of the image's rays, a little
    widened · curvature: pixels, a bound on the second derivative of the projection in the box; 0 for a pinhole.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    dist: F64
    box: F64
    curvature: float


@lru_cache(maxsize=64)
def ray_box(camera: Camera) -> F64:
    """(x min, y min, x max, y max) of the ideal rays of an image, widened by a pixel."""
    rays = camera.rays.reshape(-1, 2)
    if np.isnan(rays).all():
        raise ConfigError("no pixel of this camera has a ray", hint="check the distortion coefficients and the focal length")
    margin = 1.0 / min(camera.fx, camera.fy)
    return np.concatenate((np.nanmin(rays, axis=0) - margin, np.nanmax(rays, axis=0) + margin))


@njit(cache=True, nogil=True, error_model="numpy")
def to_camera(vertices: F32, camera_from_vehicle: F64, out: F32) -> None:
    """Vertices (V, 3) of the vehicle frame to the camera frame, metres."""
    m = camera_from_vehicle
    for i in range(len(vertices)):
        x, y, z = np.float64(vertices[i, 0]), np.float64(vertices[i, 1]), np.float64(vertices[i, 2])
        out[i, 0] = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        out[i, 1] = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        out[i, 2] = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def pixel(x: float, y: float, lens: Lens) -> tuple[float, float]:
    """Pixel u, v of ideal coordinates."""
    k1, k2, p1, p2, k3 = lens.dist
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return lens.fx * u + lens.cx, lens.fy * v + lens.cy


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _inside(x: float, y: float, z: float, plane: int, box: F64) -> float:
    """Signed distance-like value of a point to plane 0 (near) or 1..4 (sides of the box), not negative inside."""
    if plane == 0:
        return z - NEAR_M
    if plane == 1:
        return x - box[0] * z
    if plane == 2:
        return y - box[1] * z
    if plane == 3:
        return box[2] * z - x
    return box[3] * z - y


@njit(cache=True, nogil=True, error_model="numpy")
def project(p_camera: F32, lens: Lens, out: F32, outside: U8) -> None:
    """Vertices (V, 3) of the camera frame to (V, 5): ideal x, y, 1/z, and pixel u, v; and where they lie outside.

    outside: (V,) a bit for each plane beyond which the vertex lies: 1 the near limit, 2 .. 16 the sides of the lens' box.
    Nothing else is set for a vertex nearer than `NEAR_M`; outside the box, where the distortion polynomial may fold over,
    u and v mean nothing.
    """
    box = lens.box
    for i in range(len(p_camera)):
        z = np.float64(p_camera[i, 2])
        beyond = 0
        x, y = np.float64(p_camera[i, 0]), np.float64(p_camera[i, 1])
        for plane in range(5):
            beyond |= int(_inside(x, y, z, plane, box) < 0.0) << plane
        outside[i] = beyond
        if beyond & 1:
            continue
        x, y = x / z, y / z
        u, v = pixel(x, y, lens)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = x, y, 1.0 / z, u, v


@njit(cache=True, nogil=True, error_model="numpy")
def clip(corners: F64, box: F64, crossed: int, scratch: F64) -> tuple[int, int]:
    """What of a triangle (3, 3) of the camera frame the image may see: a polygon scratch[k, :n]; returns k and n (0: nothing).

    Cut at those of the near limit and the four planes through `box` whose bit is set in `crossed` (Sutherland and Hodgman,
    1974). scratch: (2, MAX_CORNERS, 3).
    """
    scratch[0, :3] = corners
    k, n = 0, 3
    for plane in range(5):
        if crossed >> plane & 1 == 0:
            continue
        m = 0
        for i in range(n):
            j = i + 1 if i + 1 < n else 0
            px, py, pz = scratch[k, i, 0], scratch[k, i, 1], scratch[k, i, 2]
            qx, qy, qz = scratch[k, j, 0], scratch[k, j, 1], scratch[k, j, 2]
            dp, dq = _inside(px, py, pz, plane, box), _inside(qx, qy, qz, plane, box)
            if dp >= 0.0:
                scratch[1 - k, m, 0], scratch[1 - k, m, 1], scratch[1 - k, m, 2] = px, py, pz
                m += 1
            if (dp >= 0.0) != (dq >= 0.0):
                t = dp / (dp - dq)
                scratch[1 - k, m, 0] = px + (qx - px) * t
                scratch[1 - k, m, 1] = py + (qy - py) * t
                scratch[1 - k, m, 2] = pz + (qz - pz) * t
                m += 1
        k, n = 1 - k, m
    return k, n


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def bulge(longest_squared: float, curvature: float) -> float:
    """How far (pixels, along u and along v) the lens may move a point of a polygon out of its corners' convex hull.

    By Taylor's theorem f(sum(b_i v_i)) - sum(b_i f(v_i)) is at most M / 2 sum(b_i |v_i - p|^2) <= M L^2 / 6 on a triangle
    with longest edge L, where M (`Lens.curvature`) bounds the second derivative of the projection f. The constant covers
    float32.
    """
    return curvature * longest_squared / 6.0 + 2e-3
