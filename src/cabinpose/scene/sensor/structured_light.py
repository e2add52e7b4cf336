"""Noise model `structured_light`: a Kinect-v1 or Xtion, which matches a projected dot pattern.

Sources: Nguyen, Izadi, Lovell, "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking", 3DIMPVT 2012
(axial noise over depth and angle, lateral noise); Khoshelham, Elberink, "Accuracy and Resolution of Kinect Depth Data",
Sensors 12(2), 2012 (baseline 75 mm, disparity in eighths of a pixel). Shadows follow from the projector's place.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.scene.sensor.buffers import CONFIDENCE_SIGMA_M, GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.empirical import geometric_amplitude
from cabinpose.scene.sensor.normals import normal_quantiles, random_words
from cabinpose.scene.sensor.optics import material_table
from cabinpose.scene.sensor.presets import Sensor


class StructuredLightNoise(BaseModel):
    """Depth from a projected dot pattern: quantised disparity, ragged edges, shadows and holes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["structured_light"] = "structured_light"
    axial: bool = Field(default=True, description="Axial noise after Nguyen et al. (2012).")
    lateral_px: float = Field(default=0.8, ge=0, description="Lateral noise, one sigma (pixels of the matcher).")
    quantise: bool = Field(default=True, description="Disparity comes in steps.")
    disparity_step_px: float = Field(default=0.125, gt=0, description="Step of the disparity (pixels of the matcher).")
    shadow: bool = Field(default=True, description="What the projector does not see has no depth.")
    grazing_deg: float = Field(
        default=80.0, gt=0, le=90, description="Angle of incidence beyond which the pattern is not matched (degrees)."
    )
    min_return: float = Field(
        default=0.0015,
        ge=0,
        description="Light returned, relative to a white surface facing the camera at 1 m, below which no dot is seen.",
    )
    fill_px: int = Field(
        default=0, ge=0, le=64, description="Holes up to this wide along a row are filled with the farther of their ends (px)."
    )
    range_window: bool = Field(default=True, description="Depths outside the sensor's range are invalid.")


def simulate_structured_light(
    buffers: GeometryBuffers, sensor: Sensor, noise: StructuredLightNoise, *, rng: Generator
) -> SensorFrame:
    """One frame of a structured-light camera; see `simulate`. The amplitude is that of the geometry, without noise."""
    clean, cos_incidence, material = buffers.pixels()
    height, width = clean.shape
    focal = sensor.camera.fx * sensor.native_scale
    depth = np.empty((height, width), np.float32)
    sigma = np.empty((height, width), np.float32)
    _match(
        buffers.depth_m, buffers.cos_incidence, buffers.material, buffers.supersample, buffers.slots(),
        buffers.parts_depth_m, buffers.parts_cos_incidence, buffers.parts_material,
        material_table(True, True, 0.0, 0.0)[:, 0].copy(), random_words((height, width), rng=rng), normal_quantiles(),
        noise.axial, noise.lateral_px / sensor.native_scale, focal * sensor.baseline_m,
        noise.disparity_step_px if noise.quantise else 0.0, np.cos(np.radians(noise.grazing_deg)), noise.min_return, depth, sigma,
    )  # fmt: skip
    if noise.shadow:
        _cast_shadow(clean, sensor.camera.fx * sensor.baseline_m, depth)
    if noise.fill_px:
        _fill(depth, noise.fill_px)
    if noise.range_window:
        near, far = sensor.range_m
        depth[(depth < near) | (depth > far)] = np.nan
    return SensorFrame(
        depth,
        geometric_amplitude(clean, cos_incidence, material, sensor),
        np.where(np.isfinite(depth), 255 * CONFIDENCE_SIGMA_M / (CONFIDENCE_SIGMA_M + sigma), 0).astype(np.uint8),
    )


@njit(cache=True, nogil=True)
def _slope(line: NDArray[np.float32], at: int) -> float:
    """Central difference in a line of depths, per pixel; 0 at its ends."""
    return (float(line[at + 1]) - float(line[at - 1])) / 2 if 0 < at < line.size - 1 else 0.0


