"""Made by tools/make_stubs.py from the extension."""

from typing import Annotated

import numpy
from numpy.typing import NDArray

BLOCK_COLUMNS: int = 4

BLOCK_ROWS: int = 2

def render(
    surface: tuple[object, ...],
    camera_from_vehicle: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    closed: bool,
    eye: tuple[object, ...],
    joints: tuple[object, ...],
    images: tuple[object, ...],
    buffers: tuple[object, ...],
    states: Annotated[NDArray[numpy.uint8], dict(shape=(None, 20), order="C", device="cpu")],
) -> int:
    """
    Fill the images, buffers and states of joints of one frame; the number of mixed pixels.
    """
