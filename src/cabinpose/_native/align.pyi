"""Made by tools/make_stubs.py from the extension."""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def fit_corners(
    image: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    start: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    along: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    down: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    offset: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order="C", device="cpu")],
    levels: Annotated[NDArray[numpy.float64], dict(shape=(None, 6), order="C", device="cpu")],
) -> float:
    """Corners of a checkerboard by least squares; returns their blur."""
