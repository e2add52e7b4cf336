"""From rendered geometry to what a camera delivers, by any of the noise models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from numpy.random import Generator
from pydantic import Field

from cabinpose.core import ConfigError
from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.empirical import EmpiricalNoise
from cabinpose.scene.sensor.noise import CameraNoise
from cabinpose.scene.sensor.physical import PhysicalNoise
from cabinpose.scene.sensor.presets import Sensor
from cabinpose.scene.sensor.structured_light import StructuredLightNoise

# Discriminated by `kind`, for a field of a configuration.
NoiseModel = Annotated[PhysicalNoise | EmpiricalNoise | StructuredLightNoise, Field(discriminator="kind")]


def simulate(
    buffers: GeometryBuffers,
    sensor: Sensor,
    noise: CameraNoise,
    *,
    rng: Generator,
    exposures: Sequence[GeometryBuffers] = (),
) -> SensorFrame:
    """The frame that a camera delivers of a rendered view; equal bits of `rng` give equal bytes.

    Parameters
    ----------
    buffers
        Depth, incidence and material of the view.
    sensor
        The camera.
    noise
        Its noise model.
    rng
        Source of the noise.
    exposures
        Of `physical` noise: the view at each of `sample_times`, where things move while a frame is exposed. Where nothing moves
        from one to the next, give the same object. `buffers` is then the view in the middle.

    Returns
    -------
    SensorFrame
        depth (m, NaN invalid), amplitude, confidence and noise, (H, W) each.

    Raises
    ------
    ConfigError
        Where the geometry's size is not the sensor's, or a structured-light sensor is asked for Time-of-Flight noise.
    """
    size = (sensor.camera.height, sensor.camera.width)
    if buffers.shape != size:
        raise ConfigError(
            f"geometry of {buffers.shape[1]}x{buffers.shape[0]} pixels for the sensor '{sensor.name}' of {size[1]}x{size[0]}",
            hint="render with the sensor's own camera",
        )
    frame = noise.simulate(buffers, sensor, rng=rng, exposures=exposures)
    for effect in noise.effects:
        effect.apply(frame, buffers, sensor, rng=rng)
    noise.filter(frame, buffers, sensor)
    return frame
