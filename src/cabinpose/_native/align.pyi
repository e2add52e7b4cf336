"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def fit_corners(
    image: Annotated[NDArray[numpy.float64], dict(shape=(None, None), writable=False)],
    *,
    start: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), writable=False)],
    along: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), writable=False)],
    down: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), writable=False)],
    offset: Annotated[NDArray[numpy.float64], dict(shape=(None, 2))],
    levels: Annotated[NDArray[numpy.float64], dict(shape=(None, 6))],
) -> float:
    """Corners of a checkerboard by least squares; returns their blur."""
