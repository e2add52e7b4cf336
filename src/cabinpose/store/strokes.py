"""Lines, dots and words in images, with smooth edges, and the colours of people."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from PIL import ImageDraw, ImageFont

Image = NDArray[np.uint8]  # (H, W, 3) RGB
Colour = tuple[int, int, int]
# By person; told apart by people with any colour vision (Okabe and Ito 2008, without black and grey).
PERSON_COLOUR: tuple[Colour, ...] = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (204, 121, 167), (213, 94, 0))
_FINER = 4  # lines and dots are drawn so many times larger, then averaged


class Strokes:
    """Lines and dots with smooth edges, drawn over an image in place when the block ends. Places are (x, y) px, middles whole."""

    def __init__(self, image: Image) -> None:
        self._image = image
        self._layer = PilImage.new("RGBA", (image.shape[1] * _FINER, image.shape[0] * _FINER))
        self._draw = ImageDraw.Draw(self._layer)

    def __enter__(self) -> Strokes:
        return self

    def __exit__(self, *_: object) -> None:
        over = np.asarray(self._layer.reduce(_FINER), np.float64)
        share = over[..., 3:] / 255.0
        self._image[...] = (over[..., :3] * share + self._image * (1.0 - share)).round()

    def line(self, start: NDArray[np.float64], end: NDArray[np.float64], colour: Colour, width: float) -> None:
        """A line `width` px wide."""
        self._draw.line([*self._finer(start), *self._finer(end)], colour, round(width * _FINER))

    def dot(self, at: NDArray[np.float64], radius: float, colour: Colour) -> None:
        """A filled circle of a radius in px."""
        x, y = self._finer(at)
        r = radius * _FINER
        self._draw.ellipse([x - r, y - r, x + r, y + r], colour)

    @staticmethod
    def _finer(at: NDArray[np.float64]) -> tuple[float, float]:
        return float(at[0] + 0.5) * _FINER, float(at[1] + 0.5) * _FINER


def text(image: Image, words: str, xy: tuple[int, int], colour: Colour = (32, 36, 44), size: int = 14, weight: int = 400) -> None:
    """Write words with their baseline's left end at `xy`; a weight above 500 is bold."""
    picture = PilImage.fromarray(image)
    draw = ImageDraw.Draw(picture)
    for shift in (0.0, 0.5) if weight > _BOLD else (0.0,):
        draw.text((xy[0] + shift, xy[1]), words, colour, _font(size), anchor="ls")
    image[...] = np.asarray(picture)


_BOLD = 500


@lru_cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
