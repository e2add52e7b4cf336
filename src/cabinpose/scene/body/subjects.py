"""Eighteen named people of different sizes, ages and clothes, and one for every percentile of the packaged populations."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from types import MappingProxyType
from typing import NamedTuple, cast

from cabinpose.scene.body.outfit import Outfit
from cabinpose.scene.body.phenotype import Phenotype
from cabinpose.scene.body.populations import POPULATIONS, load_population
from cabinpose.scene.body.proportions import Sex


class Subject(NamedTuple):
    """A named person."""

    phenotype: Phenotype
    outfit: Outfit


# gender, age, muscle, weight, height, proportions, stature (m). S01 and S02 are the average man and woman, S03 the small
# woman (5th percentile), S04 the tall man (95th percentile), S05 a child of about ten.
_ROWS: tuple[tuple[tuple[float, float, float, float, float, float, float], Outfit], ...] = (
    ((0.0, 0.50, 0.40, 0.68, 0.45, 0.3, 1.755), Outfit("t_shirt", "jeans", "trainers", "short", fit=0.5, folds=1)),
    ((1.0, 0.50, 0.25, 0.75, 0.45, 0.3, 1.620), Outfit("long_sleeve", "trousers", "leather", "long", fit=0.3, folds=2)),
    ((1.0, 0.60, 0.25, 0.75, 0.42, 0.4, 1.500), Outfit("jumper", "trousers", "leather", "medium", glasses="clear", folds=3)),
    ((0.0, 0.55, 0.40, 0.75, 0.48, 0.3, 1.870), Outfit("jacket", "trousers", "leather", "short", fit=0.6, folds=4)),
    ((0.5, 0.05, 0.50, 0.50, 0.48, 0.3, 1.400), Outfit("t_shirt", "shorts", "trainers", "medium", fit=0.7, folds=5)),
    ((1.0, 1.00, 0.20, 0.85, 0.44, 0.5, 1.540), Outfit("jumper", "trousers", "leather", "bun", glasses="clear", folds=6)),
    ((0.0, 1.00, 0.30, 0.70, 0.45, 0.5, 1.690), Outfit("long_sleeve", "trousers", "leather", "bald", glasses="clear", folds=7)),
    ((0.0, 0.70, 0.20, 0.95, 0.46, 0.4, 1.780), Outfit("t_shirt", "jeans", "trainers", "short", beard=True, fit=0.6, folds=8)),
    ((1.0, 0.65, 0.10, 0.95, 0.44, 0.5, 1.640), Outfit("long_sleeve", "jeans", "trainers", "medium", fit=0.4, folds=9)),
    ((0.0, 0.45, 0.85, 0.55, 0.46, 0.1, 1.830), Outfit("t_shirt", "shorts", "trainers", "short", fit=0.2, folds=10)),
    ((1.0, 0.48, 0.60, 0.30, 0.47, 0.1, 1.720), Outfit("t_shirt", "jeans", "trainers", "bun", fit=0.2, folds=11)),
    (
        (0.0, 0.40, 0.35, 0.25, 0.47, 0.4, 1.760),
        Outfit("jumper", "jeans", "trainers", "medium", headwear="cap", fit=0.9, folds=12),
    ),
    (
        (0.0, 0.80, 0.35, 0.80, 0.45, 0.4, 1.730),
        Outfit("jacket", "jeans", "leather", "short", beard=True, headwear="cap", folds=13),
    ),
    ((1.0, 0.80, 0.25, 0.75, 0.44, 0.4, 1.600), Outfit("jacket", "trousers", "leather", "medium", fit=0.5, folds=14)),
    ((1.0, 0.38, 0.30, 0.60, 0.45, 0.2, 1.660), Outfit("t_shirt", "shorts", "trainers", "long", fit=0.4, folds=15)),
    ((0.0, 0.60, 0.45, 0.90, 0.44, 0.3, 1.680), Outfit("long_sleeve", "trousers", "trainers", "bald", beard=True, folds=16)),
    ((0.0, 0.28, 0.40, 0.45, 0.46, 0.3, 1.610), Outfit("jumper", "trousers", "trainers", "short", glasses="clear", folds=17)),
    ((1.0, 0.52, 0.15, 0.80, 0.46, 0.5, 1.690), Outfit("jacket", "jeans", "leather", "long", glasses="clear", fit=0.7, folds=18)),
)
_PERCENTILE = re.compile(rf"({'|'.join(POPULATIONS)})_(male|female)(?:_(\d+(?:\.\d+)?)y)?_p(\d+(?:\.\d+)?)")
_CLOTHES = {
    "male": Outfit("t_shirt", "trousers", "trainers", "short", folds=1),
    "female": Outfit("t_shirt", "trousers", "trainers", "medium", folds=2),
}


class NamedPeople(Mapping[str, Subject]):
    """The people of the package by name: S01 .. S18, and beside them, unlisted, one for each percentile of each population.

    `nhanes_male_p50`, `ansur_female_p5`, `cdc_male_6y_p95`: stature and mass are that percentile, of adults or of an age.
    """

    def __iter__(self) -> Iterator[str]:
        return iter(_NAMED)

    def __len__(self) -> int:
        return len(_NAMED)

    def __getitem__(self, name: str) -> Subject:
        if name in _NAMED:
            return _NAMED[name]
        word = _PERCENTILE.fullmatch(name)
        if word is None:
            raise KeyError(name)
        return _of_percentile(word[1], word[2], float(word[3]) if word[3] else None, float(word[4]))


def face_number(name: str) -> int:
    """The number of the face of somebody who has it in all datasets, by name."""
    return 1 + zlib.crc32(name.encode())


@cache
def _of_percentile(population: str, sex: str, years: float | None, percentile: float) -> Subject:
    size = load_population(population).of_percentile(cast("Sex", sex), percentile, years)
    name = f"{population}_{sex}_{percentile:g}_{years or 0.0:g}"
    return Subject(replace(Phenotype.of_size(size, rng=None), face=face_number(name)), _CLOTHES[sex])


_NAMED = MappingProxyType(
    {
        name: Subject(Phenotype(*row, face=face_number(name)), outfit)
        for name, (row, outfit) in ((f"S{number:02d}", row) for number, row in enumerate(_ROWS, start=1))
    }
)
SUBJECTS = NamedPeople()  # the people of the package, S01 and on
