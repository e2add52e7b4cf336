"""What surfaces reflect in near infrared: materials, dyes, hair and skin, at 850 and 940 nm; and how smooth they are.

Near-infrared reflectance differs from what the eye sees: a black dye may be as bright as white cloth, carbon-black pigment and
the melanin of hair stay dark, and skin differs less than in colour. `docs/sensor-model.md` has the source of each row; where it
says *assumed*, none was found.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple

Wavelength = Literal[850, 940]
"""Of a camera's light, nm: those for which reflectances are tabled."""


class Material(NamedTuple):
    """A surface material.

    id: fits uint8, below `FIRST_COAT` · name · reflectance, reflectance_940: diffuse, at 850 and 940 nm · roughness: Beckmann's
    alpha of what shines, None of what is matt · transmissive: whether light passes (glass).
    """

    id: int
    name: str
    reflectance: float
    reflectance_940: float
    roughness: float | None = None
    transmissive: bool = False

    def at(self, wavelength_nm: Wavelength) -> float:
        """Diffuse reflectance at a wavelength."""
        return self.reflectance if wavelength_nm == 850 else self.reflectance_940


# All materials, by id. Of those that are dyed, the usual kind: `DYES` has the others.
MATERIALS: tuple[Material, ...] = (
    Material(0, "nothing", 0.0, 0.0),
    Material(1, "skin", 0.543, 0.469, 0.55),
    Material(2, "hair", 0.25, 0.25),
    Material(3, "cotton", 0.640, 0.639),
    Material(4, "denim", 0.55, 0.57),
    Material(5, "wool", 0.528, 0.582),
    Material(6, "synthetic_fabric", 0.507, 0.552),
    Material(7, "leather_shoe", 0.25, 0.25, 0.2),
    Material(8, "seat_fabric", 0.35, 0.37),
    Material(9, "seat_leather", 0.45, 0.45, 0.32),
    Material(10, "soft_trim", 0.20, 0.20, 0.45),
    Material(11, "hard_plastic", 0.10, 0.10, 0.28),
    Material(12, "headliner", 0.60, 0.62),
    Material(13, "carpet", 0.15, 0.15),
    Material(14, "glass", 0.05, 0.05, transmissive=True),
    Material(15, "metal", 0.35, 0.38, 0.15),
    Material(16, "rubber", 0.064, 0.065, 0.5),
    Material(17, "belt_webbing", 0.507, 0.552),
    Material(18, "spectacle_lens", 0.06, 0.06, transmissive=True),
    Material(19, "painted_wall", 0.75, 0.75),
    Material(20, "wood", 0.634, 0.667),
    Material(21, "steering_leather", 0.15, 0.15, 0.35),
    Material(30, "eye", 0.40, 0.40, 0.1),  # the white of it, darker than skin; of eyes and mouths all are assumed
    Material(31, "iris", 0.35, 0.35, 0.1),
    Material(32, "pupil", 0.04, 0.04, 0.1),
    Material(33, "mouth", 0.25, 0.22, 0.3),
    Material(40, "cardboard", 0.60, 0.60),
    Material(41, "paper", 0.809, 0.799),
)
OF_THINGS = MATERIALS[-2:]  # of things that people bring along alone
MATERIAL_ID = MappingProxyType({material.name: material.id for material in MATERIALS})  # by name
FIRST_COAT = 64
"""Codes of a scene's own coats begin here; below are materials."""


class Coat(NamedTuple):
    """What one scene's surfaces of a code reflect, in place of the material's own.

    code: uint8, a material's id or, from `FIRST_COAT` on, one of the scene's own · material: id, which says how smooth it is ·
    reflectance: diffuse, at the wavelength of the scene's camera.
    """

    code: int
    material: int
    reflectance: float


class Dye(NamedTuple):
    """A way in which a material gets its colour, whatever that colour is.

    name · share: of what is made of the material (assumed) · low, high: diffuse reflectance at 850 nm, drawn evenly ·
    longer: how many times that at 940 nm · to_the_eye: whether it absorbs near infrared as it does visible light, so that what is
    light in colour is light there too.
    """

    name: str
    share: float
    low: float
    high: float
    longer: float = 1.0
    to_the_eye: bool = False

    def at(self, rank: float, wavelength_nm: Wavelength, seen: float) -> float:
        """Diffuse reflectance; rank: 0..1 from low to high · seen: reflectance of the colour to the eye, 0..1."""
        value = self.low + rank * (self.high - self.low)
        if wavelength_nm == 940:
            value *= self.longer
        return max(value, seen) if self.to_the_eye else value


