"""The cars of a configuration: presets, presets with dimensions changed, the user's own meshes, random ones by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Discriminator, Field, Tag, field_validator, model_serializer, model_validator

from cabinpose.core import ConfigError, unknown_name
from cabinpose.scene.cabin import PRESET_DIMENSIONS, PRESETS, CabinDimensions, DimensionFields

_RANDOM_CAR = re.compile(r"C\d{4,}")
_OF_THE_PRESET = "layout"  # what cannot be changed: no other dimension fits both


def is_car_file(car: str) -> bool:
    """Whether a car of the configuration is a user's own mesh."""
    return car.endswith((".yaml", ".yml"))


def is_random_car(car: str) -> bool:
    """Whether a car is drawn from the dataset's seed."""
    return _RANDOM_CAR.fullmatch(car) is not None


def _as_changes(schema: dict[str, Any]) -> None:
    """Without defaults: what is left out is the preset's."""
    found = schema["properties"]
    del found[_OF_THE_PRESET]
    for each in found.values():
        each.pop("default", None)
    schema["properties"] = {"preset": found.pop("preset"), "name": found.pop("name"), **found}


class ChangedPreset(DimensionFields):
    """A preset some of whose dimensions are changed; what is left out is as in the preset."""

    model_config = ConfigDict(json_schema_extra=_as_changes, allow_inf_nan=False)

    preset: str = Field(description=f"The preset it starts from: {', '.join(PRESETS)}.")
    name: str = Field(min_length=1, description="Name that the dataset records.")

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        if _OF_THE_PRESET in data:
            raise ConfigError(f"the {_OF_THE_PRESET} of a preset stays as it is", hint="start from a preset that has it")
        base = PRESET_DIMENSIONS.get(str(data.get("preset")))
        return data if base is None else base.model_dump(exclude={"name"}) | data

    @field_validator("preset")
    @classmethod
    def _known(cls, preset: str) -> str:
        if preset not in PRESETS:
            raise unknown_name("cabin preset", preset, PRESETS)
        return preset

    @field_validator("name")
    @classmethod
    def _own_name(cls, name: str) -> str:
        if name in PRESETS or is_random_car(name) or is_car_file(name):
            raise ConfigError(f"'{name}' is the name of another car", hint="give a changed preset a name of its own")
        return name

    @model_serializer
    def _changes(self) -> dict[str, Any]:
        """The keys that were changed: a preset's own are as this version has them."""
        base = PRESET_DIMENSIONS[self.preset]
        own = {key: value for key, value in self.dimensions if key != "name" and value != getattr(base, key)}
        return {"preset": self.preset, "name": self.name, **own}

    @property
    def dimensions(self) -> CabinDimensions:
        """All dimensions of the car."""
        return CabinDimensions(**{key: getattr(self, key) for key in CabinDimensions.model_fields})


def _kind(car: Any) -> str:
    return "dimensions" if isinstance(car, (dict, ChangedPreset)) else "name"


Car = Annotated[Annotated[str, Tag("name")] | Annotated[ChangedPreset, Tag("dimensions")], Discriminator(_kind)]


def place_name(car: str | ChangedPreset) -> str:
    """What a car is called in a dataset: the stem of an own mesh's file, the name of a changed preset."""
    if isinstance(car, ChangedPreset):
        return car.name
    return Path(car).stem if is_car_file(car) else car


def check_cars(cars: tuple[str | ChangedPreset, ...], random_cars: int) -> None:
    """Raises ConfigError for cars that are not known, or are called as another one."""
    some_random = random_cars or any(isinstance(car, str) and is_random_car(car) for car in cars)
    named = {place_name(car): car for car in cars if isinstance(car, ChangedPreset)}
    for car in cars:
        if named.get(place_name(car), car) != car:
            raise ConfigError(f"two cars are called '{place_name(car)}'", hint="give each a name of its own")
        if isinstance(car, ChangedPreset):
            continue
        if car not in PRESETS and not is_car_file(car) and not is_random_car(car):
            raise unknown_name("car", car, [*PRESETS, "<path to a .yaml of your own mesh>"])
        if some_random and is_car_file(car) and is_random_car(Path(car).stem):
            raise ConfigError(f"{Path(car).name} would be taken for a random car", hint="give the file another name")
    if not cars and not random_cars:
        raise ConfigError("there is no car", hint="name cars, or ask for random_cars")
