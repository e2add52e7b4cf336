"""`build_cabin`: from dimensions to a cabin, left- or right-hand drive."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np

from cabinpose.core import ConfigError, DriveSide, Matrix, apply, invert, unknown_name
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin import cockpit, shell
from cabinpose.scene.cabin.dimensions import CabinDimensions
from cabinpose.scene.cabin.layout import Layout
from cabinpose.scene.cabin.model import (
    BeltAnchors,
    Cabin,
    Part,
    Seat,
    SeatSetting,
    SteeringWheel,
    Vector,
    ViewAnchor,
    in_slot_order,
)
from cabinpose.scene.cabin.presets import PRESET_DIMENSIONS, PRESETS
from cabinpose.scene.cabin.seats import STYLES, SeatShape, SeatStand, seat_parts
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.cabin.shapes import block, join, tube
from cabinpose.scene.cabin.views import built_views

_FRONT, _REAR = ("driver", "front_passenger"), ("rear_left", "rear_center", "rear_right")
# What every cabin has that is built here, whatever its dimensions.
SEATS_OF_ALL = ("driver", "front_passenger", "rear_left", "rear_right")
RECLINE = (np.deg2rad(10.0), np.deg2rad(45.0))  # range of a front backrest's torso angle


def build_cabin(dimensions: CabinDimensions | str, *, drive_side: DriveSide = "left") -> Cabin:
    """The cabin of these dimensions, or of the preset of this name. Equal input gives the same object.

    Benches that face each other have no wheel, which alone would tell the drive side: their `driver` sits on the left always.
    Raises ConfigError for an unknown preset or drive side.
    """
    if isinstance(dimensions, str):
        if dimensions not in PRESET_DIMENSIONS:
            raise unknown_name("cabin preset", dimensions, PRESETS)
        dimensions = PRESET_DIMENSIONS[dimensions]
    if drive_side not in ("left", "right"):
        raise ConfigError(f"unknown drive side '{drive_side}'", hint="known: left, right")
    return _build(dimensions, "left" if dimensions.layout == "facing" else drive_side)


@lru_cache(maxsize=32)
def _build(d: CabinDimensions, drive_side: DriveSide) -> Cabin:
    layout = Layout(d)
    parts: list[Part] = shell.floor(layout) + shell.doors(layout) + shell.roof(layout) + shell.roof_fittings(layout)
    seats = _front_row(layout, parts) | _rear_row(layout, parts)
    wheel: SteeringWheel | None = None
    targets: dict[str, Vector] = {}
    if not layout.facing:
        parts += cockpit.dashboard(layout)
        wheel, wheel_parts = cockpit.steering(layout)
        console_parts, knob = cockpit.console(layout, STYLES[d.seat_style].width)
        parts += wheel_parts + console_parts
        targets["gear_lever"] = knob
    parts += _belt_fittings(seats)
    targets |= _reach_targets(layout, seats)
    views = built_views(layout)

    if drive_side == "right":
        parts = [_mirrored_part(p) for p in parts]
        seats = {_mirrored_name(s.slot): _mirrored_seat(s) for s in seats.values()}
        targets = {_mirrored_name(k): _mirror(v) for k, v in targets.items()}
        views = {k: ViewAnchor(_mirror(v.eye), _mirror(v.target)) for k, v in views.items()}
        if wheel is not None:
            pose = wheel.vehicle_from_wheel.copy()
            pose[1, 3] = -pose[1, 3]
            wheel = replace(wheel, vehicle_from_wheel=pose)
    pads: dict[str, Matrix] = {}
    if not layout.facing:
        pads, pedal_parts = cockpit.pedals(layout, float(seats["driver"].design_h_point[1]))
        parts += pedal_parts
    return Cabin(d.name, drive_side, tuple(parts), in_slot_order(seats), wheel, pads, targets, views)


def _front_row(layout: Layout, parts: list[Part]) -> dict[str, Seat]:
    d = layout.d
    shape = STYLES[d.seat_style]
    if d.seat_style == "bench":
        shape = shape.of_width(2 * d.w20_mm / 1000 - 0.01)
    stand = SeatStand(layout.cushion, d.h30_mm / 1000, d.h58_mm / 2000)
    fixed = layout.facing
    default = SeatSetting(0.0, 0.0, float(layout.torso))
    low, high = (
        (default, default)
        if fixed
        else (
            SeatSetting(-d.l23_aft_mm / 1000, -d.h58_mm / 2000, min(RECLINE[0], default.torso_angle)),
            SeatSetting(d.l23_fore_mm / 1000, d.h58_mm / 2000, max(RECLINE[1], default.torso_angle)),
        )
    )
    seats = {}
    for slot, side in (("driver", 1.0), ("front_passenger", -1.0)):
        armrests = (-1,) if side > 0.0 else (1,)  # the doors have their own
        parts += seat_parts(slot, shape, stand, leather=d.leather, armrests=armrests)
        h = layout.h_front * (1.0, side, 1.0)
        upper = _shoulder_exit(h, shape, default.torso_angle, side, True) if fixed else _d_ring(layout, h, side)
        belt = BeltAnchors(
            upper,
            h + _flip(fixed, (-0.10, -side * (shape.width / 2 + 0.02), -0.09)),
            h + _flip(fixed, (-0.14, side * (shape.width / 2 + 0.015), -0.14)),
            rides_seat=not fixed,
        )
        heel = np.array([0.0, h[1], 0.0])
        seats[slot] = Seat(
            slot, h, np.pi if fixed else 0.0, default, (low, high), float(layout.cushion), heel,
            "pedals" if slot == "driver" and not fixed else "floor", belt,
            shape.cushion_below_h, shape.back_behind_h,
        )  # fmt: skip
    return seats


def _flip(backward: bool, offset: tuple[float, float, float]) -> Vector:
    return np.array(offset) * ((-1.0, 1.0, 1.0) if backward else (1.0, 1.0, 1.0))


def _belt_fittings(seats: dict[str, Seat]) -> list[Part]:
    """Buckles on their stalks, and D-rings or shoulder exits, where the belts hang from."""
    parts = []
    rings = []
    for seat in seats.values():
        if seat.belt is None:
            continue
        rings.append(block((0.018, 0.030, 0.055)).shifted(*seat.belt.upper))
        local = apply(invert(seat.vehicle_from_seat(seat.default)), seat.belt.buckle)
        stalk = tube([local + (-0.025, 0, -0.05), local], 0.007, 6)
        buckle = block((0.030, 0.022, 0.06)).turned("y", 0.4).shifted(*local)
        group = f"seat:{seat.slot}/base"
        parts.append(Part(f"{seat.slot} buckle", to_surface(join([stalk, buckle]), "trim", "hard_plastic"), group))
    parts.append(Part("belt guides", to_surface(join(rings), "trim", "hard_plastic")))
    return parts


def _d_ring(layout: Layout, h: Vector, side: float) -> Vector:
    """The upper belt anchor on the B-pillar, above the shoulder."""
    z = float(min(h[2] + 0.66, layout.rail_z(layout.b_pillar_x) - 0.05))
    x = float(min(layout.b_line(np.array(z)), h[0] - 0.24))
    return np.array([x, side * (float(layout.half_width(x, z)) - 0.035), z])


def _shoulder_exit(h: Vector, shape: SeatShape, torso: float, side: float, backward: bool) -> Vector:
    """Where the belt leaves the top of a backrest that is not beside a pillar."""
    up, behind = shape.back_height + 0.012, shape.back_behind_h + 0.6 * shape.back_depth
    offset = (
        -rp.sin(torso) * up - rp.cos(torso) * behind,
        side * 0.36 * shape.top_width,
        rp.cos(torso) * up - rp.sin(torso) * behind,
    )
    return np.asarray(h + _flip(backward, offset))


def _rear_row(layout: Layout, parts: list[Part]) -> dict[str, Seat]:
    d = layout.d
    default = SeatSetting(0.0, 0.0, float(layout.torso_2))
    stand = SeatStand(layout.cushion_2, d.h30_2_mm / 1000)
    heel_ahead = {"rows": 0.44, "facing": 0.50}[d.layout]
    three = d.rear_places == 3
    w20 = d.w20_2_mm / 1000
    places = [("rear_left", w20), ("rear_right", -w20)] + ([("rear_center", 0.0)] if three else [])
    edge = float(layout.half_width(layout.h_rear[0], layout.h_rear[2])) - 0.03
    centre_half = max(w20 - 0.235, 0.11) if three else 0.0
    seats = {}
    for slot, y in places:
        style = d.rear_style
        if style == "captain":
            width = min(0.50, 2 * w20 / 2 - 0.02) if three else None
        elif slot == "rear_center":
            width = 2 * centre_half
        else:
            inner = centre_half if three else max(w20 - 0.29, 0.004)
            width = 2 * min(edge - w20, w20 - inner)
        sides = (1.0, 1.0) if style != "bench" else {"rear_left": (2.4, 0.3), "rear_right": (0.3, 2.4)}.get(slot, (0.2, 0.2))
        shape = STYLES[style] if width is None else STYLES[style].of_width(width)
        if slot == "rear_center" and not d.centre_headrest:
            shape = replace(shape, headrest="none")
        parts += seat_parts(slot, shape, stand, leather=d.leather, sides=sides, fine=False)
        h = np.array([layout.h_rear[0], y, layout.h_rear[2]])
        side = -1.0 if y < 0 else 1.0
        reach = float(np.clip(shape.width / 2, 0.21, 0.23))
        if layout.facing or slot == "rear_center":
            upper = _shoulder_exit(h, shape, default.torso_angle, side, False)
        else:
            z = min(h[2] + 0.62, float(layout.rail_z(h[0] - 0.36)) - 0.02)
            upper = np.array([h[0] - 0.36, side * (float(layout.half_width(h[0] - 0.36, z)) - 0.04), z])
        belt = BeltAnchors(
            upper,
            h + (-0.11, -side * reach, -0.09), h + (-0.13, side * reach, -0.12), rides_seat=False,
        )  # fmt: skip
        seats[slot] = Seat(
            slot, h, 0.0, default, (default, default), float(layout.cushion_2), np.array([h[0] + heel_ahead, y, 0.0]), "floor",
            belt, shape.cushion_below_h, shape.back_behind_h,
        )  # fmt: skip
    return seats


def _reach_targets(layout: Layout, seats: dict[str, Seat]) -> dict[str, Vector]:
    """Places that hands go to, (3,) vehicle, m: on the surface of the thing or a finger's width before it; a knob's middle."""
    d = layout.d
    front, rear = layout.h_front, layout.h_rear
    targets: dict[str, Vector] = {}
    if not layout.facing:
        shape, face_x, top_z, low_z = cockpit.dash_measures(layout)
        floating = shape.screen == "floating"
        targets["infotainment"] = np.array(
            [face_x - shape.stack + (-0.032 if floating else 0.0), 0.0, top_z + (0.02 if floating else -0.145)]
        )
        targets["climate"] = np.array([face_x - shape.stack, 0.0, top_z - 0.22])
        targets["glovebox"] = np.array([face_x + shape.passenger - 0.01, -front[1], 0.5 * (low_z + top_z) - 0.05])
        mirror_x, mirror_z = shell.mirror_place(layout)
        targets["mirror"] = np.array([mirror_x - 0.025, 0.0, mirror_z])
        visor_x = layout.header_x - 0.17
        targets["sun_visor"] = np.array([visor_x, front[1], float(layout.roof(visor_x, front[1])) - 0.04])
        targets["sun_visor_passenger"] = targets["sun_visor"] * (1, -1, 1)
        for row, h in (("", front), ("rear_", rear)):
            for side, sign in (("left", 1.0), ("right", -1.0)):
                y = sign * (float(layout.half_width(h[0] + 0.12, h[2] + 0.2)) - 0.045)
                targets[f"{row}armrest_{side}"] = np.array([h[0] + 0.10, y, h[2] + 0.205])
                door = sign * (float(layout.half_width(h[0] + 0.34, h[2] + 0.25)) - 0.015)
                targets[f"{row}window_switch_{side}"] = np.array([h[0] + 0.34, door, h[2] + 0.255])
        if d.console_style != "none":
            lid = {"low": 0.08, "tunnel": 0.14, "high": 0.18}[d.console_style]
            targets["console"] = np.array([front[0] + 0.02, 0.0, front[2] + lid])
    for slot, seat in seats.items():
        if seat.belt is not None:
            targets[f"buckle_{slot}"] = seat.belt.buckle + (0.0, 0.0, 0.06)
    return targets


def _mirror(p: Vector) -> Vector:
    return np.asarray(p * (1.0, -1.0, 1.0))


def _mirrored_name(name: str) -> str:
    """The name of a seat, of something of it, or of a reach target on the other side of the car."""
    return re.sub("left|right", lambda side: {"left": "right", "right": "left"}[side[0]], name)


def _mirrored_part(part: Part) -> Part:
    """The mirror image in y = 0 of a part in its group's frame; its seat, if any, changes sides with it."""
    flip, surface = np.array([1, -1, 1], np.float32), part.surface
    turned = replace(
        surface, vertices=surface.vertices * flip, normals=surface.normals * flip,
        faces=np.ascontiguousarray(surface.faces[:, ::-1]),
    )  # fmt: skip
    return replace(part, name=_mirrored_name(part.name), group=_mirrored_name(part.group), surface=turned)


def _mirrored_seat(seat: Seat) -> Seat:
    belt = seat.belt
    if belt is not None:
        belt = BeltAnchors(_mirror(belt.upper), _mirror(belt.buckle), _mirror(belt.outer_lap), belt.rides_seat)
    return replace(
        seat, slot=_mirrored_name(seat.slot), design_h_point=_mirror(seat.design_h_point), heel_m=_mirror(seat.heel_m), belt=belt
    )
