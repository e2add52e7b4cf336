"""What things look like to the eye: a diffuse reflectance for every triangle of a scene, linear sRGB.

A person has the same skin, hair and clothes, and a car the same trim, in every frame of a dataset.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from cabinpose.core import Floats, Floats32
from cabinpose.core import reproducible as rp
from cabinpose.scene import LABEL_ID as LABEL
from cabinpose.scene import MATERIAL_ID as MATERIAL
from cabinpose.scene import MATERIALS, Surface
from cabinpose.scene.body import Person
from cabinpose.synth.streams import weighted

# Monk skin tone scale (Monk 2019, CC BY 4.0), sRGB.
_SKIN: tuple[int, ...] = (
    0xF6EDE4, 0xF3E7DB, 0xF7EAD0, 0xEADABA, 0xD7BD96, 0xA07E56, 0x825C43, 0x604134, 0x3A312A, 0x292420,
)  # fmt: skip
_BLOOD = 1.0, 0.86, 0.8  # live skin is redder than the scale's patches
_SKIN_GAIN = 0.62  # the scale is of patches under studio light: skin reflects between some 4 and 60 % of red
_HAIR = ((0x1B1512, 0.35), (0x2E1F16, 0.25), (0x4A3020, 0.18), (0x7A5433, 0.1), (0xB08A55, 0.08), (0x6E3519, 0.04))
_GREY_HAIR = 0xB5B1AB
_IRISES = ((0x3B2314, 0.55), (0x5A3A1E, 0.2), (0x6B6B3A, 0.1), (0x6E8AA0, 0.15))  # assumed
_TOPS = (
    0xE8E6E0, 0x23262B, 0x5A6168, 0x2B3A55, 0x6D2230, 0x2E4A3A, 0x8A94A0, 0xB7A98F, 0x3F5F86, 0xC9C4BA, 0x7A4B3A, 0xB55A3C,
    0xD3B04A, 0x4F3B5C, 0x5F8A8B,
)  # fmt: skip
_BOTTOMS = (0x1E2126, 0x2F3339, 0x4C4A46, 0x6F6350, 0x8E8168, 0x2A3448, 0x3E4436)
_JEANS = (0x2B3A52, 0x3D5472, 0x5C7898, 0x1C2230)
_SHOES = (0xE4E2DD, 0x1A1A1C, 0x55585C, 0x7C2B2B, 0x2C3B58)
_LEATHER_SHOES = (0x17130F, 0x3A2416, 0x5B3A22)
_CAPS = (0x1F2329, 0x7A2226, 0x22365A, 0xC8C3B6, 0x44503C)

# Of a car: seats, and the trim below the windows; what is dark is common.
_SEATS = ((0x26272A, 0.4), (0x3A3C40, 0.2), (0x6B665E, 0.12), (0xA4927A, 0.14), (0x5A3A26, 0.08), (0xC9C0AF, 0.06))
_TRIM = ((0x1F2022, 0.5), (0x2C2D30, 0.25), (0x4A4642, 0.12), (0x8C7F6C, 0.13))
_LINING = ((0xBDB9B0, 0.5), (0xD2CDC2, 0.25), (0x8D8C89, 0.15), (0x2B2B2D, 0.1))
_BELTS = ((0x1C1C1E, 0.75), (0x55524D, 0.15), (0x8C8170, 0.06), (0x7A1F22, 0.04))
_PLASTICS = (0x1A1B1D, 0x33363A, 0xD8D6D0, 0x2C4A70, 0x7A2226)
_WALLS = (0xDAD6CC, 0xCFC9BC, 0xB9C2C4, 0xD9CDB4, 0xB8AFA6)
_WOODS = (0x7A5433, 0xA77C4C, 0x4E3524, 0xC7A877)

# Roughness of what shines (Beckmann alpha); all else is matte.
ROUGHNESS: Mapping[int, float] = MappingProxyType(
    {
        MATERIAL[name]: alpha
        for name, alpha in (
            ("skin", 0.55), ("leather_shoe", 0.2), ("seat_leather", 0.32), ("soft_trim", 0.45), ("hard_plastic", 0.28),
            ("metal", 0.15), ("rubber", 0.5), ("steering_leather", 0.35),
            ("eye", 0.1), ("iris", 0.1), ("pupil", 0.1), ("mouth", 0.3),
        )
    }
)  # fmt: skip
_CLOTH = tuple(MATERIAL[name] for name in ("cotton", "denim", "wool", "synthetic_fabric"))
_FEET = (LABEL["foot_left"], LABEL["foot_right"])


def linear(srgb: int) -> Floats:
    """A colour 0xRRGGBB as linear light (3,), 0..1 (IEC 61966-2-1)."""
    value = np.array((srgb >> 16, srgb >> 8 & 255, srgb & 255)) / 255.0
    return np.where(value <= 0.04045, value / 12.92, rp.power((value + 0.055) / 1.055, 2.4))


def near_infrared(surface: Surface) -> Floats32:
    """(F, 3) diffuse reflectance of every triangle at 850 nm: that of the sensor model, the same in all three channels."""
    table = np.zeros(256, np.float32)
    for material in MATERIALS:
        table[material.id] = material.reflectance
    return np.repeat(table[surface.material][:, None], 3, axis=1)


def backdrop_colours(surface: Surface, *, rng: np.random.Generator) -> Floats32:
    """(F, 3) of a car's or room's triangles."""
    seat, trim, lining, belt = (_weighted(table, rng) for table in (_SEATS, _TRIM, _LINING, _BELTS))
    wall, wood = (linear(int(rng.choice(table))) for table in (_WALLS, _WOODS))
    table = np.full((256, 3), 0.3)
    for name, colour in {
        "seat_fabric": seat, "seat_leather": seat, "soft_trim": trim, "hard_plastic": 0.6 * trim + 0.006, "headliner": lining,
        "carpet": 0.5 * trim + 0.01, "metal": np.full(3, 0.35), "rubber": np.full(3, 0.015), "belt_webbing": belt,
        "steering_leather": linear(0x1B1A1A), "painted_wall": wall, "wood": wood, "cotton": wall * 0.8,
        "synthetic_fabric": seat,
    }.items():  # fmt: skip
        table[MATERIAL[name]] = colour
    colours = table[surface.material]
    colours[surface.label == LABEL["floor"]] *= rng.uniform(0.8, 1.0)
    return _blotched(colours, 0.03, rng)


def belt_colours(surface: Surface, *, rng: np.random.Generator) -> Floats32:
    """(F, 3) of a seat belt that somebody wears."""
    return np.tile(_weighted(_BELTS, rng).astype(np.float32), (len(surface.faces), 1))


def thing_colours(surface: Surface, *, rng: np.random.Generator) -> Floats32:
    """(F, 3) of a child seat or an object."""
    cloth, plastic = (linear(int(rng.choice(table))) for table in (_TOPS, _PLASTICS))
    table = np.tile(cloth, (256, 1))
    for name, colour in {
        "hard_plastic": plastic, "soft_trim": plastic, "metal": np.full(3, 0.35), "rubber": np.full(3, 0.015),
        "belt_webbing": linear(0x1C1C1E), "cardboard": linear(0xA98255), "paper": linear(0xE6E2D8),
    }.items():  # fmt: skip
        table[MATERIAL[name]] = colour
    return _blotched(table[surface.material], 0.05, rng)


def person_colours(person: Person, *, rng: np.random.Generator) -> Floats32:
    """(F, 3) of the triangles of a dressed person, in the order of `PosedBody.surface`."""
    dressed, outfit = person.dressed, person.outfit
    at = rng.uniform(0.0, len(_SKIN) - 1.0)
    tones = 0.02 + _SKIN_GAIN * np.array([linear(c) for c in _SKIN])
    skin = np.array([np.interp(at, np.arange(len(_SKIN)), tones[:, k]) for k in range(3)]) * _BLOOD
    hair = _weighted(_HAIR if at < 5 else _HAIR[:2], rng)
    grey = float(np.clip((person.phenotype.years - 40.0) / 35.0 + rng.normal(0, 0.2), 0.0, 1.0))
    hair = hair + rp.power(grey, 1.5) * (linear(_GREY_HAIR) - hair)
    top, bottom, shoe, cap = (
        linear(int(rng.choice(table)))
        for table in (
            _TOPS,
            _JEANS if outfit.bottom == "jeans" else _BOTTOMS,
            _SHOES if outfit.shoes == "trainers" else _LEATHER_SHOES,
            _CAPS,
        )
    )
    sock = linear(int(rng.choice((0xDAD8D2, 0x202124, 0x3A4250))))
    material, label = dressed.material, dressed.label
    cloth = np.isin(material, _CLOTH)
    colours = np.tile(skin, (len(material), 1))
    colours[cloth] = bottom
    colours[cloth & dressed.is_top] = top
    foot = np.isin(label, _FEET)
    colours[cloth & foot & ~dressed.is_top] = shoe if outfit.shoes != "none" else sock
    colours[(material == MATERIAL["cotton"]) & foot] = sock
    colours[material == MATERIAL["leather_shoe"]] = shoe
    colours[material == MATERIAL["rubber"]] = linear(0xD0CEC8 if outfit.shoes == "trainers" and shoe.mean() > 0.3 else 0x1A1918)
    colours[material == MATERIAL["hair"]] = hair
    colours[label == LABEL["headwear"]] = cap
    colours[(label == LABEL["glasses"])] = linear(0x191817)
    colours[dressed.is_lip & (material == MATERIAL["skin"])] = skin * (0.92, 0.62, 0.6) + (0.004, 0.0, 0.0)
    for name, colour in {
        "eye": np.minimum(0.45, 0.25 + 0.4 * skin) * (1.0, 0.93, 0.9), "iris": _weighted(_IRISES if at < 5 else _IRISES[:2], rng),
        "pupil": linear(0x0A0908), "mouth": linear(0x5A1F22),
    }.items():  # fmt: skip
        colours[material == MATERIAL[name]] = colour
    return _blotched(colours, 0.05, rng)


def _blotched(colours: Floats, share: float, rng: np.random.Generator) -> Floats32:
    """Colours with the small unevenness that nothing real is without."""
    return np.clip(colours * (1.0 + share * rng.uniform(-1.0, 1.0, (len(colours), 1))), 0.0, 0.9).astype(np.float32)


def _weighted(table: tuple[tuple[int, float], ...], rng: np.random.Generator) -> Floats:
    return linear(weighted(dict(table), rng=rng))
