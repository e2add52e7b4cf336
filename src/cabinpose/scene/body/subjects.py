"""Eighteen named people of different sizes, ages and clothes."""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

from cabinpose.scene.body.outfit import Outfit
from cabinpose.scene.body.phenotype import Phenotype


class Subject(NamedTuple):
    """A named person."""

    phenotype: Phenotype
    outfit: Outfit


# gender, age, muscle, weight, height, proportions
_ROWS: tuple[tuple[tuple[float, float, float, float, float, float], Outfit], ...] = (
    ((0.0, 0.5, 0.5, 0.5, 0.4, 0.6), Outfit("t_shirt", "jeans", "trainers", "short", folds=1)),
)
SUBJECTS = MappingProxyType(
    {f"S{number:02d}": Subject(Phenotype(*row), outfit) for number, (row, outfit) in enumerate(_ROWS, start=1)}
)
