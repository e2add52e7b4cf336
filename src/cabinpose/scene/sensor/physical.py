"""Noise model `physical`: a continuous-wave Time-of-Flight camera, from geometry to what it delivers.

Sources: Lambers, Hoberg, Kolb, "Simulation of Time-of-Flight Sensors for Evaluation of Chip Layout Variants", IEEE Sensors
Journal 15(7), 2015 (taps of a pmd pixel); Lange, "3D Time-of-Flight Distance Measurement with Custom Solid-State Image
Sensors", Siegen, 2000 (phase noise); Jongenelen et al., IEEE Trans. Instrum. Meas. 60(5), 2011 (two frequencies).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.random import Generator, Philox
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from cabinpose._native import sensor as native
from cabinpose.core import Bools, ConfigError, Floats, Floats32, unknown_name
from cabinpose.core import reproducible as rp
from cabinpose.scene.materials import Coat, Wavelength
from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.indirect import indirect_light
from cabinpose.scene.sensor.noise import EdgeRule, invalidate
from cabinpose.scene.sensor.normals import normal_quantiles, random_words
from cabinpose.scene.sensor.optics import PANES, lens_maps, material_table
from cabinpose.scene.sensor.presets import Sensor
from cabinpose.scene.sensor.shade import light_shadow, sunlit

Wiggling = Literal["calibrated", "uncalibrated"]
# Share of a triangular correlation by name. What calibration leaves is assumed; without it a frame's four phases at 60 MHz have
# 0.42 by `tools/real_tof.py`, and 0.51 to 0.58 in another reading of it.
WIGGLING: Mapping[str, float] = MappingProxyType({"calibrated": 0.1, "uncalibrated": 0.5})


_Share = Annotated[float, Field(ge=0, le=1)]


def _by_name(given: object) -> object:
    if not isinstance(given, str):
        return given
    if given not in WIGGLING:
        raise unknown_name("wiggling", given, tuple(WIGGLING))
    return WIGGLING[given]


class PhysicalNoise(EdgeRule):
    """Continuous-wave Time-of-Flight from geometry; every effect can be switched."""

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
    wiggling: Annotated[_Share, BeforeValidator(_by_name, json_schema_input_type=_Share | Wiggling)] = Field(
        default=0.1,
        description="Share of a triangular correlation left: calibrated (0.1), uncalibrated (0.5), or 0..1; 1 = up to 4.07"
        " degrees of error.",
    )
    stray_light: float = Field(
        default=0.003,
        ge=0,
        le=1,
        description="Share of the mean light of the image that the lens scatters onto every pixel (multipath).",
    )
    multipath: bool = Field(default=False, description="Light that reaches a surface by way of others lengthens its range.")
    multipath_unseen: float = Field(
        default=0.15,
        ge=0,
        lt=1,
        description="Reflectance of what the camera does not see of a car's cabin, for multipath; 0 where that is open.",
    )
    lens_scatter: float = Field(
        default=0.0,
        ge=0,
        le=0.5,
        description="Share of a pixel's light that lens and sensor scatter over the image: what is near pulls what is dark.",
    )
    lens_scatter_px: float = Field(
        default=20.0,
        ge=8,
        le=200,
        description="Width of the scattered light (pixels): Gaussians of one, two and four times that.",
    )
    ambient: float = Field(
        default=0.01, ge=0, description="Ambient irradiance in the cabin at 850 nm, relative to the camera's own light at 1 m."
    )
    daylight: float = Field(default=1.0, ge=0, description="The same outside the windows.")
    light_offset_m: float = Field(
        default=0.0,
        ge=-0.5,
        le=0.5,
        description="The light source is this far to the right of the lens (m): what is near throws a shadow beside itself.",
    )
    sun: float = Field(
        default=0.0,
        ge=0,
        description="Ambient irradiance in a beam of sunlight on a visible place, drawn for each frame; about 30 in full sun.",
    )
    sun_width_m: float = Field(default=0.3, gt=0, description="Diameter of the beam (m).")
    fixed_pattern_mm: float = Field(
        default=0.0, ge=0, description="Offset of each pixel's range, the same in all frames: standard deviation (mm)."
    )
    fixed_pattern_gain: float = Field(
        default=0.0, ge=0, le=0.1, description="Error of each pixel's range that grows with it, the same in all frames: share."
    )
    fixed_pattern_seed: int = Field(default=0, ge=0, description="Which camera of its kind it is: the seed of the pattern.")
    reflectance: bool = Field(
        default=True,
        description="Materials reflect as at the sensor's wavelength, smooth ones shine; off: everything is white and matt.",
    )
    incidence: bool = Field(default=True, description="Light returned falls with the cosine of incidence.")
    vignetting: bool = Field(default=True, description="Lens and light source fall off towards the edge of the image.")
    glass: bool = Field(default=True, description="Window panes return next to nothing; off: they are dim diffuse surfaces.")
    range_window: bool = Field(default=True, description="Depths outside the sensor's range are invalid.")
    low_amplitude: bool = Field(default=True, description="Pixels below the sensor's minimum amplitude are invalid.")
    low_amplitude_spread: float = Field(
        default=0.0,
        ge=0,
        le=2,
        description="Spread of that minimum over pixels and frames, of its logarithm: what is lost has a speckled border.",
    )
    circular_field: bool = Field(default=True, description="Pixels outside the lens' image circle are invalid.")

    def simulate(
        self, buffers: GeometryBuffers, sensor: Sensor, *, rng: Generator, exposures: Sequence[GeometryBuffers] = ()
    ) -> SensorFrame:
        """One frame of a continuous-wave camera."""
        if sensor.principle != "time_of_flight":
            raise ConfigError(
                f"sensor '{sensor.name}' is not a Time-of-Flight camera, and the noise model 'physical' is one",
                hint="choose the noise model 'structured_light' or 'empirical'",
            )
        expected = len(sample_times(sensor, self))
        samples = list(exposures) or [buffers] * expected
        if len(samples) != expected:
            raise ConfigError(
                f"{len(samples)} exposures for the {expected} samples of a frame of '{sensor.name}'",
                hint="give the geometry at each of `sample_times`",
            )
        camera = _continuous_wave(sensor, self, buffers.supersample)
        if buffers.coats:
            camera = camera._replace(table=_table(sensor, self, buffers.coats))
        if self.multipath:
            lit, falloff, unseen = _lit(buffers, sensor, self), self.vignetting, self.multipath_unseen
            light = indirect_light(lit, sensor, camera.table, camera.frequencies, falloff=falloff, unseen=unseen)
            camera = camera._replace(indirect=light)
        if self.sun > 0 or buffers.sunlight is not None:
            camera = _in_the_sun(camera, buffers, sensor, self, rng=rng)
        first = len(samples) if sensor.second_integration_s is None else len(samples) // 2
        frame = _exposed(samples[:first], camera, sensor, self, rng=rng)
        if sensor.second_integration_s is not None and (full := np.isinf(frame.noise_m)).any():
            _take_shorter(frame, full, samples[first:], camera, sensor, self, rng=rng)
        if self.low_amplitude and self.low_amplitude_spread > 0:
            height, width = buffers.shape
            ranks = random_words((height, (width + 3) // 4), rng=rng).view(np.uint16)[:, :width]
            floor = sensor.min_amplitude_e * rp.exp(self.low_amplitude_spread * normal_quantiles()[ranks])
            invalidate(frame, frame.amplitude < floor)
        if self.fixed_pattern_mm > 0 or self.fixed_pattern_gain > 0:
            _add_fixed_pattern(frame, camera, self)
        return frame


NO_EFFECTS = PhysicalNoise(  # a camera without noise
    shot_noise=False, read_noise=False, full_well=False, flying_pixels=False, blur=0.0, wrapping=False, consistency=False,
    wiggling=0.0, stray_light=0.0, ambient=0.0, daylight=0.0, reflectance=False, incidence=False, vignetting=False,
    glass=False, range_window=False, low_amplitude=False, circular_field=False,
)  # fmt: skip

_LEAST_AMBIENT = 1e-3  # of the table of materials that sunlight multiplies
# Sunlight at the ground in 20 nm about a wavelength, of that at 850 nm: ASTM G173-03, 0.303 and 0.977 W/m2/nm.
SUNLIGHT: Mapping[Wavelength, float] = MappingProxyType({850: 1.0, 940: 0.31})
_PATTERN_STREAM = 0xF1ED  # of a camera's seed: apart from the streams of frames
_NO_INDIRECT = np.zeros((0, 0, 0), np.float32)


class _ContinuousWave(NamedTuple):
    """Lens and light of a sensor, as the kernel takes them beside the sensor and the effects: sensor/continuous_wave.cpp."""

    range_over_depth: Floats32
    parts_range_over_depth: Floats32
    gain: Floats32
    ambient_gain: Floats32
    table: Floats32
    frequencies: NDArray[np.float64]
    frequency_ratio: tuple[int, int]
    near: float
    far: float
    indirect: Floats32


def _table(sensor: Sensor, noise: PhysicalNoise, coats: tuple[Coat, ...] = ()) -> Floats32:
    share = SUNLIGHT[sensor.wavelength_nm]
    return material_table(
        noise.reflectance, noise.glass, share * noise.ambient, share * noise.daylight, sensor.wavelength_nm, coats
    )


@lru_cache(maxsize=8)
def _continuous_wave(sensor: Sensor, noise: PhysicalNoise, supersample: int) -> _ContinuousWave:
    """What frames have in common."""
    maps = lens_maps(sensor, supersample)
    field = maps.field if noise.circular_field else np.isfinite(maps.range_over_depth)
    dark, electrons = np.float32(0.0), np.float32(sensor.signal_e)
    ambient_gain = np.where(field, electrons * maps.vignetting if noise.vignetting else electrons, dark)
    gain = np.where(field, ambient_gain * maps.illumination, dark) if noise.vignetting else ambient_gain
    frequencies = sensor.frequencies_hz if noise.second_frequency else sensor.frequencies_hz[:1]
    near, far = sensor.range_m if noise.range_window else (-np.inf, np.inf)
    return _ContinuousWave(
        range_over_depth=maps.range_over_depth,
        parts_range_over_depth=maps.parts_range_over_depth,
        gain=gain,
        ambient_gain=ambient_gain,
        table=_table(sensor, noise),
        frequencies=np.array(frequencies),
        frequency_ratio=sensor.frequency_ratio if len(frequencies) == 2 else (1, 1),
        near=near,
        far=far,
        indirect=_NO_INDIRECT,
    )


def sample_times(sensor: Sensor, noise: PhysicalNoise) -> Floats:
    """(S,) s from the middle of a frame's exposure: the middles of its correlation samples, in the order they are exposed.

    Four samples of the first frequency (0, 90, 180, 270 degrees) and of the second; in two-integration mode the same again.
    """
    frequencies = len(sensor.frequencies_hz) if noise.second_frequency else 1
    lasts = [t for t in (sensor.integration_s, sensor.second_integration_s) if t is not None]
    lasting = np.repeat(lasts, 4 * frequencies)
    ends = np.cumsum(lasting + sensor.readout_s) - sensor.readout_s
    return np.asarray(ends - lasting / 2 - ends[-1] / 2)


def _shares(which: Sequence[int], frequencies: int, planes: int) -> Floats:
    """(M, planes): of the moments `which` (S,) the samples belong to, in the means that the kernel decodes.

    C0 - C2 = K (I(t0) + I(t2)) and C3 - C1 = K (Q(t1) + Q(t3)), where I and Q are the light in phase and in quadrature.
    """
    of_moment = np.eye(max(which) + 1)[list(which)]  # (S, M)
    shares = np.repeat(of_moment.mean(axis=0)[:, None], planes, axis=1)
    for k in range(frequencies):
        for plane, samples in ((2 + 2 * k, [0, 2]), (3 + 2 * k, [1, 3])):
            shares[:, plane] = of_moment[4 * k : 4 * k + 4][samples].mean(axis=0)
    return shares


def _exposed(
    samples: Sequence[GeometryBuffers], camera: _ContinuousWave, sensor: Sensor, noise: PhysicalNoise, *, rng: Generator
) -> SensorFrame:
    """A frame of the geometry at each of its samples, many of which may be one and the same object."""
    views = list({id(view): view for view in samples}.values())
    which = [next(i for i, view in enumerate(views) if view is sample) for sample in samples]
    frequencies = len(camera.frequencies)
    shares = _shares(which, frequencies, 2 + 2 * frequencies + (not noise.wrapping))
    views = [_lit(view, sensor, noise) for view in views]
    frame = SensorFrame.empty(views[0].shape)
    words = random_words(views[0].shape, rng=rng).view(np.uint16)
    native.simulate_continuous_wave(views, shares, camera, sensor, noise, words, normal_quantiles(), frame)
    return frame


def _take_shorter(
    frame: SensorFrame,
    full: Bools,
    samples: Sequence[GeometryBuffers],
    camera: _ContinuousWave,
    sensor: Sensor,
    noise: PhysicalNoise,
    *,
    rng: Generator,
) -> None:
    """Put a second, shorter integration in place of pixels (H, W) that are full in the first, their amplitude at its scale."""
    ratio = np.float32((sensor.second_integration_s or 0.0) / sensor.integration_s)
    dimmed = camera._replace(gain=camera.gain * ratio, ambient_gain=camera.ambient_gain * ratio)
    shorter = _exposed(samples, dimmed, sensor, noise, rng=rng)
    for image in ("depth_m", "confidence", "noise_m"):
        getattr(frame, image)[full] = getattr(shorter, image)[full]
    frame.amplitude[full] = np.minimum(shorter.amplitude[full] / ratio, 65535.0).astype(np.uint16)


def _lit(buffers: GeometryBuffers, sensor: Sensor, noise: PhysicalNoise) -> GeometryBuffers:
    """Geometry of which pixels in the light source's shadow, and their parts, return nothing of the camera's light."""
    if not noise.light_offset_m:
        return buffers
    shadow = light_shadow(buffers.depth_m, sensor.camera, noise.light_offset_m)
    parts = np.where(shadow.ravel()[buffers.mixed][:, None], np.float32(0.0), buffers.parts_cos_incidence)
    return replace(buffers, cos_incidence=np.where(shadow, np.float32(0.0), buffers.cos_incidence), parts_cos_incidence=parts)


def _in_the_sun(
    camera: _ContinuousWave, buffers: GeometryBuffers, sensor: Sensor, noise: PhysicalNoise, *, rng: Generator
) -> _ContinuousWave:
    """A camera whose gain of ambient light is that of sunlight where it falls, as each pixel's centre is lit.

    It falls through the windows, as the view says, and in a beam, where noise has one.
    """
    ambient = max(noise.ambient, _LEAST_AMBIENT)
    table = _table(sensor, noise.model_copy(update={"ambient": ambient}), buffers.coats)
    inside = (buffers.material > 0) & ~(PANES[buffers.material] & noise.glass)
    light = np.full(buffers.shape, np.float32(noise.ambient))
    if buffers.sunlight is not None:
        light += buffers.sunlight
    if noise.sun > 0:
        light += noise.sun * sunlit(buffers.depth_m, inside, sensor.camera, noise.sun_width_m, rng=rng)
    share = np.where(inside, light / ambient, np.float32(1.0))
    return camera._replace(table=table, ambient_gain=(camera.ambient_gain * share).astype(np.float32))


@lru_cache(maxsize=4)
def _pattern(shape: tuple[int, int], seed: int) -> tuple[Floats32, Floats32]:
    """Offset and gain of each pixel, standard normal."""
    offset, gain = Generator(Philox(key=(seed, _PATTERN_STREAM))).standard_normal((2, *shape), np.float32)
    return offset, gain


def _add_fixed_pattern(frame: SensorFrame, camera: _ContinuousWave, noise: PhysicalNoise) -> None:
    """Add each pixel's own error to its range; what it takes out of the range window becomes invalid."""
    offset, gain = _pattern(frame.depth_m.shape, noise.fixed_pattern_seed)
    frame.depth_m[:] *= 1 + np.float32(noise.fixed_pattern_gain) * gain
    frame.depth_m[:] += np.float32(noise.fixed_pattern_mm * 1e-3) * offset / camera.range_over_depth
    with np.errstate(invalid="ignore"):
        invalidate(frame, (frame.depth_m < camera.near) | (frame.depth_m > camera.far) | (frame.depth_m <= 0))
