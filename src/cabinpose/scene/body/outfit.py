"""What people wear: `Outfit` names garments, hair and accessories, `GARMENTS` what they are of. Shapes are in `wardrobe`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple, get_args

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.json_schema import SkipJsonSchema

from cabinpose.core import ConfigError, at_rank, unknown_name

Top = Literal[
    "none", "t_shirt", "long_sleeve", "shirt", "jumper", "turtleneck", "hoodie", "jacket", "open_jacket", "coat",
]  # fmt: skip
Bottom = Literal["none", "trousers", "jeans", "shorts", "skirt", "long_skirt", "dress"]
Shoes = Literal["none", "trainers", "leather"]
Hair = Literal["bald", "short", "medium", "long", "bun"]
Headwear = Literal["none", "cap", "beanie", "hat", "hood", "headscarf"]
Glasses = Literal["none", "clear", "sun"]
_CHOICES = {
    "top": get_args(Top), "bottom": get_args(Bottom), "shoes": get_args(Shoes), "hair": get_args(Hair),
    "headwear": get_args(Headwear), "glasses": get_args(Glasses),
}  # fmt: skip
OVER_HAIR, COVERING_HAIR = ("cap", "beanie", "hat"), ("hood", "headscarf")
"""Headwear from whose rim hair hangs, and that under which it lies flat."""


class Garment(NamedTuple):
    """Whose colour and dye something worn has, and what it is made of.

    coat: the surface of a person (`sheets.PLACES`, "skin", "shoes"), "" where the material alone tells · label: of a class of its
    own, "" where it has that of the body below.
    """

    coat: str
    material: str
    label: str = ""


GARMENTS: Mapping[str, Mapping[str, Garment]] = MappingProxyType(
    {
        "skin": {"skin": Garment("skin", "skin")},
        "hair": dict.fromkeys(("short", "medium", "long", "bun"), Garment("hair", "hair", "hair")),
        "brows": {"brows": Garment("hair", "hair")},
        "beard": {"beard": Garment("hair", "hair")},
        "top": {
            "t_shirt": Garment("top", "cotton"), "long_sleeve": Garment("top", "cotton"), "shirt": Garment("top", "cotton"),
            "jumper": Garment("top", "wool"), "turtleneck": Garment("top", "wool"), "hoodie": Garment("top", "cotton"),
            "jacket": Garment("top", "synthetic_fabric"), "open_jacket": Garment("top", "synthetic_fabric"),
            "coat": Garment("top", "wool"),
        },
        "inner": {"t_shirt": Garment("inner", "cotton")},
        "bottom": {
            "trousers": Garment("bottom", "cotton"), "jeans": Garment("bottom", "denim"), "shorts": Garment("bottom", "cotton"),
            "skirt": Garment("bottom", "cotton"), "long_skirt": Garment("bottom", "cotton"), "dress": Garment("bottom", "cotton"),
        },
        "socks": {"socks": Garment("socks", "cotton")},
        "shoes": {"trainers": Garment("shoes", "synthetic_fabric"), "leather": Garment("shoes", "leather_shoe")},
        "headwear": {
            "cap": Garment("headwear", "cotton", "headwear"), "beanie": Garment("headwear", "wool", "headwear"),
            "hat": Garment("headwear", "wool", "headwear"), "headscarf": Garment("headwear", "cotton", "headwear"),
            "hood": Garment("top", "cotton", "headwear"),
        },
        "glasses": {"clear": Garment("", "spectacle_lens", "glasses"), "sun": Garment("", "hard_plastic", "glasses")},
        "mask": {"mask": Garment("mask", "synthetic_fabric")},
        "scarf": {"scarf": Garment("scarf", "wool")},
        "gloves": {"gloves": Garment("gloves", "wool")},
    }
)  # fmt: skip
"""By place and name: the one table that clothes are drawn by and labels go by; "inner" is the shirt under an open jacket."""
_BODICES = ("t_shirt", "long_sleeve")  # with a dress they are the upper part of it

_HAIR: Mapping[Hair, float] = MappingProxyType({"short": 4.0, "medium": 3.0, "long": 2.0, "bun": 1.0, "bald": 1.0})
# How people wear their hair, of a hundred men and women who are not bald: assumed.
_OF_MEN: Mapping[Hair, float] = MappingProxyType({"short": 78.0, "medium": 15.0, "long": 5.0, "bun": 2.0})
_OF_WOMEN: Mapping[Hair, float] = MappingProxyType({"short": 17.0, "medium": 35.0, "long": 35.0, "bun": 13.0})
_BALD_YEARS, _BALD_MEN = (25.0, 65.0), 0.25  # share of men who are bald, from none at the first age to all of it at the second

# What outfits are drawn by, all assumed: the share of the cold season, and in each season what a kind of top is in particular.
COLD = 0.35
TOP_CUTS: Mapping[str, Mapping[str, Mapping[Top, float]]] = MappingProxyType(
    {
        "warm": {
            "long_sleeve": {"long_sleeve": 0.5, "shirt": 0.5}, "jumper": {"jumper": 0.45, "hoodie": 0.4, "turtleneck": 0.15},
            "jacket": {"jacket": 0.5, "open_jacket": 0.5},
        },
        "cold": {
            "long_sleeve": {"long_sleeve": 0.5, "shirt": 0.5}, "jumper": {"jumper": 0.4, "hoodie": 0.3, "turtleneck": 0.3},
            "jacket": {"jacket": 0.3, "open_jacket": 0.2, "coat": 0.5},
        },
    }
)  # fmt: skip
HANGING_SHARES: Mapping[Bottom, float] = MappingProxyType({"skirt": 0.08, "long_skirt": 0.05, "dress": 0.07})  # of women
_HANGS = sum(HANGING_SHARES.values())
OVER_DRESSES: tuple[Top, ...] = ("t_shirt", "long_sleeve", "open_jacket")  # tops that a dress has, or is worn under
HEADWEAR_SHARES: Mapping[str, Mapping[Headwear, float]] = MappingProxyType(
    {"warm": {"beanie": 0.01, "hat": 0.03}, "cold": {"beanie": 0.15, "hat": 0.02}}
)
HEADSCARF, HOOD_UP, _CAP = 0.06, 0.2, 0.12  # of women; of hoods; of who wears nothing else on the head
SMALL_SHARES: Mapping[str, tuple[float, float, float, float]] = MappingProxyType(
    {"warm": (0.12, 0.02, 0.0, 0.03), "cold": (0.05, 0.35, 0.15, 0.05)}  # sunglasses, scarf, gloves, mask
)


def hair_shares(gender: float, years: float) -> Mapping[Hair, float]:
    """How common each style of hair is; gender: 0 male to 1 female. Assumed."""
    bald = _BALD_MEN * (1.0 - gender) * float(np.interp(years, _BALD_YEARS, (0.0, 1.0)))
    worn = {style: share + gender * (_OF_WOMEN[style] - share) for style, share in _OF_MEN.items()}
    return {style: (1.0 - bald) * share / 100.0 for style, share in worn.items()} | {"bald": bald}


@dataclass(frozen=True)
class Outfit:
    """Clothing, hair and accessories of one person.

    fit: 0 close, 1 loose · folds: number of the pattern of folds · number: which of the person's outfits it is, each with
    colours of its own. Raises ConfigError for names that do not exist.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")  # where it is part of a configuration

    top: Top = "t_shirt"
    bottom: Bottom = "trousers"
    shoes: Shoes = "trainers"
    hair: Hair = "short"
    beard: bool = False
    headwear: Headwear = "none"
    glasses: Glasses = "none"
    scarf: bool = False
    gloves: bool = False
    mask: bool = False
    fit: float = 0.5
    folds: int = 0
    number: Annotated[SkipJsonSchema[int], Field(exclude=True)] = 0  # of the place in a list: no key of a configuration

    def __post_init__(self) -> None:
        for kind, known in _CHOICES.items():
            value = getattr(self, kind)
            if value not in known:
                raise unknown_name(kind, str(value), known)
        if not 0.0 <= self.fit <= 1.0:
            raise ConfigError(f"outfit fit is {self.fit}", hint="0 is close, 1 is loose")

    @classmethod
    def random(cls, *, rng: np.random.Generator, hair: Mapping[Hair, float] = _HAIR, gender: float = 0.5) -> Outfit:
        """An everyday outfit; the same number of draws whatever comes out.

        hair: how common each style is · gender: 0 male to 1 female. Coats, scarves, gloves and beanies go
        together, worn in the cold season. Shares are assumed.
        """
        u, folds = rng.random(8), int(rng.integers(1 << 16))
        cold, cut, legs, head, *small = rng.random(8).tolist()
        season = "cold" if cold < COLD else "warm"
        kind: Top = at_rank({"t_shirt": 3, "long_sleeve": 2, "jumper": 2, "jacket": 2}, u[0])
        top: Top = at_rank(TOP_CUTS[season].get(kind, {kind: 1.0}), cut)
        bottom: Bottom = at_rank({"trousers": 4, "jeans": 4, "shorts": 1}, u[1])
        hangs = {hanging: gender * share for hanging, share in HANGING_SHARES.items()}
        bottom = at_rank(hangs | {bottom: 1 - gender * _HANGS}, legs)
        if bottom == "dress" and top not in OVER_DRESSES:
            bottom = "skirt"
        up = HOOD_UP if top == "hoodie" else 0.0
        worn: dict[Headwear, float] = dict(HEADWEAR_SHARES[season]) | {"headscarf": gender * HEADSCARF, "hood": up}
        headwear: Headwear = at_rank(worn | {"none": 1.0 - sum(worn.values())}, head)
        if u[5] < _CAP and headwear == "none":
            headwear = "cap"
        bare_neck = headwear != "headscarf" and (top != "hoodie" or headwear == "hood")  # a hood that hangs leaves no room
        dark, scarf, gloves, mask = (x < share for x, share in zip(small, SMALL_SHARES[season], strict=True))
        return cls(
            top=top, bottom=bottom, shoes=at_rank({"trainers": 3, "leather": 2}, u[2]), hair=at_rank(hair, u[3]),
            beard=bool(u[4] < 0.15), headwear=headwear, glasses="sun" if dark else "clear" if u[6] < 0.3 else "none",
            scarf=scarf and bare_neck, gloves=gloves, mask=mask, fit=float(u[7]), folds=folds,
        )  # fmt: skip

    def redressed(self, other: Outfit) -> Outfit:
        """The clothes of another outfit on the same person, who keeps hair, beard, sight, and a headscarf if it is worn."""
        clear: Glasses = "clear" if self.glasses == "clear" else "none"
        glasses: Glasses = other.glasses if other.glasses == "sun" else clear
        if self.headwear == "headscarf":
            other = replace(other, headwear="headscarf", scarf=False)
        elif other.headwear == "headscarf":
            other = replace(other, headwear="none")
        return replace(other, hair=self.hair, beard=self.beard, glasses=glasses)


