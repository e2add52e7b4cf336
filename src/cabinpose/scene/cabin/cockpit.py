"""Before the driver: dashboard, steering wheel and column, pedals, centre console with the gear lever."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cabinpose.core import Floats, Matrix
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.layout import PEDAL_LENGTH, Layout
from cabinpose.scene.cabin.model import WHEEL_GROUP, Part, SteeringWheel, Vector
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.cabin.shapes import Solid, block, ellipse, join, loft, rounded_box, smooth_curve, smoothstep, sweep, tube

_FOOTREST_FLATTER, _FOOTREST_ANGLES = np.deg2rad(10.0), np.deg2rad((30.0, 50.0))  # than the pedals; from the horizontal (assumed)
_FINGERS_M = 0.06  # between the rim and what is ahead of it (assumed)
_CUP_M, _COLLAR_M, _PROUD_M = 0.0385, 0.0035, 0.009  # radius of a cup holder, its wall, and how far that stands out (assumed)
_TWO_CUPS_M = 0.092  # half of a console that has holders beside each other


@dataclass(frozen=True)
class DashShape:
    """Measures of a dashboard: heights relative to the cowl, depths relative to the wheel's centre, m.

    face: the face ahead of the wheel's centre · hood: height of the cluster hood · hood_half: its half width ·
    passenger: how much further ahead the passenger's face is · brow: how far the top pad overhangs · stack: how far
    the centre stack stands out · tilt: lower edge ahead of the upper (m) · screen: "floating", "inset" or "none".
    """

    face: float
    hood: float
    hood_half: float
    passenger: float
    brow: float
    stack: float
    tilt: float
    screen: str
    ledge: float = 0.0


DASHES = {
    "simple": DashShape(face=0.20, hood=0.060, hood_half=0.15, passenger=0.05, brow=0.02, stack=0.02, tilt=0.05, screen="inset",
                       ledge=0.06),
    "wave": DashShape(face=0.19, hood=0.055, hood_half=0.19, passenger=0.01, brow=0.03, stack=0.045, tilt=0.07,
                     screen="floating"),
    "tier": DashShape(face=0.20, hood=0.035, hood_half=0.24, passenger=0.02, brow=0.045, stack=0.03, tilt=0.08, screen="floating",
                     ledge=0.03),
    "driver": DashShape(face=0.18, hood=0.070, hood_half=0.20, passenger=0.06, brow=0.02, stack=0.08, tilt=0.10, screen="inset"),
    "upright": DashShape(face=0.17, hood=0.080, hood_half=0.20, passenger=0.02, brow=0.00, stack=0.07, tilt=0.02, screen="inset",
                       ledge=0.05),
}  # fmt: skip


def dash_measures(layout: Layout) -> tuple[DashShape, float, float, float]:
    """Shape of the dashboard, x of its face, height of its top, height of its lower edge."""
    shape = DASHES[layout.d.dash_style]
    wheel_x, wheel_z = -layout.d.l11_mm / 1000, layout.d.h17_mm / 1000
    return shape, wheel_x + shape.face, layout.cowl_z + 0.005, wheel_z - 0.185


def dashboard(layout: Layout) -> list[Part]:
    """The dashboard from side to side, its cluster hood before the driver, vents, screen and glove box."""
    shape, face_x, top_z, low_z = dash_measures(layout)
    cowl_x, driver_y = layout.cowl_x - 0.005, layout.h_front[1]
    wheel = steering_wheel(layout)
    centre, up = wheel.vehicle_from_wheel[:3, 3], wheel.vehicle_from_wheel[:3, 0]

    def behind_rim(z: float, y: float) -> float:
        """How near (x) something at a height may come to the rim, beside the driver's middle, for the fingers around it."""
        half = np.sqrt(max(wheel.rim_radius_m**2 - (y - driver_y) ** 2, 0.0))
        if half == 0.0:
            return -np.inf
        along = min(max((z - centre[2]) / up[2], -half), half)
        return float(centre[0] + along * up[0] + wheel.rim_section_m + _FINGERS_M)

    stations = np.linspace(-1, 1, 29)
    rings = []
    for v in stations:
        half = float(layout.half_width(np.array(face_x), np.array(layout.belt_z))) + 0.015
        y = v * half
        hood = 1 - float(smoothstep(abs(y - driver_y), shape.hood_half * 0.72, shape.hood_half * 1.12))
        stack = 1 - float(smoothstep(abs(y), 0.11, 0.17))
        right = float(smoothstep(-y, 0.05, 0.25))
        edge = float(smoothstep(abs(v), 0.86, 1.0))
        face = face_x + shape.passenger * right - shape.stack * stack * (1 - 0.5 * hood) + 0.03 * edge
        upper = top_z + shape.hood * hood - 0.012 * right - 0.015 * edge
        brow = max(face - shape.brow - 0.075 * hood, behind_rim(upper, y) + 0.03 * (1 - hood))
        lower = low_z + 0.02 * right - 0.05 * stack
        front = min(cowl_x - 0.09 * v * v, cowl_x)
        ledge = shape.ledge * (1 - hood) * (1 - stack)
        points = [
            (front, lower + 0.16), (front, layout.cowl_z - 0.03), (front - 0.03, layout.cowl_z - 0.004),
            (0.5 * front + 0.5 * brow, 0.5 * layout.cowl_z + 0.5 * upper + 0.008), (brow + 0.05, upper),
            (brow + 0.008, upper - 0.006), (brow, upper - 0.022), (brow + 0.012 + 0.03 * hood, upper - 0.040 - 0.02 * hood),
            (face + 0.02 + 0.02 * hood, upper - 0.075 - 0.05 * hood), (face + 0.022, 0.5 * (upper + lower) + 0.02),
            (face - ledge, 0.5 * (upper + lower) - 0.005), (face - 0.6 * ledge + 0.01, 0.5 * (upper + lower) - 0.035),
            (face + 0.5 * shape.tilt, lower + 0.05), (face + shape.tilt, lower + 0.005), (face + shape.tilt + 0.03, lower),
            (0.4 * front + 0.6 * (face + shape.tilt), lower + 0.04),
        ]  # fmt: skip
        curve = smooth_curve(points, 26, closed=True)
        rings.append(np.stack((curve[:, 0], np.full(len(curve), y), curve[:, 1]), axis=-1))
    parts = [Part("dashboard", to_surface(loft(np.stack(rings)), "dashboard", "soft_trim"))]

    details = []
    vent = block((0.03, 0.11, 0.052))
    mid_z = top_z - 0.095
    for y in (layout.h_front[1] + 0.27, -layout.h_front[1] - 0.22):
        x = face_x + 0.03 + (shape.passenger if y < 0 else 0.0)
        if abs(y) + 0.06 < float(layout.half_width(np.array(x), np.array(mid_z))):
            details.append(vent.shifted(x, y, mid_z))
    centre_z = top_z - (0.075 if shape.screen == "floating" else 0.055)
    details += [vent.shifted(face_x - shape.stack + 0.014, y, centre_z) for y in (-0.077, 0.077)]
    parts.append(Part("vents", to_surface(join(details), "dashboard", "hard_plastic")))
    if shape.screen == "floating":
        screen = rounded_box((0.016, 0.27, 0.145), (0.006, 0.014, 0.014), (1, 1, 1), corner=1)
        screen = screen.turned("y", np.deg2rad(8)).shifted(face_x - shape.stack - 0.022, 0.0, top_z + 0.02)
    else:
        screen = rounded_box((0.02, 0.205, 0.115), (0.006, 0.010, 0.010), (1, 1, 1), corner=1)
        screen = screen.turned("y", np.deg2rad(5)).shifted(face_x - shape.stack + 0.012, 0.0, top_z - 0.145)
    parts.append(Part("screen", to_surface(screen, "screen", "hard_plastic")))
    return parts


