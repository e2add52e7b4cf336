"""The camera model fitted to pixels whose rays are known: from a device's points, or from another lens model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from cabinpose.core.camera import Camera

_MOST_PIXELS = 4000  # of the fit: nine parameters need no more, and a frame of 300 000 would take seconds
_FEWEST_PIXELS = 50


@dataclass(frozen=True)
class CameraFit:
    """A fitted camera and what it leaves: root mean square and largest distance (px) between its pixels and the true ones."""

    camera: Camera
    rms_px: float
    max_px: float


@dataclass(frozen=True)
class RationalLens:
    """A lens of the rational model, in px: fx fy cx cy, radial k1 to k6, tangential p1 p2.

    tangential: the factor of the mixed term x y, 2 in Brown and Conrady's model (OpenCV's), 1 in Azure Kinect's Rational6KT.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    radial: tuple[float, float, float, float, float, float]
    p1: float
    p2: float
    tangential: float = 2.0

    def distort(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Ideal normalised coordinates (..., 2) to distorted ones."""
        x, y = xy[..., 0], xy[..., 1]
        k1, k2, k3, k4, k5, k6 = self.radial
        r2 = x * x + y * y
        scale = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        both = self.tangential * x * y
        dx = self.p1 * both + self.p2 * (r2 + 2 * x * x)
        dy = self.p2 * both + self.p1 * (r2 + 2 * y * y)
        return np.stack((x * scale + dx, y * scale + dy), axis=-1)

    def rays(self, width: int, height: int, every: int = 1) -> NDArray[np.float64]:
        """(height, width, 2) ideal normalised coordinates of each `every`-th pixel, NaN elsewhere and where there are none.

        Newton's method on `distort`, with numerical derivatives; steps are bounded, so that none leaves the lens' field.
        """
        u, v = np.meshgrid(np.arange(0, width, every, dtype=np.float64), np.arange(0, height, every, dtype=np.float64))
        target = np.stack(((u - self.cx) / self.fx, (v - self.cy) / self.fy), axis=-1)
        guess, eps = target.copy(), 1e-6
        for _ in range(60):
            residual = self.distort(guess) - target
            dx = (self.distort(guess + (eps, 0)) - self.distort(guess - (eps, 0))) / (2 * eps)
            dy = (self.distort(guess + (0, eps)) - self.distort(guess - (0, eps))) / (2 * eps)
            with np.errstate(divide="ignore", invalid="ignore"):
                det = dx[..., 0] * dy[..., 1] - dx[..., 1] * dy[..., 0]
                step_x = (residual[..., 0] * dy[..., 1] - residual[..., 1] * dy[..., 0]) / det
                step_y = (residual[..., 1] * dx[..., 0] - residual[..., 0] * dx[..., 1]) / det
            step = np.clip(np.nan_to_num(np.stack((step_x, step_y), axis=-1)), -0.2, 0.2)
            guess = guess - step
            if np.abs(step).max() < 1e-13:
                break
        guess[np.linalg.norm(self.distort(guess) - target, axis=-1) > 1e-7] = np.nan
        rays = np.full((height, width, 2), np.nan)
        rays[::every, ::every] = guess
        return rays


def fit_camera(xy: ArrayLike, *, start: Camera | None = None, distorted: bool = True) -> CameraFit | None:
    """The camera whose pixels see along given rays, by least squares in the image.

    Parameters
    ----------
    xy
        (height, width, 2), ideal normalised coordinates (x/z, y/z) of the pixels' rays, NaN = unknown.
    start
        Where to begin; None: a camera without distortion.
    distorted
        Whether to fit (k1, k2, p1, p2, k3) too.

    Returns
    -------
    CameraFit or None
        None where too few rays are known, or they do not spread over the image.
    """
    rays = np.asarray(xy, dtype=np.float64)
    height, width = rays.shape[:2]
    known = np.isfinite(rays).all(axis=-1)
    v, u = np.nonzero(known)
    if len(u) < _FEWEST_PIXELS or np.ptp(u) < 3 or np.ptp(v) < 3:
        return None
    chosen = np.unique(np.linspace(0, len(u) - 1, min(len(u), _MOST_PIXELS)).astype(int))
    some_xy, some_uv = rays[v[chosen], u[chosen]], np.stack((u[chosen], v[chosen]), axis=-1).astype(np.float64)
    first = start or _pinhole(width, height, some_xy, some_uv)
    if first is None:
        return None
    begin = np.array([first.fx, first.fy, first.cx, first.cy, *(first.dist if distorted else ())])

    def residual(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        return (_pixels(_camera(width, height, parameters), some_xy) - some_uv).ravel()

    bounds = np.full((2, len(begin)), np.inf) * [[-1], [1]]
    bounds[0, :2] = 1e-3  # focal lengths are positive
    solved = scipy.optimize.least_squares(
        residual, begin, bounds=bounds, x_scale=np.where(begin == 0, 0.1, np.abs(begin)), xtol=1e-12, ftol=1e-12
    )
    camera = _camera(width, height, solved.x)
    error = np.linalg.norm(_pixels(camera, rays[known]) - np.stack((u, v), axis=-1), axis=-1)
    return CameraFit(camera, float(np.sqrt(np.mean(error**2))), float(error.max()))


def fit_lens(lens: RationalLens, width: int, height: int, field: float) -> CameraFit:
    """The camera of five coefficients that comes closest to a lens.

    Parameters
    ----------
    lens
        In pixels of the image.
    width, height
        Size of the image, px.
    field
        The rays that are fitted, as the radius x²+y² = field² (normalised); pixels outside it get no light.

    Raises
    ------
    ValueError
        Where no camera fits.
    """
    rays = lens.rays(width, height, every=max(width // 160, 1))
    with np.errstate(invalid="ignore"):
        rays[~(np.linalg.norm(rays, axis=-1) <= field)] = np.nan
    fit = fit_camera(rays)
    if fit is None:
        raise ValueError("no camera fits the lens")
    return fit


def pixel_error(camera: Camera, xy: ArrayLike) -> float:
    """Median distance (px) between the pixels of rays (height, width, 2) and where a camera sees them; NaN without rays."""
    rays = np.asarray(xy, dtype=np.float64)
    v, u = np.nonzero(np.isfinite(rays).all(axis=-1))
    if not len(u):
        return float("nan")
    return float(np.median(np.linalg.norm(_pixels(camera, rays[v, u]) - np.stack((u, v), axis=-1), axis=-1)))


def _pinhole(width: int, height: int, xy: NDArray[np.float64], uv: NDArray[np.float64]) -> Camera | None:
    """The camera without distortion by two straight lines: u over x, v over y."""
    if np.ptp(xy[:, 0]) < 1e-9 or np.ptp(xy[:, 1]) < 1e-9:
        return None
    (fx, cx), (fy, cy) = (np.polyfit(xy[:, axis], uv[:, axis], 1) for axis in (0, 1))
    return Camera(width, height, float(fx), float(fy), float(cx), float(cy)) if fx > 0 and fy > 0 else None


def _camera(width: int, height: int, parameters: NDArray[np.float64]) -> Camera:
    fx, fy, cx, cy, *dist = (float(p) for p in parameters)
    k1, k2, p1, p2, k3 = dist or (0.0,) * 5
    return Camera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def _pixels(camera: Camera, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    return camera.distort(xy) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
