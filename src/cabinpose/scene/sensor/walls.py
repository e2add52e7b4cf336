"""Frames of a flat wall, as a laboratory records them: the noise of each pixel over time, and where the wall stands.

Source: Gonçalves (thesis, 2020, section 5.2.1.4 and equation 5.12): a flat wall at some distances, some hundred frames of each.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Camera, ConfigError

F64 = NDArray[np.float64]
LEAST_FRAMES = 10
LEAST_PIXELS = 200
# Frames whose middle differs by more than this share of the distance show walls at two distances.
_SAME_WALL = 0.03
_MOVED = 0.005  # share of the distance, rms over the frames of one wall
_ON_THE_WALL = 0.03  # what is farther from the plane, as a share of its depth, is something else: floor, ceiling, furniture
_FLAT = 0.01  # share of the depth, rms in the middle of the image
_SEEN = 0.95  # of the frames in which a pixel has to be valid
_MISMEASURED = 3.0  # times the distance of the plane: beyond it a stated one is in another unit, or of another wall
_SPREADS = 3.5  # robust standard deviations beyond which a pixel does not take part in the fit of the plane


@dataclass(frozen=True)
class Wall:
    """A wall at one distance, over its frames.

    distance_m: along the optical axis · frames: how many · used: (H, W) bool, the pixels that see the wall in nearly all frames ·
    depth_m: (H, W) of the plane, along the axis · sigma_m: (H, W) standard deviation of the depth over time, without the part
    that the steps of the recorded depth add · cos_incidence: (H, W) · amplitude, amplitude_variance: (H, W) over time, in the
    camera's unit; None where it was not recorded · bias_m: median of measured minus true depth · flatness_m: robust rms of the
    mean image about the plane, in the middle. What is not used is NaN.
    """

    name: str
    camera: Camera
    distance_m: float
    frames: int
    used: NDArray[np.bool_]
    depth_m: F64
    sigma_m: F64
    cos_incidence: F64
    amplitude: F64 | None
    amplitude_variance: F64 | None
    bias_m: float
    flatness_m: float


class _Moments:
    """Count, mean and sum of squared deviations of each pixel over frames, NaN left out (Welford, 1962)."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.count, self.mean, self.squares = np.zeros(shape), np.zeros(shape), np.zeros(shape)

    def add(self, image: NDArray[Any]) -> None:
        valid = np.isfinite(image)
        self.count += valid
        before = np.where(valid, image - self.mean, 0.0)
        self.mean += before / np.maximum(self.count, 1.0)
        self.squares += before * np.where(valid, image - self.mean, 0.0)

    @property
    def variance(self) -> F64:
        return self.squares / np.maximum(self.count - 1.0, 1.0)


