"""What a ToF camera's pixels see of a few simple bodies: rays cast analytically, many to a pixel where it sees an edge.

The renderer of `synth.render` draws triangles at 2 x 2 samples a pixel. Calibration needs edges and markers to hundredths of a
pixel. So the light of hundreds of rays is summed up for each surface in a pixel, and handed to the sensor model as one part a
surface: it averages energies and phasors of parts, and this is the same average.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.frames import Matrix, apply
from cabinpose.scene.materials import ID, MATERIALS
from cabinpose.scene.sensor import GeometryBuffers, Sensor
from cabinpose.scene.sensor.optics import lens_maps

F64 = NDArray[np.float64]

_SUPERSAMPLE = 2  # parts of the sensor model: 2 x 2, one for each kind of surface
_BACKGROUND, _CAPSULE, _PLATE, _SPHERE = range(4)
_EDGE_RAYS, _SPHERE_RAYS = 8, 16  # along a pixel's side, where it sees an edge, a sphere
# Surfaces are of one material; their reflectance relative to it is in the cosine, by which the sensor model multiplies it.
_MATERIAL = ID["painted_wall"]
_REFLECTANCE = MATERIALS[_MATERIAL].reflectance
_THIN = 0.005  # radius (m) of capsules that may pass between the corners of a pixel
_TILE = 16  # pixels of a side of the squares in which bodies are looked for


@dataclass(frozen=True)
class Plate:
    """A flat rectangle with a checkerboard on it, which is printed on the side that faces -z.

    frame: (4, 4) from the plate's frame (x, y in its plane) to the scene's · size: x and y of two opposite corners (m) ·
    squares: x and y of the checkerboard's first corner, its squares along x and along y, their side (m); the first is black ·
    reflectances: of paper, ink and the back.
    """

    frame: Matrix
    size: tuple[float, float, float, float]
    squares: tuple[float, float, int, int, float]
    reflectances: tuple[float, float, float] = (0.75, 0.06, 0.3)


@dataclass(frozen=True)
class Scene:
    """Bodies in one frame, metres; reflectances are relative to a white Lambertian surface, and may be above 1.

    planes: (P, 5) unit normal, distance d of n p = d, reflectance · capsules: (C, 8) two ends, radius, reflectance ·
    spheres: (S, 5) centre, radius, reflectance at its middle · plate: at most one.
    """

    planes: F64
    capsules: F64
    spheres: F64
    plate: Plate | None = None

    def seen_from(self, b_from_a: Matrix) -> Scene:
        """The scene in another frame."""
        normals = self.planes[:, :3] @ b_from_a[:3, :3].T
        planes = np.column_stack((normals, self.planes[:, 3] + normals @ b_from_a[:3, 3], self.planes[:, 4]))
        ends = apply(b_from_a, self.capsules[:, :6].reshape(-1, 3)).reshape(-1, 6)
        return Scene(
            planes,
            np.column_stack((ends, self.capsules[:, 6:])),
            np.column_stack((apply(b_from_a, self.spheres[:, :3]), self.spheres[:, 3:])),
            None if self.plate is None else replace(self.plate, frame=b_from_a @ self.plate.frame),
        )


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> tuple[F64, F64]:
    """Ideal coordinates of the pixels' centres (H, W, 2) and corners (H + 1, W + 1, 2)."""
    corners = replace(camera, width=camera.width + 1, height=camera.height + 1, cx=camera.cx + 0.5, cy=camera.cy + 0.5)
    return camera.rays, corners.rays


