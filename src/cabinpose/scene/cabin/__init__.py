"""Parametric car interiors from SAE J1100 dimensions, and the user's own car meshes in their place.

`load_cabin` and `CabinFile` load trimesh when they are first asked for: the parametric cars do without.
"""

from typing import TYPE_CHECKING, Any

from cabinpose.scene.cabin.belt import BeltMisuse, BeltWear, belt_surface, fastening_surface, harness_surface
from cabinpose.scene.cabin.build import SEATS_OF_ALL, VIEWS_OF_ALL, build_cabin
from cabinpose.scene.cabin.dimensions import CabinDimensions
from cabinpose.scene.cabin.draw import random_dimensions
from cabinpose.scene.cabin.model import BeltAnchors, Cabin, Part, Seat, SeatSetting, SteeringWheel, ViewAnchor
from cabinpose.scene.cabin.presets import PRESET_DIMENSIONS, PRESETS

if TYPE_CHECKING:
    from cabinpose.scene.cabin.car_file import CabinFile
    from cabinpose.scene.cabin.imported import load_cabin

__all__ = [
    "PRESETS",
    "PRESET_DIMENSIONS",
    "SEATS_OF_ALL",
    "VIEWS_OF_ALL",
    "BeltAnchors",
    "BeltMisuse",
    "BeltWear",
    "Cabin",
    "CabinDimensions",
    "CabinFile",
    "Part",
    "Seat",
    "SeatSetting",
    "SteeringWheel",
    "ViewAnchor",
    "belt_surface",
    "build_cabin",
    "fastening_surface",
    "harness_surface",
    "load_cabin",
    "random_dimensions",
]


def __getattr__(name: str) -> Any:
    if name not in {"CabinFile", "load_cabin"}:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from cabinpose.scene.cabin import imported  # noqa: PLC0415 - trimesh, for a user's own mesh alone

    return getattr(imported, name)
