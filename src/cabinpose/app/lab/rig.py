"""The rig of the virtual laboratory: which camera, where, by which clocks, with which errors. All that is true of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from cabinpose.app.lab.clocks import Clock, ClockSettings
from cabinpose.core import Matrix, invert, is_rigid, look_at, unknown_name
from cabinpose.scene.sensor import PhysicalNoise, Sensor, sensor_by_name
from cabinpose.signals import ClockMap

Source = Literal["tof", "optical", "suit", "suit2", "tracker"]
SOURCES: tuple[Source, ...] = ("tof", "optical", "suit", "suit2")
Row = tuple[float, float, float, float]
Rows = tuple[Row, Row, Row, Row]


def _rows(value: Any) -> Any:
    """A rigid transform as tuples, so that rigs can be compared, hashed and written as YAML."""
    try:
        matrix = np.asarray(value, np.float64)
    except (TypeError, OverflowError) as error:
        raise ValueError(f"not a transform: {error}") from error
    if not is_rigid(matrix):
        raise ValueError("not a rigid transform: 4 rows of 4, a rotation and a translation in metres, last row 0 0 0 1")
    return tuple(map(tuple, matrix.tolist()))


class Device(ClockSettings):
    """A device's clock, and how often it gives a sample."""

    rate_hz: float = Field(gt=0, description="Samples per second of its own clock.")


class Tracker(Device):
    """A mobile tracker on the head: its clock, and what it gets wrong, one sigma about each axis."""

    rate_hz: float = Field(default=90.0, gt=0, description="Samples per second of its own clock.")
    offset_s: float = Field(default=203.1, description="What its clock shows at the rig's start (s).")
    drift_ppm: float = Field(default=12.0, gt=-1e5, lt=1e5, description="How much faster than true time it runs (1e-6).")
    latency_s: float = Field(default=0.015, ge=0, description="From the moment that a sample shows to its arrival, at least (s).")
    jitter_s: float = Field(default=0.002, ge=0, description="Mean of what comes on top of the latency (s).")
    noise_m: float = Field(default=0.001, ge=0, description="Of the position, from sample to sample (m).")
    noise_deg: float = Field(default=0.2, ge=0, description="Of the orientation, from sample to sample (deg).")
    wander_m: float = Field(default=0.003, ge=0, description="Of the position, over seconds (m).")
    wander_deg: float = Field(default=0.5, ge=0, description="Of the orientation, over seconds (deg).")


