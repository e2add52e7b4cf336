"""What a network sees: the camera's frame resampled to the model's own pinhole, so that one model serves many cameras.

Every method looks through a fixed virtual camera without distortion. A frame of any real camera is resampled to it by
nearest neighbour (depths are never averaged over an edge); joints are predicted in the virtual camera and go back to the
real one through 3D. Needs numpy only: models run without torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Camera, ConfigError

F32 = NDArray[np.float32]
Joints = NDArray[np.float64]
TICK_M = 1e-4  # of a kept depth
MOST_M = 6.5  # of a kept depth: it has 16 bits
# Share of a view that the camera fills below which it is doubted: the median error of `in_car` is 1.2 cm at 90 %, 2.3 cm at 17 %,
# 4.6 cm at 11 %, 5.8 cm at 5 % and 9.7 cm at 3 %. ITOP's images cut to 100 x 100 pixels fill 13 %.
LEAST_FILLED = 0.1
_STRIP = 32  # rows
LEAST_SHOWN = 0.1  # share of the camera's pixels that the view has; `room` has 17 % of an Azure Kinect's wide field, the widest


@dataclass(frozen=True)
class InputView:
    """The virtual pinhole of a model: size and focal length in pixels, optical axis through the centre.

    max_depth_m: what lies farther counts as invalid, as it would for a sensor of that range.
    """

    width: int = 176
    height: int = 144
    focal: float = 80.0
    max_depth_m: float = 6.5

    @cached_property
    def camera(self) -> Camera:
        """The pinhole of this view."""
        return Camera(self.width, self.height, self.focal, self.focal, (self.width - 1) / 2, (self.height - 1) / 2)

    def resample(self, images: NDArray[np.generic], source: Camera) -> NDArray[np.generic]:
        """Images (..., H, W) of the source camera as (..., height, width) of this view; 0 where the source does not look."""
        if images.shape[-2:] != (source.height, source.width):
            raise ConfigError(
                f"frames of {images.shape[-1]}x{images.shape[-2]} pixels do not belong to a camera of "
                f"{source.width}x{source.height}",
                hint="give the intrinsics of the frames",
            )
        return _gather(images, _nearest(self, source))

    def filled(self, source: Camera) -> float:
        """The share of this view's pixels that the source camera sees."""
        return 1.0 - _nearest(self, source).outside.size / (self.width * self.height)

    def shown(self, source: Camera) -> float:
        """The share of the source camera's pixels that this view sees."""
        u, seen = np.arange(source.width, dtype=np.float64), 0
        for top in range(0, source.height, _STRIP):  # of a whole image the arrays would stay with the process
            v = np.arange(top, min(top + _STRIP, source.height), dtype=np.float64)
            strip = source.undistort(np.stack(np.meshgrid((u - source.cx) / source.fx, (v - source.cy) / source.fy), axis=-1))
            seen += int(np.count_nonzero(self.camera.contains(strip * self.focal + (self.camera.cx, self.camera.cy))))
        return seen / (source.width * source.height)

    def doubts(self, source: Camera) -> tuple[str, ...]:
        """What speaks against looking at a camera's images through this view, in words."""
        return _doubts(self, source)

    def depth(self, depth_m: NDArray[np.floating], source: Camera) -> F32:
        """Depth images (..., H, W) in metres, NaN or 0 where invalid, as this view's, 0 where invalid or out of range."""
        seen = np.asarray(self.resample(depth_m, source), dtype=np.float32)  # a copy, so that it can be changed in place
        valid = (seen > 0) & (seen <= self.max_depth_m)  # False for NaN and the infinities
        np.copyto(seen, np.float32(0), where=~valid)
        return seen

    def to_source(self, images: NDArray[np.generic], source: Camera) -> NDArray[np.generic]:
        """Images (..., height, width) of this view as (..., H, W) of the source camera; 0 where the view does not look."""
        return _gather(images, _nearest_back(self, source))

    def pixels(self, uv: NDArray[np.floating], source: Camera) -> Joints:
        """Where the source camera sees what the view sees at (u, v) (..., 2), whatever its depth; NaN where it sees nothing."""
        camera = self.camera
        xy = (np.asarray(uv, dtype=np.float64) - (camera.cx, camera.cy)) / self.focal
        return source.project(np.concatenate((xy, np.ones_like(xy[..., :1])), axis=-1))

    def to_view(self, p_camera: Joints) -> Joints:
        """Points (..., 3) in the camera frame (m) to (u, v, z): pixels of this view and depth in metres."""
        return np.concatenate((self.camera.project(p_camera), p_camera[..., 2:]), axis=-1)

    def from_view(self, uvz: NDArray[np.floating]) -> Joints:
        """The inverse of `to_view`: (u, v, z) to points (..., 3) in the camera frame (m)."""
        points = np.array(uvz, dtype=np.float64)
        xy = points[..., :2]
        xy -= self.camera.cx, self.camera.cy
        xy /= self.focal
        xy *= points[..., 2:]
        return points


