"""What things look like to the eye: a diffuse reflectance for every triangle of a scene, linear sRGB.

A person has the same skin, hair and clothes, and a car the same trim, in every frame of a dataset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Floats32
from cabinpose.scene import LABEL_ID as LABEL
from cabinpose.scene import MATERIAL_ID as MATERIAL
from cabinpose.scene import Surface
from cabinpose.scene.body import Person
from cabinpose.synth.person_look import TOPS, WORN, PersonLook, linear, worn_faces
from cabinpose.synth.streams import weighted

_IRISES = ((0x3B2314, 0.55), (0x5A3A1E, 0.2), (0x6B6B3A, 0.1), (0x6E8AA0, 0.15))  # assumed
_DARK_EYED = 5.0  # tone of the skin from which on eyes are brown (assumed)
# Of a car: seats, and the trim below the windows; what is dark is common.
_SEATS = ((0x26272A, 0.4), (0x3A3C40, 0.2), (0x6B665E, 0.12), (0xA4927A, 0.14), (0x5A3A26, 0.08), (0xC9C0AF, 0.06))
_TRIM = ((0x1F2022, 0.5), (0x2C2D30, 0.25), (0x4A4642, 0.12), (0x8C7F6C, 0.13))
_LINING = ((0xBDB9B0, 0.5), (0xD2CDC2, 0.25), (0x8D8C89, 0.15), (0x2B2B2D, 0.1))
_BELTS = ((0x1C1C1E, 0.75), (0x55524D, 0.15), (0x8C8170, 0.06), (0x7A1F22, 0.04))
_PLASTICS = (0x1A1B1D, 0x33363A, 0xD8D6D0, 0x2C4A70, 0x7A2226)
_WALLS = (0xDAD6CC, 0xCFC9BC, 0xB9C2C4, 0xD9CDB4, 0xB8AFA6)
_WOODS = (0x7A5433, 0xA77C4C, 0x4E3524, 0xC7A877)


def near_infrared(surface: Surface, table: Floats32) -> Floats32:
    """(F, 3) diffuse reflectance of every triangle in near infrared, the same in all three channels.

    table: (256, 4) of the sensor model, by material or code of a coat: `scene.sensor.material_table`.
    """
    return np.repeat(table[surface.material, :1], 3, axis=1)


class Trim(NamedTuple):
    """Colours of a car, linear sRGB (3,): its seats, the trim below the windows, the lining of the roof, the belts."""

    seat: Floats
    trim: Floats
    lining: Floats
    belt: Floats

    def colours(self) -> dict[str, Floats]:
        """By material."""
        return {
            "seat_fabric": self.seat, "seat_leather": self.seat, "soft_trim": self.trim,
            "hard_plastic": 0.6 * self.trim + 0.006, "headliner": self.lining, "carpet": 0.5 * self.trim + 0.01,
            "belt_webbing": self.belt, "steering_leather": linear(0x1B1A1A), "synthetic_fabric": self.seat,
        }  # fmt: skip


def draw_trim(*, rng: np.random.Generator) -> Trim:
    """The colours of a car."""
    return Trim(*(_weighted(table, rng) for table in (_SEATS, _TRIM, _LINING, _BELTS)))


def backdrop_colours(surface: Surface, *, rng: np.random.Generator) -> Floats32:
    """(F, 3) of a car's or room's triangles."""
    trim = draw_trim(rng=rng)
    wall, wood = (linear(int(rng.choice(table))) for table in (_WALLS, _WOODS))
    table = np.full((256, 3), 0.3)
    for name, colour in {
        **trim.colours(), "metal": np.full(3, 0.35), "rubber": np.full(3, 0.015), "painted_wall": wall, "wood": wood,
        "cotton": wall * 0.8,
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
    cloth, plastic = (linear(int(rng.choice(table))) for table in (TOPS, _PLASTICS))
    table = np.tile(cloth, (256, 1))
    for name, colour in {
        "hard_plastic": plastic, "soft_trim": plastic, "metal": np.full(3, 0.35), "rubber": np.full(3, 0.015),
        "belt_webbing": linear(0x1C1C1E), "cardboard": linear(0xA98255), "paper": linear(0xE6E2D8),
    }.items():  # fmt: skip
        table[MATERIAL[name]] = colour
    return _blotched(table[surface.material], 0.05, rng)


def person_colours(person: Person, look: PersonLook, *, rng: np.random.Generator) -> Floats32:
    """(F, 3) of the triangles of a dressed person, in the order of `PosedBody.surface`."""
    dressed = person.dressed
    place, skin, shoes = worn_faces(person, look), look.colours["skin"], look.colours["shoes"]
    colours = np.tile(skin, (len(place), 1))
    for number, name in enumerate(WORN):
        colours[place == number] = look.colours[name]
    material, label = dressed.material, dressed.label
    white = person.outfit.shoes == "trainers" and shoes.mean() > 0.3
    colours[material == MATERIAL["rubber"]] = linear(0xD0CEC8 if white else 0x1A1918)
    colours[label == LABEL["glasses"]] = linear(0x191817)
    colours[dressed.is_lip & (material == MATERIAL["skin"])] = skin * (0.92, 0.62, 0.6) + (0.004, 0.0, 0.0)
    for name, colour in {
        "eye": np.minimum(0.45, 0.25 + 0.4 * skin) * (1.0, 0.93, 0.9),
        "iris": _weighted(_IRISES if look.tone < _DARK_EYED else _IRISES[:2], rng),
        "pupil": linear(0x0A0908), "mouth": linear(0x5A1F22),
    }.items():  # fmt: skip
        colours[material == MATERIAL[name]] = colour
    return _blotched(colours, 0.05, rng)


def _blotched(colours: Floats, share: float, rng: np.random.Generator) -> Floats32:
    """Colours with the small unevenness that nothing real is without."""
    return np.clip(colours * (1.0 + share * rng.uniform(-1.0, 1.0, (len(colours), 1))), 0.0, 0.9).astype(np.float32)


def _weighted(table: tuple[tuple[int, float], ...], rng: np.random.Generator) -> Floats:
    return linear(weighted(dict(table), rng=rng))
