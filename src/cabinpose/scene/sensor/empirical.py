"""Noise model `empirical`: a measured sigma(z), noise at edges, circular crop and range window.

Source: Gonçalves (thesis, 2020), equations 5.5 to 5.8 and 5.12: axial noise of a Pico Monstar 105 in use case 3 on a white
wall, sigma = 1 + 5 z + 1 z^2 (mm, z in m). The thesis adds Gaussian noise at abrupt depth edges and sets edge pixels to 0
(5.6), without naming thresholds; the defaults here are ours. By default only those go that stand before or behind all of their
neighbours (`remove_spikes`); `remove_edges` takes out what cameras' own filters do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.random import Generator
from pydantic import Field

from cabinpose._native import sensor as native
from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.noise import EdgeRule
from cabinpose.scene.sensor.normals import normal_quantiles, random_words
from cabinpose.scene.sensor.optics import surface_optics
from cabinpose.scene.sensor.presets import Sensor


class EmpiricalNoise(EdgeRule):
    """Axial noise sigma(z) = a + b z + c z^2 as measured, and what else a real image shows."""

    kind: Literal["empirical"] = "empirical"
    a_mm: float = Field(default=1.0, ge=0, description="Constant part of sigma (mm).")
    b_mm_per_m: float = Field(default=5.0, ge=0, description="Part of sigma that grows with depth (mm per m).")
    c_mm_per_m2: float = Field(default=1.0, ge=0, description="Part of sigma that grows with depth squared (mm per m^2).")
    edge_sigma_mm: float = Field(default=40.0, ge=0, description="Gaussian noise added at abrupt edges (mm).")
    remove_spikes: bool = Field(
        default=True, description="Edge pixels farther than the threshold before or behind all neighbours are invalid."
    )
    glass: bool = Field(default=True, description="Window panes deliver no depth.")
    range_window: bool = Field(
        default=True, description="Dead zone and saturation: depths outside the sensor's range are invalid."
    )
    circular_field: bool = Field(default=True, description="Pixels outside the lens' image circle are invalid.")

    def simulate(
        self,
        buffers: GeometryBuffers,
        sensor: Sensor,
        *,
        rng: Generator,
        exposures: Sequence[GeometryBuffers] = (),  # noqa: ARG002 - it is measured of what stands still
    ) -> SensorFrame:
        """The amplitude is that of the geometry, without noise."""
        height, width = buffers.shape
        frame = SensorFrame.empty(buffers.shape)
        ranks = random_words((height, (width + 3) // 4), rng=rng).view(np.uint16)
        native.simulate_empirical(buffers, surface_optics(sensor, buffers.coats), sensor, self, ranks, normal_quantiles(), frame)
        return frame
