"""What a network sees: the camera's frame resampled to the model's own pinhole, so that one model serves many cameras.

Every method looks through a fixed virtual camera without distortion. A frame of any real camera is resampled to it by
nearest neighbour (depths are never averaged over an edge); joints are predicted in the virtual camera and go back to the
real one through 3D. Needs numpy only: models run without torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError

F32 = NDArray[np.float32]
Joints = NDArray[np.float64]


@dataclass(frozen=True)
class InputView:
    """The virtual pinhole of a model: size and focal length in pixels, optical axis through the centre.

    max_depth_m: what lies farther counts as invalid, as it would for a sensor of that range.
    """

    width: int = 176
    height: int = 144
    focal: float = 80.0
    max_depth_m: float = 6.5

    @property
    def camera(self) -> Camera:
        """The pinhole of this view."""
        return Camera(self.width, self.height, self.focal, self.focal, (self.width - 1) / 2, (self.height - 1) / 2)

    def resample(self, images: NDArray[np.generic], source: Camera) -> NDArray[np.generic]:
        """Images (..., H, W) of the source camera as (..., height, width) of this view; 0 where the source does not look."""
        if images.shape[-2:] != (source.height, source.width):
            raise ConfigError(
                f"frames of {images.shape[-1]}x{images.shape[-2]} pixels do not belong to a camera of {source.width}x{source.height}",
                hint="give the intrinsics of the frames",
            )
        index, inside = _nearest(self, source)
        flat = images.reshape(*images.shape[:-2], -1)
        return np.where(inside, flat[..., index], flat.dtype.type(0))

    def depth(self, depth_m: NDArray[np.floating], source: Camera) -> F32:
        """Depth images (..., H, W) in metres, NaN or 0 where invalid, as this view's, 0 where invalid or out of range."""
        seen = np.nan_to_num(self.resample(depth_m, source).astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        return np.where((seen > 0) & (seen <= self.max_depth_m), seen, np.float32(0))

    def to_view(self, p_camera: Joints) -> Joints:
        """Points (..., 3) in the camera frame (m) to (u, v, z): pixels of this view and depth in metres."""
        return np.concatenate((self.camera.project(p_camera), p_camera[..., 2:]), axis=-1)

    def from_view(self, uvz: NDArray[np.floating]) -> Joints:
        """The inverse of `to_view`: (u, v, z) to points (..., 3) in the camera frame (m)."""
        uvz_ = np.asarray(uvz, dtype=np.float64)
        return self.camera.unproject(uvz_[..., :2], uvz_[..., 2])


@lru_cache(maxsize=32)
def _nearest(view: InputView, source: Camera) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Flat index of the source pixel nearest to each of the view's pixels (height, width), and whether there is one."""
    uv = source.distort(view.camera.rays) * (source.fx, source.fy) + (source.cx, source.cy)
    inside = source.contains(uv)
    if source.is_distorted:  # beyond its fold the polynomial maps far rays back into the image
        back = source.undistort(
            (np.where(inside[..., None], uv, (source.cx, source.cy)) - (source.cx, source.cy)) / (source.fx, source.fy)
        )
        inside &= np.linalg.norm(back - view.camera.rays, axis=-1) < 1e-3
    u, v = np.round(np.where(inside[..., None], uv, 0.0)).astype(np.int64).transpose(2, 0, 1)
    return np.clip(v, 0, source.height - 1) * source.width + np.clip(u, 0, source.width - 1), inside
