"""What encloses a cabin: floor, toe board, doors, pillars, glass, roof, shelf and tail, each a slab that is solid outwards."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.layout import WALL, Layout
from cabinpose.scene.cabin.model import Part
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.cabin.shapes import Solid, block, ellipse, join, loft, rounded_box, slab, smooth_curve, smoothstep, sweep

_UNDER_MATS_M = 0.004  # of the carpet, below the height at which heels stand: mats lie on it

Line = Callable[[Floats], Floats]


def _both_sides(solid: Solid) -> Solid:
    return join([solid, solid.mirrored()])


def _side_patch(layout: Layout, x: Floats, z: Floats, inset: Floats | float, thickness: float = WALL) -> Solid:
    """The left-hand slab over grids x, z (M, N): its inner face lies `inset` inside the half width, its outer is smooth."""
    y = layout.half_width(x, z)
    return slab(np.stack((x, y - inset, z), axis=-1), np.stack((x, y + thickness, z), axis=-1))


def _lower_grid(layout: Layout, x_front: float, x_rear: float, cells: tuple[int, int]) -> tuple[Floats, Floats, Floats, Floats]:
    """Grids (x, z, s, t) below the belt line: s 0 front .. 1 rear, t 0 sill .. 1 belt."""
    s, t = np.meshgrid(np.linspace(0, 1, cells[0] + 1), np.linspace(0, 1, cells[1] + 1), indexing="ij")
    x = x_front + s * (x_rear - x_front)
    return x, -0.02 + t * (layout.belt_line(x) + 0.02), s, t


def _upper_grid(layout: Layout, front: Line, rear: Line, cells: tuple[int, int]) -> tuple[Floats, Floats, Floats, Floats]:
    """Grids (x, z, s, t) from the belt line to the roof rail, between two lines in side view."""
    s, t = np.meshgrid(np.linspace(0, 1, cells[0] + 1), np.linspace(0, 1, cells[1] + 1), indexing="ij")
    nominal = layout.belt_z + t * (layout.head_front[1] - 0.10 - layout.belt_z)
    x = front(nominal) + s * (rear(nominal) - front(nominal))
    z = layout.belt_line(x) + t * (layout.rail_z(x) - layout.belt_line(x))
    return x, z, s, t


def _door_trim(style: str, s: Floats, t: Floats) -> Floats:
    """Depth (m) of the door trim inside the clear half width: what tells one door from another."""
    shoulder = 0.012 * smoothstep(t, 0.80, 0.90)
    edge = smoothstep(s, 0.0, 0.06) * smoothstep(1 - s, 0.0, 0.06)
    if style == "plain":
        trim = 0.006 + 0.030 * smoothstep(0.30 - t, 0.0, 0.06)
    elif style == "pocket":
        trim = 0.045 * smoothstep(0.34 - t, 0.0, 0.10) + 0.012 * rp.sin(np.pi * t) ** 2
    elif style == "sport":
        sweep_line = 0.40 + 0.28 * s
        trim = 0.040 * smoothstep(sweep_line - t, -0.10, 0.16)
    elif style == "upright":
        trim = 0.055 * smoothstep(0.42 - t, 0.0, 0.08) * smoothstep(t, 0.02, 0.08)
    elif style == "wall":
        trim = 0.020 * smoothstep(0.5 - t, 0.0, 0.2)
    else:  # sweep
        wave = 0.42 + 0.10 * rp.sin(np.pi * (s - 0.15))
        trim = 0.038 * smoothstep(wave - t, -0.05, 0.14) + 0.010 * smoothstep(t, 0.62, 0.80)
    return np.asarray(edge * trim + shoulder)


def _armrest(layout: Layout, h_x: float, seat_z: float, length: float) -> Solid:
    """A door armrest that rises out of the trim, its top about 190 mm above the H-point."""
    style = layout.d.door_style
    depth, height = {"plain": (0.045, 0.05), "pocket": (0.065, 0.075), "sport": (0.050, 0.06), "upright": (0.060, 0.05)}.get(
        style, (0.065, 0.065)
    )
    box = rounded_box((length, 2 * depth, height), (0.07, 0.026, 0.024), (5, 1, 1), corner=1)
    top = seat_z + 0.19

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        x_ = x + h_x + 0.10
        s = x / length + 0.5  # rises towards the front, where the pull handle is
        z_ = z + top - height / 2 + 0.05 * smoothstep(s, 0.55, 1.0)
        return np.stack((x_, y * (1 - 0.25 * smoothstep(s, 0.7, 1.0)) + layout.half_width(x_, z_), z_), axis=-1)

    return box.deformed(bend)


def _on_door(layout: Layout, solid: Solid, x: float, z: float) -> Solid:
    """A solid around the origin, set on the left door's trim at (x, z) with its middle in the clear half width."""

    def bend(p: Floats) -> Floats:
        x_, z_ = p[:, 0] + x, p[:, 2] + z
        return np.stack((x_, p[:, 1] + layout.half_width(x_, z_), z_), axis=-1)

    return solid.deformed(bend)


