"""Made by tools/make_stubs.py from the extension."""

from typing import Annotated

import numpy
from numpy.typing import NDArray

def bone_frames(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu")],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu")],
) -> None:
    """Frames of the main bones."""

def joint_positions(
    rest: tuple[object, ...],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu")],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu")],
    out: Annotated[NDArray[numpy.float64], dict(shape=(20, 3), order="C", device="cpu")],
) -> None:
    """The 20 joints, m."""

def end_frames(
    rest: tuple[object, ...],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu")],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu")],
    palms: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), order="C", device="cpu")],
    soles: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), order="C", device="cpu")],
) -> None:
    """Frames of palms and soles."""

def skin_transforms(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    rest: tuple[object, ...],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu")],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu")],
    out: Annotated[NDArray[numpy.float64], dict(shape=(75, 3, 4), order="C", device="cpu")],
) -> None:
    """What skinning applies to the mesh at rest."""

def pose(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu")],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu")],
    vehicle_from_mesh: Annotated[NDArray[numpy.float64], dict(shape=(75, 3, 4), order="C", device="cpu")],
    joints: Annotated[NDArray[numpy.float64], dict(shape=(20, 3), order="C", device="cpu")],
    palms: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), order="C", device="cpu")],
    soles: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), order="C", device="cpu")],
) -> None:
    """Bones, joints, palms, soles and skin transforms of a posture."""

def blend_shapes(
    mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    basis: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    coefficients: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
) -> None:
    """A body at rest."""

def skin_layers(
    transforms: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 4), order="C", device="cpu", writable=False)],
    index: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    weight: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    layers: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), order="C", device="cpu")],
) -> None:
    """Layers of a mesh at rest, posed by linear blend skinning."""

def vertex_normals(
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
) -> None:
    """Unit normals of vertices, weighted by area."""

def relax(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    neighbours: tuple[object, ...],
    share: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    sweeps: int,
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
) -> None:
    """Laplacian smoothing."""

def stretch(
    under: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    neighbours: tuple[object, ...],
    mask: Annotated[NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    gap: float,
    evening: int,
    sweeps: int,
    out: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
) -> None:
    """An elastic membrane over a body."""

def refine(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    blend: tuple[object, ...],
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
    normals: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
) -> None:
    """The seen mesh and its normals, rounded."""

def hang(
    down: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    radius: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    angle: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    narrowing: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
) -> None:
    """Radius of cloth hanging about an axis."""

def fill_noise(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    where: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    waves: Annotated[NDArray[numpy.float64], dict(shape=(None, None, 3), order="C", device="cpu", writable=False)],
    phases: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    blend: tuple[object, ...],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu")],
) -> None:
    """Smooth noise at every seen vertex."""

def raise_folds(
    trains: tuple[object, ...],
    noise: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order="C", device="cpu", writable=False)],
    where: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
) -> None:
    """Height of folds."""