def _names(outfit: Outfit) -> dict[str, str]:
    """What is worn at each place of `GARMENTS`; what is not among their names is nothing."""
    small = {name: name if getattr(outfit, name) else "none" for name in ("beard", "scarf", "gloves", "mask")}
    return small | {
        "skin": "skin", "hair": "none" if outfit.hair == "bald" else outfit.hair, "brows": "brows", "top": outfit.top,
        "inner": "t_shirt" if outfit.top == "open_jacket" else "none", "bottom": outfit.bottom, "shoes": outfit.shoes,
        "socks": "none" if outfit.shoes == "none" else "socks", "headwear": outfit.headwear, "glasses": outfit.glasses,
    }  # fmt: skip


def worn(outfit: Outfit) -> dict[str, Garment]:
    """What is worn, by place of `GARMENTS`, without the places where nothing is; a dress with a plain top is of one cloth."""
    names = _names(outfit)
    made = {place: GARMENTS[place][name] for place, name in names.items() if name in GARMENTS[place]}
    if outfit.bottom == "dress":
        made |= {place: made["bottom"] for place in ("top", "inner") if names[place] in _BODICES}
    return made


def worn_words(outfit: Outfit) -> dict[str, str]:
    """What is on each place of the axis `worn` of datasets that bodies know of, "none" without; of the skin there is no word."""
    names = _names(outfit)
    top = ",".join((names["top"], *(name for name in ("scarf", "gloves") if names[name] != "none")))
    told = ("hair", "beard", "bottom", "shoes", "headwear", "glasses", "mask")
    return {"skin": "", "top": top} | {place: names[place] for place in told}
