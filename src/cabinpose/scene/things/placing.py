"""Where things come to stand: on a seat, pressed into its foam as their weight and a belt press them, or on two thighs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cabinpose._native import contact as native
from cabinpose.core.arrays import Floats
from cabinpose.core.frames import Matrix, apply, axis_rotation, transform
from cabinpose.scene.cabin.model import Seat, SeatSetting
from cabinpose.scene.contact.field import OUTSIDE, PlacedField, balls_of
from cabinpose.scene.things.thing import PlacedThing, Thing

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


def deepest_obstacle(
    placed: PlacedField, points: Floats, pressed_m: float, only: Callable[[str], bool] | None = None
) -> Obstacle:
    """The part of a car that points (N, 3) m of the vehicle frame are deepest in, beyond `pressed_m` of its foam.

    Buckles are left out: they hang on webbing and are pushed aside. only: names of the groups that count.
    """
    worst = Obstacle("", -math.inf)
    sampled = np.ascontiguousarray(points, np.float32)
    balls = balls_of(sampled)
    for group, _, group_from_vehicle in placed.groups:
        if only is not None and not only(group.name):
            continue
        index, clearance = native.points_below(
            sampled, balls, group_from_vehicle, group.grid, group.give_m + group.bound_m, group.bound_m
        )
        if not len(index):
            continue
        local = apply(group_from_vehicle, points[index])
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


def stands_free(placed: PlacedField, points: Floats, pressed_m: float, only: Callable[[str], bool] | None) -> bool:
    """Whether no point is deeper in anything than `deepest_obstacle` allows: the same answer, sooner."""
    sampled = np.ascontiguousarray(points, np.float32)
    balls = balls_of(sampled)
    for group, _, group_from_vehicle in placed.groups:
        if only is not None and not only(group.name):
            continue
        enough = max(group.give_m - pressed_m, 0.0) + group.bound_m
        index, clearance = native.points_below(sampled, balls, group_from_vehicle, group.grid, enough, group.bound_m)
        if not len(index):
            continue
        if clearance.min() < -group.bound_m and not any(part.name.endswith("buckle") for part in group.parts):
            return False
        local = apply(group_from_vehicle, points[index])
        for part, low, high in zip(group.parts, group.part_low, group.part_high, strict=True):
            near = np.asarray((local > low) & (local < high)).all(axis=1)
            if near.any() and not part.name.endswith("buckle"):
                allowed = min(part.give_m, pressed_m)
                depth = part.shell_m - part.mesh.signed_distance(local[near], part.give_m + 2.0 * group.bound_m)
                if float(depth.max()) > allowed:
                    return False
    return True


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
    x = (below * math.sin(recline) - behind) / (math.cos(recline) + math.tan(tilt) * math.sin(recline))
    corner = np.array((x, 0.0, x * math.tan(tilt) - below))
    return np.asarray(seat.vehicle_from_seat(setting) @ transform(axis_rotation("y", -tilt), corner))


def stand_on_seat(
    thing: Thing,
    seat: Seat,
    setting: SeatSetting,
    placed: PlacedField,
    turn: Matrix,
    ahead_m: float,
    aside_m: float,
    pressed_m: float,
) -> Matrix:
    """Let a thing down onto a cushion.

    Parameters
    ----------
    thing, seat, setting
        What, and onto which seat.
    placed
        The car's fields; only those of the seat itself hold the thing up, or everything where it has none of its own.
    turn
        (3, 3) cushion_from_thing.
    ahead_m, aside_m
        Where it is let down: how far its rear is ahead of the backrest, how far its origin is from the middle. A thing that leans
        on the backrest (`ahead_m` 0) is then pushed back until it does, and let down again.
    pressed_m
        How far it sinks into the foam.

    Returns
    -------
    Matrix
        vehicle_from_thing, (4, 4).
    """
    cushion, own = cushion_frame(seat, setting), f"seat:{seat.slot}/"
    has_own = any(group.name.startswith(own) for group, _, _ in placed.groups)

    def at(x: float, z: float) -> Matrix:
        return np.asarray(cushion @ transform(turn, (x, aside_m, z)))

    def free(x: float, z: float) -> bool:
        points = apply(at(x, z), thing.points)
        return stands_free(placed, points, pressed_m, (lambda name: name.startswith(own)) if has_own else None)

    turned = apply(transform(turn), thing.points)
    low = turned.min(axis=0)
    rear = turned[turned[:, 2] < low[2] + _UNDERSIDE_M, 0].min()
    x, lowest = (ahead_m if ahead_m > 0.0 else _BEFORE_BACK_M) - low[0], -low[2]
    z = let_down(lambda z: free(x, z), lowest + _FLOWN_M, lowest - _SUNK_M)
    if ahead_m <= 0.0:
        for _ in range(2):
            x = let_down(lambda x, z=z: free(x, z + 0.001), x, -_SUNK_M - rear)  # type: ignore[misc]
            z = let_down(lambda z, x=x: free(x, z), z, lowest - _SUNK_M)  # type: ignore[misc]
    return at(x, z)


def in_the_way(thing: PlacedThing, placed: PlacedField, pressed_m: float) -> Obstacle | None:
    """What a placed thing stands in, of everything around it; None where it stands free."""
    points = apply(thing.vehicle_from_thing, thing.thing.points)
    found = deepest_obstacle(placed, points, pressed_m)
    return found if found.excess_m > TOUCHING_M else None
