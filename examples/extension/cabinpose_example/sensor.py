"""A sensor, and an effect on the noise of any camera: pixels that dust on the lens takes."""

from math import radians
from typing import Literal

from numpy.random import Generator
from pydantic import Field

from cabinpose.core import Camera
from cabinpose.scene.sensor import GeometryBuffers, NoiseEffect, Sensor, SensorFrame, invalidate

WIDE_TOF = Sensor(
    name="wide_tof", camera=Camera.from_fov(160, 120, radians(110.0)), range_m=(0.15, 3.0), fps=30, integration_s=1e-3,
    frequencies_hz=(60e6,),
)  # fmt: skip


class Dust(NoiseEffect):
    """Takes out a share of all pixels, others in every frame."""

    kind: Literal["dust"] = "dust"
    share: float = Field(0.01, ge=0, le=1, description="Of the pixels.")

    def apply(self, frame: SensorFrame, buffers: GeometryBuffers, sensor: Sensor, *, rng: Generator) -> None:
        """See `NoiseEffect.apply`."""
        invalidate(frame, rng.random(frame.depth_m.shape) < self.share)