def cast(scene: Scene, sensor: Sensor) -> GeometryBuffers:
    """What the camera sees of a scene in its own frame: geometry for `simulate`, with the noise model's incidence left on."""
    camera = sensor.camera
    centres, corners = _rays(camera)
    shape = (camera.height, camera.width)
    if scene.plate is None:
        plate = np.zeros((0, 12))
    else:
        turn, origin = scene.plate.frame[:3, :3], scene.plate.frame[:3, 3]
        plate = np.concatenate((origin, turn.T.ravel()))[None]
    settings = (
        np.zeros(12) if scene.plate is None else np.array((*scene.plate.size, *scene.plate.squares, *scene.plate.reflectances))
    )
    bodies = (np.ascontiguousarray(scene.planes), np.ascontiguousarray(scene.capsules), scene.spheres.copy(), plate, settings)
    depth, cosine = np.empty(shape, np.float32), np.empty(shape, np.float32)
    finely = np.zeros(shape, np.uint8)
    _look(centres, corners, *bodies, depth, cosine, finely)
    mixed = np.flatnonzero(finely).astype(np.int32)
    parts_depth = np.empty((len(mixed), _SUPERSAMPLE**2), np.float32)
    parts_cosine = np.empty_like(parts_depth)
    factors = lens_maps(sensor, _SUPERSAMPLE).parts_range_over_depth
    _look_finely(mixed, finely, corners, factors, *bodies, parts_depth, parts_cosine)
    cosine /= np.float32(_REFLECTANCE)
    parts_cosine /= np.float32(_REFLECTANCE)
    return GeometryBuffers(
        _SUPERSAMPLE, depth, cosine, np.where(depth > 0, np.uint8(_MATERIAL), np.uint8(0)),
        mixed, parts_depth, parts_cosine, np.where(parts_depth > 0, np.uint8(_MATERIAL), np.uint8(0)),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _sphere(x: float, y: float, cx: float, cy: float, cz: float, radius: float) -> float:
    """Depth at which the ray t (x, y, 1) from the origin enters a sphere; inf where it does not."""
    a = x * x + y * y + 1.0
    b = x * cx + y * cy + cz
    c = cx * cx + cy * cy + cz * cz - radius * radius
    root = b * b - a * c
    if root <= 0.0 or b <= 0.0:
        return np.inf
    return (b - np.sqrt(root)) / a


@njit(cache=True, nogil=True, error_model="numpy")
def _distance_to_line(x: float, y: float, body: F64) -> tuple[float, float]:
    """Least distance between the ray through (x, y, 1) and a capsule's axis, and the depth there, as (distance, depth)."""
    a = x * x + y * y + 1.0
    ex, ey, ez = body[3] - body[0], body[4] - body[1], body[5] - body[2]
    b = x * ex + y * ey + ez
    e = ex * ex + ey * ey + ez * ez
    d = x * body[0] + y * body[1] + body[2]
    f = ex * body[0] + ey * body[1] + ez * body[2]
    determinant = a * e - b * b
    s = 0.0
    if determinant > 1e-12:
        s = min(max((b * d - a * f) / determinant, 0.0), 1.0)
    px, py, pz = body[0] + s * ex, body[1] + s * ey, body[2] + s * ez
    t = (x * px + y * py + pz) / a
    return np.sqrt((px - t * x) ** 2 + (py - t * y) ** 2 + (pz - t) ** 2), t


@njit(cache=True, nogil=True, error_model="numpy")
def _capsule(x: float, y: float, body: F64) -> float:
    """Depth at which the ray t (x, y, 1) enters a capsule; inf where it does not."""
    distance, _ = _distance_to_line(x, y, body)
    radius = body[6]
    if distance >= radius:
        return np.inf
    ex, ey, ez = body[3] - body[0], body[4] - body[1], body[5] - body[2]
    e = ex * ex + ey * ey + ez * ez
    along = x * ex + y * ey + ez
    start = -(body[0] * ex + body[1] * ey + body[2] * ez)
    # the cylinder: |p - (p e) e / e^2| = radius with p = t d - p0
    a = (x * x + y * y + 1.0) * e - along * along
    b = -(x * body[0] + y * body[1] + body[2]) * e - start * along
    c = (body[0] ** 2 + body[1] ** 2 + body[2] ** 2 - radius * radius) * e - start * start
    root = b * b - a * c
    if root > 0.0 and a > 1e-12:
        t = (-b - np.sqrt(root)) / a
        at = start + t * along
        if 0.0 < at < e:
            return t
    return min(
        _sphere(x, y, body[0], body[1], body[2], radius),
        _sphere(x, y, body[3], body[4], body[5], radius),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _near(x: float, y: float, reach: float, capsules: F64, spheres: F64, among: int) -> int:
    """Bodies, a bit each, that a ray through a point up to `reach` from (x, y, 1) may meet: capsules, then spheres."""
    found, square = 0, x * x + y * y + 1.0
    for k in range(capsules.shape[0]):
        if among >> k & 1:
            body = capsules[k]
            distance, _ = _distance_to_line(x, y, body)
            if distance < body[6] + reach * (max(body[2], body[5]) + body[6]):
                found |= 1 << k
    for k in range(spheres.shape[0]):
        bit = capsules.shape[0] + k
        if among >> bit & 1:
            s = spheres[k]
            t = max((x * s[0] + y * s[1] + s[2]) / square, 0.0)
            distance = np.sqrt((t * x - s[0]) ** 2 + (t * y - s[1]) ** 2 + (t - s[2]) ** 2)
            if distance < s[3] + reach * (s[2] + s[3]):
                found |= 1 << bit
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _on_plate(x: float, y: float, p: F64) -> tuple[float, float, float]:
    """Where the ray t (x, y, 1) meets a plate's plane, in its frame, and the depth there; NaN where it does not."""
    towards = p[9] * x + p[10] * y + p[11]
    if abs(towards) < 1e-9:
        return np.nan, np.nan, np.nan
    t = (p[9] * p[0] + p[10] * p[1] + p[11] * p[2]) / towards
    if t <= 0.0:
        return np.nan, np.nan, np.nan
    qx, qy, qz = t * x - p[0], t * y - p[1], t - p[2]
    return p[3] * qx + p[4] * qy + p[5] * qz, p[6] * qx + p[7] * qy + p[8] * qz, t


@njit(cache=True, nogil=True, error_model="numpy")
def _hit(
    x: float, y: float, planes: F64, capsules: F64, spheres: F64, plate: F64, settings: F64, among: int
) -> tuple[int, float, float]:
    """Along the ray t (x, y, 1): which surface, its depth (0: none), its reflectance times the cosine of incidence.

    The surface is its kind times 64 plus which of that kind. Capsules and spheres are those of the bits `among` (`_near`).
    """
    length = np.sqrt(x * x + y * y + 1.0)
    surface, depth, light = 64 * _BACKGROUND - 1, np.inf, 0.0
    for k in range(planes.shape[0]):
        towards = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
        if towards * planes[k, 3] > 0.0:
            t = planes[k, 3] / towards
            if t < depth:
                surface, depth, light = 64 * _BACKGROUND + k, t, planes[k, 4] * abs(towards) / length
    for k in range(plate.shape[0]):
        a, b, t = _on_plate(x, y, plate[k])
        if t < depth and settings[0] <= a <= settings[2] and settings[1] <= b <= settings[3]:
            towards = plate[k, 9] * x + plate[k, 10] * y + plate[k, 11]
            i, j = int(np.floor((a - settings[4]) / settings[8])), int(np.floor((b - settings[5]) / settings[8]))
            reflectance = settings[9]
            if towards < 0.0:
                reflectance = settings[11]
            elif 0 <= i < settings[6] and 0 <= j < settings[7] and (i + j) % 2 == 0:
                reflectance = settings[10]
            surface, depth, light = 64 * _PLATE, t, reflectance * abs(towards) / length
    bit = 0
    while among >> bit:
        if among >> bit & 1:
            if bit < capsules.shape[0]:
                body = capsules[bit]
                t = _capsule(x, y, body)
                if 0.0 < t < depth:
                    ex, ey, ez = body[3] - body[0], body[4] - body[1], body[5] - body[2]
                    px, py, pz = t * x - body[0], t * y - body[1], t - body[2]
                    along = min(max((px * ex + py * ey + pz * ez) / (ex * ex + ey * ey + ez * ez), 0.0), 1.0)
                    nx, ny, nz = px - along * ex, py - along * ey, pz - along * ez
                    cosine = -(nx * x + ny * y + nz) / (body[6] * length)
                    surface, depth, light = 64 * _CAPSULE + bit, t, body[7] * max(cosine, 0.0)
            else:
                k = bit - capsules.shape[0]
                s = spheres[k]
                t = _sphere(x, y, s[0], s[1], s[2], s[3])
                if 0.0 < t < depth:
                    cosine = -((t * x - s[0]) * x + (t * y - s[1]) * y + (t - s[2])) / (s[3] * length)
                    surface, depth, light = 64 * _SPHERE + k, t, s[4] * max(cosine, 0.0)
        bit += 1
    if depth == np.inf:
        return surface, 0.0, 0.0
    return surface, depth, light


@njit(cache=True, nogil=True, error_model="numpy")
def _half_diagonal(corners: F64, v: int, u: int, size: int, x: float, y: float) -> float:
    """The farthest of the four corners of `size` x `size` pixels from (x, y)."""
    farthest = 0.0
    for dv in (0, size):
        for du in (0, size):
            c = corners[min(v + dv, corners.shape[0] - 1), min(u + du, corners.shape[1] - 1)]
            farthest = max(farthest, (c[0] - x) ** 2 + (c[1] - y) ** 2)
    return np.sqrt(farthest)


@njit(cache=True, nogil=True, error_model="numpy")
def _lines_between(a: NDArray[np.float64], first: float, last: float, step: float) -> bool:
    """Whether values (4,) lie on both sides of one of the lines first, first + step, ..., last."""
    low, high = min(a[0], a[1], a[2], a[3]), max(a[0], a[1], a[2], a[3])
    line = first + max(np.ceil((low - first) / step), 0.0) * step
    return line <= high and line <= last + 1e-9


@njit(cache=True, nogil=True, error_model="numpy")
def _beside(a: NDArray[np.float64], b: NDArray[np.float64], x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether a polygon with its corners at (a, b) (4,) lies on one side of a rectangle; False where a corner is NaN."""
    if np.isnan(a[0] + a[1] + a[2] + a[3]):
        return False
    return (
        max(a[0], a[1], a[2], a[3]) < x0
        or min(a[0], a[1], a[2], a[3]) > x1
        or max(b[0], b[1], b[2], b[3]) < y0
        or min(b[0], b[1], b[2], b[3]) > y1
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _sees_a_line(a: NDArray[np.float64], b: NDArray[np.float64], settings: F64) -> bool:
    """Whether a pixel with its corners at (a, b) (4,) on the plate may see an edge of it or of its squares."""
    x0, y0, x1, y1 = settings[0], settings[1], settings[2], settings[3]
    if _beside(a, b, x0, y0, x1, y1):
        return False
    if _lines_between(a, x0, x1, x1 - x0) or _lines_between(b, y0, y1, y1 - y0):
        return True
    side = settings[8]
    x2, y2 = settings[4] + settings[6] * side, settings[5] + settings[7] * side
    if _beside(a, b, settings[4], settings[5], x2, y2):
        return False
    return _lines_between(a, settings[4], x2, side) or _lines_between(b, settings[5], y2, side)


@njit(cache=True, nogil=True, error_model="numpy")
def _same_plane(corners: F64, top: int, left: int, rows: int, columns: int, planes: F64) -> bool:
    """Whether all rays of a tile meet the same plane first: where the four at its corners do, since such regions are convex."""
    first = -1
    for k in range(4):
        ray = corners[top + k // 2 * rows, left + k % 2 * columns]
        nearest, which = 0.0, -1
        for n in range(planes.shape[0]):
            nearness = (planes[n, 0] * ray[0] + planes[n, 1] * ray[1] + planes[n, 2]) / planes[n, 3]
            if nearness > nearest:
                nearest, which = nearness, n
        if which < 0 or (k > 0 and which != first):
            return False
        first = which
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _look(
    centres: F64,
    corners: F64,
    planes: F64,
    capsules: F64,
    spheres: F64,
    plate: F64,
    settings: F64,
    depth: NDArray[np.float32],
    cosine: NDArray[np.float32],
    finely: NDArray[np.uint8],
) -> None:
    """One ray a pixel, and which pixels need more: `finely` is the number of rays along their side, 0 where one does."""
    height, width = depth.shape
    everything = (1 << (capsules.shape[0] + spheres.shape[0])) - 1
    seen, on_plate = np.empty((_TILE + 1, _TILE + 1), np.int64), np.empty((_TILE + 1, _TILE + 1, 2))
    a, b = np.empty(4), np.empty(4)
    for top in range(0, height, _TILE):
        for left in range(0, width, _TILE):
            middle = centres[min(top + _TILE // 2, height - 1), min(left + _TILE // 2, width - 1)]
            reach = _half_diagonal(corners, top, left, _TILE, middle[0], middle[1])
            bodies = everything
            if reach < np.inf:  # and no corner lies outside the lens model
                bodies = _near(middle[0], middle[1], reach, capsules, spheres, everything)
            rows, columns = min(_TILE, height - top), min(_TILE, width - left)
            for k in range(4 * plate.shape[0]):
                ray = corners[top + k // 2 * rows, left + k % 2 * columns]
                a[k], b[k], _ = _on_plate(ray[0], ray[1], plate[0])
            plates = plate
            if plate.shape[0] and _beside(a, b, settings[0], settings[1], settings[2], settings[3]):
                plates = plate[:0]
            if not bodies and not plates.shape[0] and _same_plane(corners, top, left, rows, columns, planes):
                for v in range(top, top + rows):
                    for u in range(left, left + columns):
                        x, y = centres[v, u]
                        _, depth[v, u], light = _hit(x, y, planes, capsules, spheres, plates, settings, 0)
                        cosine[v, u] = light
                        finely[v, u] = 0
                continue
            capsules_here = bodies & ((1 << capsules.shape[0]) - 1)
            for v in range(rows + 1):
                for u in range(columns + 1):
                    ray = corners[top + v, left + u]
                    seen[v, u], _, _ = _hit(ray[0], ray[1], planes, capsules, spheres, plates, settings, capsules_here)
                    if plates.shape[0]:
                        on_plate[v, u, 0], on_plate[v, u, 1], _ = _on_plate(ray[0], ray[1], plate[0])
            for v in range(rows):
                for u in range(columns):
                    x, y = centres[top + v, left + u]
                    here, depth[top + v, left + u], light = _hit(x, y, planes, capsules, spheres, plates, settings, bodies)
                    cosine[top + v, left + u] = light
                    rays = 0
                    if not (seen[v, u] == seen[v, u + 1] == seen[v + 1, u] == seen[v + 1, u + 1] == here):
                        rays = _EDGE_RAYS
                    if plates.shape[0]:
                        for k in range(4):
                            a[k], b[k] = on_plate[v + k // 2, u + k % 2]
                        if _sees_a_line(a, b, settings):
                            rays = _EDGE_RAYS
                    if bodies:
                        near = _near(x, y, _half_diagonal(corners, top + v, left + u, 1, x, y), capsules, spheres, bodies)
                        if near >> capsules.shape[0]:
                            rays = _SPHERE_RAYS
                        for k in range(capsules.shape[0]):
                            if near >> k & 1 and seen[v, u] == here and capsules[k, 6] < _THIN:
                                rays = max(rays, _EDGE_RAYS)
                    finely[top + v, left + u] = rays


@njit(cache=True, nogil=True, error_model="numpy")
def _look_finely(
    mixed: NDArray[np.int32],
    finely: NDArray[np.uint8],
    corners: F64,
    range_over_depth: NDArray[np.float32],
    planes: F64,
    capsules: F64,
    spheres: F64,
    plate: F64,
    settings: F64,
    depth: NDArray[np.float32],
    cosine: NDArray[np.float32],
) -> None:
    """The light of many rays in the pixels `mixed`: one part for each kind of surface, at the mean range of its light.

    The rays of a pixel have n x n different u and v (a sheared grid), so that an edge along the pixels does not pass many
    at once.
    """
    width = finely.shape[1]
    everything = (1 << (capsules.shape[0] + spheres.shape[0])) - 1
    energy, moment = np.empty(4), np.empty(4)
    for m in range(mixed.size):
        v, u = mixed[m] // width, mixed[m] % width
        c00, c01, c10, c11 = corners[v, u], corners[v, u + 1], corners[v + 1, u], corners[v + 1, u + 1]
        x, y = (c00[0] + c11[0]) / 2, (c00[1] + c11[1]) / 2
        bodies = _near(x, y, _half_diagonal(corners, v, u, 1, x, y), capsules, spheres, everything)
        n = int(finely[v, u])
        energy[:], moment[:] = 0.0, 0.0
        any_range = 0.0
        for j in range(n):
            for i in range(n):
                fu, fv = (i + (j + 0.5) / n) / n, (j + (i + 0.5) / n) / n
                w00, w01, w10, w11 = (1 - fv) * (1 - fu), (1 - fv) * fu, fv * (1 - fu), fv * fu
                x = w00 * c00[0] + w01 * c01[0] + w10 * c10[0] + w11 * c11[0]
                y = w00 * c00[1] + w01 * c01[1] + w10 * c10[1] + w11 * c11[1]
                surface, t, light = _hit(x, y, planes, capsules, spheres, plate, settings, bodies)
                if t > 0.0:
                    r = t * np.sqrt(x * x + y * y + 1.0)
                    energy[surface // 64] += light / (r * r)
                    moment[surface // 64] += light / r
                    any_range = r
        for part in range(4):
            r = moment[part] / energy[part] if energy[part] > 0.0 else any_range
            depth[m, part] = r / range_over_depth[mixed[m], part]
            cosine[m, part] = 4.0 * energy[part] / (n * n) * r * r
