"""Pictures of frames: 8 bits of grey, which common tools open and show, or 16 bits of millimetres, which keep the depth.

`depth8` falls from 255 at the camera to 1 at 4 m and beyond, so that what is near is bright; 0 is invalid. `amplitude8` rises
from 0 to 255 at 500 of the camera's raw units and beyond (the scale of the thesis). `depth16` is whole millimetres, 0 invalid.
`rgb` is the colour picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ConfigError
from cabinpose.store.frames import depth_mm, file_stem, frames, write_png

if TYPE_CHECKING:
    import xarray as xr

_FARTHEST_M = 4.0  # holds cars, vans and people in a room: one scale for all datasets, in steps of 16 mm
_BRIGHTEST = 500.0


class Picture(NamedTuple):
    """A kind of picture: the variable that it shows, its pixels of the variable's (H, W), and its scale as plain data."""

    variable: str
    pixels: Callable[[NDArray[Any]], NDArray[Any]]
    scale: MappingProxyType[str, Any]


def _depth8(depth_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    grey = 255 - 254 * np.minimum(np.nan_to_num(depth_m), _FARTHEST_M) / _FARTHEST_M
    return np.where(np.isfinite(depth_m), np.rint(grey), 0).astype(np.uint8)


def _amplitude8(amplitude: NDArray[np.uint16]) -> NDArray[np.uint8]:
    return np.rint(np.minimum(amplitude, _BRIGHTEST) * (255 / _BRIGHTEST)).astype(np.uint8)


PICTURES = MappingProxyType(
    {
        "depth8": Picture("depth", _depth8, MappingProxyType({"grey": [255, 1], "depth_m": [0.0, _FARTHEST_M], "invalid": 0})),
        "amplitude8": Picture("amplitude", _amplitude8, MappingProxyType({"grey": [0, 255], "amplitude": [0.0, _BRIGHTEST]})),
        "depth16": Picture("depth", depth_mm, MappingProxyType({"grey": [1, 65535], "depth_m": [0.001, 65.535], "invalid": 0})),
        "rgb": Picture("rgb", np.asarray, MappingProxyType({"colour": "sRGB"})),
    }
)


def check_kind(kind: str, kinds: Sequence[str]) -> None:
    """Raise ConfigError unless a format has pictures of this kind."""
    if kind not in kinds:
        raise ConfigError(f"there are no images of the kind {kind}", hint=f"choose one of {', '.join(kinds)}")


def pictured(dataset: xr.Dataset, folder: Path, kind: str) -> Iterator[xr.Dataset]:
    """Write the picture of every frame into a new folder, and give the frame, with who is where in it, when it is written."""
    folder.mkdir(parents=True)
    picture = PICTURES[kind]
    for frame in frames(dataset, (picture.variable, "instance")):
        write_png(folder / f"{file_stem(frame)}.png", picture.pixels(frame[picture.variable].values))
        yield frame
