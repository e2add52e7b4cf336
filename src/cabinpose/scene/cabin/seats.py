"""Seats around an H-point: cushion, backrest and headrest with foam, and the hard parts under and behind them.

The free (not pressed) foam lies closer to the H-point than the pans of the SAE J826 manikin (98 mm below, 135 mm
behind the torso line), by what a seat gives under a sitter. Base parts are in the seat frame (H-point, x forward,
z up), back and headrest parts in the back frame (z along the torso line).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.model import Part
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.cabin.shapes import Solid, block, join, prism, rounded_box, smoothstep, tube

PAN_BELOW_H = 0.098  # SAE J826: H-point to the seat pan's lowest line
PAN_BEHIND_H = 0.135  # SAE J826: H-point to the back pan, normal to the torso line
CUSHION_GIVE = 0.055  # foam under the thighs of a production seat gives 50 to 60 mm at most
BACK_GIVE = 0.050
HEADREST_GIVE = 0.040
_KNEES_M = 0.020  # of the hollow for knees in the rear face of a front seat
_SHELL_M, _POCKET_M = 0.007, 0.010  # of the hard cover behind the foam, of the map pocket behind the cover
# Where a seat's cushion is, and its backrest with the headrest: opposite corners (2, 3) from the H-point in the seat's frame, m.
CUSHION_BOX = np.array(((-0.30, -0.30, -0.21), (0.45, 0.30, 0.10)))
BACK_BOX = np.array(((-0.62, -0.30, -0.14), (0.02, 0.30, 0.80)))


@dataclass(frozen=True)
class SeatShape:
    """Measures of a seat's upholstery, m: what makes one style differ from another.

    `bolster_*`: height of the side bolsters · `insert`: half width of the flat middle · `headrest`: None, "posts",
    "integral" (one piece with the backrest) or "wing".
    """

    width: float = 0.52
    cushion_below_h: float = 0.058
    back_behind_h: float = 0.095
    front: float = 0.385  # cushion's front edge ahead of the H-point
    cushion_depth: float = 0.125
    back_depth: float = 0.105
    back_height: float = 0.605  # top of the backrest above the H-point along the torso line
    back_low: float = -0.10  # its lower edge
    top_width: float = 0.42
    bolster_cushion: float = 0.030
    bolster_back: float = 0.045
    insert: float = 0.150
    lumbar: float = 0.012
    headrest: str = "posts"
    headrest_width: float = 0.265
    head_height: float = 0.20  # of an integral headrest above the backrest
    shell: str = "car"  # what carries the cushion: "car", "pedestal", "box"
    armrests: bool = False

    def of_width(self, width: float) -> SeatShape:
        """The same, this wide (m)."""
        wider = width / self.width
        return replace(self, width=width, top_width=self.top_width * wider, insert=self.insert * wider)


class SeatStand(NamedTuple):
    """How a seat stands: the angle of its cushion (rad), its H-point above the floor, half of what its height varies by (m)."""

    cushion_angle: float
    height: float
    half_travel: float = 0.0


STYLES = {
    "compact": SeatShape(width=0.485, bolster_cushion=0.022, bolster_back=0.035, insert=0.145, back_depth=0.085,
                         cushion_depth=0.11,
                         front=0.365, top_width=0.30, back_height=0.63, headrest="integral", headrest_width=0.25),
    "comfort": SeatShape(),
    "sport": SeatShape(width=0.535, bolster_cushion=0.055, bolster_back=0.075, insert=0.150, front=0.40, top_width=0.36,
                       back_height=0.64, headrest="wing", headrest_width=0.26, lumbar=0.016, back_depth=0.09, back_low=-0.05),
    "captain": SeatShape(width=0.505, bolster_cushion=0.018, bolster_back=0.030, insert=0.170, back_height=0.62, top_width=0.45,
                         front=0.375, shell="pedestal", armrests=True, headrest_width=0.29, back_depth=0.095),
    "plus2": SeatShape(width=0.47, bolster_cushion=0.030, bolster_back=0.040, insert=0.13, back_height=0.50, top_width=0.36,
                       front=0.33, back_depth=0.09, headrest="integral", head_height=0.09, headrest_width=0.25, shell="box"),
    "bench": SeatShape(width=0.48, bolster_cushion=0.012, bolster_back=0.020, insert=0.150, back_height=0.57, top_width=0.46,
                       front=0.350, shell="box", lumbar=0.006, headrest_width=0.25),
}  # fmt: skip


def _towards_edges(y: Floats, half: float) -> Floats:
    """Moves grid lines outwards, where the bolsters bend; the edges stay."""
    return np.asarray(np.sign(y) * half * rp.power(np.abs(y) / half, 0.72))


def _cushion(shape: SeatShape, angle: float, sides: tuple[float, float], fine: bool, floor: float) -> Solid:
    """The cushion; sides: bolster of the left and right edge, 1 = full height; its underside stays above `floor`."""
    rear = -0.215
    length, mid = shape.front - rear, (shape.front + rear) / 2
    box = rounded_box(
        (length, shape.width, shape.cushion_depth), (0.050, 0.040, 0.046), (7, 8, 1) if fine else (6, 5, 1), corner=1
    )

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        y = _towards_edges(y, shape.width / 2)
        s = (x + length / 2) / length  # 0 rear .. 1 front
        top = smoothstep(z, -shape.cushion_depth / 2, shape.cushion_depth / 2)
        bolster = np.where(y > 0, sides[0], sides[1]) * shape.bolster_cushion
        rise = bolster * smoothstep(np.abs(y), shape.insert, shape.width / 2 - 0.035) * smoothstep(s, 0.12, 0.5)
        dish = -0.010 * rp.exp(-(((x + mid) / 0.16) ** 2)) * (1 - (2 * y / shape.width) ** 2)  # hollow under the seat bones
        fall = -0.045 * rp.power(smoothstep(s, 0.80, 1.0), 1.5)  # waterfall edge under the knees
        narrow = 1 - 0.035 * smoothstep(s, 0.55, 1.0)
        x_ = x + mid
        slope = rp.tan(angle) * x_
        z_ = z - shape.cushion_depth / 2 - shape.cushion_below_h + slope + top * (rise + dish + fall)
        z_ = z_ + (1 - top) * 0.035 * smoothstep(-s, -0.55, 0.0)  # thinner at the rear: room for feet behind
        return np.stack((x_, y * narrow, np.where(top < 0.98, np.maximum(z_, floor + 0.012 * top), z_)), axis=-1)

    return box.deformed(bend)


def _crown(z: Floats) -> Floats:
    """How the upper back leans away, along x; z: height in the back frame, m."""
    return -0.018 * smoothstep(z, 0.36, 0.60)


def _rear_face(shape: SeatShape, y: Floats, z: Floats) -> Floats:
    """How far the rear face of a backrest is ahead of its lowest part: it tapers upwards; those with a shell leave knees room."""
    high = shape.back_height + (shape.head_height if shape.headrest == "integral" else 0.0)
    knees = _KNEES_M * rp.exp(-(((z - 0.22) / 0.14) ** 2)) * (1 - (2 * y / shape.width) ** 2) if shape.shell != "box" else 0.0
    return np.asarray(0.030 * smoothstep(z, 0.25, high) + knees)


def _back(shape: SeatShape, sides: tuple[float, float], fine: bool) -> Solid:
    """The backrest in the back frame."""
    low, high = shape.back_low, shape.back_height + (shape.head_height if shape.headrest == "integral" else 0.0)
    height, mid = high - low, (high + low) / 2
    box = rounded_box((shape.back_depth, shape.width, height), (0.042, 0.042, 0.060), (1, 8, 10) if fine else (1, 5, 8), corner=1)

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        y = _towards_edges(y, shape.width / 2)
        z_ = z + mid
        front = smoothstep(x, -shape.back_depth / 2, shape.back_depth / 2)
        bolster = np.where(y > 0, sides[0], sides[1]) * shape.bolster_back
        reach = smoothstep(z_, -0.10, 0.10) * (1 - 0.65 * smoothstep(z_, 0.34, 0.56))
        rise = bolster * smoothstep(np.abs(y), shape.insert * 0.95, shape.width / 2 - 0.03) * reach
        lumbar = shape.lumbar * rp.exp(-(((z_ - 0.17) / 0.11) ** 2))
        crown = _crown(z_)
        taper = 1 - (1 - shape.top_width / shape.width) * smoothstep(z_, 0.36, min(shape.back_height, high) - 0.01)
        head = np.zeros_like(z_)
        if shape.headrest == "integral":
            head = 0.065 * smoothstep(z_, shape.back_height - 0.08, high - 0.10)
        behind = (1 - front) * _rear_face(shape, y, z_)
        x_ = x - shape.back_depth / 2 - shape.back_behind_h + front * (rise + lumbar) + crown + head + behind
        return np.stack((x_, y * taper, z_), axis=-1)

    return box.deformed(bend)


def _headrest(shape: SeatShape) -> tuple[Solid, Solid | None]:
    """The pad and its posts, in the back frame."""
    wing = shape.headrest == "wing"
    size = (0.085, shape.headrest_width, 0.185)
    box = rounded_box(size, (0.036, 0.060, 0.062), (1, 4, 3), corner=1)
    centre_z, centre_x = shape.back_height + 0.045 + size[2] / 2, -0.050 - size[0] / 2

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        side = (2 * y / size[1]) ** 2
        x_ = x + (0.030 if wing else -0.012) * side - 0.010 * (2 * z / size[2]) ** 2 + 0.10 * z
        return np.stack((x_ + centre_x, y * (1 + 0.5 * z), z + centre_z), axis=-1)

    pad = box.deformed(bend)
    posts = []
    for side in (-1, 1):
        y = side * 0.065
        bottom = (-shape.back_behind_h - shape.back_depth / 2 - 0.005, y, shape.back_height - 0.06)
        path = [bottom, (bottom[0] + 0.002, y, shape.back_height + 0.01), (centre_x - 0.008, y, centre_z)]
        posts.append(tube(path, 0.0065, 6, rounded=False))
    return pad, join(posts)


def _behind(shape: SeatShape, size: tuple[float, float], middle: float, proud: float) -> Solid:
    """A flat piece of a width and height (m) on the rear face of a backrest, from its foam to `proud` behind it.

    middle: its height in the back frame, m.
    """
    thick = 0.010 + proud
    box = rounded_box((thick, *size), (0.45 * thick, 0.05, 0.05), (1, 3, 4), corner=1)

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        z_ = z + middle
        taper = 1 - (1 - shape.top_width / shape.width) * smoothstep(z_, 0.36, shape.back_height - 0.01)
        face = _crown(z_) + _rear_face(shape, y, z_) - shape.back_behind_h - shape.back_depth
        return np.stack((x + 0.5 * (0.010 - proud) + face, y * taper, z_), axis=-1)

    return box.deformed(bend)


def _back_shell(shape: SeatShape) -> Solid:
    """The hard cover behind the backrest, proud of the foam all over."""
    height = shape.back_height - 0.02
    return _behind(shape, (shape.width * 0.90, height), height / 2 - 0.06, _SHELL_M)


def _pocket(shape: SeatShape) -> Solid:
    """The map pocket on the lower half of the cover."""
    return _behind(shape, (shape.width * 0.70, 0.25), 0.17, _SHELL_M + _POCKET_M)


def _under(shape: SeatShape, stand: SeatStand) -> list[Solid]:
    """What carries the cushion, down to what the lowest setting leaves above the floor."""
    floor, angle = -stand.height + stand.half_travel + 0.006, stand.cushion_angle
    top = -shape.cushion_below_h - shape.cushion_depth
    if shape.shell == "pedestal":
        column = block((0.26, 0.28, 0.14)).shifted(0.08, 0, floor + 0.07)
        pan = rounded_box((0.46, 0.42, max(top - floor - 0.09, 0.05)), 0.03, (3, 1, 1), corner=1)
        return [column, pan.shifted(0.08, 0, (top + floor + 0.11) / 2)]
    if shape.shell == "box":
        profile = [(-0.20, floor), (0.26, floor), (0.30, top + 0.05), (0.28, top + 0.08), (-0.20, top - 0.03)]
        return [prism(profile, -shape.width / 2 + 0.004, shape.width / 2 - 0.004)]
    solids = []
    for side in (-1, 1):  # side shields, and the two risers that stand on the rails
        y = side * (shape.width / 2 - 0.012)
        shield = rounded_box((0.46, 0.028, 0.085), (0.03, 0.012, 0.03), (3, 1, 1), corner=1)

        def bend(p: Floats, y: float = y) -> Floats:
            x, side_y, z = p.T
            return np.stack((x, side_y + y, np.maximum(z + top + 0.025 + rp.tan(angle) * x, floor + 0.1 * z)), axis=-1)

        solids.append(shield.deformed(bend))
        for x in (-0.04, 0.23):  # behind the rear riser is room for the toes of those behind
            tall = max(top + 0.05 + rp.tan(angle) * x - floor, 0.03)
            solids.append(block((0.06, 0.05, tall)).shifted(x, side * (shape.width / 2 - 0.07), floor + tall / 2))
    return solids


def _armrests(shape: SeatShape, sides: tuple[int, ...]) -> Solid:
    """Folding armrests on these sides (+1 left), in the seat frame: they stay level when the back reclines."""
    arms = []
    for side in sides:
        pad = rounded_box((0.40, 0.055, 0.05), (0.03, 0.022, 0.022), (2, 1, 1), corner=1)
        arms.append(pad.shifted(-0.01, side * (shape.width / 2 + 0.030), 0.175))
    return join(arms)


def seat_parts(
    slot: str, shape: SeatShape, stand: SeatStand, *, leather: bool, sides: tuple[float, float] = (1.0, 1.0), fine: bool = True,
    armrests: tuple[int, ...] = (),
) -> list[Part]:  # fmt: skip
    """The parts of one place to sit.

    sides: bolster factors of the left and right edge · fine: more facets, for seats that a camera is close to ·
    armrests: the sides (+1 left) where the shape's armrests are folded down.
    """
    cover = "seat_leather" if leather else "seat_fabric"
    base, back, rest = (f"seat:{slot}/{g}" for g in ("base", "back", "headrest"))
    cushion = _cushion(shape, stand.cushion_angle, sides, fine, stand.half_travel + 0.012 - stand.height)
    parts = [
        Part(f"{slot} cushion", to_surface(cushion, "seat", cover), base, CUSHION_GIVE),
        Part(f"{slot} backrest", to_surface(_back(shape, sides, fine), "seat", cover), back, BACK_GIVE),
        Part(f"{slot} seat base", to_surface(join(_under(shape, stand)), "seat", "hard_plastic"), base),
    ]
    if shape.shell != "box":
        parts.append(Part(f"{slot} back shell", to_surface(_back_shell(shape), "seat", "hard_plastic"), back))
        parts.append(Part(f"{slot} map pocket", to_surface(_pocket(shape), "seat", "synthetic_fabric"), back, _POCKET_M))
    if shape.headrest in ("posts", "wing"):
        pad, posts = _headrest(shape)
        parts.append(Part(f"{slot} headrest", to_surface(pad, "headrest", cover), rest, HEADREST_GIVE))
        if posts is not None:
            parts.append(Part(f"{slot} headrest posts", to_surface(posts, "headrest", "metal"), rest))
    if shape.armrests and armrests:
        parts.append(Part(f"{slot} armrests", to_surface(_armrests(shape, armrests), "seat", cover), base, 0.01))
    return parts
