"""What a configuration may say of a sensor's lens: its calibration, or the field of view that its data sheet has."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi, radians
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import Camera, ConfigError, Distortion

_HORIZONTAL, _VERTICAL = ("fov_deg", "hfov"), "vfov"
_ANGLES = (*_HORIZONTAL, _VERTICAL)
_DEGREES = "degrees from edge to edge of the image, without distortion"


class LensKeys(BaseModel):
    """The keys of `sensor.camera` as schemas and messages list them; `lens_of_keys` makes those of a `Camera` of them."""

    model_config = ConfigDict(extra="forbid")

    width: int = Field(description="Pixels of a row.")
    height: int = Field(description="Pixels of a column.")
    fov_deg: float | None = Field(None, description=f"Horizontal field of view, {_DEGREES}, in place of fx and fy.")
    hfov: float | None = Field(None, description="The same as fov_deg.")
    vfov: float | None = Field(None, description=f"Vertical field of view, {_DEGREES}; left out: pixels are square.")
    fx: float | None = Field(None, description="Focal length, px, of a calibration; without one give fov_deg.")
    fy: float | None = Field(None, description="Focal length, px; left out: fx.")
    cx: float | None = Field(None, description="Principal point, px; left out: the middle of the image.")
    cy: float | None = Field(None, description="Principal point, px; left out: the middle of the image.")
    dist: Distortion = Field((0.0, 0.0, 0.0, 0.0, 0.0), description="OpenCV's k1 k2 p1 p2 k3.")


def lens_of_keys(data: Any) -> Any:
    """The keys of a `Camera` from those of `LensKeys`; what is no mapping as it came.

    Raises
    ------
    ConfigError
        For a field of view beside a focal length, two horizontal ones, or one that is none in degrees.
    """
    if not isinstance(data, Mapping):
        return data
    keys = {name: value for name, value in data.items() if name not in _ANGLES}
    angles = {name: data[name] for name in _ANGLES if data.get(name) is not None}
    for name, degrees in angles.items():
        if not _is_number(degrees) or not 0 < degrees < 180:
            raise ConfigError(f"{name}: no field of view: {degrees}", hint="give degrees between 0 and 180, from edge to edge")
        if degrees < pi:
            raise ConfigError(
                f"{name}: {degrees:g} degrees are the view of a telescope, and would be usual in radians",
                hint=f"give degrees: {name}: {degrees * 180 / pi:.4g}",
            )
    if not all(_is_number(keys.get(side)) and keys[side] > 0 for side in ("width", "height")):
        return {**dict.fromkeys(("fx", "fy", "cx", "cy"), 1.0), **keys}  # the size is what is told to be wrong, and nothing else
    across = [name for name in _HORIZONTAL if name in angles]
    if len(across) > 1 or (angles and any(keys.get(name) is not None for name in ("fx", "fy"))):
        both = " and ".join(name for name in (*angles, "fx", "fy") if name in angles or keys.get(name) is not None)
        raise ConfigError(f"{both} say the same", hint="give fx and fy of a calibration, or one of fov_deg and hfov")
    width, height = keys["width"], keys["height"]
    if across:
        vertical = radians(angles[_VERTICAL]) if _VERTICAL in angles else None
        lens = Camera.from_fov(width, height, radians(angles[across[0]]), vertical)
        keys |= {"fx": lens.fx, "fy": lens.fy}
    elif angles:
        keys |= dict.fromkeys(("fx", "fy"), Camera.from_fov(height, width, radians(angles[_VERTICAL])).fx)
    if "fx" in keys:
        keys.setdefault("fy", keys["fx"])
    return {"cx": (width - 1) / 2, "cy": (height - 1) / 2, **keys}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
