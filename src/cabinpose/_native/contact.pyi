"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from collections.abc import Sequence
from typing import Annotated, Protocol, overload

import numpy
from numpy.typing import NDArray

class SearchGrid(Protocol):
    @property
    def origin(self) -> Annotated[NDArray[numpy.float64], dict(shape=3, writable=False)]: ...
    @property
    def cell(self) -> float: ...
    @property
    def dims(self) -> Annotated[NDArray[numpy.int64], dict(shape=3, writable=False)]: ...
    @property
    def starts(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def entries(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...

class Mesh(Protocol):
    @property
    def corners(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), writable=False)]: ...
    @property
    def normals(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 7, 3), writable=False)]: ...
    @property
    def closed(self) -> bool: ...
    @property
    def grid(self) -> SearchGrid: ...

class FieldGrid(Protocol):
    @property
    def origin(self) -> Annotated[NDArray[numpy.float64], dict(shape=3, writable=False)]: ...
    @property
    def step(self) -> float: ...
    @property
    def quantum_m(self) -> float: ...
    @property
    def outside_m(self) -> float: ...
    @property
    def values(self) -> Annotated[NDArray[numpy.int8], dict(shape=(None, None, None), writable=False)]: ...

class Yielding(Protocol):
    @property
    def mesh(self) -> Mesh: ...
    @property
    def radius(self) -> float: ...
    @property
    def allowed(self) -> float: ...
    @property
    def shell(self) -> float: ...
    @property
    def low(self) -> Annotated[NDArray[numpy.float64], dict(shape=3, writable=False)]: ...
    @property
    def high(self) -> Annotated[NDArray[numpy.float64], dict(shape=3, writable=False)]: ...

class Felt(Protocol):
    @property
    def field(self) -> FieldGrid: ...
    @property
    def threshold(self) -> float: ...
    @property
    def seal(self) -> float: ...
    @property
    def lost(self) -> float: ...
    @property
    def parts(self) -> Sequence[Yielding]: ...

class Solids(Protocol):
    @property
    def vertices(self) -> Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)]: ...
    @property
    def boxes(self) -> Annotated[NDArray[numpy.float32], dict(shape=(None, 2, 3), writable=False)]: ...
    @property
    def faces(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None, 3), writable=False)]: ...
    @property
    def all_rows(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)]: ...
    @property
    def skin_rows(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)]: ...
    @property
    def own(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def own_rows(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)]: ...
    @property
    def leaf_rows(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)]: ...
    @property
    def leaves(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 2, 3))]: ...
    @property
    def ready(self) -> Annotated[NDArray[numpy.bool_], dict(shape=(None,))]: ...

def bin_triangles(
    corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), writable=False)],
    origin: Annotated[NDArray[numpy.float64], dict(shape=(3), writable=False)],
    cell: float,
    dims: Annotated[NDArray[numpy.int64], dict(shape=(3), writable=False)],
) -> tuple[Annotated[NDArray[numpy.int32], dict(shape=(None,))], Annotated[NDArray[numpy.int32], dict(shape=(None,))]]:
    """
    Triangles by grid cell: starts of the rows, and numbers of the triangles.
    """

def signed_distance(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    *,
    radius: float,
    enough: float,
    mesh: Mesh,
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Distance of points to triangles, m, negative inside."""

def splat(
    corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), writable=False)],
    origin: Annotated[NDArray[numpy.float64], dict(shape=(3), writable=False)],
    *,
    step: float,
    below: float,
    above: float,
    distance: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None))],
) -> None:
    """Lowers squared distances at the nodes near triangles."""

def fill(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None))],
    exact: Annotated[NDArray[numpy.bool_], dict(shape=(None, None, None), writable=False)],
    *,
    step: float,
    band: float,
) -> None:
    """Clearance at the nodes that are not exact."""

def winding_at_nodes(
    corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), writable=False)],
    origin: Annotated[NDArray[numpy.float64], dict(shape=(3), writable=False)],
    step: float,
    winding: Annotated[NDArray[numpy.int8], dict(shape=(None, None, None))],
) -> None:
    """How often a surface winds around each node."""

def merge_part(
    distance: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), writable=False)],
    winding: Annotated[NDArray[numpy.int8], dict(shape=(None, None, None), writable=False)],
    *,
    closed: bool,
    offset: Annotated[NDArray[numpy.int64], dict(shape=(3), writable=False)],
    give: float,
    above: float,
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None))],
    exact: Annotated[NDArray[numpy.bool_], dict(shape=(None, None, None))],
) -> None:
    """Lowers a group's clearance to that of one part."""

def bit_rows(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), writable=False)],
    level: float,
    bits: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None))],
) -> None:
    """Which nodes are at least a level, 64 to a word."""

