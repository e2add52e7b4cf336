"""What cameras do to depth after decoding: filters over neighbouring pixels and over frames."""

from __future__ import annotations

import numpy as np

from cabinpose.core import Floats32
from cabinpose.scene.sensor.presets import Sensor

_EDGE_M = 0.03  # of the bilateral filter: neighbours that differ by more weigh little


def median_of_valid(depths: Floats32) -> Floats32:
    """(H, W) median of depths (N, H, W), without those that are NaN; NaN where the last one is."""
    ordered = np.sort(depths, axis=0)  # NaN last
    count = np.isfinite(depths).sum(axis=0)
    low, high = (
        np.take_along_axis(ordered, at[None], axis=0)[0] for at in (np.maximum(count - 1, 0) // 2, np.maximum(count, 1) // 2)
    )
    return np.where(np.isnan(depths[-1]), np.float32(np.nan), (low + high) / 2)


def smoothed(depth: Floats32, sensor: Sensor) -> Floats32:
    """Depth (H, W) through the sensor's spatial filter: of valid neighbours, and only where the pixel itself is valid."""
    size = sensor.spatial_px
    padded = np.pad(depth, size // 2, constant_values=np.nan)
    height, width = depth.shape
    beside = [padded[y : y + height, x : x + width] for y in range(size) for x in range(size)]
    if sensor.spatial_filter == "median":
        return median_of_valid(np.stack([*(b for i, b in enumerate(beside) if i != len(beside) // 2), depth]))
    total, weights = np.zeros(depth.shape, np.float32), np.zeros(depth.shape, np.float32)
    for neighbour in beside:
        weight = np.isfinite(neighbour).astype(np.float32)
        if sensor.spatial_filter == "bilateral":
            weight = np.nan_to_num(np.exp(-0.5 * ((neighbour - depth) / np.float32(_EDGE_M)) ** 2))
        weights += weight
        total += weight * np.nan_to_num(neighbour)
    with np.errstate(invalid="ignore"):
        return np.where(np.isnan(depth), np.float32(np.nan), total / weights)
