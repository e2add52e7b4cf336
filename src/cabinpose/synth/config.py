"""The configuration of a generated dataset: plain data, checked before any work starts.

Angles are degrees and their names say so; everything else is SI. A file is YAML; relative paths in it are taken from
the folder of the file.
"""

from __future__ import annotations

import copy
import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from cabinpose.core.errors import ConfigError, unknown_name
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.body import SUBJECTS, Phenotype
from cabinpose.scene.cabin import PRESETS
from cabinpose.scene.sensor import SENSORS, NoiseModel, PhysicalNoise, Sensor, StructuredLightNoise, sensor_by_name
from cabinpose.synth.posture import ACTIONS
from cabinpose.synth.profiles import Profile

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Vector = tuple[float, float, float]
_RANDOM_CAR = re.compile(r"C\d{4,}")


class Model(BaseModel):
    """Base of all configuration: frozen, unknown keys refused, defaults checked as well."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


class Range(Model):
    """Bounds of a uniform draw."""

    min: float
    max: float

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        if self.min > self.max:
            raise ConfigError(f"min {self.min:g} is above max {self.max:g}", hint="swap the two")
        return self


class RandomPeople(Model):
    """A crowd of people drawn once for the dataset, named R0000, R0001, ..."""

    count: int = Field(100, ge=1, le=100_000)
    ranges: Mapping[str, Range] = Field(
        {}, description="Ranges of gender, age, muscle, weight, height, proportions (0..1) and stature_m, where not the defaults."
    )

    @field_validator("ranges")
    @classmethod
    def _known(cls, ranges: Mapping[str, Range]) -> Mapping[str, Range]:
        Phenotype.random({n: (r.min, r.max) for n, r in ranges.items()}, rng=frame_rng(0, 0))
        return ranges


class People(Model):
    """Who can take part."""

    subjects: tuple[str, ...] = Field(tuple(SUBJECTS), description="Named people of the package, S01 .. S18.")
    random: RandomPeople | None = Field(None, description="People drawn at random, beside the named ones.")
    driver_years: float = Field(17.0, ge=0.0, description="Age from which people drive, where anybody is as old; 0: anyone.")

    @model_validator(mode="after")
    def _known(self) -> People:
        for name in self.subjects:
            if name not in SUBJECTS:
                raise unknown_name("subject", name, list(SUBJECTS))
        if not self.subjects and self.random is None:
            raise ConfigError("nobody can take part", hint="name subjects, or ask for random people")
        return self


class CameraPose(Model):
    """A camera pose of the user's own, in the vehicle frame (room: world frame)."""

    position_m: Vector
    look_at_m: Vector
    roll_deg: float = 0.0


class Camera(Model):
    """Which sensor looks from where."""

    sensor: str | Sensor = Field(
        "pico_monstar_105/5",
        description="A preset (use case after a slash), or the mapping of an own sensor: see docs/sensor-model.md.",
    )
    views: Mapping[str, Probability | CameraPose] = Field(
        {"driver": 0.5, "front_row": 0.5},
        description="Weights of the cabin's views (driver, front_row, rear), or own poses by name (each of weight 1).",
    )
    jitter_m: float = Field(0.02, ge=0.0, le=0.5, description="The position moves by up to this along each of the camera's axes.")
    jitter_deg: float = Field(2.0, ge=0.0, le=45.0, description="The orientation turns by up to this about each of its axes.")
    supersample: int = Field(2, ge=1, le=4, description="Parts a side of a pixel that sees an edge (flying pixels need 2).")

    @field_validator("sensor")
    @classmethod
    def _known(cls, sensor: str | Sensor) -> str | Sensor:
        if isinstance(sensor, str):
            sensor_by_name(sensor)
        return sensor

    @field_validator("views")
    @classmethod
    def _some(cls, views: Mapping[str, float | CameraPose]) -> Mapping[str, float | CameraPose]:
        if not any(isinstance(v, CameraPose) or v > 0 for v in views.values()):
            raise ConfigError("no view has a weight above 0", hint="give at least one of driver, front_row, rear a weight")
        return views

    @property
    def sensor_model(self) -> Sensor:
        """The sensor itself, where `sensor` may only name it."""
        return self.sensor if isinstance(self.sensor, Sensor) else SENSORS[self.sensor]


