"""From dimensions to the lines of a cabin: where its seats are, and the surfaces that enclose it.

Everything is for left-hand drive, metres and radians, vehicle frame (x forward, y left, z up). The envelope is given
by three functions of position: `half_width(x, z)`, `roof(x, y)` and the side-view lines of glass and pillars.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.dimensions import CabinDimensions
from cabinpose.scene.cabin.shapes import smoothstep

HEAD_ROOM_OFFSET = 0.102  # SAE J1100 H61 counts from 102 mm below and behind the H-point, the manikin's seat contact
HEAD_ROOM_SLOPE = np.deg2rad(8.0)
PEDAL_LENGTH = 0.200  # ball of foot ahead of the heel along the pedal plane (SAE J4004: 200 mm)
WALL = 0.05  # thickness of doors, roof, floor, glass as solids, outwards


def pedal_plane_angle(seat_height: float) -> float:
    """A47, the pedal plane from the horizontal, rad, for H30 in m (SAE J4004: 77 - 80 H30 deg).

    Of seats below 0.35 m it is flatter than J1516's was, by up to 8 deg: ankles there are near the 87 deg of SAE J826.
    """
    return float(np.deg2rad(77.0 - 80.0 * seat_height))


def monotone_cubic(x: Floats, y: Floats) -> Floats:
    """Coefficients (4, n - 1), the cubic's first, of a curve through n >= 3 points that never overshoots them (x rising).

    On [x_k, x_k+1] they count from x_k. The slope at a point is the weighted harmonic mean of those beside it, or 0 at an
    extremum (Fritsch and Butland 1984); at the ends it is one-sided (Moler 2004). `scipy.interpolate.PchipInterpolator` to the
    last bit, without the import of everything else in there.
    """
    h = np.diff(x)
    m = np.diff(y) / h
    slope = np.zeros(len(x))
    for k in range(1, len(x) - 1):
        if m[k - 1] * m[k] > 0:
            w1, w2 = 2 * h[k] + h[k - 1], h[k] + 2 * h[k - 1]
            slope[k] = 1 / ((w1 / m[k - 1] + w2 / m[k]) / (w1 + w2))
    for end, k, beside in ((0, 0, 1), (-1, -1, -2)):
        one_sided = ((2 * h[k] + h[beside]) * m[k] - h[k] * m[beside]) / (h[k] + h[beside])
        if np.sign(one_sided) != np.sign(m[k]):
            one_sided = 0.0
        elif np.sign(m[k]) != np.sign(m[beside]) and abs(one_sided) > 3 * abs(m[k]):
            one_sided = 3 * m[k]
        slope[end] = one_sided
    t = (slope[:-1] + slope[1:] - 2 * m) / h
    return np.stack((t / h, (m - slope[:-1]) / h - t, slope[:-1], y[:-1]))


class Layout:
    """The lines of one cabin, left-hand drive."""

    def __init__(self, dimensions: CabinDimensions) -> None:
        d = self.d = dimensions
        self.facing = d.layout == "facing"
        self.h_front = np.array([(1 if self.facing else -1) * d.l53_mm, d.w20_mm, d.h30_mm]) / 1000
        self.h_rear = np.array([self.h_front[0] - d.l50_mm / 1000, d.w20_2_mm / 1000, d.h30_2_mm / 1000])
        self.torso, self.torso_2 = np.deg2rad(d.a40_deg), np.deg2rad(d.a40_2_deg)
        self.cushion, self.cushion_2 = np.deg2rad(d.a27_deg), np.deg2rad(d.a27_2_deg)
        self.belt_z = self.h_front[2] + d.h25_mm / 1000
        self.tumblehome = rp.tan(np.deg2rad(d.a122_deg))
        self.pedal_angle = pedal_plane_angle(d.h30_mm / 1000)
        self.toe_x = 0.13  # where the floor turns up into the toe board
        sign = -1.0 if self.facing else 1.0
        self.head_front = self._headlining(self.h_front, d.h61_mm / 1000, sign)
        self.head_rear = self._headlining(self.h_rear, d.h61_2_mm / 1000, 1.0)
        self.header_x = self.h_front[0] + d.header_mm / 1000
        self.roof_end_x = self.h_rear[0] - d.tail_mm / 1000
        self.header_z = self.head_front[1] - (0.0 if self.facing else 0.035)
        self.roof_end_z = self.head_rear[1] - d.roof_drop_mm / 1000
        self.cowl_z = self.belt_z + (0.0 if self.facing else 0.055)
        self.screen_slope = rp.tan(np.deg2rad(d.a121_1_deg))
        self.backlight_slope = rp.tan(np.deg2rad(d.a121_2_deg))
        self.cowl_x = self.header_x + (self.header_z - self.cowl_z) * self.screen_slope
        self.shelf_z = self.belt_z + (0.0 if self.facing else 0.02)
        self.shelf_end_x = self.roof_end_x - (self.roof_end_z - self.shelf_z) * self.backlight_slope
        self.firewall_x = max(self.cowl_x - 0.02, 0.36) if not self.facing else self.cowl_x
        self.back_x = min(self.shelf_end_x, self.roof_end_x) - 0.01
        self.b_pillar_x = self.h_front[0] - d.b_pillar_mm / 1000

    @staticmethod
    def _headlining(h_point: Floats, head_room: float, rearward: float) -> tuple[float, float]:
        reach = head_room - HEAD_ROOM_OFFSET
        return (
            float(h_point[0] - rearward * rp.sin(HEAD_ROOM_SLOPE) * reach),
            float(h_point[2] + rp.cos(HEAD_ROOM_SLOPE) * reach),
        )

    @cached_property
    def _roof_line(self) -> tuple[Floats, Floats]:
        """Where the pieces of the roof line begin and end, and their cubics."""
        points = sorted(
            {
                self.roof_end_x: self.roof_end_z,
                self.head_rear[0]: self.head_rear[1] + 0.008,
                self.head_front[0]: self.head_front[1] + 0.008,
                self.header_x: self.header_z,
            }.items()
        )
        x, z = np.array(points).T
        return x, monotone_cubic(x, z)

    def roof_line(self, x: ArrayLike) -> Floats:
        """Height of the headlining on the centre line, m."""
        knots, cubics = self._roof_line
        along = np.clip(x, self.roof_end_x, self.header_x)
        piece = np.clip(np.searchsorted(knots, along, "right") - 1, 0, len(knots) - 2)
        a, b, c, d = cubics[:, piece]
        s = along - knots[piece]
        return np.asarray(d + c * s + b * (s * s) + a * (s * s * s))

    def roof(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Height of the headlining with its crown: it falls towards the sides."""
        return np.asarray(self.roof_line(x) - 0.075 * rp.power(np.abs(y) / 0.70, 3.2))

    def rail_z(self, x: ArrayLike) -> Floats:
        """Height of the upper edge of the side windows, m."""
        return np.asarray(self.roof_line(x) - (0.10 if not self.facing else 0.13))

    def belt_line(self, x: ArrayLike) -> Floats:
        """Height of the lower edge of the side glass, m: it climbs rearward, most in a coupe."""
        climb = {"sport": 0.075, "sweep": 0.035, "pocket": 0.045, "plain": 0.02, "upright": -0.02, "wall": 0.0}[self.d.door_style]
        return np.asarray(self.belt_z + climb * np.clip(self.h_front[0] + 0.25 - np.asarray(x), -0.6, 1.2))

    def half_width(self, x: ArrayLike, z: ArrayLike) -> Floats:
        """Clear half width at the side trim or glass, m: W3 at the belt line, tumblehome above it, tucked in at the sill."""
        d = self.d
        x_, z_ = np.asarray(x, dtype=np.float64), np.asarray(z, dtype=np.float64)
        rear = smoothstep(-x_, -self.h_front[0], -self.h_rear[0])
        width = (d.w3_mm + (d.w3_2_mm - d.w3_mm) * rear) / 2000
        width = width - 0.0 * z_
        if not self.facing:
            width = width - 0.13 * np.clip((x_ + 0.30) / 0.75, 0, None) ** 2
            width = width - 0.10 * np.clip((self.h_rear[0] - 0.10 - x_) / 0.60, 0, None) ** 2
        above = np.clip(z_ - self.belt_z, 0, None)
        lower = smoothstep(0.25 - z_, 0.0, 0.25)
        return np.asarray(width - above * self.tumblehome - 0.6 * above**2 * self.tumblehome - 0.03 * lower)

    def screen_x(self, z: ArrayLike) -> Floats:
        """The windscreen's line on the centre line, side view."""
        return np.asarray(self.header_x + (self.header_z - np.asarray(z)) * self.screen_slope)

    def backlight_x(self, z: ArrayLike) -> Floats:
        """The backlight's line, side view."""
        return np.asarray(self.roof_end_x - (self.roof_end_z - np.asarray(z)) * self.backlight_slope)

    def a_pillar_x(self, z: ArrayLike) -> Floats:
        """Rear edge of the A-pillar: the windscreen's line, set back at the side."""
        back = 0.15 if not self.facing else 0.10
        return np.asarray(np.minimum(self.screen_x(z), self.cowl_x + 0.05) - back)

    def b_line(self, z: ArrayLike) -> Floats:
        """Centre of the B-pillar: it leans rearward above the belt."""
        return np.asarray(self.b_pillar_x - 0.10 * (np.asarray(z) - self.belt_z))

    def c_pillar_x(self, z: ArrayLike) -> Floats:
        """Front edge of the C-pillar, side view."""
        z_ = np.asarray(z, dtype=np.float64)
        if self.facing:
            return np.asarray(self.back_x + 0.14 + 0 * z_)
        lean = np.minimum(self.backlight_slope, 1.1)
        return np.asarray(self.roof_end_x + 0.16 - (self.roof_end_z - z_) * lean * 0.55)

    def floor_z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Height of the floor carpet: flat, with the tunnel along the centre line."""
        tunnel = self.d.tunnel_mm / 1000
        fade = smoothstep(np.asarray(x), self.h_rear[0] - 0.1, self.h_rear[0] + 0.2)
        return np.asarray(tunnel * (1 - smoothstep(np.abs(y), 0.07, 0.17)) * fade)
