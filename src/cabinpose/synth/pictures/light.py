"""The light of a picture, and the surroundings that are seen through the windows: a dome of radiance, a sun, lamps.

The dome is painted for an eye in the middle of the car: a street by day or by night, or a garage. It stands infinitely far
away, so it has no parallax within the car.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cabinpose.core import Bools, Floats, Floats32
from cabinpose.core import reproducible as rp
from cabinpose.synth.person_look import linear
from cabinpose.synth.sunlight import Sun

LightKind = Literal["day", "night", "garage"]
_DOME = 512, 1024  # rows, columns: a third of a degree, about a pixel of a Monstar
_EYE_M = 1.1  # height of the cabin's middle above the ground
_HAZE_M = 90.0
_FACADES = (0xB8A894, 0xC9BBA5, 0x9A6B52, 0x8D8F8E, 0xD8D2C4, 0xA99C86, 0x7B5547)
_CARS = (0x1C1D20, 0xDADBDC, 0x7D8287, 0x29364C, 0x6E1F22, 0xB9BABB)


@dataclass(frozen=True)
class Light:
    """Light in the scene's frame (z up); linear sRGB.

    kind, words: for the dataset · dome: (H, W, 3) float32 radiance of the directions `dome_directions` ·
    sun: towards it (3,) and its irradiance (3,), None where there is none · lamps: places (m) and intensities of points ·
    infrared: share of dome and sun that is there at 850 nm, as radiance of a white ground over that by the camera's own light
    from 1 m, 1 where no sun is known; lamps are LEDs, which have none · own: radiance of a white surface that faces the
    camera's own light at 1 m.
    """

    kind: LightKind
    words: str
    dome: Floats32
    sun: tuple[Floats, Floats] | None = None
    lamps: tuple[tuple[Floats, Floats], ...] = ()
    infrared: float = 0.0
    own: float = 0.0

    def seen(self, directions: Floats) -> Floats32:
        """Radiance (..., 3) of the dome in directions (..., 3) of any length; that of the nearest of its points."""
        x, y, z = np.moveaxis(directions / np.linalg.norm(directions, axis=-1, keepdims=True), -1, 0)
        rows, columns = self.dome.shape[:2]
        row = np.clip(rp.arccos(np.clip(z, -1, 1)) / np.pi * rows, 0, rows - 1).astype(int)
        column = (rp.arctan2(-y, x) / (2 * np.pi) % 1.0 * columns).astype(int) % columns
        return np.asarray(self.dome[row, column])


def dome_directions(rows: int, columns: int) -> Floats:
    """(rows, columns, 3) unit vectors: from the zenith down, from +x (forward) over -y (right) round."""
    polar, turn = np.pi * (np.arange(rows) + 0.5) / rows, 2 * np.pi * (np.arange(columns) + 0.5) / columns
    return np.stack(
        (rp.sin(polar)[:, None] * rp.cos(turn), -rp.sin(polar)[:, None] * rp.sin(turn),
         np.repeat(rp.cos(polar)[:, None], columns, axis=1)), axis=-1,
    )  # fmt: skip


def draw_light(kind: LightKind, glow: Floats | None, *, rng: np.random.Generator, sun: Sun | None = None) -> Light:
    """Light of a kind.

    glow: a point (3,) m before the instruments, which shine at night; None where there are none · sun: of the day, where it is
    known.
    """
    return _day(sun, rng) if kind == "day" else _DRAW[kind](glow, rng)


def _day(known: Sun | None, rng: np.random.Generator) -> Light:
    elevation, azimuth = rng.uniform(12.0, 60.0), rng.uniform(-180.0, 180.0)
    clear = bool(rng.random() < 0.65)
    if known is not None:
        elevation, azimuth, clear = known.elevation_deg, known.left_deg, known.clear
    e, a = np.radians((elevation, azimuth))
    towards = np.array((rp.cos(e) * rp.cos(a), rp.cos(e) * rp.sin(a), rp.sin(e)))
    warm = np.array((1.0, 0.96 - 0.25 * rp.exp(-elevation / 12), 0.9 - 0.5 * rp.exp(-elevation / 12)))
    power = rng.uniform(6.0, 14.0) * min(1.0, elevation / 30.0) * clear
    directions = dome_directions(*_DOME)
    up = np.clip(directions[..., 2], 0.0, 1.0)[..., None]
    if clear:
        near_sun = np.clip(rp.matmul(directions, towards), 0.0, 1.0)[..., None]
        sky = np.array((0.35, 0.62, 1.1)) * (0.9 - 0.45 * np.sqrt(up)) + np.array((0.75, 0.8, 0.85)) * rp.power(1 - up, 4)
        sky = sky + warm * (1.2 * rp.power(near_sun, 24) + 0.4 * rp.power(near_sun, 6))
    else:
        sky = np.array((1.15, 1.2, 1.25)) * (0.55 + 0.75 * up)
    sun = towards, warm * power
    dome = _street(directions, sky, np.array((2.2, 2.4, 2.7)), sun, _unlit, rng)
    ground = float((2.5 + power * rp.sin(e)) / np.pi)  # radiance of white ground
    words = f"sun {elevation:.0f} degrees high, {azimuth:.0f} to the left of ahead" if clear else "overcast"
    infrared = 1.0 if known is None else known.direct * float(rp.sin(e)) + known.sky
    return Light("day", words, dome.astype(np.float32), sun if clear else None, infrared=infrared / ground)


def _night(glow: Floats | None, rng: np.random.Generator) -> Light:
    directions = dome_directions(*_DOME)
    sky = np.full((*_DOME, 3), (0.004, 0.005, 0.009))
    shift = rng.uniform(0.0, 22.0)
    warm = np.array((1.0, 0.72, 0.42)) if rng.random() < 0.5 else np.array((0.95, 0.97, 1.0))

    def lit(at: Floats) -> Floats:
        """Irradiance (..., 3) by the street lamps at points (..., 3): pools of light below them."""
        along = (at[..., 0] + shift + 11.0) % 22.0 - 11.0
        fall = along**2 + (np.abs(at[..., 1]) - 5.0) ** 2 + (at[..., 2] - 5.0) ** 2
        return np.asarray(9.0 / fall[..., None] * warm)

    dome = _street(directions, sky, np.full(3, 0.01), None, lit, rng)
    for side in (-5.0, 5.0):
        for x in np.arange(-66.0, 67.0, 22.0) - shift:
            place = np.array((x, side, 5.0))
            distance = rp.norm(place)
            near = rp.matmul(directions, place / distance) > rp.cos(max(0.28 / float(distance), 0.008))
            dome[near] = 30.0 * warm
    lamps = []
    inside = "dark inside"
    if glow is not None:
        lamps.append((glow, rng.uniform(0.006, 0.02) * np.array((0.75, 0.85, 1.0))))
        if rng.random() < 0.35:
            lamps.append((glow + (-0.25, -glow[1], 0.5), rng.uniform(0.06, 0.12) * np.array((1.0, 0.85, 0.65))))
            inside = "roof lamp on"
    return Light("night", f"street lamps, {inside}", dome.astype(np.float32), lamps=tuple(lamps))


def _garage(glow: Floats | None, rng: np.random.Generator) -> Light:
    directions = dome_directions(*_DOME)
    size = np.array((rng.uniform(7, 14), rng.uniform(4.5, 8), rng.uniform(1.5, 2.4)))
    low, high = np.array((-size[0], -size[1], -_EYE_M)), size
    with np.errstate(divide="ignore"):
        t = np.where(directions > 0, high / directions, low / directions)
    axis = t.argmin(axis=-1)
    at = directions * t.min(axis=-1, keepdims=True)
    x, y, z = np.moveaxis(at, -1, 0)
    band = linear(int(rng.choice((0x2F5D8A, 0x8A2F2F, 0x3C7A4A, 0xC9A227))))
    colour = np.full((*_DOME, 3), 0.35) * (1 + 0.12 * _noise(rng, 48))[..., None]
    wall, floor, ceiling = axis < 2, (axis == 2) & (z < 0), (axis == 2) & (z > 0)
    colour[wall] += 0.2
    colour[wall & (z < -0.1)] *= 0.55
    colour[wall & (np.abs(z) < 0.1)] = band
    colour[floor] *= 0.5
    colour[floor & (np.abs(y) > 2.0) & ((x + 40.0) % 2.6 < 0.12)] = 0.6
    along = np.where(axis == 0, y, x)
    colour[wall & ((along + 40.0) % 5.0 < 0.45)] = (0.42, 0.42, 0.40)  # pillars
    shade = 0.75 + 0.25 * rp.cos(x * 1.3) * (z > 0) - 0.25 * floor
    dome = colour * shade[..., None]
    strip = rng.uniform(1.6, 2.6)
    lamp = ceiling & (np.abs(np.abs(y) - strip) < 0.12) & ((x + 40.0) % 3.0 < 1.5)
    tint = np.array((1.0, 1.0, 0.95)) if rng.random() < 0.6 else np.array((1.0, 0.88, 0.7))
    dome = dome * tint
    dome[lamp] = 28.0 * tint
    lamps = () if glow is None else ((glow, np.array((0.02, 0.023, 0.027))),)
    return Light("garage", "strip lights", dome.astype(np.float32), lamps=lamps)


_DRAW: dict[LightKind, Callable[[Floats | None, np.random.Generator], Light]] = {"night": _night, "garage": _garage}


def _unlit(at: Floats) -> Floats:
    return np.zeros((*at.shape[:-1], 3))


def _street(
    directions: Floats, sky: Floats, ambient: Floats, sun: tuple[Floats, Floats] | None, lamps: Callable[[Floats], Floats],
    rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """Radiance (H, W, 3) of a street along x: sky above, houses and trees at both sides, parked cars, road.

    ambient: irradiance (3,) by the sky · lamps: gives that by lamps at points (..., 3).
    """
    night = sun is None and sky.max() < 0.1
    dome = np.array(sky)
    haze = sky[sky.shape[0] // 2 - 2].mean(axis=0) * 0.9
    d = directions
    grain = 1.0 + 0.2 * _noise(rng, 96)[..., None]

    def paint(where: Bools, distance: Floats, colour: Floats, normal: Floats, emitted: Floats | float = 0.0) -> None:
        at = d[where] * distance[where][:, None]
        light = ambient * (0.5 + 0.5 * normal[..., 2:]) + lamps(at)
        if sun is not None:
            light = light + np.clip(rp.matmul(normal, sun[0]), 0.0, 1.0)[..., None] * sun[1]
        radiance = colour * grain[where] * light / np.pi + emitted
        clear = rp.exp(-distance[where] / _HAZE_M)[:, None]
        dome[where] = radiance * clear + haze * (1.0 - clear)

    with np.errstate(divide="ignore", invalid="ignore"):
        below = np.where(d[..., 2] < 0, _EYE_M / -d[..., 2], np.inf)
        x, y = (np.where(np.isfinite(below), d[..., k] * below, 1e6) for k in (0, 1))
        road = np.full((*d.shape[:2], 3), 0.10)
        road[np.abs(y) > 4.6] = (0.28, 0.27, 0.25)
        road[(np.abs(np.abs(y - 0.6) - 1.8) < 0.07) & ((x + 600.0) % 6.0 < 3.5)] = 0.55
        ground = np.isfinite(below)
        paint(ground, below, road[ground], np.array((0.0, 0.0, 1.0)))
        for side in (-1.0, 1.0):
            for kind, offset in (("houses", rng.uniform(9.0, 16.0)), ("trees", rng.uniform(6.5, 8.0)), ("cars", 4.0)):
                distance = np.where(d[..., 1] * side > 1e-3, offset / np.abs(d[..., 1]), np.inf)
                px, pz = d[..., 0] * distance, d[..., 2] * distance
                hit = np.isfinite(distance) & (pz > -_EYE_M) & (distance < 200.0)
                draw = {"houses": _houses, "trees": _trees, "cars": _parked}[kind]
                seen, colour, shining = draw(np.where(hit, px, 0.0), np.where(hit, pz, 0.0), night, rng)
                hit &= seen
                normal = np.array((0.0, -side, 0.0)) if kind != "trees" else np.array((0.0, -0.6 * side, 0.8))
                paint(hit, distance, colour[hit], normal, shining[hit])
    return dome


_Painted = tuple[Bools, Floats, Floats]


def _houses(x: Floats, z: Floats, night: bool, rng: np.random.Generator) -> _Painted:
    width = rng.uniform(8.0, 16.0)
    number = np.floor((x + 400.0) / width).astype(int) % 64
    height, palette = rng.uniform(4.0, 16.0, 64), np.array([linear(int(c)) for c in rng.choice(_FACADES, 64)])
    colour = palette[number]
    floor, bay = np.floor((z + _EYE_M) / 3.0), np.floor(x / 2.6)
    pane = ((z + _EYE_M) % 3.0 > 1.0) & ((z + _EYE_M) % 3.0 < 2.4) & (x % 2.6 > 0.8) & (x % 2.6 < 1.9)
    colour = np.where(pane[..., None], (0.06, 0.07, 0.08), colour)
    lit = pane & night & ((floor * 7 + bay * 13) % 5 < 1)
    return z < height[number], colour, np.where(lit[..., None], (0.55, 0.38, 0.18), 0.0)


def _trees(x: Floats, z: Floats, _: bool, rng: np.random.Generator) -> _Painted:
    gap, start = rng.uniform(7.0, 14.0), rng.uniform(0.0, 7.0)
    along = (x + start + 400.0) % gap - gap / 2
    ragged = 0.25 * rp.sin(9.0 * x + 4.0 * z) + 0.2 * rp.sin(23.0 * x - 17.0 * z)
    crown = (along / 2.2) ** 2 + ((z - 2.6) / 1.9) ** 2 + ragged < 1.0
    trunk = (np.abs(along) < 0.16) & (z < 1.5)
    green = linear(int(rng.choice((0x4F6B35, 0x5E7440, 0x3F5A38, 0x7C7A3E))))
    dapple = 0.7 + 0.5 * rp.sin(31.0 * x + 5.0) * rp.sin(29.0 * z)
    colour = np.where(crown[..., None], green * dapple[..., None], linear(0x4A3B2E))
    return crown | trunk, colour, np.zeros(colour.shape)


def _parked(x: Floats, z: Floats, _: bool, rng: np.random.Generator) -> _Painted:
    start = rng.uniform(0.0, 6.0)
    number = np.floor((x + start + 400.0) / 6.0).astype(int) % 32
    along = (x + start + 400.0) % 6.0 - 3.0
    there = rng.random(32) < 0.6
    up = z + _EYE_M
    body = (np.abs(along) < 2.15) & (up > 0.2) & (up < 0.85)
    cabin = (np.abs(along + 0.2) < 1.55 - 0.9 * np.clip(up - 0.85, 0, 1)) & (up >= 0.85) & (up < 1.45)
    glass = cabin & (up < 1.37) & (np.abs(along + 0.2) > 0.06)
    wheel = (np.abs(np.abs(along) - 1.35) ** 2 + (up - 0.32) ** 2) < 0.32**2
    palette = np.array([linear(int(c)) for c in rng.choice(_CARS, 32)])
    colour = np.where(wheel[..., None], 0.02, np.where(glass[..., None], 0.05, palette[number]))
    return (body | cabin | wheel) & there[number], colour, np.zeros(colour.shape)


def _noise(rng: np.random.Generator, cells: int) -> Floats:
    """(H, W) of the dome: smooth noise from -1 to 1 in `cells` cells from zenith to nadir."""
    coarse = rng.uniform(-1.0, 1.0, (cells + 1, 2 * cells + 1))
    coarse[:, -1] = coarse[:, 0]
    rows, columns = (np.linspace(0, n, s, endpoint=False) for n, s in zip((cells, 2 * cells), _DOME, strict=True))
    i, j = rows.astype(int)[:, None], columns.astype(int)[None]
    a, b = (rows % 1)[:, None], (columns % 1)[None]
    return np.asarray(
        (1 - a) * ((1 - b) * coarse[i, j] + b * coarse[i, j + 1]) + a * ((1 - b) * coarse[i + 1, j] + b * coarse[i + 1, j + 1])
    )
