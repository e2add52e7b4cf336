"""Made by tools/make_stubs.py from the extension."""

from collections.abc import Sequence
from typing import Annotated, overload

import numpy
from numpy.typing import NDArray

def bin_triangles(
    corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order="C", device="cpu", writable=False)],
    origin: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    cell: float,
    dims: Annotated[NDArray[numpy.int64], dict(shape=(3), order="C", device="cpu", writable=False)],
) -> tuple[
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
]:
    """
    Triangles by grid cell: starts of the rows, and numbers of the triangles.
    """

def signed_distance(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    radius: float,
    enough: float,
    mesh: tuple[object, ...],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
) -> None:
    """Distance of points to triangles, m, negative inside."""

def splat(
    corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order="C", device="cpu", writable=False)],
    origin: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    step: float,
    below: float,
    above: float,
    distance: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None:
    """Lowers squared distances at the nodes near triangles."""

def fill(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
    exact: Annotated[NDArray[numpy.bool_], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    step: float,
    band: float,
) -> None:
    """Clearance at the nodes that are not exact."""

def winding_at_nodes(
    corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order="C", device="cpu", writable=False)],
    origin: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    step: float,
    winding: Annotated[NDArray[numpy.int8], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None:
    """How often a surface winds around each node."""

def merge_part(
    distance: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    winding: Annotated[NDArray[numpy.int8], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    closed: bool,
    offset: Annotated[NDArray[numpy.int64], dict(shape=(3), order="C", device="cpu", writable=False)],
    give: float,
    above: float,
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
    exact: Annotated[NDArray[numpy.bool_], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None:
    """Lowers a group's clearance to that of one part."""

def bit_rows(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    level: float,
    bits: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None:
    """Which nodes are at least a level, 64 to a word."""

def flood(
    clear: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    seeds: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    nk: int,
    reached: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None), order="C", device="cpu")],
) -> bool:
    """Nodes reached from the seeds; whether the grid's border was."""

def shut_off(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu")],
    reached: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    level: float,
) -> None:
    """Turns the clearance of nodes not reached into depth."""

def quantise(
    values: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order="C", device="cpu", writable=False)],
    quantum: float,
    out: Annotated[NDArray[numpy.int8], dict(shape=(None, None, None), order="C", device="cpu")],
) -> None:
    """Clearance in whole quanta."""

@overload
def sample(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    group_from_vehicle: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    field: tuple[object, ...],
    clearance: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
) -> None:
    """Lowers clearance at points to the field's."""

@overload
def sample(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    group_from_vehicle: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    field: tuple[object, ...],
    clearance: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
) -> None: ...
@overload
def balls_of(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order="C", device="cpu")],
) -> None:
    """Balls around every 32 consecutive points."""

@overload
def balls_of(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order="C", device="cpu")],
) -> None: ...
def points_below(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order="C", device="cpu", writable=False)],
    group_from_vehicle: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    field: tuple[object, ...],
    threshold: float,
    seal: float,
) -> tuple[
    Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C")],
    Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C")],
]:
    """Numbers and clearance of the points below a threshold."""

def any_deeper(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order="C", device="cpu", writable=False)],
    group_from_points: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    field: tuple[object, ...],
    threshold: float,
    seal: float,
    lost: float,
    parts: Sequence[tuple[object, ...]],
) -> bool:
    """Whether any point is deeper in a part of a group than allowed."""

def by_place(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    run: int,
    order: Annotated[NDArray[numpy.int64], dict(shape=(None,), order="C", device="cpu")],
) -> None:
    """An order of points in which every run is close together."""

def close_solids(
    skin: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    ring_vertices: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    ring_rows: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    vertices: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    vertex_rows: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    closed: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu")],
    boxes: Annotated[NDArray[numpy.float32], dict(shape=(None, 2, 3), order="C", device="cpu")],
    box: Annotated[NDArray[numpy.float32], dict(shape=(2, 3), order="C", device="cpu")],
) -> None:
    """The vertices of a body's closed solids, and their boxes."""

def deepest_in(
    points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    index: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    solid: int,
    centre: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    radius: float,
    limits: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    body: tuple[object, ...],
) -> tuple[float, int, float]:
    """Excess, number and depth of the worst point in a solid."""

def first_of_pairs(
    body: tuple[object, ...],
    pairs: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    tolerances: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    joint_ends: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    zones: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    joints: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
) -> tuple[int, int, float, int, float]:
    """
    The first pair of solids that overlaps: pair, solid gone into, excess, point, depth.
    """

def first_between(
    body: tuple[object, ...],
    other: tuple[object, ...],
    limit: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
) -> tuple[int, int, float, int, float]:
    """
    The first solids of two bodies that overlap: into, of, excess, point, depth.
    """

def first_probe(
    probes: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    balls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order="C", device="cpu", writable=False)],
    gives: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    vehicle_from_group: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    box: Annotated[NDArray[numpy.float32], dict(shape=(2, 3), order="C", device="cpu", writable=False)],
    tolerance: float,
    body: tuple[object, ...],
    where: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu")],
) -> tuple[int, int, float, int, float]:
    """
    The first solid that a probe goes into: solid, -1, excess, probe, depth.
    """

def sampled_skin(
    skin: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    order: Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C", device="cpu", writable=False)],
    edges: Annotated[NDArray[numpy.int32], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    spacing: float,
) -> tuple[
    Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C")],
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
]:
    """
    Points of a skin no farther apart than a spacing, and a vertex near each.
    """

def limb_axes(
    joints: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    ends: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), order="C", device="cpu", writable=False)],
    skipped: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    step: float,
) -> tuple[
    Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C")],
    Annotated[NDArray[numpy.int32], dict(shape=(None,), order="C")],
]:
    """Points along limbs' bones, and the limb of each."""
