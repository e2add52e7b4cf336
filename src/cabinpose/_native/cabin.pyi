"""Made by tools/make_stubs.py from the extension."""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def any_nearer(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    place: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
    distance: float,
) -> bool:
    """Whether any point is nearer to a place than a distance."""

def belt_ribbon(
    skin: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    bones: tuple[object, ...],
    course: Annotated[NDArray[numpy.float64], dict(shape=(4, 3), order="C", device="cpu", writable=False)],
    webbing: tuple[object, ...],
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(2, None, 3, 3), order="C", device="cpu")],
    normals: Annotated[NDArray[numpy.float32], dict(shape=(2, None, 3, 3), order="C", device="cpu")],
) -> bool:
    """
    Lay a taut ribbon over a body; whether its triangles have to be turned.
    """
