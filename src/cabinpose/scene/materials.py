"""Materials and their diffuse reflectance at 850 nm.

Near-infrared reflectance differs from what the eye sees: most dyed black fabrics are bright at 850 nm, carbon-black
plastics stay dark, skin is near 0.55-0.65 for all skin tones.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple


class Material(NamedTuple):
    """A surface material: id (fits uint8), name, diffuse reflectance at 850 nm, and whether light passes (glass)."""

    id: int
    name: str
    reflectance: float
    transmissive: bool = False


# All materials, by id, with the reflectance in near infrared.
MATERIALS: tuple[Material, ...] = (
    Material(0, "nothing", 0.0),
    Material(1, "skin", 0.58),
    Material(2, "hair", 0.30),
    Material(3, "cotton", 0.65),
    Material(4, "denim", 0.55),
    Material(5, "wool", 0.50),
    Material(6, "synthetic_fabric", 0.45),
    Material(7, "leather_shoe", 0.25),
    Material(8, "seat_fabric", 0.35),
    Material(9, "seat_leather", 0.45),
    Material(10, "soft_trim", 0.20),
    Material(11, "hard_plastic", 0.10),
    Material(12, "headliner", 0.60),
    Material(13, "carpet", 0.15),
    Material(14, "glass", 0.05, transmissive=True),
    Material(15, "metal", 0.35),
    Material(16, "rubber", 0.05),
    Material(17, "belt_webbing", 0.30),
    Material(18, "spectacle_lens", 0.06, transmissive=True),
    Material(19, "painted_wall", 0.75),
    Material(20, "wood", 0.50),
    Material(21, "steering_leather", 0.15),
    Material(30, "eye", 0.40),  # the white of it, darker than skin; of eyes and mouths all are assumed
    Material(31, "iris", 0.35),
    Material(32, "pupil", 0.04),
    Material(33, "mouth", 0.25),
    Material(40, "cardboard", 0.60),
    Material(41, "paper", 0.75),
)
OF_THINGS = MATERIALS[-2:]  # of things that people bring along alone
MATERIAL_ID = MappingProxyType({material.name: material.id for material in MATERIALS})  # by name
