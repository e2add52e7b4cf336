"""Made by tools/make_stubs.py from the extension."""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def spring_transform(
    score: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    spring: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order="C", device="cpu", writable=False)],
    best: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
    source: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None:
    """The best of maps of scores under quadratic springs, and where it is."""
