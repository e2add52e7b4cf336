"""`Rasteriser`: what a camera sees of a surface, at its pixels and, for the sensor model, at the parts of mixed ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cabinpose._native import raster as native
from cabinpose.core import JOINTS, Bools, Bytes, Camera, ConfigError, Floats, Floats32, Ints, Ints32, Matrix
from cabinpose.scene import MATERIAL_ID as MATERIAL
from cabinpose.scene import Surface
from cabinpose.scene.sensor import GeometryBuffers, in_parts
from cabinpose.synth.render.visibility import visibility_rules

SEE_THROUGH: tuple[int, ...] = (MATERIAL["spectacle_lens"],)

_NONE, _SOME, _ALL = 0, 1, 2  # which pixels are seen in parts
_LOOKED_THROUGH, _TWO_SIDED = 1, 2  # bits of a material
_CACHE_LINE = 64  # bytes


class RenderedFrame(NamedTuple):
    """One rendered view. `buffers` are lent until the rasteriser's next `render`, the rest is the caller's.

    depth_clean: (H, W) float32 m along the axis at the pixel centre, 0 = nothing · labels, instance: (H, W) uint8, 0 = nothing ·
    face_id: (H, W) int32 index into the surface's faces, -1 = nothing · buffers: what the sensor model reads ·
    visibility: (P, 20) uint8 states of the joints that were asked for.
    """

    depth_clean: Floats32
    labels: Bytes
    instance: Bytes
    face_id: Ints32
    buffers: GeometryBuffers
    visibility: Bytes


class Rasteriser:
    """Z-buffer of one camera, with buffers that are reused from frame to frame.

    Every sample lies on the camera's exact ray, lens distortion included. Triangles are seen from both sides; the nearest
    one beyond 1 cm from the camera plane wins, and of equally near ones the first in the surface. Rays that the distortion model
    cannot undo (NaN in `Camera.rays`) see nothing.

    The pixel images sample the pixel's centre. The buffers sample it too and, of mixed pixels, the centres of
    supersample x supersample equal parts (`Camera.scaled`). A pixel is mixed where its neighbours to the left and right, above
    and below are not with it on one smooth surface of one material, and at the image's border. What is
    so thin that it passes between the centres of a pixel and of these four neighbours is not seen by that pixel's parts:
    where that matters, `adaptive` False takes every pixel for mixed.

    Both see panes of glass as surfaces; materials in `see_through` (spectacle lenses) are seen in the pixel images, where
    they carry a label, but the buffers hold what lies behind: a Time-of-Flight camera measures the eye region through a
    lens, and returns from a curved lens of 5 % reflectance are rare.

    The rays through joints are samples of the same pass; docs/visibility.md defines the states.
    """

    def __init__(
        self, camera: Camera, supersample: int = 2, *, see_through: Iterable[int] = SEE_THROUGH, adaptive: bool = True
    ) -> None:
        if not 1 <= supersample <= 8:
            raise ConfigError(f"supersampling by {supersample} is out of range", hint="use 1 to 8 samples a pixel side")
        self.camera = camera
        self.supersample = supersample
        if adaptive:
            which = _SOME if supersample > 1 else _NONE
        else:
            which = _ALL
        fine = camera.scaled(supersample)
        looks = np.zeros(256, np.uint8)
        looks[list(see_through)] = _LOOKED_THROUGH
        looks[MATERIAL["belt_webbing"]] |= _TWO_SIDED  # a ribbon that twists shows its back
        rays = np.stack([in_parts(fine.rays[..., k].astype(np.float32), supersample) for k in (0, 1)], axis=1)
        self._eye = _Eye(
            camera.width, camera.height, supersample, lens=_lens(camera), rays=_blocks(camera), part_rays=rays, looks=looks,
            which=which,
        )  # fmt: skip
        self._shape = camera.height, camera.width
        self._room = GeometryBuffers.room(supersample, self._shape)  # for the buffers of any frame

    def render(
        self,
        surface: Surface,
        camera_from_vehicle: Matrix,
        *,
        closed: bool = False,
        joints: ArrayLike | None = None,
        instances: ArrayLike = (),
    ) -> RenderedFrame:
        """The view of a surface given in the vehicle frame.

        closed: all its parts are closed and the camera is in none of them, so that faces turned away are never seen and
        need not be drawn · joints: (P, 20, 3) m, camera frame, NaN where absent, of the persons with instance numbers (P,) whose
        visibility is asked for.
        """
        positions = np.zeros((0, len(JOINTS), 3)) if joints is None else np.ascontiguousarray(joints, dtype=np.float64)
        numbers = np.ascontiguousarray(instances, dtype=np.uint8)
        if len(numbers) != len(positions):
            raise ConfigError(
                f"the joints of {len(positions)} persons have {len(numbers)} instance numbers",
                hint="give one number for each person",
            )
        frame = RenderedFrame(
            np.empty(self._shape, np.float32), np.empty(self._shape, np.uint8), np.empty(self._shape, np.uint8),
            np.empty(self._shape, np.int32), self._room, np.empty(positions.shape[:2], np.uint8),
        )  # fmt: skip
        camera, rules = np.ascontiguousarray(camera_from_vehicle, dtype=np.float64), visibility_rules()
        number = native.render(surface, camera, closed, self._eye, _Joints(positions, numbers, *rules), frame)
        return frame._replace(buffers=self._room.first(number))


def normals_at(surface: Surface, face: Ints, point: Floats, direction: Floats) -> Floats:
    """(N, 3) unit normals, interpolated and towards the eye, where rays (N, 3) meet triangles (N,) at points (N, 3)."""
    a, b, c = (surface.vertices[surface.faces[face, k]].astype(np.float64) for k in range(3))
    flat = np.cross(b - a, c - a)
    share = [np.einsum("ij,ij->i", np.cross(q - p, point - p), flat) for p, q in ((b, c), (c, a), (a, b))]
    corner = surface.normals[surface.faces[face]]
    mixed = sum(np.clip(s, 0.0, None)[:, None] * corner[:, k] for k, s in enumerate(share))
    mixed = np.where(np.linalg.norm(mixed, axis=1, keepdims=True) > 0, mixed, flat)
    mixed /= np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-30)
    mixed *= -np.sign(np.einsum("ij,ij->i", mixed, direction) + 1e-30)[:, None]
    return np.asarray(mixed)


class _Lens(NamedTuple):
    """The projection of a camera, as raster/projection.hpp describes it."""

    fx: float
    fy: float
    cx: float
    cy: float
    dist: Floats
    box: Floats
    curvature: float
    radius: float


class _Eye(NamedTuple):
    """A camera as the kernel needs it, see raster/render.hpp."""

    width: int
    height: int
    supersample: int
    lens: _Lens
    rays: Floats32
    part_rays: Floats32
    looks: Bytes
    which: int


class _Joints(NamedTuple):
    """The joints of people, and by which rules a surface before one hides it, see raster/joints.hpp."""

    positions: Floats
    instances: Bytes
    own: Bools
    reach: Floats
    passed_labels: Bools
    passed_materials: Bools


def _blocks(camera: Camera) -> Floats32:
    """Rays x and y of a camera's pixels as blocks (n, 2, 8), filled up with NaN to whole ones; they start at a cache line."""
    rows, columns = native.BLOCK_ROWS, native.BLOCK_COLUMNS
    down, across = -(-camera.height // rows), -(-camera.width // columns)
    padding = ((0, down * rows - camera.height), (0, across * columns - camera.width), (0, 0))
    padded = np.pad(camera.rays, padding, constant_values=np.nan).reshape(down, rows, across, columns, 2)
    blocks = padded.transpose(0, 2, 4, 1, 3).reshape(down * across, 2, rows * columns)
    memory = np.empty(blocks.size * 4 + _CACHE_LINE, np.uint8)
    start = -memory.ctypes.data % _CACHE_LINE
    aligned = memory[start : start + blocks.size * 4].view(np.float32).reshape(blocks.shape)
    aligned[:] = blocks
    return aligned


def _lens(camera: Camera) -> _Lens:
    rays = camera.rays.reshape(-1, 2)
    if np.isnan(rays).all():
        raise ConfigError("no pixel of this camera has a ray", hint="check the distortion coefficients and the focal length")
    margin = 1.0 / min(camera.fx, camera.fy)  # a pixel
    box = np.concatenate((np.nanmin(rays, axis=0) - margin, np.nanmax(rays, axis=0) + margin))
    return _Lens(
        camera.fx, camera.fy, camera.cx, camera.cy, np.array(camera.dist, np.float64), box, _curvature(camera, box),
        camera.visible_radius,
    )  # fmt: skip


def _curvature(camera: Camera, box: Floats) -> float:
    """A bound (pixels) on the second derivative of ideal coordinates -> pixels in the box; 0 for a pinhole.

    Central differences on a grid of the box, as the Frobenius norm of the Hessians, with a fifth to spare for what lies
    between the grid's nodes.
    """
    if not camera.is_distorted:
        return 0.0
    x, y = np.meshgrid(np.linspace(box[0], box[2], 65), np.linspace(box[1], box[3], 65))
    xy = np.stack((x, y), axis=-1)
    h = 1e-3

    def at(dx: float, dy: float) -> Floats:
        return camera.distort(xy + (dx * h, dy * h))

    xx = (at(1, 0) - 2 * at(0, 0) + at(-1, 0)) / h**2
    yy = (at(0, 1) - 2 * at(0, 0) + at(0, -1)) / h**2
    mixed = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / (4 * h**2)
    norms = np.sqrt(xx**2 + yy**2 + 2 * mixed**2) * (camera.fx, camera.fy)
    return float(1.2 * norms.max())