def steering_wheel(layout: Layout) -> SteeringWheel:
    """Where the wheel is, and the size of its rim."""
    d = layout.d
    section = 0.0165 if d.seat_style != "sport" else 0.0185
    tilt = np.deg2rad(d.a18_deg)
    pose = np.eye(4)
    pose[:3, 0] = (rp.sin(tilt), 0, rp.cos(tilt))
    pose[:3, 1] = (0, 1, 0)
    pose[:3, 2] = (-rp.cos(tilt), 0, rp.sin(tilt))
    pose[:3, 3] = (-d.l11_mm / 1000, layout.h_front[1], d.h17_mm / 1000)
    return SteeringWheel(pose, d.w9_mm / 2000 - section, section)


def steering(layout: Layout) -> tuple[SteeringWheel, list[Part]]:
    """The wheel in group "wheel" (rim, spokes, airbag cover) and the fixed column with its stalks."""
    d, wheel = layout.d, steering_wheel(layout)
    pose, radius, section = wheel.vehicle_from_wheel, wheel.rim_radius_m, wheel.rim_section_m

    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    flat = 0.022 * smoothstep(-rp.cos(angle), 0.86, 1.0) if d.seat_style == "sport" else 0.0  # flattened bottom
    path = np.stack(((radius - flat) * rp.cos(angle), (radius - flat) * rp.sin(angle), 0 * angle), axis=-1)
    off = np.abs(np.abs((angle + np.pi) % (2 * np.pi) - np.pi) - np.deg2rad(68))
    bulge = 1 + 0.16 * rp.exp(-((off / 0.16) ** 2))  # thumb rests at ten and two
    rim = sweep(path, ellipse(section * bulge, section * bulge, 10), closed=True, up=(0, 0, 1))

    four = d.dash_style in ("simple", "upright")
    places = [68, -68, 125, -125] if four else [92, -92, 180]
    spokes = []
    for degrees in places:
        a = np.deg2rad(degrees)
        along = np.array([rp.cos(a), rp.sin(a)])
        reach = np.linspace(0.045, radius, 7)
        depth = -0.045 + 0.043 * smoothstep(reach, 0.06, radius)
        line = np.stack((reach * along[0], reach * along[1], depth), axis=-1)
        s = np.linspace(0, 1, 7)
        wide = 0.034 - 0.014 * rp.sin(np.pi * s * 0.8) if degrees != 180 else 0.022 - 0.006 * s
        spokes.append(sweep(line, ellipse(0.0085 + 0 * s, wide, 10, 2.6), up=(0, 0, 1)))
    hub = rounded_box((0.155, 0.165, 0.055), (0.060, 0.070, 0.022), (2, 2, 1), corner=2)

    def dome(p: Floats) -> Floats:
        x, y, z = p.T
        rise = 0.016 * np.clip(1 - (x / 0.08) ** 2 - (y / 0.085) ** 2, 0, 1) * (z > 0)
        return np.stack((x - 0.006, y * (1 + 1.2 * np.minimum(x, 0)), z - 0.047 + rise), axis=-1)

    parts = [
        Part("steering wheel rim", to_surface(rim, "steering_wheel", "steering_leather"), WHEEL_GROUP),
        Part("steering wheel spokes", to_surface(join(spokes), "steering_wheel", "hard_plastic"), WHEEL_GROUP),
        Part("airbag cover", to_surface(hub.deformed(dome), "steering_wheel", "hard_plastic"), WHEEL_GROUP),
    ]

    axis = -pose[:3, 2]
    start = pose[:3, 3] + 0.055 * axis
    reach = (dash_measures(layout)[1] + 0.05 - start[0]) / axis[0]
    column = tube([start, start + axis * reach * 0.5, start + axis * reach], [0.045, 0.055, 0.065], 14)
    stalks = []
    for side in (-1, 1):
        root = start + 0.02 * axis
        tip = root + np.array([0.0, side * 0.140, 0.008]) + 0.004 * axis
        stalks.append(tube([root + (0, side * 0.04, 0), 0.5 * (root + tip), tip], [0.008, 0.009, 0.0105], 6))
    parts.append(Part("steering column", to_surface(join([column, *stalks]), "steering_column", "hard_plastic")))
    return wheel, parts


