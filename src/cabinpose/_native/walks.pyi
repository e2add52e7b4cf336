"""Made by tools/make_stubs.py from the extension."""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def grow(
    depth: Annotated[NDArray[numpy.uint16], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    view: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
    frame: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    targets: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    pool: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order="C", device="cpu", writable=False)],
    tried: int,
    most: int,
    least: int,
    deepest: int,
) -> tuple[
    Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order="C")],
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
]:
    """
    A regression tree: offsets, thresholds and children of its nodes, and each sample's leaf.
    """

def cluster(
    targets: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    order: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    starts: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    rounds: int,
    directions: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu")],
    shares: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu")],
) -> None:
    """Clusters the targets of each leaf: unit directions, cumulative shares."""

def walk(
    depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    view: Annotated[NDArray[numpy.float32], dict(shape=(3), order="C", device="cpu", writable=False)],
    starts: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    order: Annotated[NDArray[numpy.int32], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    forest: tuple[object, ...],
    step: float,
    skipped: int,
    places: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, None, 3), order="C", device="cpu")],
    joints: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 3), order="C", device="cpu")],
) -> None:
    """
    Walks to the joints of people: the places of every walk, and their means.
    """
