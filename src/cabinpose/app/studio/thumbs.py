"""Frames as small images in a grid: the element, and where its images come from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any

import numpy as np
import xarray as xr
from fastapi import APIRouter, HTTPException, Response
from nicegui.element import Element
from numpy.typing import NDArray
from PIL import Image

from cabinpose.app.studio.pictures import CLASSES, DEPTHS, GREYS, IMAGES, row_of
from cabinpose.app.view.draw import INVALID, colour_map, depth_range
from cabinpose.core import CabinposeError
from cabinpose.store import PERSON_COLOUR, label_colours

WIDTH = 128  # px of a small image
INSTANCES = [[30, 32, 38], *[list(colour) for colour in PERSON_COLOUR]]


class FrameGrid(Element, component="thumbs.js"):
    """Frames in a grid, of which one is chosen by arrow keys or a click, and opened by Enter or a double click."""

    def __init__(self, size: tuple[int, int], on_chosen: Callable[[int], Any], on_open: Callable[[], Any]) -> None:
        """size: (width, height) of the frames, px · on_chosen: is given the place of a frame among those shown."""
        super().__init__()
        self.classes("w-full h-full")
        width, height = size
        self._props |= {"url": "", "query": "", "runs": [], "notes": [], "chosen": 0}
        self._props |= {"width": WIDTH, "height": round(WIDTH * height / width)}
        self.on("chosen", lambda event: on_chosen(int(event.args)))
        self.on("open", lambda _: on_open(), args=[])

    def show(self, url: str, query: str, numbers: NDArray[np.int64], notes: Sequence[str]) -> None:
        """Show frames, by their numbers, in this order; url: of `thumb_routes`, before the number · notes: of each, or none."""
        first = np.flatnonzero(np.diff(numbers, prepend=numbers[:1] - 2) != 1)
        counts = np.diff(first, append=len(numbers))
        self._props |= {
            "url": url,
            "query": query,
            "runs": np.stack((numbers[first], counts), axis=1).tolist(),
            "notes": list(notes),
        }
        self.update()

    def choose(self, place: int) -> None:
        """Mark a frame, by its place among those shown, and bring it into view."""
        if self._props["chosen"] != place:
            self._props["chosen"] = place
            self.update()

    def focus(self) -> None:
        """Give the grid the keyboard."""
        self.run_method("focus")


def thumb(dataset: xr.Dataset, name: str, row: int, limits: tuple[float, float] | None) -> bytes:
    """A frame's image of a variable as a small PNG; limits: depths of the ends of the colours, m, None for those of the frame."""
    step = max(dataset.sizes["x"] // WIDTH, 1)
    image = dataset[name][row].values[::step, ::step]
    if name in DEPTHS:
        near, far = depth_range(image) if limits is None else limits
        share = np.clip((image - near) / max(far - near, 1e-6), 0, 1)
        picture = np.where(np.isnan(image), 0, 1 + np.nan_to_num(share) * 254).astype(np.uint8)
        palette: Any = [INVALID, *colour_map()[1:].tolist()]
    elif name in GREYS:
        white = float(np.quantile(image, 0.995)) or 1.0
        picture = (np.sqrt(np.clip(image / white, 0, 1)) * 255).astype(np.uint8)
        palette = [[value] * 3 for value in range(256)]
    else:
        palette = label_colours(dataset).tolist() if name == CLASSES[0] else INSTANCES
        picture = (image.astype(np.int64) % len(palette)).astype(np.uint8)
    drawn = Image.fromarray(picture)
    drawn.putpalette(np.asarray(palette, np.uint8).tobytes())
    buffer = BytesIO()
    drawn.save(buffer, "png", compress_level=1)
    return buffer.getvalue()


def thumb_routes(dataset: Callable[[str], xr.Dataset | None]) -> APIRouter:
    """`/thumbs/{key}/{name}/{number}`: a small image of the dataset that is open and has this key; near, far: see `thumb`."""
    router = APIRouter()

    @router.get("/thumbs/{key}/{name}/{number}")
    def small(key: str, name: str, number: int, near: float | None = None, far: float | None = None) -> Response:
        opened = dataset(key)
        if opened is None or name not in IMAGES or name not in opened:
            raise HTTPException(404, "there is no such image")
        limits = None if near is None or far is None or not np.isfinite((near, far)).all() else (near, far)
        try:
            data = thumb(opened, name, row_of(opened, number), limits)
        except (CabinposeError, OSError) as error:  # the dataset vanished, or is damaged
            raise HTTPException(404, str(error)) from error
        return Response(data, media_type="image/png", headers={"cache-control": "private, max-age=3600"})

    return router
