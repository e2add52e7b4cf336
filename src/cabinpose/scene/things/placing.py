"""Where things come to stand: on a seat, pressed into its foam as their weight and a belt press them, or on two thighs."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np

from cabinpose._native import contact as native
from cabinpose.core import Floats, Matrix, apply, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.model import Seat, SeatSetting
from cabinpose.scene.contact.field import OUTSIDE, GroupField, PlacedField
from cabinpose.scene.contact.triangles import TriangleMesh
from cabinpose.scene.things.thing import Cloud, PlacedThing, Thing

PRESSED_M = 0.012  # into foam, by a child seat that is belted or latched
RESTING_M = 0.004  # into foam, by what only lies there
TOUCHING_M = 0.002  # hard parts may overlap by this: a base beside a seat's plastic shell
_FAR_M = 0.25  # how deep a depth is still measured
_BEFORE_BACK_M, _SUNK_M = 0.10, 0.06  # where a thing is let down before it is pushed back; how far beyond the corner it may go
_UNDERSIDE_M = 0.10  # of a thing has to stay before the corner of cushion and backrest
_FLOWN_M, _STEPS = 0.25, 9  # from where a thing is let down, and the halvings until it rests: 0.5 mm


NOTHING_PLACED = PlacedField((), np.empty((0, 3)), np.empty((0, 3)))


class Obstacle(NamedTuple):
    """What a thing stands in: the name of the part, and how deep beyond what gives way, m (negative: a gap)."""

    part: str
    excess_m: float


def deepest_obstacle(placed: PlacedField, thing: PlacedThing, pressed_m: float) -> Obstacle:
    """The part of a car that a thing is deepest in, beyond `pressed_m` of its foam.

    Buckles are left out: they hang on webbing and are pushed aside.
    """
    worst = Obstacle("", -math.inf)
    cloud = thing.thing.cloud
    for group, _, group_from_vehicle in placed.groups:
        group_from_thing = rp.matmul(group_from_vehicle, thing.vehicle_from_thing)
        reach = group.give_m + group.bound_m
        index, clearance = native.points_below(*cloud, group_from_thing, group, threshold=reach, seal=group.bound_m)
        if not len(index):
            continue
        local = apply(group_from_thing, cloud.points[index])
        inside = np.zeros(len(index), bool)
        for part, low, high in zip(group.parts, group.part_low, group.part_high, strict=True):
            near = np.flatnonzero(np.asarray((local > low) & (local < high)).all(axis=1))
            if not len(near):
                continue
            depth = part.shell_m - part.mesh.signed_distance(local[near], _FAR_M)
            inside[near[depth > -group.bound_m]] = True
            excess = float(depth.max()) - min(part.give_m, pressed_m)
            if excess > worst.excess_m and not part.name.endswith("buckle"):
                worst = Obstacle(part.name, excess)
        beyond = group.interior and float(-np.where(inside, np.inf, clearance).min())
        if beyond and beyond > max(worst.excess_m, group.bound_m):
            worst = Obstacle(OUTSIDE, beyond)
    return worst


class Yielding(NamedTuple):
    """A part that points may be in.

    radius, allowed: how far its distance is measured and how deep they may be, m · shell: of `GroupPart`, m · low, high: (3,) m,
    the box outside of which it is not felt.
    """

    mesh: TriangleMesh
    radius: float
    allowed: float
    shell: float
    low: Floats
    high: Floats


class Felt(NamedTuple):
    """How deep points may be in a group, as `native.any_deeper` takes it.

    Points whose clearance is not below `threshold` are in nothing, those below `lost` surely too deep, m; the others are measured
    on the parts. seal: of `points_below`, m.
    """

    field: GroupField
    threshold: float
    seal: float
    lost: float
    parts: list[Yielding]


def felt(group: GroupField, pressed_m: float, yields_m: float = 0.0, carried_by: Collection[str] = ()) -> Felt:
    """A group whose foam may be pressed in by `pressed_m`, by points that yield by `yields_m` themselves (negative: stay off).

    Parts called `carried_by` are not felt.
    """
    parts = []
    off = max(-yields_m, 0.0)
    for part, low, high in zip(group.parts, group.part_low, group.part_high, strict=True):
        if not part.name.endswith("buckle") and part.name not in carried_by:
            allowed = min(part.give_m, pressed_m) + yields_m
            radius = part.give_m + 2.0 * group.bound_m + yields_m
            parts.append(Yielding(part.mesh, radius, allowed, part.shell_m, low - off, high + off))
    threshold = max(group.give_m - pressed_m, 0.0) + group.bound_m - yields_m
    lost = -group.bound_m - yields_m if len(parts) == len(group.parts) else -math.inf
    return Felt(group, threshold, group.bound_m, lost, parts)


def stands_free(group: Felt, cloud: Cloud, group_from_cloud: Matrix) -> bool:
    """Whether no point is deeper in a group's parts than it may be."""
    return not native.any_deeper(cloud.points, cloud.balls, group_from_cloud, group)


