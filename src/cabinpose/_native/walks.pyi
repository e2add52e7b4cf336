"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated, Protocol

import numpy
from numpy.typing import NDArray

class Forest(Protocol):
    @property
    def roots(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def offsets(self) -> Annotated[NDArray[numpy.float32], dict(shape=(None, 4), writable=False)]: ...
    @property
    def thresholds(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def children(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def directions(self) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), writable=False)]: ...
    @property
    def shares(self) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)]: ...

def grow(
    depth: Annotated[NDArray[numpy.uint16], dict(shape=(None, None, None), writable=False)],
    view: Annotated[NDArray[numpy.float32], dict(shape=(3), writable=False)],
    frame: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    *,
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    targets: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    pool: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), writable=False)],
    tried: int,
    most: int,
    least: int,
    deepest: int,
) -> tuple[
    Annotated[NDArray[numpy.float32], dict(shape=(None, 4))],
    Annotated[NDArray[numpy.int32], dict(shape=(None,))],
    Annotated[NDArray[numpy.int32], dict(shape=(None,))],
    Annotated[NDArray[numpy.int32], dict(shape=(None,))],
]:
    """
    A regression tree: offsets, thresholds and children of its nodes, and each sample's leaf.
    """

def cluster(
    targets: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    *,
    order: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    starts: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    rounds: int,
    directions: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3))],
    shares: Annotated[NDArray[numpy.float32], dict(shape=(None, None))],
) -> None:
    """Clusters the targets of each leaf: unit directions, cumulative shares."""

def walk(
    depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), writable=False)],
    view: Annotated[NDArray[numpy.float32], dict(shape=(3), writable=False)],
    starts: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    order: Annotated[NDArray[numpy.int32], dict(shape=(None, 2), writable=False)],
    forest: Forest,
    *,
    step: float,
    skipped: int,
    places: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, None, 3))],
    joints: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, 3))],
) -> None:
    """
    Walks to the joints of people: the places of every walk, and their means.
    """