class SuitErrors(BaseModel):
    """What a suit of inertial sensors gets wrong. Angles in degrees, one sigma each; 0 switches one off."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    segment_noise_deg: float = Field(
        default=0.3, ge=0, description="Of every segment's orientation, about each axis, varying fast."
    )
    soft_tissue_deg: float = Field(default=1.5, ge=0, description="Sensors that skin and muscle move against the bone.")
    heading_drift_deg_per_min: float = Field(default=0.5, ge=0, description="Turn of the suit's world about the vertical.")
    magnetic_deg: float = Field(default=2.0, ge=0, description="Heading of single segments that come near the car's steel.")
    calibration_offset_deg: float = Field(
        default=2.0, ge=0, description="Constant of each segment: the pose taken for N was none."
    )
    length_error: float = Field(
        default=0.02, ge=0, lt=0.3, description="Of each segment, as a part of its length; above 0 no spine stretches either."
    )
    root_drift_m_per_min: float = Field(
        default=0.05, ge=0, description="Of the pelvis, which the suit finds by dead reckoning (m)."
    )


class VirtualRig(BaseModel):
    """A rig, its truth and its errors; every error can be switched alone (`only`)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sensor: str = Field(default="pico_monstar_105/4", description="The ToF camera: name of a preset.")
    extrinsics: Annotated[Rows, BeforeValidator(_rows)] = Field(
        default_factory=lambda: _rows(invert(look_at((-0.15, 0.1, 1.25), (0.95, -0.05, 1.0)))),
        description="camera_from_world, 4 rows: the world is the optical system's, z up.",
    )
    start_ns: int = Field(default=1_750_000_000_000_000_000, ge=0, description="True time at which the rig's clocks start (ns).")
    tof: Device = Field(
        default=Device(rate_hz=25, offset_s=1041.3, drift_ppm=18, resolution_ns=1_000, latency_s=0.042, jitter_s=0.004),
        description="The camera's clock.",
    )
    optical: Device = Field(
        default=Device(rate_hz=100, offset_s=76.28, drift_ppm=-6, latency_s=0.009, jitter_s=0.0007),
        description="The optical system's clock.",
    )
    suit: Device = Field(
        default=Device(rate_hz=60, offset_s=412.75, drift_ppm=31, resolution_ns=1_000_000, latency_s=0.021, jitter_s=0.005),
        description="The suit's clock.",
    )
    suit2: Device = Field(
        default=Device(rate_hz=60, offset_s=98.4, drift_ppm=-12, resolution_ns=1_000_000, latency_s=0.034, jitter_s=0.005),
        description="The clock of a second person's suit.",
    )
    tracker: Tracker | None = Field(
        default=None, description="A mobile tracker beside the optical system, which then gives the head in the takes."
    )
    sensor_noise: bool = Field(default=True, description="Shot and read noise of the camera.")
    sensor_systematic: bool = Field(
        default=True, description="Wiggling, stray light, ambient light and full wells of the camera."
    )
    optical_noise_m: float = Field(default=0.00015, ge=0, description="Of a marker's position along each axis, one sigma (m).")
    optical_occlusion: bool = Field(default=True, description="Markers are lost for moments, and behind bodies.")
    optical_swaps: bool = Field(default=False, description="Two markers exchange their labels now and then.")
    suit_errors: SuitErrors = Field(default=SuitErrors(), description="What the suit gets wrong.")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.tof.rate_hz > self.tof_sensor.fps:
            raise ValueError(f"{self.sensor} gives {self.tof_sensor.fps:g} frames per second, not {self.tof.rate_hz:g}")
        return self

    @property
    def tof_sensor(self) -> Sensor:
        """The ToF camera."""
        return sensor_by_name(self.sensor)

    @property
    def camera_from_world(self) -> Matrix:
        """The truth that calibration looks for."""
        return np.array(self.extrinsics)

    @property
    def noise(self) -> PhysicalNoise:
        """What the camera adds to geometry, by the switches of the rig. The lens blurs, and edges mix, in any case."""
        noisy, real = self.sensor_noise, self.sensor_systematic
        physical = PhysicalNoise(shot_noise=noisy, read_noise=noisy, full_well=real)
        return (
            physical
            if real
            else physical.model_copy(update=dict.fromkeys(("wiggling", "stray_light", "ambient", "daylight"), 0.0))
        )

    def clock(self, source: Source) -> Clock:
        """The clock of a source."""
        return Clock(getattr(self, source), self.start_ns)

    def clock_map(self, a: Source, b: Source) -> ClockMap:
        """What the clock of source b shows when that of a shows t: the delay that alignment looks for."""
        return self.clock(a).to(self.clock(b))

    def noise_free(self) -> VirtualRig:
        """The rig without an error: no noise, no jitter, no rounding; clocks keep offset, drift and latency."""
        return self._without(tuple(_ZERO))

    def only(self, error: str) -> VirtualRig:
        """The rig with one of `ERRORS` alone. Raises ConfigError for a name that is none."""
        if error not in _ZERO:
            raise unknown_name("error of a rig", error, tuple(_ZERO))
        rig = self if error in ERRORS or self.tracker is not None else self.model_copy(update={"tracker": Tracker()})
        return rig._without(tuple(name for name in _ZERO if name != error))

    @classmethod
    def exact(cls, **settings: Any) -> VirtualRig:
        """A rig without an error, otherwise as set."""
        return cls(**settings).noise_free()

    def _without(self, errors: tuple[str, ...]) -> VirtualRig:
        values = self.model_dump()
        for error in errors:
            for path, zero in _ZERO[error].items():
                *owner, field = path.split(".")
                if owner and values[owner[0]] is None:
                    continue
                (values[owner[0]] if owner else values)[field] = zero
        return VirtualRig.model_validate(values)


# What each error is switched off by: fields of the rig, and the values that mean none.
_ZERO: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "sensor_noise": {"sensor_noise": False},
        "sensor_systematic": {"sensor_systematic": False},
        "optical_noise": {"optical_noise_m": 0.0},
        "optical_occlusion": {"optical_occlusion": False},
        "optical_swaps": {"optical_swaps": False},
        "clock_jitter": {f"{source}.jitter_s": 0.0 for source in (*SOURCES, "tracker")},
        "clock_resolution": {f"{source}.resolution_ns": 1 for source in (*SOURCES, "tracker")},
        **{name: {f"suit_errors.{name}": 0.0} for name in SuitErrors.model_fields},
        "tracker_noise": {"tracker.noise_m": 0.0, "tracker.noise_deg": 0.0},
        "tracker_wander": {"tracker.wander_m": 0.0, "tracker.wander_deg": 0.0},
    }
)
TRACKER_ERRORS = ("tracker_noise", "tracker_wander")
ERRORS = tuple(name for name in _ZERO if name not in TRACKER_ERRORS)  # of every rig