def _door_fittings(layout: Layout) -> list[Solid]:
    """Map pockets, release handles and, where the style has them, loudspeakers, on both rows' doors."""
    style = layout.d.door_style
    rows = [(layout.h_front, 0.30)] + ([(layout.h_rear, 0.16)] if style != "sport" else [])
    solids = []
    for h, ahead in rows:
        release = block((0.095, 0.045, 0.034))
        solids.append(_on_door(layout, release, h[0] + ahead + 0.10, layout.belt_z - 0.10))
        if style in ("pocket", "sweep", "upright"):
            pocket = rounded_box((0.42, 0.11, 0.15), (0.07, 0.03, 0.03), (3, 1, 1), corner=1)
            solids.append(_on_door(layout, pocket, h[0] + ahead - 0.06, 0.17))
        if style in ("sweep", "sport"):
            ring = 0.075 * np.stack([rp.cos(np.arange(14) * np.pi / 7), rp.sin(np.arange(14) * np.pi / 7)], axis=-1)
            rings = [
                np.stack((r * ring[:, 0], np.full(14, y), r * ring[:, 1]), axis=-1)
                for r, y in ((1, 0.03), (1, -0.024), (0.8, -0.030))
            ]
            solids.append(_on_door(layout, loft(np.stack(rings)), h[0] + ahead + 0.20, 0.30))
    return solids


