"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def spring_transform(
    score: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), writable=False)],
    spring: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), writable=False)],
    best: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None))],
    source: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
) -> None:
    """The best of maps of scores under quadratic springs, and where it is."""
