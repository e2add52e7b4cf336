"""Cameras by name, and the model of one.

From data sheets and from Gonçalves (thesis, 2020, section 2.1.3 and table 2.3): image sizes, fields of view, light
source, and the ranges, frame rates and integration times of the Pico Monstar 105's use cases. From Lambers' open
simulator `camsim`: contrast 0.75 and full well 100 000 e-. Calibrated here: `signal_e_per_s`, so that the image
mean of sigma in use case 3 follows the thesis' measurement on a white wall (`docs/sensor-model.md`). Assumed, as no
data sheet gives them: modulation frequencies, read noise, lens distortion, illumination profile, and all noise figures
of the two Melexis cameras.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from math import radians
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from cabinpose.core import Camera, ConfigError, Registry, check_camera, check_image_circle
from cabinpose.scene.materials import Wavelength
from cabinpose.scene.sensor.lens_keys import LensKeys, lens_of_keys

SPEED_OF_LIGHT = 299_792_458.0  # m/s
# Ratios of two frequencies beyond this leave less than 1/20 of a turn for the noise of each phase.
_LARGEST_RATIO = 12
READOUT_S = 0.96e-3  # of half the pixels at half of 80 MHz: the thesis' equation 4.1, of the EVK75123; assumed for the others
_TOLD_ELSEWHERE = ("name", "principle", "baseline_m", "native_scale")  # and what only structured light has


class Sensor(BaseModel):
    """A depth camera: lens, timing, and the figures of its pixels.

    What is left out is as in a Pico Monstar's use case 4, but for even light and no image circle.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(default="own_camera", min_length=1, description="Name that the dataset records.")
    principle: Literal["time_of_flight", "structured_light"] = Field(
        default="time_of_flight", description="How depth is measured."
    )
    camera: Annotated[Camera, BeforeValidator(lens_of_keys, json_schema_input_type=LensKeys)] = Field(
        description="Intrinsics: width, height, fx, fy, cx, cy (px) and dist (k1, k2, p1, p2, k3); fov_deg for fx and fy."
    )
    range_m: tuple[float, float] = Field(
        default=(0.3, 2.0), description="Dead zone and saturation: nearest and farthest distance delivered (m)."
    )
    wavelength_nm: Wavelength = Field(
        default=850,
        exclude_if=lambda value: value == 850,
        description="Of its light (nm): 850 or 940. Surfaces reflect as they do there.",
    )
    integration_s: float = Field(default=450e-6, gt=0, description="Exposure of one correlation sample (s).")
    second_integration_s: float | None = Field(
        default=None,
        gt=0,
        exclude_if=lambda value: value is None,
        description="Two-integration mode: a shorter exposure follows, which pixels deliver that are full in the first (s).",
    )
    readout_s: float = Field(
        default=READOUT_S,
        ge=0,
        exclude_if=lambda value: value == READOUT_S,
        description="Time between the exposures of two correlation samples (s).",
    )
    fps: float = Field(default=25.0, gt=0, description="Frames per second.")
    frequencies_hz: tuple[Annotated[float, Field(gt=1e5, lt=1e9)], ...] = Field(
        default_factory=lambda given: () if given.get("principle") == "structured_light" else (80e6, 60e6),
        max_length=2,
        description="Modulation frequencies (Hz): one, or two in the ratio of small integers.",
    )
    contrast: float = Field(default=0.75, gt=0, le=1, description="Demodulation contrast K of the pixel.")
    signal_e_per_s: float = Field(
        default=4.1e6,
        gt=0,
        description="Electrons per second in both taps from a white surface facing the camera at 1 m on the axis.",
    )
    read_noise_e: float = Field(default=5.0, ge=0, description="Read noise of one tap difference (electrons, rms).")
    full_well_e: float = Field(default=100_000.0, gt=0, description="Electrons that one tap holds.")
    min_amplitude_e: float = Field(default=45.0, ge=0, description="Amplitude below which a pixel is invalid (electrons).")
    vignetting_exponent: float = Field(default=4.0, ge=0, description="The lens passes cos^n of the angle off axis.")
    illumination_exponent: float = Field(
        default=0.0, description="Radiant intensity of the light, cos^n of the angle off axis; negative: it fills the edge."
    )
    field_radius_px: float | None = Field(
        default=None, gt=0, description="Radius of the lens' image circle about (cx, cy) (px); none = no crop."
    )
    spatial_filter: Literal["none", "mean", "median", "bilateral"] = Field(
        default="none", exclude_if=lambda value: value == "none", description="Filter of depth over neighbouring pixels."
    )
    spatial_px: Literal[3, 5, 7] = Field(
        default=3, exclude_if=lambda value: value == 3, description="Side of the square that it looks at (px)."
    )
    temporal_median: int = Field(
        default=1,
        ge=1,
        le=15,
        exclude_if=lambda value: value == 1,
        description="Each depth is the median of the pixel's last so many frames, of one sequence.",
    )
    baseline_m: float = Field(default=0.075, gt=0, description="Structured light only: distance from projector to camera (m).")
    native_scale: float = Field(default=1.0, gt=0, description="Structured light only: matched pixels per delivered pixel.")

    def model_post_init(self, context: object, /) -> None:
        """Checks that fields fit each other."""
        del context
        check_camera(self.camera, f"sensor '{self.name}'")
        check_image_circle(self.camera, f"sensor '{self.name}'", self.field_radius_px)
        near, far = self.range_m
        if not 0 <= near < far:
            raise ConfigError(
                f"sensor '{self.name}': range {near}..{far} m is empty", hint="give range_m as near, far with 0 <= near < far"
            )
        if (self.second_integration_s or 0.0) >= self.integration_s:
            raise ConfigError(
                f"sensor '{self.name}': the second integration, {self.second_integration_s} s, is not the shorter one",
                hint=f"give second_integration_s below integration_s, {self.integration_s}",
            )
        if self.principle == "time_of_flight" and self.integration_s > 1 / self.fps:
            raise ConfigError(
                f"sensor '{self.name}': an exposure of {self.integration_s:g} s is longer than a frame at {self.fps:g} frames/s",
                hint="give integration_s in seconds: 450 µs are 450.0e-6",
            )
        if self.principle == "time_of_flight" and not self.frequencies_hz:
            raise ConfigError(f"sensor '{self.name}' has no modulation frequency", hint="give one or two frequencies_hz")
        if len(self.frequencies_hz) == 2:
            ratio = self.frequency_ratio
            if ratio[0] == ratio[1] or max(ratio) > _LARGEST_RATIO:
                raise ConfigError(
                    f"sensor '{self.name}': frequencies in the ratio {ratio[0]}:{ratio[1]} do not unwrap",
                    hint=f"choose two that differ and are in a ratio of integers up to {_LARGEST_RATIO}, such as 80e6 and 60e6",
                )

    def unfiltered(self) -> Sensor:
        """The sensor without its filters, which are in all that it recorded."""
        return self.model_copy(update={"spatial_filter": "none", "temporal_median": 1})

    @property
    def assumed(self) -> Mapping[str, Any]:
        """The fields that were not given and are in force all the same, with their values."""
        fields = type(self).model_fields.items()
        left_out = [name for name, field in fields if name not in self.model_fields_set and field.exclude_if is None]
        return {name: value for name in left_out if name not in _TOLD_ELSEWHERE and (value := getattr(self, name)) is not None}

    @property
    def signal_e(self) -> float:
        """Electrons in both taps per correlation sample, from a white surface facing the camera at 1 m on the axis."""
        return self.signal_e_per_s * self.integration_s

    @property
    def frequency_ratio(self) -> tuple[int, int]:
        """Two frequencies as coprime integers p, q (to 1 Hz)."""
        first, second = self.frequencies_hz
        ratio = Fraction(round(first), round(second))
        return ratio.numerator, ratio.denominator

    @property
    def phases(self) -> int:
        """Correlation samples in a frame."""
        return 4 * len(self.frequencies_hz)