class CabinScene(Model):
    """People in cars."""

    kind: Literal["cabin"] = "cabin"
    cars: tuple[str, ...] = Field(PRESETS, description="Presets, or paths to YAML files of own car meshes.")
    random_cars: int = Field(
        0, ge=0, le=10_000, description="Cars drawn at random for the dataset beside them: C0000, C0001, ..."
    )
    right_hand_drive: Probability = Field(0.15, description="Share of cars with the wheel on the right.")
    occupancy: Mapping[str, Probability] = Field(
        {"driver": 0.95, "front_passenger": 0.5, "rear_left": 0.15, "rear_center": 0.05, "rear_right": 0.15},
        description="How likely each seat is taken, where the car has it; at least one always is.",
    )
    motion: Mapping[str, Mapping[str, Probability]] = Field(
        {}, description="Weights of the actions by seat; left out: every action that makes sense there, equally."
    )
    profile: Profile | None = Field(None, description="A motion profile for everyone, in place of the actions' own.")
    seat_variation: float = Field(
        1.0, ge=0.0, le=3.0, description="How much people differ in setting their seat; 0: each seat as its person's body asks."
    )
    people_jitter_m: float = Field(
        0.015,
        ge=0.0,
        le=0.1,
        description="How far pelvises are ahead of their place (back 0.3, aside 0.6 of it): standard deviation, cut at twice it.",
    )
    people_jitter_deg: float = Field(
        3.0, ge=0.0, le=20.0, description="How far they are turned about the seat's vertical, and tilted by 0.3 of it: likewise."
    )
    belted: Probability = Field(0.9, description="Share of occupants who wear the seat belt.")

    @model_validator(mode="after")
    def _known(self) -> CabinScene:
        for car in self.cars:
            if car not in PRESETS and not is_car_file(car):
                raise unknown_name("car", car, [*PRESETS, "<path to a .yaml of your own mesh>"])
            if self.random_cars and _RANDOM_CAR.fullmatch(Path(car).stem):
                raise ConfigError(f"{Path(car).name} would be taken for a random car", hint="give the file another name")
        if not self.cars and not self.random_cars:
            raise ConfigError("there is no car", hint="name cars, or ask for random_cars")
        for slot in (*self.occupancy, *self.motion):
            if slot not in OCCUPANT_SLOTS:
                raise unknown_name("seat", slot, list(OCCUPANT_SLOTS))
        if not any(self.occupancy.values()):
            raise ConfigError("every seat's occupancy is 0", hint="give at least one seat a probability above 0")
        for weights in self.motion.values():
            for action in weights:
                if action not in ACTIONS:
                    raise unknown_name("action", action, list(ACTIONS))
            if not any(weights.values()):
                raise ConfigError("no action has a weight above 0", hint="give at least one action a weight")
        return self


class RoomScene(Model):
    """One person standing and moving freely in a room."""

    kind: Literal["room"] = "room"
    rooms: int = Field(64, ge=1, description="Different rooms, drawn once for the dataset.")
    facing_deg: float = Field(35.0, ge=0.0, description="Standard deviation of the person's turn away from the camera.")
    profile: Profile | None = Field(None, description="A motion profile in place of the free standing poses.")


class Output(Model):
    """What is written and how it is cut."""

    frames_per_part: int = Field(100, ge=1, le=1000)
    licence: str = Field("CC0-1.0", description="Licence of the generated data (SPDX identifier).")


class Limits(Model):
    """When the search for a valid scene ends."""

    poses_per_person: int = Field(8, ge=1, description="Poses tried for a person before the whole scene is drawn anew.")
    scenes_per_frame: int = Field(60, ge=1, description="Scenes drawn for a frame before the run ends with an error.")


class SynthConfig(Model):
    """Everything that a generated dataset depends on, beside its seed and number of frames."""

    version: Literal[1] = 1
    scene: Annotated[CabinScene | RoomScene, Field(discriminator="kind")] = CabinScene()
    people: People = People()
    camera: Camera = Camera()
    noise: NoiseModel = PhysicalNoise()
    output: Output = Output()
    limits: Limits = Limits()

    @model_validator(mode="after")
    def _noise_suits_the_sensor(self) -> SynthConfig:
        sensor = self.camera.sensor_model
        if isinstance(self.noise, PhysicalNoise) and sensor.principle != "time_of_flight":
            raise ConfigError(
                f"noise 'physical' describes Time-of-Flight, sensor '{sensor.name}' is none",
                hint="choose noise kind structured_light or empirical",
            )
        return self

    @classmethod
    def load(cls, path: Path | None, overrides: Sequence[str] = ()) -> SynthConfig:
        """Read and check a YAML file (None: all defaults); ConfigError names the key, the reason and the remedy.

        overrides: "KEY=VALUE", such as "scene.cars=[suv]", in place of what the file says; the value is YAML.
        """
        data: Any = {}
        if path is not None:
            try:
                text = path.read_text(encoding="utf-8")
            except OSError as error:
                raise ConfigError(
                    f"cannot read {path}: {error.strerror}", hint="`cabinpose config init` writes a first one"
                ) from error
            try:
                data = yaml.safe_load(text) or {}
            except yaml.YAMLError as error:
                raise ConfigError(
                    f"{path} is not YAML: {error}", hint="`cabinpose config init` writes a file to start from"
                ) from error
            if isinstance(data, dict):
                data = _with_paths(data, path.parent)
        return cls.parse(_overridden(data, overrides))

    @classmethod
    def parse(cls, data: Any, *, base: Path = Path()) -> SynthConfig:
        """Check plain data; relative paths of car meshes and recordings are resolved against `base`.

        A scene without a `kind` is a cabin, noise without one is physical.
        """
        if not isinstance(data, dict):
            raise ConfigError("a configuration is a mapping of keys to values", hint="`cabinpose config schema` lists the keys")
        kinds = {"scene": "cabin", "noise": "physical"}
        data = {key: {"kind": kinds[key]} | v if key in kinds and isinstance(v, dict) else v for key, v in data.items()}
        try:
            return cls.model_validate(_with_paths(data, base))
        except ValidationError as error:
            raise explain(error, cls) from error


