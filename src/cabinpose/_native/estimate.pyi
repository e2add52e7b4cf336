"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated, Protocol

import numpy
from numpy.typing import NDArray

class SightLimits(Protocol):
    @property
    def touching(self) -> float: ...
    @property
    def near(self) -> float: ...
    @property
    def nearer(self) -> float: ...
    @property
    def edge(self) -> float: ...
    @property
    def step(self) -> float: ...
    @property
    def off(self) -> float: ...
    @property
    def darkest(self) -> float: ...
    @property
    def every(self) -> int: ...

def see(
    depth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    *,
    amplitude: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    limits: SightLimits,
) -> tuple[int, int, int, int, int, int, int, int, int, int, int, int, int, int]:
    """
    What tells whether a frame can be a picture of people: valid, touching, near, nearer, pairs, steps, lit; over all pixels valid, joined, odd; blocks, pairs of them, edges, blocks off one surface.
    """
