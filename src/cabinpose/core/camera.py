"""The camera model: pinhole with OpenCV's radial-tangential distortion.

Pixel (u, v): an integer is a pixel centre, so the image spans [-0.5, width - 0.5]. `depth_m` is z along the
optical axis, `range_m` the length of the ray; `rays` ties them: range = depth * |(x, y, 1)|.
Source of the distortion model: OpenCV `calib3d`, five coefficients (k1, k2, p1, p2, k3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose._native import core as native
from cabinpose.core import reproducible as rp
from cabinpose.core.errors import ConfigError

Array = NDArray[np.float64]
Distortion = tuple[float, float, float, float, float]
NO_DISTORTION: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
_WINDOW = 2  # px to each side of a pixel: their median stands for the surface there
_ROUNDED = 1e-7  # of the size of a cubic's coefficients: a double root at 0 is as far off by rounding
_TANGENTIAL = 1.02  # what tangential distortion may add to the radius at which the model folds: a factor


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera: sizes in pixels, `dist` as OpenCV's (k1, k2, p1, p2, k3)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    dist: Distortion = NO_DISTORTION

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ConfigError(f"a camera needs pixels, not {self.width}x{self.height}", hint="set width and height to at least 1")
        if not (0 < self.fx < np.inf and 0 < self.fy < np.inf):
            raise ConfigError(f"focal lengths are positive and finite, not {self.fx}, {self.fy}", hint="give fx and fy in pixels")
        if not np.isfinite((self.cx, self.cy, *self.dist)).all():
            raise ConfigError(
                f"principal point and distortion are finite, not {self.cx}, {self.cy} and {self.dist}",
                hint="give cx and cy in pixels, dist as k1 k2 p1 p2 k3",
            )

    @cached_property
    def monotonic_radius(self) -> float:
        """The ideal radius (tangent of the angle off axis) up to which radial distortion grows with it; infinite: everywhere."""
        k1, k2, _, _, k3 = self.dist
        # d(r + k1 r^3 + k2 r^5 + k3 r^7) / dr = 0 is x^3 + 3 k1 x^2 + 5 k2 x + 7 k3 = 0 of x = 1 / r^2, and t^3 + p t + q = 0 of
        # t = x + k1. Its greatest root by Viete's formula where there are three, else by Cardano's.
        p, q = 5 * k2 - 3 * k1 * k1, k1 * (2 * k1 * k1 - 5 * k2) + 7 * k3
        discriminant = q * q / 4 + p * p * p / 27
        if discriminant <= 0:
            size = 2 * math.sqrt(max(-p, 0.0) / 3)
            t = size * rp.cos(rp.arccos(max(-1.0, min(3 * q / (p * size), 1.0))) / 3) if p * size < 0 else 0.0
        else:
            u = math.copysign(rp.power(abs(q) / 2 + math.sqrt(discriminant), 1 / 3), -q)
            t = u - p / (3 * u)
        none = _ROUNDED * (abs(k1) + math.sqrt(abs(k2)) + rp.power(abs(k3), 1 / 3))
        return 1.0 / math.sqrt(t - k1) if t - k1 > none else math.inf

    @cached_property
    def visible_radius(self) -> float:
        """The ideal radius of the last point that the lens sees; infinite where it folds nowhere."""
        return self.monotonic_radius * (_TANGENTIAL if any(self.dist[2:4]) else 1.0)

    @classmethod
    def from_fov(
        cls, width: int, height: int, horizontal_fov: float, vertical_fov: float | None = None, dist: Distortion = NO_DISTORTION
    ) -> Camera:
        """A centred camera from its full field of view in radians; square pixels where only one angle is given.

        The field of view is that of the undistorted pinhole, edge to edge of the image.
        """
        fx = width / 2 / rp.tan(horizontal_fov / 2)
        fy = fx if vertical_fov is None else height / 2 / rp.tan(vertical_fov / 2)
        return cls(width, height, float(fx), float(fy), (width - 1) / 2, (height - 1) / 2, dist)

    @property
    def k(self) -> Array:
        """The 3x3 matrix of intrinsics (px)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def is_distorted(self) -> bool:
        return any(self.dist)

    @property
    def fields_deg(self) -> tuple[float, float]:
        """The field of view without distortion, degrees, horizontal and vertical."""
        x, y = (2 * math.degrees(rp.arctan(n / (2 * f))) for n, f in ((self.width, self.fx), (self.height, self.fy)))
        return x, y

    def scaled(self, factor: int) -> Camera:
        """The same view with `factor` times as many pixels a side, each pixel cut into factor x factor equal ones.

        The same object for the same camera, so that its rays are worked out once.
        """
        return _scaled(self, factor)

    def binned(self, factor: int) -> Camera:
        """The same view with pixels `factor` times as wide and high, of which there are whole ones only, and one at least."""
        shift = (factor - 1) / 2  # an integer is a pixel's centre
        size = max(self.width // factor, 1), max(self.height // factor, 1)
        centre = (self.cx - shift) / factor, (self.cy - shift) / factor
        return Camera(*size, self.fx / factor, self.fy / factor, *centre, self.dist)

    def turned(self, quarters: int) -> Camera:
        """The camera of its images turned counter-clockwise by so many quarters, as `numpy.rot90` turns them."""
        if not quarters % 4:
            return self
        k1, k2, p1, p2, k3 = self.dist
        once = Camera(
            self.height, self.width, self.fy, self.fx, self.cy, self.width - 1 - self.cx, (k1, k2, -p2, p1, k3)
        )  # fmt: skip
        return once.turned(quarters - 1)

    def distort(self, xy: ArrayLike) -> Array:
        """Ideal normalised coordinates (..., 2) to distorted ones."""
        xy_ = np.asarray(xy, dtype=np.float64)
        if not self.is_distorted:
            return xy_
        k1, k2, p1, p2, k3 = self.dist
        x, y = xy_[..., 0], xy_[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        distorted = np.empty(xy_.shape)
        distorted[..., 0] = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        distorted[..., 1] = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return distorted

    def undistort(self, xy: ArrayLike, iterations: int = 40) -> Array:
        """Distorted normalised coordinates (..., 2) to ideal ones, by Newton steps on `distort`.

        NaN where no ideal point was found (beyond the radius up to which the model is monotonic).
        """
        target = np.asarray(xy, dtype=np.float64)
        if not self.is_distorted:
            return target
        ideal = np.empty(target.shape)
        native.undistort(
            np.ascontiguousarray(target).reshape(-1, 2), np.array(self.dist, np.float64), iterations, ideal.reshape(-1, 2)
        )
        if self.visible_radius < math.inf:  # a root of the polynomial beyond it is no ray, and may lie across the axis
            ideal[np.linalg.norm(ideal, axis=-1) > self.visible_radius] = np.nan
        return ideal

    def project(self, p_camera: ArrayLike, *, folded: bool = False) -> Array:
        """Points in front of the camera as pixels.

        Parameters
        ----------
        p_camera : (..., 3)
            m, camera frame.
        folded
            Give what the polynomial says beyond `monotonic_radius`, too: for fits, whose trial lenses may fold anywhere.

        Returns
        -------
        (..., 2)
            px; NaN at or behind the camera plane, and where radial distortion would fold the point back towards the axis.
        """
        p = np.asarray(p_camera, dtype=np.float64)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        ideal = p[..., :2] / z[..., None]
        uv = self.distort(ideal) * (self.fx, self.fy) + (self.cx, self.cy)
        if self.visible_radius < math.inf and not folded:
            uv[np.linalg.norm(ideal, axis=-1) > self.visible_radius] = np.nan
        return uv

    def unproject(self, uv: ArrayLike, depth_m: ArrayLike) -> Array:
        """Pixels (..., 2) with depth along the axis (...) to points (..., 3) in metres."""
        xy = self.undistort((np.asarray(uv, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy))
        depth = np.asarray(depth_m, dtype=np.float64)
        return np.concatenate((xy * depth[..., None], np.broadcast_to(depth[..., None], (*xy.shape[:-1], 1))), axis=-1)

    @cached_property
    def rays(self) -> Array:
        """(height, width, 2): ideal normalised coordinates (x/z, y/z) of every pixel centre."""
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        xy = np.stack(((u - self.cx) / self.fx, (v - self.cy) / self.fy), axis=-1)
        return self.undistort(xy)

    @cached_property
    def range_over_depth(self) -> Array:
        """(height, width): |(x, y, 1)| of every pixel's ray, the factor from depth to range."""
        return np.sqrt(1 + np.sum(self.rays**2, axis=-1))

    def range_from_depth(self, depth_m: ArrayLike) -> Array:
        """Depth image (..., height, width) along the axis to range along the ray, both metres."""
        return np.asarray(depth_m) * self.range_over_depth

    def depth_from_range(self, range_m: ArrayLike) -> Array:
        """Range image (..., height, width) along the ray to depth along the axis, both metres."""
        return np.asarray(range_m) / self.range_over_depth

    def points(self, depth_m: ArrayLike) -> Array:
        """Depth image (..., height, width) to points (..., height, width, 3), camera frame, metres; NaN stays NaN."""
        depth = np.asarray(depth_m, dtype=np.float64)
        return np.concatenate((self.rays * depth[..., None], depth[..., None]), axis=-1)

    def contains(self, uv: ArrayLike) -> NDArray[np.bool_]:
        """Whether pixels (..., 2) lie in the image; False for NaN."""
        uv_ = np.asarray(uv, dtype=np.float64)
        inside = (uv_ >= -0.5) & (uv_ < (self.width - 0.5, self.height - 0.5))
        return np.asarray(inside.all(axis=-1))


@lru_cache(maxsize=16)
def _scaled(camera: Camera, factor: int) -> Camera:
    shift = (factor - 1) / 2  # an integer is a pixel's centre
    size, focal = (camera.width * factor, camera.height * factor), (camera.fx * factor, camera.fy * factor)
    return Camera(*size, *focal, camera.cx * factor + shift, camera.cy * factor + shift, camera.dist)


def surface_depth(depth_m: NDArray[np.floating], uv: Array) -> float:
    """Median of the valid depths in 5 x 5 pixels about a pixel (2,) of an image (H, W), m; NaN where nothing was measured."""
    u, v = np.rint(uv).astype(int)
    window = depth_m[max(v - _WINDOW, 0) : v + _WINDOW + 1, max(u - _WINDOW, 0) : u + _WINDOW + 1]
    valid = window[np.isfinite(window)]
    return float(np.median(valid)) if len(valid) else float("nan")
