"""Noise model `empirical`: a measured sigma(z), noise at edges, circular crop and range window.

Source: Gonçalves (thesis, 2020), equations 5.5 to 5.8 and 5.12: axial noise of a Pico Monstar 105 in use case 3 on a white
wall, sigma = 1 + 5 z + 1 z^2 (mm, z in m). The thesis adds Gaussian noise at abrupt depth edges and takes out pixels
that stand before or behind their neighbours, without naming thresholds; the defaults here are ours.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.scene.sensor.buffers import CONFIDENCE_SIGMA_M, GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.normals import normal_quantiles, random_words
from cabinpose.scene.sensor.optics import lens_maps, material_table
from cabinpose.scene.sensor.presets import Sensor


class EmpiricalNoise(BaseModel):
    """Axial noise sigma(z) = a + b z + c z^2 as measured, and what else a real image shows."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["empirical"] = "empirical"
    a_mm: float = Field(default=1.0, ge=0, description="Constant part of sigma (mm).")
    b_mm_per_m: float = Field(default=5.0, ge=0, description="Part of sigma that grows with depth (mm per m).")
    c_mm_per_m2: float = Field(default=1.0, ge=0, description="Part of sigma that grows with depth squared (mm per m^2).")
    edge_threshold_m: float = Field(default=0.10, gt=0, description="Depth step across two pixels that makes an abrupt edge (m).")
    edge_sigma_mm: float = Field(default=40.0, ge=0, description="Gaussian noise added at abrupt edges (mm).")
    edge_width_px: int = Field(default=1, ge=1, le=8, description="Reach of the central difference that finds edges (px).")
    remove_spikes: bool = Field(
        default=True, description="Edge pixels farther than the threshold before or behind all neighbours are invalid."
    )
    glass: bool = Field(default=True, description="Window panes deliver no depth.")
    range_window: bool = Field(
        default=True, description="Dead zone and saturation: depths outside the sensor's range are invalid."
    )
    circular_field: bool = Field(default=True, description="Pixels outside the lens' image circle are invalid.")


def simulate_empirical(buffers: GeometryBuffers, sensor: Sensor, noise: EmpiricalNoise, *, rng: Generator) -> SensorFrame:
    """One frame with measured noise; see `simulate`. The amplitude is that of the geometry, without noise."""
    depth, cos_incidence, material = buffers.pixels()
    height, width = depth.shape
    maps = lens_maps(sensor, 1)
    table = material_table(True, noise.glass, 0.0, 0.0)
    if noise.glass:
        depth = np.where(table[material, 1] > 0, np.float32(0.0), depth)
    field = maps.field if noise.circular_field else np.isfinite(maps.range_over_depth)
    near, far = sensor.range_m if noise.range_window else (0.0, np.inf)
    noisy = np.empty((height, width), np.float32)
    sigma = np.empty((height, width), np.float32)
    normals = normal_quantiles()[random_words((height, (width + 3) // 4), rng=rng).view(np.uint16)[:, :width]]
    _perturb(
        depth, normals, (noise.a_mm * 1e-3, noise.b_mm_per_m * 1e-3, noise.c_mm_per_m2 * 1e-3),
        noise.edge_sigma_mm * 1e-3, noise.edge_threshold_m, noise.edge_width_px, noisy, sigma,
    )  # fmt: skip
    result = noisy.copy()
    if noise.remove_spikes:
        _remove_spikes(noisy, sigma, depth, noise.edge_threshold_m, noise.edge_width_px, result)
    result[~field | (result < near) | (result > far)] = np.nan
    return SensorFrame(
        result,
        geometric_amplitude(depth, cos_incidence, material, sensor),
        np.where(np.isfinite(result), 255 * CONFIDENCE_SIGMA_M / (CONFIDENCE_SIGMA_M + sigma), 0).astype(np.uint8),
    )


def geometric_amplitude(
    depth: NDArray[np.float32], cos_incidence: NDArray[np.float32], material: NDArray[np.uint8], sensor: Sensor
) -> NDArray[np.uint16]:
    """(H, W): amplitude without noise (electrons) of one surface a pixel."""
    maps = lens_maps(sensor, 1)
    reflectance = material_table(True, True, 0.0, 0.0)[material, 0]
    scale = np.float32(sensor.signal_e * sensor.contrast) * maps.vignetting * maps.illumination
    ray = np.maximum(depth * maps.range_over_depth, np.float32(0.05))
    amplitude = np.where((depth > 0) & maps.field, scale * reflectance * cos_incidence / (ray * ray), np.float32(0.0))
    return np.minimum(amplitude, np.float32(65535.0)).astype(np.uint16)


@njit(cache=True, nogil=True)
def _perturb(
    depth: NDArray[np.float32],
    normals: NDArray[np.float32],
    coefficients: tuple[float, float, float],
    edge_sigma: float,
    threshold: float,
    reach: int,
    noisy: NDArray[np.float32],
    sigma: NDArray[np.float32],
) -> None:
    """Equation 5.5, with the noise of abrupt edges added in quadrature; NaN where there is no depth."""
    height, width = depth.shape
    a, b, c = coefficients
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if not z > 0:
                noisy[v, u] = np.nan
                sigma[v, u] = np.inf
                continue
            value = a + b * z + c * z * z
            left, right = depth[v, max(u - reach, 0)], depth[v, min(u + reach, width - 1)]
            up, down = depth[max(v - reach, 0), u], depth[min(v + reach, height - 1), u]
            if abs(right - left) > threshold or abs(down - up) > threshold:
                value = np.sqrt(value * value + edge_sigma * edge_sigma)
            sigma[v, u] = value
            noisy[v, u] = z + value * normals[v, u]


@njit(cache=True, nogil=True)
def _remove_spikes(
    noisy: NDArray[np.float32],
    sigma: NDArray[np.float32],
    depth: NDArray[np.float32],
    threshold: float,
    reach: int,
    result: NDArray[np.float32],
) -> None:
    """Equation 5.6, read as: a pixel before all of its neighbours, or behind all of them, by the threshold is taken out."""
    height, width = noisy.shape
    for v in range(height):
        for u in range(width):
            z = noisy[v, u]
            if not np.isfinite(sigma[v, u]):
                continue
            before, behind = True, True
            for dv, du in ((0, -reach), (0, reach), (-reach, 0), (reach, 0)):
                y, x = min(max(v + dv, 0), height - 1), min(max(u + du, 0), width - 1)
                if depth[y, x] > 0:
                    before &= z < noisy[y, x] - threshold
                    behind &= z > noisy[y, x] + threshold
            if before or behind:
                result[v, u] = np.nan