class _Frames:
    """What is kept of the frames of one wall."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.depth, self.amplitude = _Moments(shape), _Moments(shape)
        self.middles: list[float] = []

    def add(self, depth_m: NDArray[Any], amplitude: NDArray[Any] | None, middle: float) -> None:
        self.middles.append(middle)
        self.depth.add(depth_m)
        if amplitude is not None:
            self.amplitude.add(np.where(np.isfinite(depth_m), amplitude, np.nan))


def walls_of_frames(
    frames: Iterable[tuple[NDArray[Any], NDArray[Any] | None]], camera: Camera, *, name: str = "wall", step_m: float = 0.0,
    distance_m: float | None = None,
) -> list[Wall]:  # fmt: skip
    """The walls that frames show, one for each distance, nearest first.

    Parameters
    ----------
    frames
        Depth (H, W) along the axis, m, 0 or NaN where invalid, and amplitude (H, W) or None, one frame in memory at a time.
        Frames of several distances may follow each other in any order.
    camera
        Intrinsics of the depth image.
    name
        What errors call these frames.
    step_m
        Step of the recorded depth (m); the variance of its rounding, step² / 12, is taken off.
    distance_m
        Measured distance from the camera to the wall along the optical axis, where the frames show one wall; None: the plane's.

    Returns
    -------
    list[Wall]
        The walls of at least `LEAST_FRAMES` frames; fewer are what was seen while the camera moved to the next distance.

    Raises
    ------
    ConfigError
        Where there are too few frames, too few valid pixels, no flat wall, or a wall that moves, or is not where it was measured.
    """
    groups: list[_Frames] = []
    for depth, amplitude in frames:
        if depth.shape != (camera.height, camera.width):
            raise ConfigError(
                f"{name}: frames of {depth.shape[1]}x{depth.shape[0]} pixels, a camera of {camera.width}x{camera.height}",
                hint="give the sensor that recorded the wall, in the same mode",
            )
        depth = np.where(depth > 0, depth, np.nan)
        middle = _middle(depth)
        if not np.isfinite(middle):
            continue
        near = [g for g in groups if abs(middle / np.median(g.middles[:LEAST_FRAMES]) - 1) < _SAME_WALL]
        if not near:
            groups.append(_Frames(depth.shape))
        (near[0] if near else groups[-1]).add(depth, amplitude, middle)
    whole = [g for g in groups if len(g.middles) >= LEAST_FRAMES]
    if not whole:
        most = max((len(g.middles) for g in groups), default=0)
        raise ConfigError(
            f"{name}: {most} frames of a wall, at least {LEAST_FRAMES} are needed"
            if most
            else f"{name}: no depth in the middle of the image",
            hint="record about a hundred frames of a wall within the camera's range, without moving anything",
        )
    if distance_m is not None and len(whole) > 1:
        raise ConfigError(
            f"{name}: frames at {len(whole)} distances, and one distance is given", hint="record one file for each distance"
        )
    return sorted((_wall(g, camera, name, step_m, distance_m) for g in whole), key=lambda wall: wall.distance_m)


def _third(shape: tuple[int, int]) -> tuple[slice, slice]:
    height, width = shape
    return slice(height // 3, height - height // 3), slice(width // 3, width - width // 3)


def _middle(depth: NDArray[Any]) -> float:
    """Median depth (m) in the middle of the image; NaN where less than a tenth of it is valid."""
    seen = depth[_third((depth.shape[0], depth.shape[1]))]
    valid = seen[np.isfinite(seen)]
    return float(np.median(valid)) if valid.size > seen.size / 10 else np.nan


def _wall(of: _Frames, camera: Camera, name: str, step_m: float, distance_m: float | None) -> Wall:
    frames, middle = len(of.middles), float(np.median(of.middles))
    seen = (of.depth.count >= _SEEN * frames) & np.isfinite(camera.range_over_depth)
    if int(seen.sum()) < LEAST_PIXELS:
        raise ConfigError(
            f"{name} at {middle:.2f} m: {int(seen.sum())} pixels are valid in nearly all frames, {LEAST_PIXELS} are needed",
            hint="the wall has to be within the camera's range, matt, and bright enough",
        )
    if (moved := float(np.std(of.middles))) > _MOVED * middle:
        raise ConfigError(
            f"{name} at {middle:.2f} m: the wall moves, by {1000 * moved:.0f} mm rms",
            hint="let the camera stand and warm up, and record each distance by itself",
        )
    plane = _plane(of.depth.mean, seen, camera)
    xy1 = np.concatenate((camera.rays, np.ones((*seen.shape, 1))), axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = 1.0 / (xy1 @ plane)
    error = of.depth.mean - depth
    inner = np.zeros_like(seen)
    inner[_third(seen.shape)] = seen[_third(seen.shape)]
    flatness = spread(error[inner])
    used = seen & (depth > 0) & (np.abs(error) < _ON_THE_WALL * depth)
    if flatness > _FLAT * middle or int(used.sum()) < LEAST_PIXELS:
        raise ConfigError(
            f"{name} at {middle:.2f} m shows no flat wall: {1000 * flatness:.0f} mm rms about a plane in the middle of the image",
            hint="point the camera at a flat wall that fills at least the middle third of the image",
        )
    scale = 1.0 if distance_m is None else distance_m * float(plane[2])
    if not 1 / _MISMEASURED < scale < _MISMEASURED:
        raise ConfigError(
            f"{name}: the wall is {1 / float(plane[2]):.2f} m away by its depths, and {distance_m:g} m are given",
            hint="give measured distances in metres, one for each file in order",
        )
    sigma = np.sqrt(np.maximum(of.depth.variance - step_m**2 / 12, 0.0))
    # Zeros alone are what stands in a dataset for none.
    has_amplitude = bool((of.amplitude.count[used] > 0).all() and of.amplitude.mean[used].any())

    def keep(image: F64) -> F64:
        return np.where(used, image, np.nan)

    return Wall(
        name, camera, distance_m or float(1 / plane[2]), frames, used, keep(depth * scale), keep(sigma),
        keep(xy1 @ plane / (np.linalg.norm(plane) * camera.range_over_depth)),
        keep(of.amplitude.mean) if has_amplitude else None, keep(of.amplitude.variance) if has_amplitude else None,
        float(np.median(of.depth.mean[used] - depth[used] * scale)), flatness,
    )  # fmt: skip


def _plane(depth: F64, seen: NDArray[np.bool_], camera: Camera) -> F64:
    """(3,) n of the plane n p = 1 through the depths: 1 / z is linear in the rays. The middle first, then what lies near it."""
    rays = np.concatenate((camera.rays[seen], np.ones((int(seen.sum()), 1))), axis=-1)
    z = depth[seen]
    inner = np.zeros_like(seen)
    inner[_third((seen.shape[0], seen.shape[1]))] = True
    chosen = inner[seen]
    plane = np.zeros(3)
    for _ in range(8):
        weight = z[chosen]  # of 1 / z, so that residuals are shares of the depth
        plane[:] = np.linalg.lstsq(rays[chosen] * weight[:, None], np.ones(int(chosen.sum())), rcond=None)[0]
        off = z * (rays @ plane) - 1.0
        chosen = np.abs(off) < np.clip(_SPREADS * spread(off[chosen]), 1e-6, _ON_THE_WALL)
    return plane


def spread(values: F64) -> float:
    """Standard deviation of what is normally distributed but for outliers."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if values.size else np.inf
