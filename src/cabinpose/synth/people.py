"""The people of a configuration: named ones of the package, the user's own, and a crowd drawn at random."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from cabinpose.core import ConfigError, unknown_name
from cabinpose.scene.body import (
    DEFAULT_RANGES,
    SEATED_YEARS,
    STATURE_LIMITS_M,
    SUBJECTS,
    YEARS_LIMITS,
    Outfit,
    Phenotype,
    Population,
    load_population,
)
from cabinpose.synth.streams import frame_rng

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
_SUBJECTS = tuple(f"S{number:02d}" for number in range(1, 19))  # of a configuration that names none
_RANDOM_PERSON = re.compile(r"R\d{4,}")
MOST_OUTFITS = 8  # of a person
EVENLY = "evenly"  # in place of a population: parameters of shape, each by itself
_USUAL_POPULATION, _ADULT_YEARS = "nhanes", 18.0
_OF_SIZE = ("years", "stature_cm", "mass_kg", "gender")
CHILD_NAME = re.compile(r"([IKT])(0\d|1\d|2[0-3])")  # infants in carriers, children of 3 to 11 years, toddlers


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
    population: str | None = Field(
        None,
        exclude_if=lambda population: population is None,
        description="Whom they are drawn from: nhanes (American civilians), ansur (soldiers), cdc (American children), the path"
        " of a CSV of your own, or evenly. Left out: nhanes, or evenly where `ranges` names parameters of shape.",
    )
    ranges: Mapping[str, Range] = Field(
        {},
        description="Of a population: ranges of years, stature_cm, mass_kg, gender (0 male, 1 female). Evenly: of years,"
        " stature_cm, gender, muscle, weight, height, proportions (0..1), where not the defaults.",
    )

    @model_validator(mode="after")
    def _known(self) -> RandomPeople:
        self.draw(rng=frame_rng(0, 0))
        return self

    @property
    def drawn_from(self) -> Population | None:
        """The population; None where parameters are drawn evenly."""
        name = self.population or (EVENLY if set(self.ranges) - set(_OF_SIZE) else _USUAL_POPULATION)
        return None if name == EVENLY else load_population(name)

    @property
    def _years(self) -> tuple[float, float]:
        """Of a population: those asked for, or adults where it has any."""
        population = self.drawn_from
        first, last = population.years() if population else YEARS_LIMITS
        first = max(first, SEATED_YEARS)
        if "years" in self.ranges:
            return self.ranges["years"].min, self.ranges["years"].max
        return (max(first, _ADULT_YEARS) if last > _ADULT_YEARS + 2.0 else first), last

    def draw(self, *, rng: np.random.Generator) -> Phenotype:
        """Somebody of the crowd. Raises ConfigError where nobody can be drawn."""
        population, ranges = self.drawn_from, {name: (r.min, r.max) for name, r in self.ranges.items()}
        if population is None:
            return Phenotype.random(ranges, rng=rng)
        if others := sorted(set(ranges) - set(_OF_SIZE)):
            raise ConfigError(
                f"ranges of {', '.join(others)} have no place beside population {population.name}",
                hint=f"give {', '.join(_OF_SIZE)}, or population: {EVENLY}",
            )
        Phenotype.random({n: r for n, r in ranges.items() if n != "mass_kg"}, rng=frame_rng(0, 0))  # the ranges' limits
        size = population.draw(
            rng=rng,
            sex=self._sex,
            years=self._years,
            stature_m=_scaled(ranges.get("stature_cm"), 0.01),
            mass_kg=ranges.get("mass_kg"),
        )
        return Phenotype.of_size(size, rng=rng)

    @property
    def _sex(self) -> Literal["male", "female"] | None:
        """Of a population: the one whose gender alone is in the range."""
        gender = self.ranges.get("gender")
        if gender is None or gender.min < 0.5 <= gender.max:
            return None
        return "male" if gender.max < 0.5 else "female"

    @property
    def youngest_years(self) -> float:
        """The least age that is drawn."""
        if self.drawn_from is not None or "years" in self.ranges:
            return self._years[0]
        age = self.ranges["age"].min if "age" in self.ranges else DEFAULT_RANGES["age"][0]
        return Phenotype(age=age).years


def _scaled(limits: tuple[float, float] | None, factor: float) -> tuple[float, float] | None:
    return None if limits is None else (limits[0] * factor, limits[1] * factor)


class OwnPerson(Model):
    """Somebody of the user's own, in years, centimetres and kilograms."""

    gender: Literal["female", "male"] | Probability = Field(0.5, description="female, male, or from 0 (male) to 1 (female).")
    years: float = Field(35.0, ge=YEARS_LIMITS[0], le=YEARS_LIMITS[1], description="From birth, 0, to 80.")
    stature_cm: float | None = Field(
        None, ge=100.0 * STATURE_LIMITS_M[0], le=100.0 * STATURE_LIMITS_M[1], description="Left out: the mean of gender and age."
    )
    mass_kg: float | None = Field(None, gt=0.0, description="Of the bare body; left out: as `weight` makes it.")
    weight: Probability | None = Field(None, description="In place of mass_kg, from thin to heavy; 0.65 where both are left out.")
    muscle: Probability | None = Field(None, description="Left out: 0.3, or as much less as the mass needs.")
    height: Probability = Field(0.45, description="How much of the stature the legs are; 0.38 to 0.48 are common.")
    proportions: Probability = Field(0.3, description="From ideal to uncommon.")
    outfit: Outfit | Annotated[tuple[Outfit, ...], Field(title="several outfits", min_length=1, max_length=MOST_OUTFITS)] = Field(
        Outfit(),
        description="top, bottom, shoes, hair, beard, headwear, glasses, scarf, gloves, mask, fit, folds; or a list, of"
        " which a frame or sequence shows one.",
    )

    @field_validator("outfit", mode="before")
    @classmethod
    def _of_today(cls, given: Any) -> Any:
        return [_outfit_of_today(each) for each in given] if isinstance(given, (list, tuple)) else _outfit_of_today(given)

    @property
    def outfits(self) -> tuple[Outfit, ...]:
        """All of them."""
        several = self.outfit if isinstance(self.outfit, tuple) else (self.outfit,)
        return tuple(replace(each, number=number) for number, each in enumerate(several))

    @model_validator(mode="after")
    def _one_weight(self) -> OwnPerson:
        if self.mass_kg is not None and self.weight is not None:
            raise ConfigError("mass_kg and weight say the same of a person", hint="give one of the two")
        return self