def pedals(layout: Layout, driver_y: float) -> tuple[dict[str, Matrix], list[Part]]:
    """Poses of the pads (origin at the ball of the foot, x up the pad, z out of it) and their parts.

    The accelerator is right of the brake whichever side the driver sits on, so pedals are placed, not mirrored.
    """
    rest = float(np.clip(layout.pedal_angle - _FOOTREST_FLATTER, *_FOOTREST_ANGLES))
    places: dict[str, tuple[float, float, tuple[float, float], float]] = {  # y offset, proud of the plane, pad (long, wide), up
        "accelerator": (-0.115, 0.0, (0.13, 0.055), 0.0),
        "brake": (-0.035 if not layout.d.clutch else -0.025, 0.045, (0.065, 0.105 if not layout.d.clutch else 0.075), 0.02),
        "footrest": (0.20, 0.02, (0.20, 0.075), -0.01),
    }
    if layout.d.clutch:
        places["clutch"] = (0.085, 0.045, (0.065, 0.072), 0.02)
    room = float(layout.half_width(np.array(0.12), np.array(0.1)))
    poses: dict[str, Matrix] = {}
    parts = []
    for name in ("accelerator", "brake", "clutch", "footrest"):
        if name not in places:
            continue
        dy, proud, (long, wide), up = places[name]
        a = rest if name == "footrest" else layout.pedal_angle
        along, out = np.array([rp.cos(a), 0, rp.sin(a)]), np.array([-rp.sin(a), 0, rp.cos(a)])
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1], pose[:3, 2] = along, (0, 1, 0), out
        y = float(np.clip(driver_y + dy, -room + 0.06, room - 0.06))
        pose[:3, 3] = (PEDAL_LENGTH + up) * along + proud * out + (0, y, 0)
        poses[name] = pose
        pad = rounded_box((long, wide, 0.018), (0.012, 0.012, 0.006), (3, 1, 1), corner=1).shifted(0, 0, -0.009)
        solids = [pad]
        if name == "footrest":
            solids = [rounded_box((long, wide, 0.05), 0.012, (3, 1, 1), corner=1).shifted(0, 0, -0.025)]
        elif name == "accelerator":
            solids.append(tube([(0.05, 0, -0.014), (0.10, 0, -0.04), (0.17, 0, -0.055)], 0.007, 6))
        else:
            solids.append(tube([(0.0, 0, -0.014), (0.08, 0, -0.035), (0.24, 0, -0.02)], 0.008, 6))
        material = "rubber" if name != "footrest" else "hard_plastic"
        parts.append(Part(f"{name} pedal", to_surface(join(solids).moved(pose), "pedal", material)))
    return poses, parts


