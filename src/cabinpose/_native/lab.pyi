"""Made by tools/make_stubs.py from the extension."""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def faces_between(
    eyes: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    possible: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order="C", device="cpu")],
) -> None:
    """Faces that may come between eyes and points."""

def see_markers(
    eyes: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    markers: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    ends: float,
    seen: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order="C", device="cpu")],
) -> None:
    """Which eyes see which markers."""

def cast(
    pixels: tuple[object, ...],
    scene: tuple[object, ...],
    reflectance: float,
    depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
    cosine: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
) -> tuple[
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
    Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order="C")],
    Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order="C")],
]:
    """
    Depth and light by one ray a pixel; returns the pixels that see several surfaces, and their parts' depth and light.
    """