def channels_first(pictures: NDArray[np.generic]) -> NDArray[np.generic]:
    """Pictures (..., H, W, C) as (..., C, H, W)."""
    return np.moveaxis(pictures, -1, -3)


class _Nearest(NamedTuple):
    """at: (h, w) flat index of another camera's pixel, the nearest to each · outside: flat positions that have none."""

    at: NDArray[np.int64]
    outside: NDArray[np.int64]


def _gather(images: NDArray[np.generic], nearest: _Nearest) -> NDArray[np.generic]:
    """Images (..., H, W) read at the nearest pixels (..., h, w); 0 where there is none."""
    lead = images.shape[:-2]
    # Every index is in range; "clip" spares the check, and half of the time.
    taken = images.reshape(*lead, -1).take(nearest.at, axis=-1, mode="clip")
    taken.reshape(*lead, -1)[..., nearest.outside] = 0
    return taken


@lru_cache(maxsize=32)
def _nearest(view: InputView, source: Camera) -> _Nearest:
    """The source pixel nearest to each of the view's pixels (height, width)."""
    uv = source.distort(view.camera.rays) * (source.fx, source.fy) + (source.cx, source.cy)
    inside = source.contains(uv)
    if source.is_distorted:  # beyond its fold the polynomial maps far rays back into the image
        centre = source.cx, source.cy
        back = source.undistort((np.where(inside[..., None], uv, centre) - centre) / (source.fx, source.fy))
        inside &= np.linalg.norm(back - view.camera.rays, axis=-1) < 1e-3
    return _rounded(uv, inside, source)


@lru_cache(maxsize=256)
def _doubts(view: InputView, source: Camera) -> tuple[str, ...]:
    own, theirs = (
        " x ".join(f"{np.degrees(2 * np.arctan(n / (2 * f))):.0f}°" for n, f in ((c.width, c.fx), (c.height, c.fy)))
        for c in (view.camera, source)
    )
    told = []
    if (filled := view.filled(source)) < LEAST_FILLED:
        told.append(
            f"images of {theirs} fill {100 * filled:.2g} % of the {own} that the model looks at, and it has learnt from fuller"
            " ones: joints will be far off. Take a wider lens, or train a model for this one"
        )
    if (shown := view.shown(source)) < LEAST_SHOWN:
        told.append(
            f"the model looks at {own} about the axis, {100 * shown:.2g} % of images of {theirs}, and sees nobody beside that."
            " Take a narrower lens, or train a model for this one"
        )
    return tuple(told)


@lru_cache(maxsize=32)
def _nearest_back(view: InputView, source: Camera) -> _Nearest:
    """The view's pixel nearest to each of the source's pixels (H, W)."""
    uv = source.rays * view.focal + (view.camera.cx, view.camera.cy)
    return _rounded(uv, view.camera.contains(uv), view.camera)


def _rounded(uv: Joints, inside: NDArray[np.bool_], camera: Camera) -> _Nearest:
    """The pixels of a camera that points uv (h, w, 2) of its image fall on, where they are `inside` (h, w)."""
    u, v = np.round(np.where(inside[..., None], uv, 0.0)).astype(np.int64).transpose(2, 0, 1)
    at = np.clip(v, 0, camera.height - 1) * camera.width + np.clip(u, 0, camera.width - 1)
    return _Nearest(at, np.flatnonzero(~inside))


class Kept(NamedTuple):
    """One frame in the view, as kept in memory; the fields of `Batch` without N, depth in ticks of 0.1 mm, integers of the disk.

    Images that the method does not read have the shape (0, 0).
    """

    depth: NDArray[np.uint16]
    joints: NDArray[np.float32]
    visibility: NDArray[np.uint8]
    present: NDArray[np.bool_]
    amplitude: NDArray[np.uint16]
    labels: NDArray[np.uint8]
    wheel: NDArray[np.int8] = np.array(0, np.int8)
    rgb: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