@njit(cache=True, nogil=True)
def _match(
    depth: NDArray[np.float32],
    cos_incidence: NDArray[np.float32],
    material: NDArray[np.uint8],
    s: int,
    slots: NDArray[np.int32],
    parts_depth: NDArray[np.float32],
    parts_cosine: NDArray[np.float32],
    parts_material: NDArray[np.uint8],
    reflectance: NDArray[np.float32],
    words: NDArray[np.uint64],
    quantiles: NDArray[np.float32],
    axial: bool,
    lateral: float,
    focal_baseline: float,
    step: float,
    grazing_cosine: float,
    min_return: float,
    out: NDArray[np.float32],
    sigma_out: NDArray[np.float32],
) -> None:
    """Depth of every pixel from its own disparity; NaN where no dot is matched. `focal_baseline` in px m.

    slots: (H, W) of `GeometryBuffers.slots`. A pixel without parts is a smooth surface, continued along its slope.
    """
    height, width = out.shape
    for v in range(height):
        for u in range(width):
            word = words[v, u]
            du = lateral * quantiles[word & np.uint64(0xFFFF)]
            dv = lateral * quantiles[(word >> np.uint64(16)) & np.uint64(0xFFFF)]
            n_axial = quantiles[(word >> np.uint64(32)) & np.uint64(0xFFFF)]
            n_return = quantiles[(word >> np.uint64(48)) & np.uint64(0xFFFF)]
            x = min(max(int(np.floor((u + 0.5 + du) * s)), 0), width * s - 1)
            y = min(max(int(np.floor((v + 0.5 + dv) * s)), 0), height * s - 1)
            row, column = y // s, x // s
            slot, part = slots[row, column], (y - row * s) * s + x - column * s
            if slot >= 0:
                z, c, m = float(parts_depth[slot, part]), float(parts_cosine[slot, part]), parts_material[slot, part]
            else:
                z, c, m = float(depth[row, column]), float(cos_incidence[row, column]), material[row, column]
                z += _slope(depth[row], column) * ((x + 0.5) / s - 0.5 - column)
                z += _slope(depth[:, column], row) * ((y + 0.5) / s - 0.5 - row)
            out[v, u] = np.nan
            sigma_out[v, u] = np.inf
            if not z > 0 or c < grazing_cosine:
                continue
            # The dots' contrast varies; a third of the threshold makes the border of a hole ragged.
            if reflectance[m] * c / (z * z) < min_return * (1 + n_return / 3):
                continue
            angle = np.arccos(min(c, 1.0))
            sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * angle**2 / (np.pi / 2 - angle) ** 2
            sigma_out[v, u] = sigma
            if axial:
                z += sigma * n_axial
            if step > 0 and z > 0:
                disparity = np.floor(focal_baseline / z / step + 0.5) * step
                z = focal_baseline / disparity if disparity > 0 else np.inf
            out[v, u] = z


@njit(cache=True, nogil=True)
def _cast_shadow(clean: NDArray[np.float32], focal_baseline: float, out: NDArray[np.float32]) -> None:
    """Takes out pixels that a projector one baseline to the right (camera x) does not see, row by row.

    A surface at depth z stands in the projector's image `focal_baseline / z` px left of where the camera has it; from right to
    left, what does not come out farther left than all before it is hidden behind nearer surfaces.
    """
    height, width = clean.shape
    for v in range(height):
        leftmost = np.inf
        for u in range(width - 1, -1, -1):
            z = clean[v, u]
            if z > 0:
                projected = u - focal_baseline / z
                if projected < leftmost:
                    leftmost = projected
                else:
                    out[v, u] = np.nan


@njit(cache=True, nogil=True)
def _fill(depth: NDArray[np.float32], widest: int) -> None:
    """Fills holes of up to `widest` px in a row with the farther of their two ends."""
    height, width = depth.shape
    for v in range(height):
        start = -1
        for u in range(width):
            if np.isnan(depth[v, u]):
                continue
            if start >= 0 and 0 < u - start - 1 <= widest:
                value = max(depth[v, start], depth[v, u])
                for x in range(start + 1, u):
                    depth[v, x] = value
            start = u
