"""What a person's shape is made of: six numbers from 0 to 1 and a stature, and ways to draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from cabinpose.core import ConfigError, unknown_name
from cabinpose.scene.body.populations import STATURE_LIMITS_M, Anthropometry, load_population
from cabinpose.scene.body.proportions import Sex

# Drawn from these unless the user says otherwise: people as they are met, not the corners of the shape space.
DEFAULT_RANGES = MappingProxyType(
    {
        "gender": (0.0, 1.0), "age": (0.3, 1.0), "muscle": (0.1, 0.7), "weight": (0.35, 1.0), "height": (0.38, 0.48),
        "proportions": (0.0, 0.6),
    }
)  # fmt: skip
# Mean and standard deviation of adults' stature (m), men and women, and what is left of it at eighty years: Fryar et al. 2021
# (NHANES 2015-2018), Vital and Health Statistics 3-46. Who is younger than 20 has that of the growth charts (CDC 2000).
_STATURE_M, _OF_OLD = ((1.754, 0.075), (1.615, 0.071)), 0.97
_GROWN_YEARS, _ADULT_YEARS = 20.0, 25.0
_AGES, _YEARS = (-1.0, -0.7, 0.0, 0.5, 1.0), (0.0, 3.0, 10.0, 25.0, 80.0)  # what `age` stands for
YEARS_LIMITS = (_YEARS[0], _YEARS[-1])
SEATED_YEARS = 3.0  # who is younger lies in a carrier, is harnessed, or has no seat: a crowd is not
CHILD_YEARS = 12.0  # who is younger is a child

_GENDER_SPREAD = 0.15  # of men from 0, of women from 1
# The data's young girls have a woman's hips: girls have a boy's until puberty. And its `age` is linear from a child of ten to 25
# years, whereas people of 16 are built as adults: those of a size follow their growth (CDC 2000: 0.7 of the way at 14 years).
_PUBERTY, _GIRL = (9.0, 16.0), 0.3
_MATURING_YEARS = (0.0, 3.0, 10.0, 12.0, 14.0, 16.0, 18.0, 25.0, 80.0)
_MATURING_AGES = (-1.0, -0.7, 0.0, 0.2, 0.36, 0.45, 0.48, 0.5, 1.0)
# Muscle where fat leaves room for it; proportions, of children uncommon, which have the narrower shoulders.
_CHILDS_MUSCLE, _MUSCLE, _PROPORTIONS = 0.1, {"male": (0.2, 0.55), "female": (0.15, 0.45)}, 0.6


def age_of(years: float) -> float:
    """The body data's `age` of somebody of 0 to 80 years; below 0 under ten."""
    return float(np.interp(years, _YEARS, _AGES))


def usual_stature_m(gender: float, age: float) -> tuple[float, float]:
    """Mean and standard deviation (m) of the stature of people of this gender and age (as `Phenotype` has them)."""
    years = float(np.interp(age, _AGES, _YEARS))
    both = np.array([_usual_stature_m("male", years), _usual_stature_m("female", years)])
    mean, sd = (both[0] + gender * (both[1] - both[0])).tolist()
    return mean, sd


def _usual_stature_m(sex: Sex, years: float) -> tuple[float, float]:
    adult = np.array(_STATURE_M[sex == "female"])
    grown = np.array(load_population("cdc").stature_m(sex, min(years, _GROWN_YEARS)))
    share = min(max((years - _GROWN_YEARS) / (_ADULT_YEARS - _GROWN_YEARS), 0.0), 1.0)
    old = 1.0 - (1.0 - _OF_OLD) * max(years - _ADULT_YEARS, 0.0) / (_YEARS[-1] - _ADULT_YEARS)
    mean, sd = (((1.0 - share) * grown + share * adult) * old).tolist()
    return mean, sd


