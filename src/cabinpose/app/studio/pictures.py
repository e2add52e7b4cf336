"""Images for the browser: 16 bits a pixel, coloured there; those of datasets travel compressed."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
        """As HTTP; keep: the browser may keep it, since it never changes, and it is packed."""
        height, width = self.values.shape
        headers = {
            "x-width": str(width), "x-height": str(height), "x-step": repr(self.step), "x-unit": self.unit, "x-kind": self.kind,
            "x-bits": str(8 * self.values.dtype.itemsize),
        }  # fmt: skip
        if keep:
            return packed_response([self.values], headers)
        little = self.values.astype(self.values.dtype.newbyteorder("<"))
        return Response(little.tobytes(), media_type="application/octet-stream", headers=headers | {"cache-control": "no-store"})


def packed(values: NDArray[np.uint16] | NDArray[np.int16] | NDArray[np.uint8]) -> bytes:
    """Whole numbers, of any shape, as differences from one to the next: small ones even, the low bytes first, then the high ones.

    So a noisy depth image takes half of its bytes with the quickest compression, in a third less time than as it is.
    """
    flat = values.ravel()
    step = np.diff(flat, prepend=flat.dtype.type(0)).view(f"i{flat.itemsize}")
    even = (step << 1) ^ (step >> (8 * flat.itemsize - 1))
    return even.astype(f"<i{flat.itemsize}").view(np.uint8).reshape(-1, flat.itemsize).T.tobytes()


def packed_response(arrays: Sequence[NDArray[Any]], headers: Mapping[str, str]) -> Response:
    """Arrays as `packed` gives them, one after the other, which the browser may keep."""
    body = zlib.compress(b"".join(map(packed, arrays)), 1, wbits=zlib.MAX_WBITS | 16)
    told = {**headers, "x-packed": "1", "content-encoding": "gzip", "cache-control": "private, max-age=3600"}
    return Response(body, media_type="application/octet-stream", headers=told)


def picture(name: str, image: NDArray[np.generic]) -> Picture:
    """A variable's image: depths are float32 m with NaN where invalid."""
    if name in DEPTHS:
        ticks = np.nan_to_num(np.asarray(image, np.float32)) * np.float32(1 / DEPTH_SCALE_M) + np.float32(0.5)
        return Picture(np.clip(ticks, 0, 65535).astype(np.uint16), "ramp", DEPTH_SCALE_M, "m")
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