_CARBON = ("carbon black", 0.03, 0.08)


def _carbon(share: float) -> Dye:
    name, low, high = _CARBON
    return Dye(name, share, low, high, to_the_eye=True)


# By material: how it is dyed.
DYES: Mapping[str, tuple[Dye, ...]] = MappingProxyType(
    {
        "cotton": (
            Dye("reactive", 0.70, 0.45, 0.68), Dye("sulphur", 0.12, 0.10, 0.40, 1.1, to_the_eye=True), _carbon(0.18)
        ),
        "denim": (Dye("indigo", 0.75, 0.45, 0.65, 1.04), Dye("sulphur", 0.25, 0.10, 0.40, 1.1, to_the_eye=True)),
        "wool": (Dye("acid", 0.75, 0.35, 0.68, 1.1), Dye("chrome", 0.25, 0.10, 0.40, 1.1, to_the_eye=True)),
        "synthetic_fabric": (Dye("disperse", 0.65, 0.40, 0.65, 1.09), _carbon(0.35)),
        "print": (Dye("pigment", 0.5, 0.40, 0.70), _carbon(0.5)),
        "leather_shoe": (
            Dye("tanned", 0.15, 0.50, 0.70), Dye("dyed through", 0.35, 0.25, 0.55),
            Dye("carbon finish", 0.5, 0.05, 0.12, to_the_eye=True),
        ),
        "seat_fabric": (Dye("disperse", 0.65, 0.35, 0.60, 1.09), _carbon(0.35)),
        "seat_leather": (
            Dye("dyed through", 0.4, 0.25, 0.55), Dye("carbon finish", 0.35, 0.05, 0.12, to_the_eye=True),
            Dye("cool pigment", 0.25, 0.20, 0.40),
        ),
        "soft_trim": (Dye("carbon black", 0.6, 0.02, 0.06, to_the_eye=True), Dye("cool pigment", 0.4, 0.15, 0.40)),
        "hard_plastic": (Dye("carbon black", 0.7, 0.02, 0.06, to_the_eye=True), Dye("cool pigment", 0.3, 0.15, 0.40)),
        "headliner": (Dye("undyed", 1.0, 0.50, 0.75, 1.04),),
        "carpet": (Dye("acid", 0.5, 0.40, 0.60, 1.04), _carbon(0.5)),
        "steering_leather": (Dye("carbon finish", 0.7, 0.05, 0.12, to_the_eye=True), Dye("dyed through", 0.3, 0.25, 0.55)),
    }
)  # fmt: skip

# By the colour that grows: least and most diffuse reflectance, at both wavelengths.
HAIR: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "black": (0.02, 0.08), "dark_brown": (0.15, 0.35), "light_brown": (0.40, 0.60), "blond": (0.40, 0.60),
        "red": (0.40, 0.60), "grey": (0.50, 0.70),
    }
)  # fmt: skip


class SkinTone(NamedTuple):
    """Skin of a tone: mean and standard deviation over people of its reflectance at 850 and at 940 nm."""

    tone: float
    at_850: tuple[float, float]
    at_940: tuple[float, float]


# By the place on the Monk scale, 0 (lightest) to 9 (assumed of the groups that were measured); in between they are interpolated.
SKIN: tuple[SkinTone, ...] = (
    SkinTone(0.0, (0.570, 0.044), (0.485, 0.039)),
    SkinTone(4.0, (0.579, 0.048), (0.497, 0.042)),
    SkinTone(6.0, (0.514, 0.091), (0.453, 0.070)),
    SkinTone(9.0, (0.324, 0.095), (0.342, 0.074)),
)
SKIN_LIMITS: Mapping[Wavelength, tuple[float, float]] = MappingProxyType({850: (0.255, 0.681), 940: (0.270, 0.584)})
"""Least and most of any group that was measured."""
