"""Units of length: the one table of what they are, what files call them, and which of them a measured length is in."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Final

LENGTHS_M: Final[Mapping[str, float]] = MappingProxyType(
    {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "um": 1e-6, "inch": 0.0254, "ft": 0.3048}
)
"""Metres of each unit, by the name that we print."""
CMU_UNIT_M: Final = LENGTHS_M["inch"] / 0.45
"""Metres of the unit of the CMU database, which gives inches times 0.45."""

# Other words for them, in small letters: C3D's POINT:UNITS, GenICam's Scan3dDistanceUnit, descriptions of LSL's streams.
_WORDS: Mapping[str, str] = MappingProxyType(
    {
        word: name
        for name, words in {
            "m": "meter meters metre metres",
            "cm": "centimeter centimeters centimetre centimetres",
            "mm": "millimeter millimeters millimetre millimetres",
            "inch": "in inches",
            "ft": "foot feet",
        }.items()
        for word in words.split()
    }
)


def metres_of(word: str) -> float | None:
    """Metres of a unit of length by its name or another word for it, in letters of any size; None for what is none."""
    name = word.strip().lower()
    return LENGTHS_M.get(_WORDS.get(name, name))


def units_that_fit(length: float, span_m: tuple[float, float], units: Collection[str] = ("m", "cm", "mm", "inch")) -> list[str]:
    """Those of the units in which a length, given in them, lies within a span of metres."""
    return [name for name in units if span_m[0] <= length * LENGTHS_M[name] <= span_m[1]]