def is_car_file(car: str) -> bool:
    """Whether a car of the configuration is a user's own mesh."""
    return car.endswith((".yaml", ".yml"))


def room_preset() -> SynthConfig:
    """One person standing in a room before a Kinect-class camera, in ITOP's geometry: adults, as its subjects are."""
    adults = {"age": Range(min=0.45, max=0.85), "stature_m": Range(min=1.6, max=1.95)}
    return SynthConfig(
        scene=RoomScene(),
        people=People(subjects=(), random=RandomPeople(count=300, ranges=adults)),
        camera=Camera(sensor="kinect_v1", views={"room": 1.0}, jitter_m=0.0, jitter_deg=0.0),
        noise=StructuredLightNoise(fill_px=5),
    )


def _overridden(data: Any, overrides: Sequence[str]) -> Any:
    """A copy of plain data with "KEY=VALUE" put in; keys of keys are parted by dots.

    Of a mapping by name that the data lack, such as `scene.occupancy`, the other names keep their defaults.
    """
    result = copy.deepcopy(data)
    defaults = {"occupancy": CabinScene().occupancy, "views": Camera().views}
    for override in overrides:
        keys, equals, text = override.partition("=")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError:
            equals = ""
        if not equals or not all(keys.split(".")):
            raise ConfigError(f"'{override}' says nothing of the configuration", hint="write KEY=VALUE, such as scene.cars=[suv]")
        *path, last = keys.split(".")
        at = result
        for depth, key in enumerate(path):
            at = at.setdefault(key, dict(defaults.get(key, {}))) if isinstance(at, dict) else None
            if not isinstance(at, dict):
                where = ".".join(path[: depth + 1])
                raise ConfigError(f"'{override}': {where} has no keys", hint="`cabinpose config schema` lists the keys")
        at[last] = value
    return result


def _with_paths(data: dict[str, Any], base: Path) -> dict[str, Any]:
    """A copy in which the paths of own cars and recordings are absolute."""
    scene = data.get("scene")
    if not isinstance(scene, dict):
        return data
    scene = dict(scene)
    if isinstance(scene.get("cars"), list):
        scene["cars"] = [str((base / c).resolve()) if isinstance(c, str) and is_car_file(c) else c for c in scene["cars"]]
    profile = scene.get("profile")
    if isinstance(profile, dict) and isinstance(profile.get("path"), str):
        scene["profile"] = {**profile, "path": str((base / profile["path"]).resolve())}
    return {**data, "scene": scene}


def explain(error: ValidationError, model: type[BaseModel]) -> ConfigError:
    """One `ConfigError` of pydantic's findings: every path with its reason, and close matches of unknown keys."""
    lines, hint = [], None
    for finding in error.errors():
        where = ".".join(str(p) for p in finding["loc"]) or "configuration"
        if finding["type"] == "extra_forbidden":
            key = str(finding["loc"][-1])
            close = difflib.get_close_matches(key, sorted(_keys(model)), n=3)
            lines.append(f"{where}: unknown key")
            hint = hint or (f"did you mean {' or '.join(close)}?" if close else "`cabinpose config schema` lists the keys")
        else:
            lines.append(f"{where}: {finding['msg'][0].lower()}{finding['msg'][1:]}, not {finding['input']!r}")
    return ConfigError("; ".join(lines), hint=hint or "`cabinpose config schema` lists what each key takes")


def _keys(model: type[BaseModel]) -> set[str]:
    """The names of all fields of a model and of the models within."""
    schema = model.model_json_schema()
    keys = set(schema.get("properties", {}))
    for definition in schema.get("$defs", {}).values():
        keys |= set(definition.get("properties", {}))
    return keys


def frame_rng(seed: int, frame_index: int) -> np.random.Generator:
    """The generator of one frame: the same numbers whatever made the frame, and when."""
    return np.random.Generator(np.random.Philox(key=np.array((seed, frame_index), dtype=np.uint64)))