def stands_inside(
    interior: GroupField, cloud: Cloud, interior_from_cloud: Matrix, carried_by: Collection[str], seen_m: float
) -> bool:
    """Whether every point of a thing is in the car's interior, or in one of the parts that carry it.

    seen_m: how far the surfaces of those are looked for.
    """
    bound = interior.bound_m
    index, _ = native.points_below(*cloud, interior_from_cloud, interior, threshold=-bound, seal=bound)
    beyond = apply(interior_from_cloud, cloud.points[index])
    for part in interior.parts:
        if len(beyond) and part.name in carried_by:
            beyond = beyond[part.mesh.signed_distance(beyond, seen_m) >= part.shell_m + bound]
    return not len(beyond)


def let_down(free: Callable[[float], bool], start: float, end: float) -> float:
    """The last place on the way from `start` to `end` that is still free, of ways that are free up to some place."""
    if free(end):
        return end
    for _ in range(_STEPS):
        middle = 0.5 * (start + end)
        start, end = (middle, end) if free(middle) else (start, middle)
    return start


def cushion_frame(seat: Seat, setting: SeatSetting) -> Matrix:
    """`vehicle_from_cushion`: origin where the free cushion meets the backrest, x forwards along the cushion, z off it."""
    recline, tilt = setting.torso_angle, seat.cushion_angle
    below, behind = seat.cushion_below_h_m, seat.backrest_behind_h_m
    x = (below * rp.sin(recline) - behind) / (rp.cos(recline) + rp.tan(tilt) * rp.sin(recline))
    corner = np.array((x, 0.0, x * rp.tan(tilt) - below))
    return np.asarray(rp.matmul(seat.vehicle_from_seat(setting), transform(axis_rotation("y", -tilt), corner)))


class Spot(NamedTuple):
    """Where a thing is let down onto a cushion.

    ahead_m: of its rear from the backrest; at 0 it is then pushed back until it leans on it, and let down again · aside_m: of its
    origin from the middle · turn: (3, 3) cushion_from_thing.
    """

    ahead_m: float = 0.0
    aside_m: float = 0.0
    turn: Matrix = np.eye(3)


LEANING = Spot()  # in the middle, facing forwards


def stand_on_seat(thing: Thing, seat: Seat, setting: SeatSetting, placed: PlacedField, spot: Spot, pressed_m: float) -> Matrix:
    """Let a thing down onto a cushion.

    Parameters
    ----------
    thing, seat, setting
        What, and onto which seat.
    placed
        The car's fields; only those of the seat itself hold the thing up, or everything where it has none of its own.
    spot
        Where it is let down.
    pressed_m
        How far it sinks into the foam.

    Returns
    -------
    Matrix
        vehicle_from_thing, (4, 4).
    """
    cushion, own = cushion_frame(seat, setting), f"seat:{seat.slot}/"
    own_groups = [group for group in placed.groups if group[0].name.startswith(own)]
    holders = [(felt(group, pressed_m), group_from) for group, _, group_from in own_groups or placed.groups]

    def at(x: float, z: float) -> Matrix:
        return np.asarray(rp.matmul(cushion, transform(spot.turn, (x, spot.aside_m, z))))

    def free(x: float, z: float) -> bool:
        vehicle_from_thing = at(x, z)
        return all(stands_free(group, thing.cloud, rp.matmul(group_from, vehicle_from_thing)) for group, group_from in holders)

    turned = apply(transform(spot.turn), thing.cloud.points)
    low = turned.min(axis=0)
    rear = turned[turned[:, 2] < low[2] + _UNDERSIDE_M, 0].min()
    x, lowest = (spot.ahead_m if spot.ahead_m > 0.0 else _BEFORE_BACK_M) - low[0], -low[2]
    z = let_down(lambda z: free(x, z), lowest + _FLOWN_M, lowest - _SUNK_M)
    if spot.ahead_m <= 0.0:
        for _ in range(2):
            x = let_down(lambda x, z=z: free(x, z + 0.001), x, -_SUNK_M - rear)  # type: ignore[misc]
            z = let_down(lambda z, x=x: free(x, z), z, lowest - _SUNK_M)  # type: ignore[misc]
    return at(x, z)


def in_the_way(thing: PlacedThing, placed: PlacedField, pressed_m: float) -> Obstacle | None:
    """What a placed thing stands in, of everything around it; None where it stands free."""
    found = deepest_obstacle(placed, thing, pressed_m)
    return found if found.excess_m > TOUCHING_M else None
