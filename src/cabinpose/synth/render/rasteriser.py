"""`Rasteriser`: what a camera sees of a surface, at its pixels and, for the sensor model, at the parts of mixed ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import Matrix
from cabinpose.scene.materials import ID as MATERIAL
from cabinpose.scene.sensor.buffers import GeometryBuffers, centre_part, in_parts
from cabinpose.scene.surface import Surface
from cabinpose.synth.render.lanes import BLOCK, LANES, X, Y
from cabinpose.synth.render.projection import Lens, project, ray_box, to_camera
from cabinpose.synth.render.shading import ALL, NONE, SOME, classify, find_mixed, look_through, shade, take_rays
from cabinpose.synth.render.zbuffer import STRIP, Lattice, Parts, rasterise, refine

SEE_THROUGH: tuple[int, ...] = (MATERIAL["spectacle_lens"],)

_CACHE_LINE = 64  # bytes
_ROW = 64  # blocks of lanes in a row of parts: what is noted of a row stays in the cache


class RenderedFrame(NamedTuple):
    """One rendered view. The images (H, W) are the caller's; `buffers` are lent until the rasteriser's next `render`.

    depth_clean: float32 m along the axis at the pixel centre, 0 = nothing · labels, instance: uint8, 0 = nothing ·
    face_id: int32 index into the surface's faces, -1 = nothing · buffers: what the sensor model reads.
    """

    depth_clean: NDArray[np.float32]
    labels: NDArray[np.uint8]
    instance: NDArray[np.uint8]
    face_id: NDArray[np.int32]
    buffers: GeometryBuffers


class Rasteriser:
    """Z-buffer of one camera, with working memory that is reused from frame to frame.

    Every sample lies on the camera's exact ray, lens distortion included. Triangles are seen from both sides; the nearest
    one beyond `NEAR_M` wins, and of equally near ones the first in the surface. Rays that the distortion model
    cannot undo (NaN in `Camera.rays`) see nothing.

    The pixel images sample the pixel's centre. The buffers sample it too and, of mixed pixels, the centres of
    supersample x supersample equal parts (`Camera.scaled`). A pixel is mixed where its neighbours to the left and right, above
    and below are not with it on one smooth surface of one material (`shading.find_mixed`), and at the image's border. What is
    so thin that it passes between the centres of a pixel and of these four neighbours is not seen by that pixel's parts:
    where that matters, `adaptive` False takes every pixel for mixed.

    Both see panes of glass as surfaces; materials in `see_through` (spectacle lenses) are seen in the pixel images, where
    they carry a label, but the buffers hold what lies behind: a Time-of-Flight camera measures the eye region through a
    lens, and returns from a curved lens of 5 % reflectance are rare.
    """

    def __init__(
        self, camera: Camera, supersample: int = 2, *, see_through: Iterable[int] = SEE_THROUGH, adaptive: bool = True
    ) -> None:
        if not 1 <= supersample <= 8:
            raise ConfigError(f"supersampling by {supersample} is out of range", hint="use 1 to 8 samples a pixel side")
        self.camera = camera
        self.supersample = supersample
        if adaptive:
            self._mixed = SOME if supersample > 1 else NONE
        else:
            self._mixed = ALL
        fine = camera.scaled(supersample)
        box = ray_box(fine)
        self._lens = Lens(camera.fx, camera.fy, camera.cx, camera.cy, np.array(camera.dist), box, _curvature(camera, box))
        self._centre = _lattice(camera)
        self._part_rays = tuple(in_parts(fine.rays[..., k].astype(np.float32), supersample) for k in (0, 1))
        self._reach = (supersample - 1) / (2 * supersample)
        self._see_through = np.zeros(256, np.uint8)
        self._see_through[list(see_through)] = 1
        self._see_through[MATERIAL["belt_webbing"]] |= 2  # a ribbon that twists shows its back
        shape = (camera.height, camera.width)
        self._pixels = _SampleMemory.of(shape)
        self._parts = _SampleMemory.of((-(-fine.height * fine.width // (_ROW * LANES)), _ROW * LANES))
        self._part_samples = _aligned(self._parts.depth.size // LANES * BLOCK)
        self._mixed_pixels = np.empty(camera.height * camera.width, np.int32)
        self._before = np.empty(-(-camera.height // STRIP) * STRIP * camera.width + 1, np.int32)
        self._vertices = _VertexMemory.of(0)
        self._faces = _FaceMemory.of(0)

    def render(self, surface: Surface, camera_from_vehicle: Matrix, *, closed: bool = False) -> RenderedFrame:
        """The view of a surface given in the vehicle frame.

        closed: all its parts are closed and the camera is in none of them, so that faces turned away are never seen and
        need not be drawn.
        """
        if len(surface.vertices) > len(self._vertices.outside):
            self._vertices = _VertexMemory.of(max(len(surface.vertices), len(self._vertices.outside) * 3 // 2))
        if len(surface.faces) > len(self._faces.slots):
            self._faces = _FaceMemory.of(max(len(surface.faces), len(self._faces.slots) * 3 // 2))
        n = len(surface.vertices)
        p_camera, projected, outside = (array[:n] for array in self._vertices)
        faces = surface.faces.view(np.uint32)  # unsigned: no test for negative indices in the kernels
        matrix = np.ascontiguousarray(camera_from_vehicle, dtype=np.float64)
        to_camera(surface.vertices, matrix, p_camera)
        project(p_camera, self._lens, projected, outside)
        memory, pixels, parts = self._faces, self._pixels, self._parts
        memory.slots[: len(faces)] = -1
        lit = (p_camera, surface.normals, matrix[:3, :3], faces, surface.material, memory.matrices, memory.slots)
        noted = rasterise(
            p_camera, projected, outside, faces, self._see_through[surface.material], self._lens, self._centre, self._reach,
            closed, memory.noted, memory.boxes,
        )  # fmt: skip
        used = shade(self._centre, *lit, 0, *pixels)
        depth = pixels.depth.copy()
        face_id = np.empty(depth.shape, np.int32)
        labels, instance = np.empty(depth.shape, np.uint8), np.empty(depth.shape, np.uint8)
        classify(self._centre, surface.label, surface.instance, face_id, labels, instance)

        number = find_mixed(*pixels, self._see_through, self._mixed, self._before, self._mixed_pixels)
        per_pixel = self.supersample**2
        rows = -(-number * per_pixel // (_ROW * LANES))
        lattice = Lattice(_ROW * LANES, rows, _ROW, self._part_samples, self._part_samples.view(np.int32))
        take_rays(self._mixed_pixels, number, *self._part_rays, lattice)
        refine(
            p_camera, projected, outside, faces, self._lens, self.camera.width, memory.noted, memory.boxes, noted,
            Parts(lattice, self._before, per_pixel, self._reach),
        )  # fmt: skip
        shade(lattice, *lit, used, *(array[:rows] for array in parts))
        mixed = self._mixed_pixels[:number]
        taken = slice(number * per_pixel)
        buffers = GeometryBuffers(
            self.supersample, *pixels, mixed, parts.depth.reshape(-1)[taken].reshape(number, per_pixel),
            parts.cosine.reshape(-1)[taken].reshape(number, per_pixel),
            parts.material.reshape(-1)[taken].reshape(number, per_pixel),
        )  # fmt: skip
        look_through(
            mixed, self._see_through, centre_part(self.supersample), *(array.reshape(-1) for array in pixels),
            buffers.parts_depth_m, buffers.parts_cos_incidence, buffers.parts_material,
        )  # fmt: skip
        return RenderedFrame(depth, labels, instance, face_id, buffers)


class _SampleMemory(NamedTuple):
    """What is known of each sample."""

    depth: NDArray[np.float32]
    cosine: NDArray[np.float32]
    material: NDArray[np.uint8]

    @classmethod
    def of(cls, shape: tuple[int, int]) -> _SampleMemory:
        return cls(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.uint8))


class _VertexMemory(NamedTuple):
    """What the kernels note of each vertex."""

    p_camera: NDArray[np.float32]
    projected: NDArray[np.float32]
    outside: NDArray[np.uint8]

    @classmethod
    def of(cls, size: int) -> _VertexMemory:
        return cls(np.empty((size, 3), np.float32), np.empty((size, 5), np.float32), np.empty(size, np.uint8))


class _FaceMemory(NamedTuple):
    """What the kernels note of each face."""

    matrices: NDArray[np.float32]
    slots: NDArray[np.int32]
    noted: NDArray[np.int32]
    boxes: NDArray[np.int16]

    @classmethod
    def of(cls, size: int) -> _FaceMemory:
        return cls(
            np.empty((size, 9), np.float32), np.empty(size, np.int32), np.empty(size, np.int32), np.empty((size, 4), np.int16)
        )


def _lattice(camera: Camera) -> Lattice:
    """A camera's pixels as a lattice; rows are filled up with rays of NaN to whole vectors."""
    row_blocks = -(-camera.width // LANES)
    padding = ((0, 0), (0, row_blocks * LANES - camera.width))
    samples = _aligned(camera.height * row_blocks * BLOCK).reshape(-1, BLOCK)
    for k, offset in ((0, X), (1, Y)):
        padded = np.pad(camera.rays[..., k], padding, constant_values=np.nan)
        samples[:, offset : offset + LANES] = padded.reshape(-1, LANES)
    flat = samples.ravel()
    return Lattice(camera.width, camera.height, row_blocks, flat, flat.view(np.int32))


def _aligned(size: int) -> NDArray[np.float32]:
    """Zeros (size,) that start at a cache line, so that no block of lanes straddles more lines than it fills."""
    memory = np.zeros(size * 4 + _CACHE_LINE, np.uint8)
    start = -memory.ctypes.data % _CACHE_LINE
    return memory[start : start + size * 4].view(np.float32)


def _curvature(camera: Camera, box: NDArray[np.float64]) -> float:
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