def _cup_holder() -> Solid:
    """A collar around a mat, both sunk into the surface at z = 0: the well itself is not dug out."""
    turn = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
    circle = np.column_stack((rp.cos(turn), rp.sin(turn), 0.0 * turn))
    wall = [(0.0, -0.02), (_COLLAR_M, -0.02), (_COLLAR_M, _PROUD_M - 0.001), (0.5 * _COLLAR_M, _PROUD_M), (0.0, _PROUD_M - 0.001)]
    collar = [np.column_stack(((_CUP_M + out) * circle[:, :2], np.full(len(turn), z))) for out, z in wall]
    mat = [(_CUP_M + 0.5 * _COLLAR_M) * circle + (0.0, 0.0, z) for z in (-0.01, 0.001)]
    return join([loft(np.stack(collar), closed=True), loft(np.stack(mat))])


def console(layout: Layout, seat_width: float) -> tuple[list[Part], Vector]:
    """The centre console, if any, and the gear lever; also where a hand finds the lever's knob, (3,) m."""
    d = layout.d
    h_x, h_z = layout.h_front[0], layout.h_front[2]
    _, face_x, _, low_z = dash_measures(layout)
    half = min(layout.h_front[1] - seat_width / 2 - 0.012, 0.115)
    parts = []
    knob = np.array([h_x + 0.43, 0.0, h_z + 0.14])
    if d.console_style != "none":
        front = face_x + 0.10
        lid = h_z + {"low": 0.07, "tunnel": 0.13, "high": 0.17}[d.console_style]
        deck = h_z + {"low": -0.03, "tunnel": 0.03, "high": 0.10}[d.console_style]
        rear = h_x - {"low": 0.08, "tunnel": 0.22, "high": 0.24}[d.console_style]
        x = np.linspace(rear, front, 18)
        armrest = 1 - smoothstep(x, h_x + 0.13, h_x + 0.20)
        climb = smoothstep(x, face_x - 0.20, face_x + 0.04)
        top = deck + (lid - deck) * armrest + (low_z + 0.05 - deck) * climb * (1.0 if d.console_style != "low" else 0.75)
        wide = half * (1 - 0.08 * (1 - armrest)) * (1 - 0.15 * smoothstep(-x, -rear - 0.05, -rear))
        low = float(d.tunnel_mm) / 1000 * 0.5
        height = (top - low) / 2
        section = ellipse(height, wide, 16, 6.0)
        path = np.stack((x, 0 * x, low + height), axis=-1)
        rings = path[:, None] + np.stack((0 * section[..., 0], section[..., 1], section[..., 0]), axis=-1)
        parts.append(Part("centre console", to_surface(loft(rings), "console", "soft_trim" if d.leather else "hard_plastic")))
        places = (-0.043, 0.043) if half > _TWO_CUPS_M else (0.0,)
        cups_x = h_x + 0.245
        holders = [_cup_holder().shifted(cups_x, y, float(np.interp(cups_x, x, top))) for y in places]
        parts.append(Part("cup holders", to_surface(join(holders), "console", "rubber")))
        deck_x = h_x + 0.36
        knob = np.array([deck_x, 0.0, float(np.interp(deck_x, x, top)) + (0.125 if d.clutch else 0.085)])
        foot = knob - (0.0, 0.0, 0.10)
    elif d.dash_style == "upright":
        knob = np.array([face_x - 0.17, layout.h_front[1] - 0.27, low_z + 0.13])
        foot = np.array([face_x + 0.02, knob[1], low_z + 0.06])
        pod = rounded_box((0.16, 0.15, 0.12), 0.03, (1, 1, 1)).shifted(face_x + 0.02, float(knob[1]), low_z + 0.06)
        parts.append(Part("gear lever pod", to_surface(pod, "console", "hard_plastic")))
    else:
        foot = np.array([knob[0] + 0.05, 0.0, 0.04])
        boot = rounded_box((0.26, 0.15, 0.10), (0.05, 0.05, 0.04), (2, 1, 1)).shifted(float(foot[0]), 0, 0.05)
        parts.append(Part("gear lever boot", to_surface(boot, "console", "hard_plastic")))
    lever = tube([foot, 0.5 * (foot + knob), knob], 0.008, 8)
    ball = rounded_box((0.045, 0.040, 0.055), (0.021, 0.019, 0.024), (1, 1, 1), corner=2).shifted(*knob)
    parts.append(Part("gear lever", to_surface(join([lever, ball]), "console", "hard_plastic")))
    return parts, knob
