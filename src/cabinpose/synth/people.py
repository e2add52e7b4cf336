"""The people of a configuration: named ones of the package, the user's own, and a crowd drawn at random."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from cabinpose.core import ConfigError, unknown_name
from cabinpose.scene.body import DEFAULT_RANGES, STATURE_LIMITS_M, SUBJECTS, YEARS_LIMITS, Outfit, Phenotype
from cabinpose.synth.streams import frame_rng

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
_SUBJECTS = tuple(f"S{number:02d}" for number in range(1, 19))  # of a configuration that names none
_RANDOM_PERSON = re.compile(r"R\d{4,}")
CHILD_NAME = re.compile(r"K(0\d|1\d|2[0-3])")  # who sits in child seats


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
        {}, description="Ranges of years, stature_cm, gender, muscle, weight, height, proportions (0..1), where not the defaults."
    )

    @field_validator("ranges")
    @classmethod
    def _known(cls, ranges: Mapping[str, Range]) -> Mapping[str, Range]:
        Phenotype.random({n: (r.min, r.max) for n, r in ranges.items()}, rng=frame_rng(0, 0))
        return ranges

    @property
    def youngest_years(self) -> float:
        """The least age that is drawn."""
        if "years" in self.ranges:
            return self.ranges["years"].min
        age = self.ranges["age"].min if "age" in self.ranges else DEFAULT_RANGES["age"][0]
        return Phenotype(age=age).years


class OwnPerson(Model):
    """Somebody of the user's own, in years, centimetres and kilograms."""

    gender: Literal["female", "male"] | Probability = Field(0.5, description="female, male, or from 0 (male) to 1 (female).")
    years: float = Field(35.0, ge=YEARS_LIMITS[0], le=YEARS_LIMITS[1])
    stature_cm: float | None = Field(
        None, ge=100.0 * STATURE_LIMITS_M[0], le=100.0 * STATURE_LIMITS_M[1], description="Left out: the mean of gender and age."
    )
    mass_kg: float | None = Field(None, gt=0.0, description="Of the bare body; left out: as `weight` makes it.")
    weight: Probability | None = Field(None, description="In place of mass_kg, from thin to heavy; 0.65 where both are left out.")
    muscle: Probability | None = Field(None, description="Left out: 0.3, or as much less as the mass needs.")
    height: Probability = Field(0.45, description="How much of the stature the legs are; 0.38 to 0.48 are common.")
    proportions: Probability = Field(0.3, description="From ideal to uncommon.")
    outfit: Outfit = Field(Outfit(), description="top, bottom, shoes, hair, beard, cap, glasses, fit, folds.")

    @model_validator(mode="after")
    def _one_weight(self) -> OwnPerson:
        if self.mass_kg is not None and self.weight is not None:
            raise ConfigError("mass_kg and weight say the same of a person", hint="give one of the two")
        return self


class People(Model):
    """Who can take part."""

    subjects: tuple[str, ...] = Field(_SUBJECTS, description="Named people of the package, S01 .. S18.")
    own: Mapping[str, OwnPerson] = Field({}, description="People of your own by name, beside them.")
    random: RandomPeople | None = Field(None, description="People drawn at random, beside the named ones.")
    asymmetric: bool = Field(False, description="Whether the left and right sides of bodies differ, of each in its own way.")
    driver_years: float = Field(17.0, ge=0.0, description="Age from which people drive, where anybody is as old; 0: anyone.")

    @model_validator(mode="after")
    def _known(self) -> People:
        for name in self.subjects:
            if name not in SUBJECTS:
                hint = "people of your own take part without being named here" if name in self.own else None
                raise ConfigError(str(unknown_name("subject", name, ())), hint=hint or f"known: {', '.join(SUBJECTS)}")
        for name in self.own:
            if name in SUBJECTS or _RANDOM_PERSON.fullmatch(name) or CHILD_NAME.fullmatch(name) or not name:
                raise ConfigError(f"'{name}' is the name of somebody else", hint="give a person of your own another name")
        if not self.names:
            raise ConfigError("nobody can take part", hint="name subjects, describe own people, or ask for random ones")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Everybody who can take part, named people first."""
        return (*self.subjects, *self.own, *(f"R{i:04d}" for i in range(self.random.count if self.random else 0)))

    def knows(self, name: str) -> bool:
        """Whether there is somebody of this name, whom `subjects` need not list."""
        drawn = self.random is not None and _RANDOM_PERSON.fullmatch(name) and int(name[1:]) < self.random.count
        return name in SUBJECTS or name in self.own or bool(drawn or CHILD_NAME.fullmatch(name))