# A lens with square pixels whose barrel distortion gives 100 x 85 degrees on 352 x 287, as published; the polynomial is
# monotonic beyond the corner (ideal radius 1.67), so every pixel has a ray.
_MONSTAR_LENS = Camera(352, 287, 173.646, 173.646, 175.5, 143.0, (-0.133684, 0.02, 0.0, 0.0, 0.0))
# Image circle: reaches the left and right border, cuts the corners.
_MONSTAR_FIELD_PX = 188.0
# Range (m), frames/s, integration (us), frequencies (MHz). Two frequencies where the frame time allows eight samples; 80
# and 60 MHz repeat after 7.49 m. The fast cases 5 and 6 have one: 60 MHz (2.50 m) holds 0.3-2.0 m, 80 MHz (1.87 m) 0.1-1.0 m.
_MONSTAR_USE_CASES = {
    1: ((1.0, 4.0), 5, 2000, (80, 60)),
    2: ((1.0, 4.0), 10, 1000, (80, 60)),
    3: ((0.5, 1.5), 15, 700, (80, 60)),
    4: ((0.3, 2.0), 25, 450, (80, 60)),
    5: ((0.3, 2.0), 35, 600, (60,)),
    6: ((0.1, 1.0), 45, 500, (80,)),
}


def _monstar(use_case: int, name: str) -> Sensor:
    window, fps, integration_us, frequencies_mhz = _MONSTAR_USE_CASES[use_case]
    return Sensor(
        name=name, camera=_MONSTAR_LENS, range_m=window, fps=fps, integration_s=integration_us * 1e-6,
        frequencies_hz=tuple(f * 1e6 for f in frequencies_mhz), illumination_exponent=-2.0, field_radius_px=_MONSTAR_FIELD_PX,
    )  # fmt: skip


