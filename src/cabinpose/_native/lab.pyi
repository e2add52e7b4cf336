"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated, Protocol

import numpy
from numpy.typing import NDArray

class PixelRays(Protocol):
    @property
    def centres(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, 2), writable=False)]: ...
    @property
    def corners(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, 2), writable=False)]: ...
    @property
    def factors(self) -> Annotated[NDArray[numpy.float32], dict(shape=(None, 4), writable=False)]: ...

class SceneArrays(Protocol):
    @property
    def planes(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 5), writable=False)]: ...
    @property
    def capsules(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 8), writable=False)]: ...
    @property
    def spheres(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 5), writable=False)]: ...
    @property
    def plates(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 24), writable=False)]: ...

def faces_between(
    *,
    eyes: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), writable=False)],
    possible: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
) -> None:
    """Faces that may come between eyes and points."""

def see_markers(
    *,
    eyes: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    markers: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), writable=False)],
    ends: float,
    seen: Annotated[NDArray[numpy.bool_], dict(shape=(None, None))],
) -> None:
    """Which eyes see which markers."""

def cast(
    pixels: PixelRays,
    scene: SceneArrays,
    reflectance: float,
    *,
    depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None))],
    cosine: Annotated[NDArray[numpy.float32], dict(shape=(None, None))],
) -> tuple[
    Annotated[NDArray[numpy.int32], dict(shape=(None,))],
    Annotated[NDArray[numpy.float32], dict(shape=(None, 4))],
    Annotated[NDArray[numpy.float32], dict(shape=(None, 4))],
]:
    """
    Depth and light by one ray a pixel; returns the pixels that see several surfaces, and their parts' depth and light.
    """
