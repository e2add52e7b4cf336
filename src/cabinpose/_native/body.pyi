"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated, Protocol

import numpy
from numpy.typing import NDArray

class RestArrays(Protocol):
    @property
    def offsets(self) -> Annotated[NDArray[numpy.float64], dict(shape=(23, 3), writable=False)]: ...
    @property
    def frames(self) -> Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), writable=False)]: ...
    @property
    def heads(self) -> Annotated[NDArray[numpy.float64], dict(shape=(75, 3), writable=False)]: ...
    @property
    def joint_bone(self) -> Annotated[NDArray[numpy.int64], dict(shape=20, writable=False)]: ...
    @property
    def joint_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(20, 3), writable=False)]: ...
    @property
    def palms(self) -> Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), writable=False)]: ...
    @property
    def soles(self) -> Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), writable=False)]: ...
    @property
    def pronation(self) -> Annotated[NDArray[numpy.float64], dict(shape=2, writable=False)]: ...
    @property
    def finger_axes(self) -> Annotated[NDArray[numpy.float64], dict(shape=(30, 3), writable=False)]: ...
    @property
    def finger_curl(self) -> Annotated[NDArray[numpy.float64], dict(shape=30, writable=False)]: ...

class Neighbours(Protocol):
    @property
    def start(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def near(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...

class Blend(Protocol):
    @property
    def start(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def parent(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def weight(self) -> Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)]: ...

class Trains(Protocol):
    @property
    def phase(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), writable=False)]: ...
    @property
    def strength(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), writable=False)]: ...
    @property
    def length(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)]: ...
    @property
    def start(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)]: ...

def bone_frames(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), writable=False)],
    rest: RestArrays,
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3))],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3))],
) -> None:
    """Frames of the main bones."""

def joint_positions(
    rest: RestArrays,
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3))],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(20, 3))],
) -> None:
    """The 20 joints, m."""

def end_frames(
    rest: RestArrays,
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3))],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3))],
    *,
    palms: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4))],
    soles: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4))],
) -> None:
    """Frames of palms and soles."""

def skin_transforms(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), writable=False)],
    rest: RestArrays,
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3))],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(75, 3, 4))],
) -> None:
    """What skinning applies to the mesh at rest."""

def pose(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), writable=False)],
    rest: RestArrays,
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3))],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3))],
    vehicle_from_mesh: Annotated[NDArray[numpy.float64], dict(shape=(75, 3, 4))],
    joints: Annotated[NDArray[numpy.float64], dict(shape=(20, 3))],
    *,
    palms: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4))],
    soles: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4))],
) -> None:
    """Bones, joints, palms, soles and skin transforms of a posture."""

def blend_shapes(
    mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    basis: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), writable=False)],
    coefficients: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3))],
) -> None:
    """A body at rest."""

def skin_layers(
    transforms: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 4), writable=False)],
    index: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    weight: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    layers: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), writable=False)],
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3))],
) -> None:
    """Layers of a mesh at rest, posed by linear blend skinning."""

def vertex_normals(
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), writable=False)],
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3))],
) -> None:
    """Unit normals of vertices, weighted by area."""

def relax(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    neighbours: Neighbours,
    share: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    sweeps: int,
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3))],
) -> None:
    """Laplacian smoothing."""

def stretch(
    under: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), writable=False)],
    neighbours: Neighbours,
    mask: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    *,
    gap: float,
    evening: int,
    sweeps: int,
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3))],
) -> None:
    """An elastic membrane over a body."""

def refine(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), writable=False)],
    blend: Blend,
    *,
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3))],
    normals: Annotated[NDArray[numpy.float32], dict(shape=(None, 3))],
) -> None:
    """The seen mesh and its normals, rounded."""

def hang(
    *,
    down: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    radius: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    angle: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    narrowing: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Radius of cloth hanging about an axis."""

def roll_ball(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    *,
    origin: Annotated[NDArray[numpy.float64], dict(shape=(None, None, 3), writable=False)],
    direction: Annotated[NDArray[numpy.float64], dict(shape=(None, None, 3), writable=False)],
    ball: float,
    radius: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    touched: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
) -> None:
    """
    How far out along rays a ball rolls on points, and which of them it touches.
    """

def fill_noise(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    where: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    waves: Annotated[NDArray[numpy.float64], dict(shape=(None, None, 3), writable=False)],
    phases: Annotated[NDArray[numpy.float64], dict(shape=(None, None), writable=False)],
    blend: Blend,
    out: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
) -> None:
    """Smooth noise at every seen vertex."""

def raise_folds(
    trains: Trains,
    noise: Annotated[NDArray[numpy.float64], dict(shape=(None, None), writable=False)],
    where: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Height of folds."""
