"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated, Protocol

import numpy
from numpy.typing import NDArray

class LainOn(Protocol):
    @property
    def labels(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)]: ...
    @property
    def kinds(self) -> Annotated[NDArray[numpy.uint8], dict(shape=256, writable=False)]: ...
    @property
    def limbs(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 7), writable=False)]: ...

class TrunkBones(Protocol):
    @property
    def ends(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 2, 3), writable=False)]: ...
    @property
    def girth(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)]: ...
    @property
    def n_trunk(self) -> int: ...

class Webbing(Protocol):
    @property
    def width(self) -> float: ...
    @property
    def thickness(self) -> float: ...
    @property
    def gap(self) -> float: ...

def any_nearer(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    place: Annotated[NDArray[numpy.float32], dict(shape=(3), writable=False)],
    distance: float,
) -> bool:
    """Whether any point is nearer to a place than a distance."""

def belt_ribbon(
    skin: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), writable=False)],
    lain_on: LainOn,
    bones: TrunkBones,
    course: Annotated[NDArray[numpy.float64], dict(shape=(4, 3), writable=False)],
    webbing: Webbing,
    *,
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(2, None, 3, 3))],
    normals: Annotated[NDArray[numpy.float32], dict(shape=(2, None, 3, 3))],
) -> bool:
    """
    Lay a taut ribbon over a body; whether its triangles have to be turned.
    """
