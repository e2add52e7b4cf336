"""Parametric car interiors from SAE J1100 dimensions, and the user's own car meshes in their place."""

from cabinpose.scene.cabin.belt import belt_surface
from cabinpose.scene.cabin.build import build_cabin
from cabinpose.scene.cabin.dimensions import CabinDimensions
from cabinpose.scene.cabin.draw import random_dimensions
from cabinpose.scene.cabin.imported import CabinFile, load_cabin
from cabinpose.scene.cabin.model import BeltAnchors, Cabin, Part, Seat, SeatSetting, SteeringWheel, ViewAnchor
from cabinpose.scene.cabin.presets import PRESET_DIMENSIONS, PRESETS

__all__ = [
    "PRESETS",
    "PRESET_DIMENSIONS",
    "BeltAnchors",
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
    "load_cabin",
    "random_dimensions",
]