@dataclass(frozen=True)
class Phenotype:
    """Shape parameters, each from 0 to 1 (Anny's, after MakeHuman's macro details), and a stature.

    gender: 0 male, 1 female · age: -1 newborn, -0.9 a year, -0.7 three years, 0 child of ten, 0.5 young adult, 1 old ·
    muscle and weight: 0.5 average · height: of the other five's body, mostly in its legs · proportions: 0 ideal, 1 uncommon ·
    stature_m: the body is scaled evenly to it; None leaves it as the six make it (1.91 m for the average man, 1.77 m for the
    woman) · asymmetry: number of the pattern by which the sides differ, 0 where they do not · size: the stature, mass and
    dimensions that the body is made to, in place of `weight` (and of `muscle`, where much fat needs less of it) · face: number
    of the face, 0 the data's own. Raises ConfigError outside.
    """

    gender: float = 0.5
    age: float = 0.5
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5
    stature_m: float | None = None
    asymmetry: int = 0
    size: Anthropometry | None = None
    face: int = 0

    def __post_init__(self) -> None:
        for name in DEFAULT_RANGES:
            value = getattr(self, name)
            least = _AGES[0] if name == "age" else 0.0
            if not least <= value <= 1.0:
                raise ConfigError(f"phenotype {name} is {value}", hint=f"it lies between {least:g} and 1")
        if self.face < 0:
            raise ConfigError(f"phenotype face is {self.face}", hint="it is 0 or a positive whole number")
        low, high = STATURE_LIMITS_M
        if self.stature_m is not None and not low <= self.stature_m <= high:
            raise ConfigError(f"a stature of {self.stature_m} m", hint=f"statures from {low} to {high} m")

    @property
    def years(self) -> float:
        """The age in years: that of the size, or else what the body looks like."""
        return float(np.interp(self.age, _AGES, _YEARS)) if self.size is None else self.size.years

    @classmethod
    def of_size(cls, size: Anthropometry, *, rng: np.random.Generator | None) -> Phenotype:
        """The phenotype of somebody of a size: a clear man or woman of common build, drawn by `rng` or in the middle for None."""
        u = np.full(3, 0.5) if rng is None else rng.random(3)
        grown = float(np.interp(size.years, _PUBERTY, (0.0, 1.0)))
        gender = _GIRL + grown * (1.0 - _GIRL) if size.sex == "female" else 0.0
        low, high = (_CHILDS_MUSCLE + grown * (value - _CHILDS_MUSCLE) for value in _MUSCLE[size.sex])
        return cls(
            gender=abs(gender - _GENDER_SPREAD * float(u[0])),
            age=float(np.interp(size.years, _MATURING_YEARS, _MATURING_AGES)),
            muscle=low + float(u[1]) * (high - low),
            height=0.45,
            proportions=_PROPORTIONS * (1.0 - grown * float(u[2])),
            stature_m=size.stature_m,
            size=size,
        )

    @classmethod
    def random(cls, ranges: Mapping[str, tuple[float, float]] | None = None, *, rng: np.random.Generator) -> Phenotype:
        """Parameters drawn evenly from `ranges` (name -> (least, greatest)), from `DEFAULT_RANGES` where none is given.

        `years` (3 to 80) may stand for `age`, `stature_cm` for `stature_m`.

        The stature is normally distributed around the mean of the gender and age within 2.5 standard deviations, unless
        `ranges` has `stature_m`. Eight numbers are drawn whatever the ranges. Raises ConfigError for unknown names, for
        ranges that are turned round and for those outside the limits.
        """
        names = (*DEFAULT_RANGES, "stature_m")
        chosen = dict(DEFAULT_RANGES)
        for given, (low, high) in (ranges or {}).items():
            name = {"years": "age", "stature_cm": "stature_m"}.get(given, given)
            if name not in names:
                raise unknown_name("phenotype parameter", name, ("years", "stature_cm", *names))
            metres = STATURE_LIMITS_M
            limits = {
                "stature_m": metres, "stature_cm": (100.0 * metres[0], 100.0 * metres[1]),
                "years": (SEATED_YEARS, YEARS_LIMITS[1]), "age": (age_of(SEATED_YEARS), 1.0),
            }  # fmt: skip
            least, greatest = limits.get(given, (0.0, 1.0))
            if not least <= low <= high <= greatest:
                raise ConfigError(
                    f"range of phenotype {given} is ({low}, {high})",
                    hint=f"give {least:g} <= least <= greatest <= {greatest:g}"
                    + (", or `years`" if given == "age" and high > 1.0 else ""),
                )
            if given == "years":
                low, high = age_of(low), age_of(high)
            elif given == "stature_cm":
                low, high = low / 100.0, high / 100.0
            chosen[name] = (low, high)
        u, normal = rng.random(7), rng.standard_normal()
        drawn = {name: low + x * (high - low) for x, (name, (low, high)) in zip(u[:6], list(chosen.items())[:6], strict=True)}
        if "stature_m" in chosen:
            low, high = chosen["stature_m"]
            stature = low + u[6] * (high - low)
        else:
            mean, sd = usual_stature_m(drawn["gender"], drawn["age"])
            stature = mean + sd * float(np.clip(normal, -2.5, 2.5))
        return cls(**drawn, stature_m=float(np.clip(stature, *STATURE_LIMITS_M)))
