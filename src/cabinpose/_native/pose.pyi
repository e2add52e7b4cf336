"""Made by tools/make_stubs.py from the extension."""

from collections.abc import Sequence
from typing import Annotated, overload

import numpy
from numpy.typing import NDArray

def solve_chain(
    chain: tuple[object, ...],
    task: tuple[object, ...],
    q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
    iterations: int,
) -> tuple[float, float]:
    """
    Improve a chain's angles, in place; the position (m) and rotation (rad) that are missed.
    """

def chain_tool(
    chain: tuple[object, ...],
    q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    base_from_tool: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu")],
) -> None:
    """The frame of a chain's tool."""

def seed_limb(
    chain: tuple[object, ...],
    ball: int,
    target: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    prior: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    stiffness: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu", writable=False)],
    oriented: bool,
    swivels: int,
    q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order="C", device="cpu")],
) -> None:
    """A start for the chain solver: the closed form at the best swivel."""

def rotation_vector(
    r: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order="C", device="cpu", writable=False)],
) -> tuple[float, float, float]:
    """The rotation vector of a rotation matrix, rad."""

def euler_near(
    r: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order="C", device="cpu", writable=False)],
    axes: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order="C", device="cpu", writable=False)],
    near: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
) -> tuple[float, float, float]:
    """
    Angles of a rotation about three orthogonal axes in turn, near given ones, rad.
    """

def skeleton_frames(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu")],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu")],
    palms: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), order="C", device="cpu")],
    soles: Annotated[NDArray[numpy.float64], dict(shape=(2, 4, 4), order="C", device="cpu")],
) -> None:
    """Frames of main bones, palms and soles."""

def solve_arm(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu")],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    side: int,
    lower: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    upper: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    task: tuple[object, ...],
) -> tuple[float, float]:
    """
    Bring a palm to its target, in place of q; the position (m) and rotation (rad) that are missed.
    """

def solve_leg(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu")],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    side: int,
    lower: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    upper: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    task: tuple[object, ...],
) -> tuple[float, float]:
    """
    Bring a sole to its target, in place of q; the position (m) and rotation (rad) that are missed.
    """

def turn_head(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu")],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    vehicle_from_head: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    lower: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    upper: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
) -> float:
    """Turn neck and head to a rotation, in place of q; what is missed, rad."""

def lean_to_reach(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu")],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    side: int,
    point: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    reach: float,
    lower: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    upper: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
) -> float:
    """
    Lean the trunk to bring a shoulder within reach of a point, in place of q; what is missing, m.
    """

CELL_M: float = 0.015

BACK_FROM_M: tuple[float, ...] = (-0.3, -0.15)

TRUNK_FROM_M: float = -0.45

TRUNK_STEP_M: float = 0.03

THIGH_STATIONS: int = 14

ON_UPPER_ARM: tuple[float, ...] = (0.55, 0.8, 1.0)

ON_FOREARM: tuple[float, ...] = (0.2, 0.5, 0.8)

@overload
def lower_sides(
    vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    middle: float,
    corner: Annotated[NDArray[numpy.float64], dict(shape=(2), order="C", device="cpu", writable=False)],
    beside: float,
    field: Annotated[NDArray[numpy.float64], dict(shape=(2, None, None), order="C", device="cpu")],
) -> None:
    """Lower a height field to a mesh, in place."""

@overload
def lower_sides(
    vertices: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order="C", device="cpu", writable=False)],
    middle: float,
    corner: Annotated[NDArray[numpy.float64], dict(shape=(2), order="C", device="cpu", writable=False)],
    beside: float,
    field: Annotated[NDArray[numpy.float64], dict(shape=(2, None, None), order="C", device="cpu")],
) -> None: ...
def beside(
    room: tuple[object, ...],
    p: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    r: float,
) -> tuple[float, float]:
    """
    How deep a ball lies in the car's sides (m, negative: clear), and the way out along y.
    """

def in_own(
    room: tuple[object, ...],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu", writable=False)],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu", writable=False)],
    which: int,
    p: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    r: float,
) -> float:
    """
    How deep a ball lies in the trunk (`which` 2) or a thigh (0 left, 1 right), m.
    """

def arm_trouble(
    room: tuple[object, ...],
    rotation: Annotated[NDArray[numpy.float64], dict(shape=(23, 3, 3), order="C", device="cpu", writable=False)],
    position: Annotated[NDArray[numpy.float64], dict(shape=(23, 3), order="C", device="cpu", writable=False)],
    side: int,
    elbow: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    allowed: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
) -> float:
    """
    The sum of squares (m2) of what an arm lies too deep in trunk, thighs and the car.
    """

def foot_aside(
    room: tuple[object, ...],
    sole: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    side: int,
) -> float:
    """The shift along y (m) that takes a shoe out of tunnel and doors."""

def leg_aside(
    room: tuple[object, ...],
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    side: int,
) -> float:
    """
    The shift along y (m) that takes a leg out of the car's sides and neighbours.
    """

def shoulders_inside(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu")],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    room: tuple[object, ...],
    forward: float,
    lower: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    upper: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
) -> None:
    """Bend the loins away from what a shoulder would go into, in place of q."""

def give_way(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu")],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu")],
    forward: float,
    room: tuple[object, ...],
    flanks: tuple[object, ...],
    lower: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    upper: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
) -> None:
    """
    Turn and bend a trunk out of its neighbours and the car's sides, in place of q and vehicle_from_root.
    """

def settle_arm(
    q: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu")],
    rest: tuple[object, ...],
    vehicle_from_root: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order="C", device="cpu", writable=False)],
    side: int,
    lower: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    upper: Annotated[NDArray[numpy.float64], dict(shape=(44), order="C", device="cpu", writable=False)],
    task: tuple[object, ...],
    room: tuple[object, ...],
    allowed: Annotated[NDArray[numpy.float64], dict(shape=(3), order="C", device="cpu", writable=False)],
    moves: bool,
    upwards: bool,
) -> float:
    """Turn an arm out of what is in its way, in place of q; the miss, m."""

def solve_people(
    people: Sequence[tuple[object, ...]],
    car: Sequence[tuple[object, ...]],
    pairs: tuple[object, ...],
    between: float,
    iterations: int,
    missed: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order="C", device="cpu")]],
) -> list[tuple[int, int, int, float]]:
    """
    Poses of people in a car; what is left of each: its kind, a solid, the other solid or group, and the excess.
    """