def doors(layout: Layout) -> list[Part]:
    """Trim, armrests, sills and side structure below the belt line, and the pillars and glass above it."""
    parts: list[Part] = []

    def add(name: str, solid: Solid, label: str = "trim", material: str = "soft_trim", give: float = 0.0) -> None:
        parts.append(Part(name, to_surface(_both_sides(solid), label, material), give_m=give))

    b = layout.b_pillar_x
    rear_cut = float(layout.c_pillar_x(np.array(layout.belt_z)))
    door_front = 0.02 if not layout.facing else layout.cowl_x - 0.12
    grid = _lower_grid(layout, door_front, b, (9, 12))
    add("front door trim", _side_patch(layout, grid[0], grid[1], _door_trim(layout.d.door_style, *grid[2:])), "door")
    grid = _lower_grid(layout, b, rear_cut, (8, 12))
    add("rear door trim", _side_patch(layout, grid[0], grid[1], _door_trim(layout.d.door_style, *grid[2:])), "door")
    grid = _lower_grid(layout, max(layout.firewall_x, layout.cowl_x) + 0.03, door_front, (4, 6))
    add("kick panel", _side_patch(layout, grid[0], grid[1], 0.004), material="hard_plastic")
    grid = _lower_grid(layout, rear_cut, layout.back_x, (5, 6))
    add("rear quarter trim", _side_patch(layout, grid[0], grid[1], 0.01))

    if not layout.facing:
        armrests = [_armrest(layout, layout.h_front[0], layout.h_front[2], 0.46)]
        if layout.d.door_style != "sport":
            armrests.append(_armrest(layout, layout.h_rear[0], layout.h_rear[2], 0.40))
        add("armrests", join(armrests), "door", give=0.01)
        add("door fittings", join(_door_fittings(layout)), "door", material="hard_plastic")

    x = np.linspace(door_front, rear_cut, 8)
    path = np.stack((x, layout.half_width(x, 0.05 + 0 * x) + 0.015, np.full_like(x, 0.035)), axis=-1)
    add("sill", sweep(path, ellipse(0.055, 0.055, 10, 3.0), up=(0, 0, 1)), material="hard_plastic")

    half_b = 0.045
    windows = (
        ("front side glass", layout.a_pillar_x, lambda z: layout.b_line(z) + half_b),
        ("rear side glass", lambda z: layout.b_line(z) - half_b, layout.c_pillar_x),
    )
    for name, front, rear in windows:
        x, z, _, _ = _upper_grid(layout, front, rear, (6, 4))
        add(name, _side_patch(layout, x, z, -0.008, WALL + 0.02), "glass", "glass")

    z = np.linspace(0.02, float(layout.rail_z(b)) + 0.03, 9)
    path = np.stack((layout.b_line(z), layout.half_width(layout.b_line(z), z) + 0.012, z), axis=-1)
    width = 0.055 + 0.03 * smoothstep(layout.belt_z - z, 0.1, 0.5)
    add("B-pillar", sweep(path, ellipse(width, 0.036 + 0 * z, 12, 2.6), up=(1, 0, 0)), material="hard_plastic")

    t = np.linspace(-0.12, 1.06, 7)
    z = layout.cowl_z + t * (float(layout.rail_z(layout.header_x)) - layout.cowl_z)
    x = layout.a_pillar_x(z) + 0.045
    path = np.stack((x, layout.half_width(x, z) + 0.006, z), axis=-1)
    add("A-pillar", sweep(path, ellipse(0.062, 0.040, 12, 2.4), up=(1, 0, 0)), material="hard_plastic")

    def backlight(z: Floats) -> Floats:
        return np.minimum(layout.backlight_x(z), layout.c_pillar_x(z) - 0.06)

    x, z, s, _ = _upper_grid(layout, layout.c_pillar_x, backlight, (6, 6))
    inset = 0.012 + 0.03 * np.sqrt(np.clip(rp.sin(np.pi * np.clip(s, 0.0, 0.5)), 0, 1))
    add("C-pillar", _side_patch(layout, x, z, inset), material="soft_trim")

    x = np.linspace(layout.header_x + 0.03, layout.roof_end_x, 10)
    z = layout.rail_z(x) + 0.035
    down = np.linspace(0.15, 1.0, 4)  # and on along the backlight to the shelf
    z = np.concatenate((z, z[-1] + down * (layout.shelf_z - 0.04 - z[-1])))
    x = np.concatenate((x, layout.backlight_x(z[-4:]) + 0.09 * (1 - down)))
    path = np.stack((x, layout.half_width(x, z) + 0.004, z), axis=-1)
    add("roof rail", sweep(path, ellipse(0.052, 0.036, 10, 2.4), up=(0, 0, 1)), material="headliner")
    return parts


def floor(layout: Layout) -> list[Part]:
    """Floor with its tunnel, toe board, and firewall: one carpeted slab."""
    toe = layout.toe_x
    angle = layout.pedal_angle - np.deg2rad(6)
    if layout.facing:
        side_view = np.array([(layout.back_x, 0.0), (layout.cowl_x + 0.02, 0.0)])
    else:
        up = 0.30
        bend = (toe + up * rp.cos(angle), up * rp.sin(angle))
        side_view = np.array([(layout.back_x, 0.0), (toe, 0.0), bend, (layout.firewall_x + 0.06, layout.cowl_z)])
    lengths = np.linalg.norm(np.diff(side_view, axis=0), axis=1)
    cells = np.maximum(np.round(lengths / 0.16).astype(int), 2)
    pieces = zip(side_view[:-1], side_view[1:], cells, strict=True)
    line = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in pieces] + [side_view[-1:]])
    v = np.array([0.09, 0.18, 0.27, 0.42, 0.7, 1.0])
    v = np.concatenate((-v[::-1], [0.0], v))
    tangent = np.gradient(line, axis=0)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack((-tangent[:, 1], tangent[:, 0]), axis=-1)  # into the cabin
    x, z = np.repeat(line[:, :1], len(v), 1), np.repeat(line[:, 1:], len(v), 1)
    y = v * (layout.half_width(x, np.full_like(x, 0.05)) + 0.02)
    bump = layout.floor_z(x, y) - (0.0 if layout.facing else _UNDER_MATS_M)
    inner = np.stack((x + bump * normal[:, :1], y, z + bump * normal[:, 1:]), axis=-1)
    outer = np.stack((x - WALL * normal[:, :1], y, z - WALL * normal[:, 1:]), axis=-1)
    parts = [Part("floor", to_surface(slab(inner, outer), "floor", "carpet"))]
    if not layout.facing:
        rails = []
        for side in (-1, 1):
            for dy in (-0.19, 0.19):
                box = block((0.50, 0.035, 0.03))
                rails.append(box.shifted(layout.h_front[0] + 0.06, side * layout.h_front[1] + dy, 0.012))
        material = "carpet" if layout.d.leather else "rubber"
        parts.append(Part("floor mats", to_surface(join(_mats(layout)), "floor", material)))
        parts.append(Part("seat rails", to_surface(join(rails), "floor", "metal")))
    return parts


