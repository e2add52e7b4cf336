"""Noise model `physical`: a continuous-wave Time-of-Flight camera, from geometry to what it delivers.

Sources: Lambers, Hoberg, Kolb, "Simulation of Time-of-Flight Sensors for Evaluation of Chip Layout Variants", IEEE Sensors
Journal 15(7), 2015 (taps of a pmd pixel); Lange, "3D Time-of-Flight Distance Measurement with Custom Solid-State Image
Sensors", Siegen, 2000 (phase noise); Jongenelen et al., IEEE Trans. Instrum. Meas. 60(5), 2011 (two frequencies).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core.errors import ConfigError
from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.continuous_wave import average_parts, collect_phasors, decode, mean_light, spread
from cabinpose.scene.sensor.normals import normal_quantiles, random_words
from cabinpose.scene.sensor.optics import GLOSS_WIDTH, lens_maps, material_table
from cabinpose.scene.sensor.presets import SPEED_OF_LIGHT, Sensor


class PhysicalNoise(BaseModel):
    """Continuous-wave Time-of-Flight from geometry; every effect can be switched."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["physical"] = "physical"
    shot_noise: bool = Field(default=True, description="Photon noise of signal and ambient light.")
    read_noise: bool = Field(default=True, description="Read noise of the taps.")
    full_well: bool = Field(default=True, description="Taps clip at their full well; a clipped pixel is invalid.")
    flying_pixels: bool = Field(default=True, description="Average the phasors of a mixed pixel's parts; off: take one sample.")
    blur: float = Field(
        default=0.1, ge=0, le=0.25, description="Share of a pixel's light that the lens spills to its neighbour on each side."
    )
    wrapping: bool = Field(
        default=True, description="The phase repeats beyond the unambiguous range; off: it is unwrapped perfectly."
    )
    second_frequency: bool = Field(
        default=True, description="Use the sensor's second modulation frequency, where it has one, to unwrap."
    )
    consistency: bool = Field(default=True, description="Pixels whose two phases belong to no single distance are invalid.")
    wiggling: float = Field(
        default=0.1,
        ge=0,
        le=1,
        description="Share of a triangular correlation left after calibration; 1 = up to 4.07 degrees of error.",
    )
    stray_light: float = Field(
        default=0.003,
        ge=0,
        le=1,
        description="Share of the mean light of the image that the lens scatters onto every pixel (multipath).",
    )
    ambient: float = Field(
        default=0.01, ge=0, description="Ambient irradiance in the cabin at 850 nm, relative to the camera's own light at 1 m."
    )
    daylight: float = Field(default=1.0, ge=0, description="The same outside the windows.")
    reflectance: bool = Field(default=True, description="Materials reflect as at 850 nm; off: everything is white.")
    incidence: bool = Field(default=True, description="Light returned falls with the cosine of incidence.")
    vignetting: bool = Field(default=True, description="Lens and light source fall off towards the edge of the image.")
    glass: bool = Field(default=True, description="Window panes return next to nothing; off: they are dim diffuse surfaces.")
    range_window: bool = Field(default=True, description="Depths outside the sensor's range are invalid.")
    low_amplitude: bool = Field(default=True, description="Pixels below the sensor's minimum amplitude are invalid.")
    circular_field: bool = Field(default=True, description="Pixels outside the lens' image circle are invalid.")


NO_EFFECTS = PhysicalNoise(
    shot_noise=False, read_noise=False, full_well=False, flying_pixels=False, blur=0.0, wrapping=False, consistency=False,
    wiggling=0.0, stray_light=0.0, ambient=0.0, daylight=0.0, reflectance=False, incidence=False, vignetting=False,
    glass=False, range_window=False, low_amplitude=False, circular_field=False,
)  # fmt: skip

# Of p t2 - q t1 from a whole number, in turns; half a turn is the most there can be, and makes the unwrapping wrong. Phases
# at the sensor's floor are two sigma inside; mixtures of a dim near and a bright far surface may be outside.
_PHASE_TOLERANCE = 0.25


@lru_cache(maxsize=8)
def _gains(
    sensor: Sensor, vignetting: bool, circular: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Electrons per unit of relative energy, electrons per unit of ambient irradiance, and the field: (H, W) each."""
    maps = lens_maps(sensor, 1)
    lens = maps.vignetting if vignetting else np.ones_like(maps.vignetting)
    light = maps.illumination if vignetting else np.ones_like(maps.illumination)
    field = maps.field if circular else np.isfinite(maps.range_over_depth)
    scale = np.where(field, np.float32(sensor.signal_e), np.float32(0.0))
    return scale * lens * light, scale * lens, field


def simulate_physical(buffers: GeometryBuffers, sensor: Sensor, noise: PhysicalNoise, *, rng: Generator) -> SensorFrame:
    """One frame of a continuous-wave camera; see `simulate`."""
    if sensor.principle != "time_of_flight":
        raise ConfigError(
            f"sensor '{sensor.name}' is not a Time-of-Flight camera, and the noise model 'physical' is one",
            hint="choose the noise model 'structured_light' or 'empirical'",
        )
    height, width = buffers.shape
    if not noise.flying_pixels:
        buffers = buffers.one_sample()
    maps = lens_maps(sensor, buffers.supersample)
    gain, ambient_gain, field = _gains(sensor, noise.vignetting, noise.circular_field)
    frequencies = np.array(sensor.frequencies_hz if noise.second_frequency else sensor.frequencies_hz[:1])
    energy, moment, daylight = (np.empty((height, width), np.float32) for _ in range(3))
    phasor = np.empty((2 * len(frequencies), height, width), np.float32)
    table = material_table(noise.reflectance, noise.glass, noise.ambient, noise.daylight)
    light = (
        noise.incidence, table, GLOSS_WIDTH, (2.0 * frequencies / SPEED_OF_LIGHT).astype(np.float32), noise.wiggling,
        energy, moment, daylight, phasor,
    )  # fmt: skip
    collect_phasors(buffers.depth_m, buffers.cos_incidence, buffers.material, maps.range_over_depth, *light)
    average_parts(
        buffers.mixed, buffers.parts_depth_m, buffers.parts_cos_incidence, buffers.parts_material,
        maps.parts_range_over_depth, *light,
    )  # fmt: skip
    if noise.blur > 0:
        for image in (energy, moment, daylight, *phasor):
            spread(image, noise.blur)
    stray = np.zeros(1 + len(phasor))
    if noise.stray_light > 0:
        mean_light(energy, phasor, gain, stray)
    near, far = sensor.range_m if noise.range_window else (-np.inf, np.inf)
    frame = SensorFrame(
        np.empty((height, width), np.float32), np.empty((height, width), np.uint16), np.empty((height, width), np.uint8)
    )
    ranks = random_words((height, width), rng=rng).view(np.uint16)
    decode(
        energy, moment, daylight, phasor, gain, ambient_gain, field, maps.range_over_depth,
        ranks, normal_quantiles(), (noise.stray_light * stray).astype(np.float32),
        frequencies, sensor.frequency_ratio if len(frequencies) == 2 else (1, 1), SPEED_OF_LIGHT, sensor.contrast,
        noise.shot_noise, sensor.read_noise_e if noise.read_noise else 0.0, sensor.full_well_e if noise.full_well else np.inf,
        sensor.min_amplitude_e if noise.low_amplitude else 0.0, near, far, noise.wrapping,
        _PHASE_TOLERANCE if noise.consistency else 0.5,
        frame.depth_m, frame.amplitude, frame.confidence,
    )  # fmt: skip
    return frame
