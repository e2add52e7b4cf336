"""The finer pinhole grid on which pictures are made, and what the z-buffer knows of its samples.

Path tracers know pinholes. So a scene is looked at on a grid that covers everything the lens sees, and each sample is counted
to the pixel in which the lens (`Camera.distort`) images it: every pixel is the mean over its own area, for any lens.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cabinpose.core import Bools, Camera, Floats, Floats32, Ints, Matrix, invert
from cabinpose.core import reproducible as rp
from cabinpose.scene import Surface
from cabinpose.scene.sensor import PANES
from cabinpose.synth.render import Rasteriser, normals_at

FINER = 2  # samples of the grid along a pixel's side, where the lens magnifies most


@dataclass(frozen=True)
class Grid:
    """A pinhole that covers a lens' view.

    camera: the lens · pinhole: its samples as pixels · pixel: (N,) flat index of the pixel of each sample, -1 outside ·
    count: (H * W,) samples of each pixel · centre: (H * W,) the sample nearest to each pixel's centre.
    """

    camera: Camera
    pinhole: Camera
    pixel: Ints
    count: Ints
    centre: Ints

    def mean(self, values: Floats) -> Floats:
        """(H, W, C) of the samples' values (N, C); NaN in pixels through which the lens shows nothing."""
        share = np.divide(1.0, self.count, out=np.full(len(self.count), np.nan), where=self.count > 0)
        return self.total(values) * share.reshape(self.camera.height, self.camera.width, 1)

    def total(self, values: Floats) -> Floats:
        """(H, W, C) sums of the samples' values (N, C)."""
        inside = self.pixel >= 0
        where = self.pixel[inside]
        sums = np.empty((len(self.count), values.shape[1]))
        for k in range(values.shape[1]):
            sums[:, k] = np.bincount(where, values[inside, k], len(self.count))
        return sums.reshape(self.camera.height, self.camera.width, -1)


@lru_cache(maxsize=8)
def grid_of(camera: Camera) -> Grid:
    """The grid of a camera."""
    pitch = 1.0 / (FINER * max(camera.fx, camera.fy))
    if camera.is_distorted:
        low, high = (np.asarray(f(camera.rays, axis=(0, 1))) for f in (np.nanmin, np.nanmax))
        low, high = low - FINER * pitch, high + FINER * pitch
    else:
        corners = np.array([(-0.5, -0.5), (camera.width - 0.5, camera.height - 0.5)])
        low, high = (corners - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    width, height = np.ceil((high - low) / pitch - 1e-6).astype(int).tolist()
    cx, cy = (-low / pitch - 0.5).tolist()
    pinhole = Camera(width, height, 1.0 / pitch, 1.0 / pitch, cx, cy)
    xy = pinhole.rays
    uv = np.floor(camera.distort(xy) * (camera.fx, camera.fy) + (camera.cx, camera.cy) + 0.5).astype(int)
    seen = ((uv >= 0) & (uv < (camera.width, camera.height))).all(axis=-1)
    if camera.is_distorted:  # beyond the radius up to which the lens model is monotonic, it images places a second time
        seen &= np.abs(camera.undistort(camera.distort(xy)) - xy).max(axis=-1) < pitch
    pixel = np.where(seen, uv[..., 1] * camera.width + uv[..., 0], -1).reshape(-1)
    count = np.bincount(pixel[pixel >= 0], minlength=camera.width * camera.height)
    middle = np.clip(np.nan_to_num((camera.rays - low) / pitch).astype(int), 0, (width - 1, height - 1))
    return Grid(camera, pinhole, pixel, count, (middle[..., 1] * width + middle[..., 0]).reshape(-1))


def without_panes(surface: Surface) -> Bools:
    """(F,) the triangles that pictures show: all but panes and lenses, through which light passes as if they were not there."""
    return np.asarray(~PANES[surface.material])


@dataclass(frozen=True)
class Hits:
    """What the z-buffer finds on the grid's rays.

    face: (N,) of the surface, -1 = nothing · depth_m: (N,), 0 = nothing · normal: (N, 3) unit, interpolated, towards the eye,
    0 = nothing · direction: (N, 3) of the rays, 1 long along the axis; both in the scene's frame.
    """

    face: Ints
    depth_m: Floats32
    normal: Floats
    direction: Floats


def hits(rasteriser: Rasteriser, surface: Surface, shown: Bools, world_from_camera: Matrix) -> Hits:
    """The hits of the rays of a rasteriser of `Grid.pinhole` on the triangles `shown` (F,) of a surface."""
    index = np.flatnonzero(shown)
    part = Surface(
        surface.vertices, surface.normals, np.ascontiguousarray(surface.faces[index]),
        *(np.ascontiguousarray(a[index]) for a in (surface.label, surface.material, surface.instance)),
    )  # fmt: skip
    frame = rasteriser.render(part, invert(world_from_camera))
    found = frame.face_id.reshape(-1)
    hit = np.flatnonzero(found >= 0)
    face = np.full(len(found), -1)
    face[hit] = index[found[hit]]
    rotation, eye = np.asarray(world_from_camera)[:3, :3], np.asarray(world_from_camera)[:3, 3]
    rays = rasteriser.camera.rays.reshape(-1, 2)
    direction = rp.matmul(np.concatenate((rays, np.ones((len(rays), 1))), axis=1), rotation.T)
    depth = frame.depth_clean.reshape(-1)
    point = eye + direction[hit] * depth[hit, None]
    normal = np.zeros((len(found), 3))
    normal[hit] = normals_at(surface, face[hit], point, direction[hit])
    return Hits(face, depth, normal, direction)