_ALL = (
    _monstar(3, "pico_monstar_105"), *(_monstar(use_case, f"pico_monstar_105/{use_case}") for use_case in _MONSTAR_USE_CASES),
    # LED light: low frequency, much of it lost, so noisier. 90 degree lens.
    Sensor(
        name="evk75023", camera=Camera.from_fov(320, 240, radians(90.0)), range_m=(0.3, 4.0), fps=30, integration_s=1.0e-3,
        frequencies_hz=(20e6,), contrast=0.6, signal_e_per_s=12.0e6, read_noise_e=20.0, min_amplitude_e=150.0,
    ),
    # 110 degrees of lens whose barrel distortion leaves 100 on the 320 columns.
    Sensor(
        name="evk75123", camera=Camera(320, 240, 160.800, 160.800, 159.5, 119.5, (-0.155, 0.0273, 0.0, 0.0, 0.0)),
        range_m=(0.2, 3.0), fps=30, integration_s=1.0e-3, frequencies_hz=(40e6,), contrast=0.7, signal_e_per_s=9.0e6,
        read_noise_e=15.0, min_amplitude_e=120.0, illumination_exponent=-1.0, field_radius_px=172.0,
    ),
    # ITOP's intrinsics, 0.0035 = 1 / 285.714. The matcher works on 640 columns.
    Sensor(
        name="kinect_v1", principle="structured_light", camera=Camera(320, 240, 285.714, 285.714, 160.0, 120.0),
        range_m=(0.4, 8.0), fps=30, integration_s=1 / 30, native_scale=2.0,
    ),
)  # fmt: skip
OWN_SENSORS: Mapping[str, Sensor] = MappingProxyType({sensor.name: sensor for sensor in _ALL})
SENSORS: Registry[Sensor] = Registry("cabinpose.sensors", "sensor", Sensor, named=True)


def sensor_by_name(name: str) -> Sensor:
    """The preset of that name; `ConfigError` with the known names otherwise."""
    return SENSORS[name]