def _mats(layout: Layout) -> list[Solid]:
    """A mat before each outer seat, its top the height on which heels stand; clear of the tunnel, the sills and the rails."""
    rows = ((layout.h_front, layout.h_front[0] + 0.34, layout.toe_x - 0.01), (layout.h_rear, layout.h_rear[0] + 0.28,
             layout.h_rear[0] + 0.60))  # fmt: skip
    solids = []
    for h, rear, front in rows:
        edge = float(layout.half_width(np.array(front), np.array(0.0))) - 0.07
        inner, outer = max(h[1] - 0.21, 0.15), min(h[1] + 0.22, edge)
        size = (front - rear, outer - inner, 2.0 * _UNDER_MATS_M)
        mat = rounded_box(size, (0.06, 0.06, 0.002), (2, 2, 1), corner=1).shifted(0.5 * (front + rear), 0.5 * (inner + outer))
        solids += [mat.shifted(z=-_UNDER_MATS_M), mat.shifted(z=-_UNDER_MATS_M).mirrored()]
    return solids


def roof(layout: Layout) -> list[Part]:
    """Headlining, windscreen, backlight, parcel shelf and tail."""
    v = np.linspace(-1, 1, 13)
    x = np.linspace(layout.header_x, layout.roof_end_x, 13)
    xg, vg = np.meshgrid(x, v, indexing="ij")
    y = vg * (layout.half_width(xg, layout.rail_z(xg)) + 0.02)
    z = layout.roof(xg, y)
    inner = np.stack((xg, y, z), axis=-1)
    parts = [Part("headlining", to_surface(slab(inner, inner + (0, 0, WALL)), "trim", "headliner"))]
    parts.append(Part("windscreen", to_surface(_end_glass(layout, front=True), "glass", "glass")))
    parts.append(Part("backlight", to_surface(_end_glass(layout, front=False), "glass", "glass")))
    seat_top_x = layout.h_rear[0] - 0.16 - 0.42 * rp.sin(layout.torso_2)
    if layout.d.door_style != "upright" and not layout.facing and seat_top_x - 0.05 > layout.shelf_end_x:
        x = np.linspace(seat_top_x, layout.shelf_end_x - 0.02, 6)
        xg, vg = np.meshgrid(x, np.linspace(-1, 1, 9), indexing="ij")
        y = vg * layout.half_width(xg, np.full_like(xg, layout.belt_z))
        top = np.stack((xg, y, layout.shelf_z - 0.02 + 0.0 * xg), axis=-1)
        parts.append(Part("parcel shelf", to_surface(slab(top, top - (0, 0, 0.03)), "trim", "carpet")))
    parts.append(_end_wall(layout, "tail panel", layout.back_x, -1.0))
    if layout.facing:
        parts.append(_end_wall(layout, "front panel", layout.cowl_x, 1.0))
    return parts


