"""Noise model `structured_light`: a Kinect-v1 or Xtion, which matches a projected dot pattern.

Sources: Nguyen, Izadi, Lovell, "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking", 3DIMPVT 2012
(axial noise over depth and angle, lateral noise); Khoshelham, Elberink, "Accuracy and Resolution of Kinect Depth Data",
Sensors 12(2), 2012 (baseline 75 mm, disparity in eighths of a pixel). Shadows follow from the projector's place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.random import Generator
from pydantic import Field

from cabinpose._native import sensor as native
from cabinpose.core import reproducible as rp
from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.noise import CameraNoise
from cabinpose.scene.sensor.normals import normal_quantiles, random_words
from cabinpose.scene.sensor.optics import surface_optics
from cabinpose.scene.sensor.presets import Sensor


class StructuredLightNoise(CameraNoise):
    """Depth from a projected dot pattern: quantised disparity, ragged edges, shadows and holes."""

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

    def simulate(
        self,
        buffers: GeometryBuffers,
        sensor: Sensor,
        *,
        rng: Generator,
        exposures: Sequence[GeometryBuffers] = (),  # noqa: ARG002 - its pattern is read at once
    ) -> SensorFrame:
        """The amplitude is that of the geometry, without noise."""
        frame, ranks = SensorFrame.empty(buffers.shape), random_words(buffers.shape, rng=rng).view(np.uint16)
        optics, grazing = surface_optics(sensor, buffers.coats), float(rp.cos(np.radians(self.grazing_deg)))
        native.simulate_structured_light(buffers, optics, sensor, self, ranks, normal_quantiles(), frame, grazing_cosine=grazing)
        return frame
