"""What frames of a depth camera are like, whoever is before it: reach, light, holes, mixed pixels, noise in space and time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from cabinpose.core import Camera, DatasetError
from cabinpose.store import camera_of

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
STEP = 0.08  # share of the depth that makes a silhouette
LOOKED_AT = 40  # frames, and pairs of frames in a row, that tell what a camera is like
BINS_M: F64 = np.arange(0.0, 4.01, 0.1)
"""(B + 1,) m, borders of the histogram of depths; what is farther counts in the last bin."""
_SEEN = 0.05  # of the frames in which a pixel has a depth, so that it is one that the lens serves
_FIELD = 0.999  # of those pixels: single ones farther out are no part of the image circle
_BLOCK = 8  # px, side of the squares of which it is said whether they stand still
_STILL = 3.0  # standard errors by which the mean of a square that stands still differs from one frame to the next
_FEWEST_BLOCKS, _LEVELS = 40, 8  # squares that tell the noise at a distance, and such distances


@dataclass(frozen=True)
class CameraFacts:
    """What some frames of one camera are like.

    frames: that were looked at · camera: its intrinsics · depth_m: quantiles 0.05, 0.5, 0.95 of the depths, m · histogram: (B,)
    shares of the depths in `BINS_M` · field_px: radius about the principal point within which pixels have depths, px · invalid:
    share of pixels without a depth · light: median of amplitude times squared depth, in the camera's unit times m²; NaN without
    amplitudes · mixed: mixed pixels to a pixel of silhouette · noise_m: standard deviation between neighbours in a row, away from
    silhouettes, m · still_m: (L, 2) depth and standard deviation over time, m, of what stands still; none where no frames follow
    each other or nothing does.
    """

    frames: int
    camera: Camera
    depth_m: tuple[float, float, float]
    histogram: F64
    field_px: float
    invalid: float
    light: float
    mixed: float
    noise_m: float
    still_m: F64


def facts_of(dataset: xr.Dataset, groups: NDArray[np.int64] | None = None) -> CameraFacts:
    """What the frames of a dataset are like, from at most `LOOKED_AT` of them.

    Parameters
    ----------
    dataset
        With depth.
    groups
        (F,) frames that follow each other have the same number; None: none do.

    Raises
    ------
    DatasetError
        Where there is no depth, no camera, or no pixel has a depth.
    """
    if "depth" not in dataset:
        raise DatasetError("the frames have no depth", hint="make a dataset of depth: `cabinpose import depth-images`")
    count = dataset.sizes["frame"]
    rows = np.unique(np.linspace(0, count - 1, min(count, LOOKED_AT)).astype(int))
    depth = dataset["depth"].isel(frame=rows).values.astype(np.float64)
    valid = np.isfinite(depth)
    if not valid.any():
        raise DatasetError("no pixel of the frames has a depth", hint="`cabinpose view` shows them; see --unit for depth images")
    camera = camera_of(dataset.isel(frame=0), depth.shape[2], depth.shape[1])
    field = ndimage.binary_erosion(valid.mean(axis=0) > _SEEN, iterations=2)
    step = step_of(depth[int(valid.any(axis=(1, 2)).argmax())])
    mixed, noise = zip(*(_of_frame(image, field, step) for image in depth if np.isfinite(image).any()), strict=True)
    amplitude = dataset["amplitude"].isel(frame=rows).values if "amplitude" in dataset else np.zeros(depth.shape, np.uint16)
    lit = valid & (amplitude > 0)
    light = float(np.median(amplitude[lit] * depth[lit] ** 2)) if lit.any() else np.nan
    low, middle, high = np.quantile(depth[valid], (0.05, 0.5, 0.95)).tolist()
    told = np.histogram(np.minimum(depth[valid], BINS_M[-1] - 1e-6), BINS_M)[0] / valid.sum()
    still = still_noise(_pairs(dataset, groups), step) if groups is not None else np.zeros((0, 2))
    v, u = np.nonzero(valid.mean(axis=0) > _SEEN)
    radius = float(np.quantile(np.hypot(u - camera.cx, v - camera.cy), _FIELD)) if u.size else np.nan
    return CameraFacts(
        len(rows),
        camera,
        (low, middle, high),
        told,
        radius,
        1 - float(valid.mean()),
        light,
        _median(mixed),
        _median(noise),
        still,
    )


def _median(values: Sequence[float]) -> float:
    known = np.array(values)[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def step_of(depth: F64) -> float:
    """The least difference of two depths, m (NaN invalid): the step in which they were recorded."""
    different = np.diff(np.unique(depth[np.isfinite(depth)].round(7)))
    return float(different.min()) if different.size else 0.0


def _of_frame(depth: F64, field: Mask, step_m: float) -> tuple[float, float]:
    """Mixed pixels to a pixel of silhouette, and the noise between neighbours (m)."""
    whole = filled(depth)
    flat = field & ~ndimage.binary_dilation(silhouettes(whole), iterations=3)
    return mixed_pixels(depth, whole, field), noise_of(depth, flat, step_m)


# ---------------------------------------------------------------------------------------------------------- one frame


def filled(depth: F64) -> F64:
    """Invalid pixels (NaN) of (H, W) with the depth of the nearest valid one."""
    at = ndimage.distance_transform_edt(np.isnan(depth), return_distances=False, return_indices=True)
    return np.asarray(depth[tuple(at)])


def silhouettes(depth: F64) -> Mask:
    """(H, W) pixels on both sides of a step of depth, of a frame without holes."""
    edge = np.zeros(depth.shape, bool)
    across = np.abs(np.diff(depth, axis=1)) > STEP * np.minimum(depth[:, 1:], depth[:, :-1])
    along = np.abs(np.diff(depth, axis=0)) > STEP * np.minimum(depth[1:], depth[:-1])
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= along
    edge[:-1] |= along
    return edge


def mixed_pixels(depth: F64, whole: F64, region: Mask) -> float:
    """Valid pixels within 2 px of a silhouette, of a depth between its sides, to a pixel along silhouettes; NaN without any.

    depth: (H, W) m, NaN invalid · whole: the same or the true scene, without holes · region: (H, W) that is looked at.
    """
    edge = silhouettes(whole)
    if not (edge & region).any():
        return np.nan
    near, far = ndimage.minimum_filter(whole, 7), ndimage.maximum_filter(whole, 7)
    gap = far - near
    close = region & (ndimage.distance_transform_edt(~edge) < 2)
    between = (depth > near + 0.2 * gap) & (depth < far - 0.2 * gap) & (gap > 2 * STEP * near) & close
    return float(between.sum()) / (edge & region).sum() * 2  # two pixels of `edge` to a step


def noise_of(error: F64, where: Mask, step_m: float = 0.0) -> float:
    """Sigma (m) of what differs from one pixel to the next along a row, without outliers and what rounding adds."""
    second = error[:, :-2] - 2 * error[:, 1:-1] + error[:, 2:]
    values = second[where[:, 1:-1] & np.isfinite(second)]
    if len(values) < 100:
        return float("nan")
    for _ in range(5):
        values = values[np.abs(values - values.mean()) < 3.5 * values.std() + 1e-9]
    return float(np.sqrt(max(values.var() / 6 - step_m**2 / 12, 0.0)))


# ---------------------------------------------------------------------------------------------------------- over time


def _pairs(dataset: xr.Dataset, groups: NDArray[np.int64]) -> Iterator[tuple[F64, F64]]:
    """At most `LOOKED_AT` pairs of depths of frames that follow each other."""
    first = np.flatnonzero(groups[1:] == groups[:-1])
    for row in first[np.unique(np.linspace(0, len(first) - 1, min(len(first), LOOKED_AT)).astype(int))] if first.size else ():
        one, other = dataset["depth"].isel(frame=slice(row, row + 2)).values.astype(np.float64)
        yield one, other


def still_noise(pairs: Iterator[tuple[F64, F64]] | Sequence[tuple[F64, F64]], step_m: float = 0.0) -> F64:
    """(L, 2) depth and standard deviation over time, m, of what stands still in pairs of frames (H, W) in a row.

    A square of pixels stands still where its mean changes by no more than its own noise lets it; the difference of two frames has
    twice the variance of one. Of the squares at a distance the median counts, which those that moved along their surface do not
    reach. step_m: of the recorded depth; the variance of its rounding is taken off.
    """
    depths: list[F64] = []
    variances: list[F64] = []
    for one, other in pairs:
        blocks, at = (_blocks(image) for image in (other - one, one))
        whole = np.isfinite(blocks).all(axis=1) & np.isfinite(at).all(axis=1)
        blocks, at = blocks[whole], at[whole]
        if not len(blocks):
            continue
        variance = blocks.var(axis=1, ddof=1)
        still = blocks.mean(axis=1) ** 2 * _BLOCK**2 <= _STILL**2 * variance
        flat = np.ptp(at, axis=1) < STEP * at.mean(axis=1)  # pixels at a silhouette flicker between its sides
        depths.append(at.mean(axis=1)[still & flat])
        variances.append(variance[still & flat])
    z, v = (np.concatenate([np.zeros(0), *each]) for each in (depths, variances))
    levels = min(_LEVELS, len(z) // _FEWEST_BLOCKS)
    order = np.argsort(z, kind="stable")
    rows = [
        (float(np.median(z[some])), float(np.sqrt(max(np.median(v[some]) / 2 - step_m**2 / 12, 0.0))))
        for some in np.array_split(order, max(levels, 1))
        if levels
    ]
    return np.array(rows).reshape(-1, 2)


def _blocks(image: F64) -> F64:
    """(N, `_BLOCK`²) the squares of an image (H, W)."""
    height, width = (side // _BLOCK * _BLOCK for side in image.shape)
    cut = image[:height, :width].reshape(height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK)
    return cut.swapaxes(1, 2).reshape(-1, _BLOCK**2)
