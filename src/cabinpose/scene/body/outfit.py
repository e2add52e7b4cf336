"""What people wear: `Outfit` names garments, hair and accessories; how they look is in `garments` and `accessories`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from pydantic import ConfigDict

from cabinpose.core import ConfigError, unknown_name

Top = Literal["none", "t_shirt", "long_sleeve", "jumper", "jacket"]
Bottom = Literal["none", "trousers", "jeans", "shorts"]
Shoes = Literal["none", "trainers", "leather"]
Hair = Literal["bald", "short", "medium", "long", "bun"]
_CHOICES = {"top": get_args(Top), "bottom": get_args(Bottom), "shoes": get_args(Shoes), "hair": get_args(Hair)}

_HAIR: Mapping[Hair, float] = MappingProxyType({"short": 4.0, "medium": 3.0, "long": 2.0, "bun": 1.0, "bald": 1.0})
# How people wear their hair, of a hundred men and women who are not bald: assumed.
_OF_MEN: Mapping[Hair, float] = MappingProxyType({"short": 78.0, "medium": 15.0, "long": 5.0, "bun": 2.0})
_OF_WOMEN: Mapping[Hair, float] = MappingProxyType({"short": 17.0, "medium": 35.0, "long": 35.0, "bun": 13.0})
_BALD_YEARS, _BALD_MEN = (25.0, 65.0), 0.25  # share of men who are bald, from none at the first age to all of it at the second


def hair_shares(gender: float, years: float) -> Mapping[Hair, float]:
    """How common each style of hair is; gender: 0 male to 1 female. Assumed."""
    bald = _BALD_MEN * (1.0 - gender) * float(np.interp(years, _BALD_YEARS, (0.0, 1.0)))
    worn = {style: share + gender * (_OF_WOMEN[style] - share) for style, share in _OF_MEN.items()}
    return {style: (1.0 - bald) * share / 100.0 for style, share in worn.items()} | {"bald": bald}


@dataclass(frozen=True)
class Outfit:
    """Clothing, hair and accessories of one person.

    fit: 0 close, 1 loose · folds: number of the pattern of folds. Raises ConfigError for names that do not exist.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")  # where it is part of a configuration

    top: Top = "t_shirt"
    bottom: Bottom = "trousers"
    shoes: Shoes = "trainers"
    hair: Hair = "short"
    beard: bool = False
    cap: bool = False
    glasses: bool = False
    fit: float = 0.5
    folds: int = 0

    def __post_init__(self) -> None:
        for kind, known in _CHOICES.items():
            value = getattr(self, kind)
            if value not in known:
                raise unknown_name(kind, str(value), known)
        if not 0.0 <= self.fit <= 1.0:
            raise ConfigError(f"outfit fit is {self.fit}", hint="0 is close, 1 is loose")

    @classmethod
    def random(cls, *, rng: np.random.Generator, hair: Mapping[Hair, float] = _HAIR) -> Outfit:
        """An everyday outfit; the same number of draws whatever comes out. hair: how common each style is."""
        u = rng.random(8)

        def pick(x: float, weights: Mapping[Any, float]) -> str:
            bounds = np.cumsum(list(weights.values()))
            return list(weights)[int(np.searchsorted(bounds, x * bounds[-1], side="right"))]

        return cls(
            top=pick(u[0], {"t_shirt": 3, "long_sleeve": 2, "jumper": 2, "jacket": 2}),  # type: ignore[arg-type]
            bottom=pick(u[1], {"trousers": 4, "jeans": 4, "shorts": 1}),  # type: ignore[arg-type]
            shoes=pick(u[2], {"trainers": 3, "leather": 2}),  # type: ignore[arg-type]
            hair=pick(u[3], hair),  # type: ignore[arg-type]
            beard=bool(u[4] < 0.15),
            cap=bool(u[5] < 0.12),
            glasses=bool(u[6] < 0.3),
            fit=float(u[7]),
            folds=int(rng.integers(1 << 16)),
        )
