"""What a person's shape is made of: six numbers from 0 to 1, and ways to draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

import numpy as np

from cabinpose.core.errors import ConfigError, unknown_name


@dataclass(frozen=True)
class Phenotype:
    """Shape parameters, each from 0 to 1 (Anny's, after MakeHuman's macro details).

    gender: 0 male, 1 female · age: 0 child of about ten, 0.5 young adult, 1 old · muscle and weight: 0.5 average ·
    height: for the other five as they are · proportions: 0 uncommon, 1 ideal. Raises ConfigError outside.
    """

    gender: float = 0.5
    age: float = 0.5
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not 0.0 <= value <= 1.0:
                raise ConfigError(f"phenotype {name} is {value}", hint="each phenotype parameter lies between 0 and 1")

    @classmethod
    def random(cls, ranges: Mapping[str, tuple[float, float]] | None = None, *, rng: np.random.Generator) -> Phenotype:
        """Parameters drawn evenly from `ranges` (name -> (least, greatest)), from 0 to 1 where none is given.

        Six numbers are drawn whatever the ranges. Raises ConfigError for unknown names and for ranges that are turned
        round or leave [0, 1].
        """
        names = tuple(field.name for field in fields(cls))
        for name, (low, high) in (ranges or {}).items():
            if name not in names:
                raise unknown_name("phenotype parameter", name, names)
            if not 0.0 <= low <= high <= 1.0:
                raise ConfigError(f"range of phenotype {name} is ({low}, {high})", hint="give 0 <= least <= greatest <= 1")
        limits = np.array([(ranges or {}).get(name, (0.0, 1.0)) for name in names])
        values = limits[:, 0] + rng.random(len(names)) * (limits[:, 1] - limits[:, 0])
        return cls(**dict(zip(names, values.tolist(), strict=True)))
