"""What somebody looks like to the eye: tone of the skin, hair, colours and prints of clothes, and which triangles have them.

The same in every frame of a dataset. What the same surfaces reflect in near infrared is in `reflectances`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from cabinpose.core import Bytes, Floats, Ints
from cabinpose.core import reproducible as rp
from cabinpose.scene import MATERIAL_ID as MATERIAL
from cabinpose.scene.body import PLACES, Person
from cabinpose.synth.streams import own_rng, weighted

WORN = (
    "skin", "hair", "top", "bottom", "shoes", "socks", "headwear", "top_print", "bottom_print",
    "inner", "scarf", "gloves", "mask",
)  # fmt: skip
"""Surfaces of a person that have a colour, and a reflectance, of their own."""
NOT_WORN = 255  # of soles, glasses, eyes and mouths, which are of their material

# Monk skin tone scale (Monk 2019, CC BY 4.0), sRGB.
_SKIN: tuple[int, ...] = (
    0xF6EDE4, 0xF3E7DB, 0xF7EAD0, 0xEADABA, 0xD7BD96, 0xA07E56, 0x825C43, 0x604134, 0x3A312A, 0x292420,
)  # fmt: skip
_BLOOD = 1.0, 0.86, 0.8  # live skin is redder than the scale's patches
_SKIN_GAIN = 0.62  # the scale is of patches under studio light: skin reflects between some 4 and 60 % of red
# Colour, share (assumed), and what grew it: a row of `scene.HAIR`.
_HAIR = (
    (0x1B1512, 0.35, "black"), (0x2E1F16, 0.25, "dark_brown"), (0x4A3020, 0.18, "dark_brown"), (0x7A5433, 0.1, "light_brown"),
    (0xB08A55, 0.08, "blond"), (0x6E3519, 0.04, "red"),
)  # fmt: skip
_GREY_HAIR = 0xB5B1AB
_GREY_YEARS = 40.0, 35.0  # from when on hair is grey, and over how many years it becomes so: assumed
_DYED = 0.08, 0.5  # share of men and of women who dye what is grey: assumed
_DYES_FROM = 0.15  # share of grey from which it is dyed: assumed
TOPS = (
    0xE8E6E0, 0x23262B, 0x5A6168, 0x2B3A55, 0x6D2230, 0x2E4A3A, 0x8A94A0, 0xB7A98F, 0x3F5F86, 0xC9C4BA, 0x7A4B3A, 0xB55A3C,
    0xD3B04A, 0x4F3B5C, 0x5F8A8B,
)  # fmt: skip
_BOTTOMS = (0x1E2126, 0x2F3339, 0x4C4A46, 0x6F6350, 0x8E8168, 0x2A3448, 0x3E4436)
_JEANS = (0x2B3A52, 0x3D5472, 0x5C7898, 0x1C2230)
_SHOES = (0xE4E2DD, 0x1A1A1C, 0x55585C, 0x7C2B2B, 0x2C3B58)
_LEATHER_SHOES = (0x17130F, 0x3A2416, 0x5B3A22)
_CAPS = (0x1F2329, 0x7A2226, 0x22365A, 0xC8C3B6, 0x44503C)
_SCARVES = (0x7A2226, 0x2B3A55, 0x8A8F98, 0xB08A3A, 0x2E4A3A, 0xD8D2C6, 0x4F3B5C)
_GLOVES = (0x17181B, 0x3A2A22, 0x4C4A46, 0x6D2230)
_MASKS = (0x8FBFD6, 0xE6E8EA, 0x17181B)
_SOCKS = (0xDAD8D2, 0x202124, 0x3A4250)
_PRINTS = (0x141414, 0x1A1B1F, 0x23262B, 0xE8E6E0, 0xB55A3C, 0x3F5F86, 0x2E4A3A, 0xD3B04A)
# What is printed or woven into clothes: upper bounds of a number from 0 to 1 (shares assumed).
_TOP_PATTERNS = (("", 0.70), ("stripes", 0.88), ("checks", 1.0))
_BOTTOM_PATTERNS = (("", 0.92), ("checks", 1.0))
_PRINTED = ("t_shirt", "long_sleeve", "shirt", "jumper", "trousers", "shorts")
_STRIPE_M, _CHECK_M = 0.04, 0.05
_ODD = 1001  # more columns of checks than any garment has, and odd
_PLACE = np.full(256, NOT_WORN, np.uint8)  # of a material, where nothing else tells
_PLACE[MATERIAL["skin"]], _PLACE[MATERIAL["hair"]] = WORN.index("skin"), WORN.index("hair")
_PLACE[[MATERIAL["synthetic_fabric"], MATERIAL["leather_shoe"]]] = WORN.index("shoes")
_OF_PLACE = np.array([NOT_WORN, *(WORN.index(name) for name in PLACES[1:])], np.uint8)


class PersonLook(NamedTuple):
    """How somebody looks.

    tone: of the skin, 0 (lightest) to 9 on the Monk scale · colours: linear sRGB (3,) of each of `WORN` · hair: what grew it, a
    row of `scene.HAIR` · grey: share of hair that has turned grey, seen or not · dyed: whether it is not seen, for it is
    dyed · patterns: of "top" and "bottom", "" where they are plain.
    """

    tone: float
    colours: Mapping[str, Floats]
    hair: str
    grey: float
    dyed: bool
    patterns: Mapping[str, str]


def linear(srgb: int) -> Floats:
    """A colour 0xRRGGBB as linear light (3,), 0..1 (IEC 61966-2-1)."""
    value = np.array((srgb >> 16, srgb >> 8 & 255, srgb & 255)) / 255.0
    return np.where(value <= 0.04045, value / 12.92, rp.power((value + 0.055) / 1.055, 2.4))


def look_of(person: Person, seed: int, subject: str) -> PersonLook:
    """How somebody looks in the dataset of a seed."""
    outfit, gender = person.outfit, person.phenotype.gender
    wearer = f"{subject} in outfit {outfit.number}" if outfit.number else subject
    rng, prints = own_rng(seed, subject), own_rng(seed, f"prints of {wearer}")
    tone = rng.uniform(0.0, len(_SKIN) - 1.0)
    tones = 0.02 + _SKIN_GAIN * np.array([linear(c) for c in _SKIN])
    skin = np.array([np.interp(tone, np.arange(len(_SKIN)), tones[:, k]) for k in range(3)]) * _BLOOD
    grown = {colour: (share, kind) for colour, share, kind in (_HAIR if tone < 5 else _HAIR[:2])}
    colour = weighted({c: share for c, (share, _) in grown.items()}, rng=rng)
    from_years, over = _GREY_YEARS
    turned = float(np.clip((person.phenotype.years - from_years) / over + rng.normal(0, 0.2), 0.0, 1.0))
    grey = float(rp.power(turned, 1.5))
    palettes = {
        "top": TOPS, "bottom": {"jeans": _JEANS, "dress": TOPS}.get(outfit.bottom, _BOTTOMS),
        "shoes": _SHOES if outfit.shoes == "trainers" else _LEATHER_SHOES, "headwear": _CAPS, "socks": _SOCKS,
    }  # fmt: skip
    dyes = own_rng(seed, wearer) if outfit.number else rng
    colours = {name: linear(int(dyes.choice(table))) for name, table in palettes.items()}
    more = own_rng(seed, f"small clothes of {wearer}")
    for name, table in {"inner": TOPS, "scarf": _SCARVES, "gloves": _GLOVES, "mask": _MASKS}.items():
        colours[name] = linear(int(more.choice(table)))
    u = prints.random(5)
    dyed = grey > _DYES_FROM and own_rng(seed, f"prints of {subject}").random() < _DYED[0] + gender * (_DYED[1] - _DYED[0])
    natural = linear(colour)
    hair = natural if dyed else natural + grey * (linear(_GREY_HAIR) - natural)
    printed = {f"{part}_print": linear(_PRINTS[int(u[k] * len(_PRINTS))]) for k, part in ((1, "top"), (2, "bottom"))}
    patterns = {
        part: next(name for name, bound in table if u[k] < bound) if garment in _PRINTED and outfit.bottom != "dress" else ""
        for k, part, garment, table in (
            (3, "top", outfit.top, _TOP_PATTERNS), (4, "bottom", outfit.bottom, _BOTTOM_PATTERNS)
        )
    }  # fmt: skip
    return PersonLook(tone, {"skin": skin, "hair": hair, **colours, **printed}, grown[colour][1], grey, dyed, patterns)


def worn_faces(person: Person, look: PersonLook) -> Bytes:
    """(F,) index in `WORN` of each triangle of a dressed person, in the order of `PosedBody.surface`; else `NOT_WORN`."""
    dressed = person.dressed
    place = np.where(dressed.worn > 0, _OF_PLACE[dressed.worn], _PLACE[dressed.material])
    for part, pattern in look.patterns.items():
        if pattern:
            of = np.flatnonzero(place == WORN.index(part))
            middle = dressed.rest[dressed.faces[of]].mean(axis=1)
            place[of[pattern_cells(pattern, middle) % 2 == 1]] = WORN.index(f"{part}_print")
    return place


def pattern_cells(pattern: str, at: Floats) -> Ints:
    """(N,) the stripe or check that places on a garment are in, by where they are at rest (N, 3) m; odd ones are coloured."""
    if pattern == "stripes":
        return np.floor(at[:, 2] / _STRIPE_M).astype(np.int64)
    column, row = np.floor(at[:, 1:] / _CHECK_M).astype(np.int64).T
    return np.asarray(row + _ODD * column)
