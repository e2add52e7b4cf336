"""Made by tools/make_stubs.py from the extension."""

from collections.abc import Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray

def simulate_continuous_wave(
    views: Sequence[tuple[object, ...]],
    shares: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    camera: tuple[object, ...],
    ranks: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    quantiles: Annotated[NDArray[numpy.float32], dict(shape=(65536), order="C", device="cpu", writable=False)],
    out: tuple[object, ...],
) -> None:
    """One frame of a continuous-wave Time-of-Flight camera."""

def indirect_light(
    view: tuple[object, ...],
    scene: tuple[object, ...],
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None:
    """Light that surfaces send on to others, by virtual point lights."""

def simulate_empirical(
    view: tuple[object, ...],
    camera: tuple[object, ...],
    ranks: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    quantiles: Annotated[NDArray[numpy.float32], dict(shape=(65536), order="C", device="cpu", writable=False)],
    out: tuple[object, ...],
) -> None:
    """One frame of a camera with measured noise."""

def simulate_structured_light(
    view: tuple[object, ...],
    camera: tuple[object, ...],
    ranks: Annotated[NDArray[numpy.uint16], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    quantiles: Annotated[NDArray[numpy.float32], dict(shape=(65536), order="C", device="cpu", writable=False)],
    out: tuple[object, ...],
) -> None:
    """One frame of a camera that matches a projected dot pattern."""