def _end_wall(layout: Layout, name: str, x: float, outward: float) -> Part:
    zg, vg = np.meshgrid(np.linspace(-0.03, layout.belt_z + 0.03, 6), np.linspace(-1, 1, 9), indexing="ij")
    xg = np.full_like(zg, x) - outward * 0.05 * rp.power(vg, 4)
    y = vg * (layout.half_width(xg, zg) + 0.02)
    inner = np.stack((xg, y, zg), axis=-1)
    return Part(name, to_surface(slab(inner, inner + (outward * WALL, 0, 0)), "trim", "hard_plastic"))


def _end_glass(layout: Layout, front: bool) -> Solid:
    """Windscreen or backlight: bowed in plan, from the cowl or shelf up to the edge of the headlining."""
    slope = layout.screen_slope if front else layout.backlight_slope
    way = 1.0 if front else -1.0
    low = layout.cowl_z - 0.02 if front else layout.shelf_z - 0.02
    edge_x = layout.header_x if front else layout.roof_end_x
    t, v = np.meshgrid(np.linspace(0, 1, 7), np.linspace(-1, 1, 13), indexing="ij")
    half = layout.half_width(np.full_like(t, edge_x), np.full_like(t, layout.belt_z))
    y = v * half
    for _ in range(3):  # the glass narrows with height, and height follows the roof's crown at y
        top = layout.roof(np.full_like(t, edge_x), y) + 0.01
        z = low + t * (top - low)
        line = layout.screen_x(z) if front else layout.backlight_x(z)
        x = line - way * 0.09 * v**2 * (1 - 0.6 * t)
        y = v * (layout.half_width(x, z) + 0.01)
    inner = np.stack((x, y, z), axis=-1)
    normal = np.array([way, 0.0, slope]) / rp.hypot(1.0, slope)
    return slab(inner, inner + WALL * normal)


def mirror_place(layout: Layout) -> tuple[float, float]:
    """x and z of the middle of the rear-view mirror, m; it is on the centre line."""
    z = layout.header_z - 0.105
    return float(layout.screen_x(np.array(z))) - 0.105, z


def roof_fittings(layout: Layout) -> list[Part]:
    """Sun visors, rear-view mirror, grab handles and roof console."""
    parts = []
    if not layout.facing:
        visors = []
        for side in (-1, 1):
            y0, x0 = side * layout.h_front[1] * 0.98, layout.header_x - 0.10
            box = rounded_box((0.155, 0.38, 0.020), (0.03, 0.05, 0.009), (1, 5, 1), corner=1)

            def bend(p: Floats, x0: float = x0, y0: float = y0) -> Floats:
                x, y = p[:, 0] + x0, p[:, 1] + y0
                return np.stack((x, y, p[:, 2] + layout.roof(x, y) - 0.018), axis=-1)

            visors.append(box.deformed(bend))
        parts.append(Part("sun visors", to_surface(join(visors), "trim", "headliner")))
        x, z = mirror_place(layout)
        mirror = rounded_box((0.028, 0.23, 0.066), (0.012, 0.030, 0.028), (1, 2, 1), corner=1)
        mirror = mirror.turned("z", np.deg2rad(-12)).turned("y", np.deg2rad(8)).shifted(x, 0, z)
        stem = smooth_curve([(x + 0.015, 0, z), (x + 0.05, 0, z + 0.035), (x + 0.10, 0, z + 0.075)], 4)
        stalk = sweep(stem, ellipse(0.011, 0.011, 6))
        parts.append(Part("rear-view mirror", to_surface(join([mirror, stalk]), "mirror", "hard_plastic")))
    handles = []
    places = [layout.h_rear[0] + 0.02] if not layout.facing else [layout.h_rear[0] + 0.1, layout.h_front[0] - 0.1]
    for x in places:
        xs = x + np.array([-0.11, -0.10, -0.05, 0.05, 0.10, 0.11])
        z = layout.rail_z(xs) + np.array([0.05, 0.02, 0.0, 0.0, 0.02, 0.05])
        y = layout.half_width(xs, z) - np.array([0.03, 0.055, 0.062, 0.062, 0.055, 0.03])
        handles.append(_both_sides(sweep(np.stack((xs, y, z), axis=-1), ellipse(0.010, 0.010, 8))))
    parts.append(Part("grab handles", to_surface(join(handles), "trim", "hard_plastic")))
    return parts
