"""The keys of a configuration that say which sensor looks from where."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from cabinpose.core import ConfigError, unknown_name
from cabinpose.scene.sensor import SENSORS, Sensor, sensor_by_name
from cabinpose.synth.occupant import Matrix4
from cabinpose.synth.people import Model, Probability

Vector = tuple[float, float, float]


_FARTHEST_M, _FARTHEST_CM = 20.0, 250.0  # from the origin of a car or a room; in centimetres a place in a car is within 2.5 m


def _in_metres(place: Vector, whose: str) -> Vector:
    """The place itself; ConfigError where it can only be in millimetres or centimetres. whose: what the message calls it."""
    farthest = max(map(abs, place))
    if farthest <= _FARTHEST_M:
        return place
    unit, factor = ("millimetres", 1e-3) if farthest > _FARTHEST_CM else ("centimetres", 1e-2)
    metres = ", ".join(f"{factor * x:.6g}" for x in place)
    raise ConfigError(
        f"{whose}: [{', '.join(f'{x:g}' for x in place)}] is {farthest:g} m away, so probably in {unit}",
        hint=f"places are metres: [{metres}]",
    )


class CameraPose(Model):
    """A camera pose of the user's own, in the vehicle frame (room: world frame)."""

    position_m: Vector
    look_at_m: Vector
    roll_deg: float = 0.0

    @field_validator("position_m", "look_at_m")
    @classmethod
    def _in_metres(cls, place: Vector, info: ValidationInfo) -> Vector:
        return _in_metres(place, str(info.field_name))


class ExactCameraPose(Model):
    """A camera pose as `cabinpose config frame` writes it, to the last bit."""

    vehicle_from_camera: Matrix4

    @field_validator("vehicle_from_camera")
    @classmethod
    def _in_metres(cls, matrix: Matrix4) -> Matrix4:
        _in_metres((matrix[0][3], matrix[1][3], matrix[2][3]), "the last column of vehicle_from_camera")
        return matrix

    @property
    def position_m(self) -> Vector:
        """Where the lens is."""
        return tuple(row[3] for row in self.vehicle_from_camera[:3])  # type: ignore[return-value]


_SENSOR = "pico_monstar_105/5"


class Camera(Model):
    """Which sensor looks from where."""

    sensor: str | Sensor = Field(
        _SENSOR,
        description="A preset (use case after a slash), one with fields changed ({preset: evk75123, fps: 15}), or the mapping of"
        " an own sensor: see docs/sensor-model.md.",
    )
    views: Mapping[str, Probability | CameraPose | ExactCameraPose] = Field(
        {"driver": 0.5, "front_row": 0.5},
        description="Weights of the views (in a car driver, front_row, rear, and mirror, roof_console, cluster, a_pillar,"
        " display, where cameras of products sit; in a room room, room_top), or in a car own poses by name (each of weight 1).",
    )
    jitter_m: float = Field(0.02, ge=0.0, le=0.5, description="In a car the position moves by up to this along each camera axis.")
    jitter_deg: float = Field(2.0, ge=0.0, le=45.0, description="In a car the orientation turns by up to this about each axis.")
    supersample: int = Field(2, ge=1, le=4, description="Parts a side of a pixel that sees an edge (flying pixels need 2).")

    @field_validator("sensor", mode="before")
    @classmethod
    def _changed(cls, sensor: Any) -> Any:
        if not isinstance(sensor, dict) or "preset" not in sensor:
            return sensor
        for field in sensor.keys() - {"preset"} - Sensor.model_fields.keys():
            raise unknown_name("field of a sensor", field, list(Sensor.model_fields))
        changes = {field: value for field, value in sensor.items() if field != "preset"}
        preset = sensor_by_name(str(sensor["preset"])).model_dump(exclude={"field_radius_px"} if "camera" in changes else None)
        return preset | changes  # an image circle is of one lens

    @field_validator("sensor")
    @classmethod
    def _known(cls, sensor: str | Sensor) -> str | Sensor:
        if isinstance(sensor, str) and sensor != _SENSOR:  # whose look-up would take 5 % of the time to import this
            sensor_by_name(sensor)
        return sensor

    @field_validator("views")
    @classmethod
    def _some(cls, views: Mapping[str, Any]) -> Mapping[str, Any]:
        if not any(not isinstance(v, float) or v > 0 for v in views.values()):
            raise ConfigError("no view has a weight above 0", hint="give at least one of driver, front_row, rear a weight")
        return views

    @property
    def weights(self) -> Mapping[str, float]:
        """The views that are taken, with their weights; own ones have 1."""
        weights = {name: view if isinstance(view, float) else 1.0 for name, view in self.views.items()}
        return {name: weight for name, weight in weights.items() if weight > 0.0}

    @property
    def sensor_model(self) -> Sensor:
        """The sensor itself, where `sensor` may only name it."""
        return self.sensor if isinstance(self.sensor, Sensor) else SENSORS[self.sensor]

    @property
    def taken(self) -> str:
        """The fields of an own sensor that were not given, with what is taken for them, in words; empty where there are none."""
        given = self.sensor.assumed if isinstance(self.sensor, Sensor) else {}
        return ", ".join(f"{name} {' '.join(f'{x:g}' for x in np.atleast_1d(value))}" for name, value in given.items())