def _outfit_of_today(given: Any) -> Any:
    """An outfit of a configuration; of one written before there was `headwear`, where `cap` and `glasses` were true or false."""
    if not isinstance(given, Mapping):
        return given
    outfit = dict(given)
    if outfit.pop("number", 0) != 0:
        raise ConfigError(
            "outfits have no key number", hint="leave it out: they are numbered by their places in the list, from 0"
        )
    if isinstance(outfit.get("cap"), bool) and outfit.pop("cap") and outfit.setdefault("headwear", "cap") != "cap":
        raise ConfigError(f"headwear is {outfit['headwear']} and cap is true", hint="leave out cap, or give headwear: cap")
    if isinstance(outfit.get("glasses"), bool):
        outfit["glasses"] = "clear" if outfit["glasses"] else "none"
    return outfit


class People(Model):
    """Who can take part."""

    subjects: tuple[str, ...] = Field(
        _SUBJECTS, description="Named people of the package, S01 .. S18, or of a percentile: nhanes_male_p50, cdc_female_6y_p5."
    )
    own: Mapping[str, OwnPerson] = Field({}, description="People of your own by name, beside them.")
    random: RandomPeople | None = Field(None, description="People drawn at random, beside the named ones.")
    outfits: int = Field(
        3, ge=1, le=MOST_OUTFITS, description="How many outfits each named or random person has; a frame or sequence shows one."
    )
    asymmetric: bool = Field(False, description="Whether the left and right sides of bodies differ, of each in its own way.")
    driver_years: float = Field(17.0, ge=0.0, description="Age from which people drive, where anybody is as old; 0: anyone.")

    @model_validator(mode="after")
    def _known(self) -> People:
        for name in self.subjects:
            if name not in SUBJECTS:
                hint = "people of your own take part without being named here" if name in self.own else None
                raise ConfigError(
                    str(unknown_name("subject", name, ())),
                    hint=hint or f"known: {', '.join(SUBJECTS)}, and percentiles as nhanes_male_p50",
                )
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
