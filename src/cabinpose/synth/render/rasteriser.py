"""`Rasteriser`: what a camera sees of a surface, at its pixels and at the sub-pixels of the sensor model."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import Matrix
from cabinpose.scene.materials import ID as MATERIAL
from cabinpose.scene.sensor.buffers import GeometryBuffers
from cabinpose.scene.surface import Surface
from cabinpose.synth.render import zbuffer

SEE_THROUGH: tuple[int, ...] = (MATERIAL["spectacle_lens"],)


class RenderedFrame(NamedTuple):
    """One rendered view. The images (H, W) are the caller's; `buffers` are lent until the rasteriser's next `render`.

    depth_clean: float32 m along the axis at the pixel centre, 0 = nothing · labels, instance: uint8, 0 = nothing ·
    face_id: int32 index into the surface's faces, -1 = nothing · buffers: the sub-pixels for the sensor model.
    """

    depth_clean: NDArray[np.float32]
    labels: NDArray[np.uint8]
    instance: NDArray[np.uint8]
    face_id: NDArray[np.int32]
    buffers: GeometryBuffers


class Rasteriser:
    """Z-buffer of one camera, with working memory that is reused from frame to frame.

    Every sample lies on the camera's exact ray, lens distortion included. Triangles are seen from both sides; the nearest
    one beyond `zbuffer.NEAR_M` wins, and of equally near ones the first in the surface. Rays that the distortion model
    cannot undo (NaN in `Camera.rays`) see nothing.

    The pixel images sample the pixel's centre. The buffers sample the centres of supersample x supersample equal parts of
    each pixel (`Camera.scaled`). Both see panes of glass as surfaces; materials in `see_through` (spectacle lenses) are
    seen in the pixel images, where they carry a label, but the buffers hold what lies behind: a Time-of-Flight camera
    measures the eye region through a lens, and returns from a curved lens of 5 % reflectance are rare.
    """

    def __init__(self, camera: Camera, supersample: int = 2, *, see_through: Iterable[int] = SEE_THROUGH) -> None:
        if not 1 <= supersample <= 8:
            raise ConfigError(f"supersampling by {supersample} is out of range", hint="use 1 to 8 sub-pixels a side")
        self.camera = camera
        self.supersample = supersample
        self._sub = camera.scaled(supersample)
        self._intrinsics = np.array([self._sub.fx, self._sub.fy, self._sub.cx, self._sub.cy])
        self._dist = np.array(camera.dist)
        self._rays = camera.rays
        self._sub_rays = self._sub.rays
        self._shading_rays = self._sub_rays.astype(np.float32)
        self._ray_length = self._sub.range_over_depth.astype(np.float32)
        self._box = _ray_box(self._sub)
        self._curvature = _projection_curvature(self._sub, self._box)
        self._see_through = np.zeros(256, np.uint8)
        self._see_through[list(see_through)] = 1
        shape, sub_shape = (camera.height, camera.width), (self._sub.height, self._sub.width)
        self._inverse_z = np.empty(shape, np.float32)
        self._sub_inverse_z = np.empty(sub_shape, np.float32)
        self._sub_nearest = np.empty(sub_shape, np.int32)
        self._buffers = GeometryBuffers(
            supersample, np.empty(sub_shape, np.float32), np.empty(sub_shape, np.float32), np.empty(sub_shape, np.uint8)
        )
        self._p_camera = np.empty((0, 3), np.float32)
        self._uvw = np.empty((0, 3))
        self._coefficients = np.empty((0, 9), np.float32)
        self._shaded = np.empty(0, np.int32)
        self._frame = 0

    def render(self, surface: Surface, camera_from_vehicle: Matrix) -> RenderedFrame:
        """The view of a surface given in the vehicle frame."""
        self._reserve(len(surface.vertices), len(surface.faces))
        self._frame += 1
        p_camera = self._p_camera[: len(surface.vertices)]
        uvw = self._uvw[: len(surface.vertices)]
        matrix = np.ascontiguousarray(camera_from_vehicle, dtype=np.float64)
        zbuffer.to_camera(surface.vertices, matrix, p_camera)
        zbuffer.project(p_camera, self._intrinsics, self._dist, self._box, uvw)
        nearest = np.empty((self.camera.height, self.camera.width), np.int32)
        zbuffer.rasterise(
            p_camera, uvw, surface.faces, self._see_through[surface.material], self.supersample, self._intrinsics, self._dist,
            self._box, self._curvature, self._sub_rays, self._sub_inverse_z, self._sub_nearest, self._rays, self._inverse_z,
            nearest,
        )  # fmt: skip
        zbuffer.shade(
            self._sub_nearest, self._sub_inverse_z, self._shading_rays, self._ray_length, p_camera, surface.normals,
            matrix[:3, :3], surface.faces, surface.material, self._coefficients, self._shaded, self._frame,
            self._buffers.depth_m, self._buffers.cos_incidence, self._buffers.material,
        )  # fmt: skip
        depth = np.empty(nearest.shape, np.float32)
        labels, instance = np.empty(nearest.shape, np.uint8), np.empty(nearest.shape, np.uint8)
        zbuffer.classify(nearest, self._inverse_z, surface.label, surface.instance, depth, labels, instance)
        return RenderedFrame(depth, labels, instance, nearest, self._buffers)

    def _reserve(self, vertices: int, faces: int) -> None:
        """Room for a surface; grows by half at least, so that a run of like scenes stops growing early."""
        if vertices > len(self._p_camera):
            size = max(vertices, len(self._p_camera) * 3 // 2)
            self._p_camera, self._uvw = np.empty((size, 3), np.float32), np.empty((size, 3))
        if faces > len(self._shaded):
            size = max(faces, len(self._shaded) * 3 // 2)
            self._coefficients, self._shaded = np.empty((size, 9), np.float32), np.zeros(size, np.int32)


def _ray_box(camera: Camera) -> NDArray[np.float64]:
    """(x min, y min, x max, y max) of the ideal rays of an image, a little widened."""
    rays = camera.rays.reshape(-1, 2)
    if np.isnan(rays).all():
        raise ConfigError("no pixel of this camera has a ray", hint="check the distortion coefficients and the focal length")
    margin = 1.0 / min(camera.fx, camera.fy)
    return np.concatenate((np.nanmin(rays, axis=0) - margin, np.nanmax(rays, axis=0) + margin))


def _projection_curvature(camera: Camera, box: NDArray[np.float64]) -> float:
    """A bound (pixels) on the second derivative of ideal coordinates -> pixels in the box; 0 for a pinhole.

    Central differences on a grid of the box, as the Frobenius norm of the Hessians, with a fifth to spare for what lies
    between the grid's nodes.
    """
    if not camera.is_distorted:
        return 0.0
    x, y = np.meshgrid(np.linspace(box[0], box[2], 65), np.linspace(box[1], box[3], 65))
    xy = np.stack((x, y), axis=-1)
    h = 1e-3

    def at(dx: float, dy: float) -> NDArray[np.float64]:
        return camera.distort(xy + (dx * h, dy * h))

    xx = (at(1, 0) - 2 * at(0, 0) + at(-1, 0)) / h**2
    yy = (at(0, 1) - 2 * at(0, 0) + at(0, -1)) / h**2
    mixed = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / (4 * h**2)
    norms = np.sqrt(xx**2 + yy**2 + 2 * mixed**2) * (camera.fx, camera.fy)
    return float(1.2 * norms.max())