def flood(
    clear: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None), writable=False)],
    seeds: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), writable=False)],
    nk: int,
    reached: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None))],
) -> bool:
    """Nodes reached from the seeds; whether the grid's border was."""

def shut_off(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None))],
    reached: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None), writable=False)],
    level: float,
) -> None:
    """Turns the clearance of nodes not reached into depth."""

def quantise(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), writable=False)],
    quantum: float,
    out: Annotated[NDArray[numpy.int8], dict(shape=(None, None, None))],
) -> None:
    """Clearance in whole quanta."""

@overload
def sample(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    group_from_vehicle: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    field: FieldGrid,
    clearance: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Lowers clearance at points to the field's."""

@overload
def sample(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    group_from_vehicle: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    field: FieldGrid,
    clearance: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None: ...
@overload
def balls_of(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
) -> None:
    """Balls around every 32 consecutive points."""

@overload
def balls_of(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
) -> None: ...
def points_below(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), writable=False)],
    group_from_vehicle: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    field: FieldGrid,
    *,
    threshold: float,
    seal: float,
) -> tuple[Annotated[NDArray[numpy.int64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))]]:
    """Numbers and clearance of the points below a threshold."""

def any_deeper(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), writable=False)],
    group_from_points: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    group: Felt,
) -> bool:
    """Whether any point is deeper in a part of a group than allowed."""

def by_place(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    run: int,
    order: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
) -> None:
    """An order of points in which every run is close together."""

def close_solids(
    skin: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    *,
    ring_vertices: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    ring_rows: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)],
    vertices: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    vertex_rows: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)],
    closed: Annotated[NDArray[numpy.float32], dict(shape=(None, 3))],
    boxes: Annotated[NDArray[numpy.float32], dict(shape=(None, 2, 3))],
    box: Annotated[NDArray[numpy.float32], dict(shape=(2, 3))],
) -> None:
    """The vertices of a body's closed solids, and their boxes."""

def deepest_in(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    index: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    *,
    solid: int,
    centre: Annotated[NDArray[numpy.float64], dict(shape=(3), writable=False)],
    radius: float,
    limits: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    body: Solids,
) -> tuple[float, int, float]:
    """Excess, number and depth of the worst point in a solid."""

def first_of_pairs(
    body: Solids,
    *,
    pairs: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)],
    tolerances: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    joint_ends: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)],
    zones: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    joints: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
) -> tuple[int, int, float, int, float]:
    """
    The first pair of solids that overlaps: pair, solid gone into, excess, point, depth.
    """

def first_between(
    *, body: Solids, other: Solids, limit: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)]
) -> tuple[int, int, float, int, float]:
    """
    The first solids of two bodies that overlap: into, of, excess, point, depth.
    """

def first_probe(
    probes: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), writable=False)],
    gives: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    vehicle_from_group: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    box: Annotated[NDArray[numpy.float32], dict(shape=(2, 3), writable=False)],
    tolerance: float,
    body: Solids,
    where: Annotated[NDArray[numpy.float64], dict(shape=(3))],
) -> tuple[int, int, float, int, float]:
    """
    The first solid that a probe goes into: solid, -1, excess, probe, depth.
    """

def sampled_skin(
    skin: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
    order: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    edges: Annotated[NDArray[numpy.int32], dict(shape=(None, 2), writable=False)],
    spacing: float,
) -> tuple[Annotated[NDArray[numpy.float32], dict(shape=(None, 3))], Annotated[NDArray[numpy.int32], dict(shape=(None,))]]:
    """
    Points of a skin no farther apart than a spacing, and a vertex near each.
    """

def limb_axes(
    joints: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    ends: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), writable=False)],
    skipped: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    step: float,
) -> tuple[Annotated[NDArray[numpy.float32], dict(shape=(None, 3))], Annotated[NDArray[numpy.int32], dict(shape=(None,))]]:
    """Points along limbs' bones, and the limb of each."""
