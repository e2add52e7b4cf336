"""Images for the browser: 16 bits a pixel as they are, coloured there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from fastapi import APIRouter, HTTPException, Response
from numpy.typing import NDArray

from cabinpose.core import CabinposeError
from cabinpose.store import DEPTH_SCALE_M

DEPTHS = ("depth", "depth_clean", "depth_styled")
GREYS = ("amplitude", "confidence")
CLASSES = ("labels", "instance")
IMAGES = (*DEPTHS, *GREYS, *CLASSES)


@dataclass(frozen=True)
class Picture:
    """An image as it travels.

    values: (H, W), 0 = invalid · kind: how to colour it · step: of a value, in `unit`.
    """

    values: NDArray[np.uint16] | NDArray[np.uint8]
    kind: str  # ramp, grey or classes
    step: float = 1.0
    unit: str = ""

    def response(self, *, keep: bool) -> Response:
        """As HTTP; keep: the browser may keep it, since it never changes."""
        height, width = self.values.shape
        headers = {
            "x-width": str(width), "x-height": str(height), "x-step": repr(self.step), "x-unit": self.unit, "x-kind": self.kind,
            "x-bits": str(8 * self.values.dtype.itemsize), "cache-control": "private, max-age=3600" if keep else "no-store",
        }  # fmt: skip
        little = self.values.astype(self.values.dtype.newbyteorder("<"))
        return Response(little.tobytes(), media_type="application/octet-stream", headers=headers)


def picture(name: str, image: NDArray[np.generic]) -> Picture:
    """A variable's image: depths are float32 m with NaN where invalid."""
    if name in DEPTHS:
        ticks = np.nan_to_num(np.asarray(image, np.float64), nan=0.0) / DEPTH_SCALE_M
        return Picture(np.clip(np.rint(ticks), 0, 65535).astype(np.uint16), "ramp", DEPTH_SCALE_M, "m")
    if name in GREYS:
        return Picture(image.astype(np.uint16), "grey")
    return Picture(image.astype(np.uint8), "classes")


def row_of(dataset: xr.Dataset, number: int) -> int:
    """The row of the frame of a number. Raises HTTPException where there is none."""
    rows = np.flatnonzero(dataset["frame"].values == number)
    if not rows.size:
        raise HTTPException(404, "there is no such frame")
    return int(rows[0])


def image_routes(dataset: Callable[[str], xr.Dataset | None]) -> APIRouter:
    """`/frames/{key}/{number}/{variable}`: an image of the dataset that is open and has this key."""
    router = APIRouter()

    @router.get("/frames/{key}/{number}/{name}")
    def image(key: str, number: int, name: str) -> Response:
        opened = dataset(key)
        if opened is None or name not in IMAGES or name not in opened:
            raise HTTPException(404, "there is no such image")
        try:
            values = opened[name][row_of(opened, number)].values
        except (CabinposeError, OSError) as error:  # the dataset vanished, or is damaged
            raise HTTPException(404, str(error)) from error
        return picture(name, values).response(keep=True)

    return router
