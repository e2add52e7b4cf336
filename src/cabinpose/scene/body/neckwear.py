"""What is worn about the neck: collars, a hood that hangs down, a scarf."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.outfit import Garment
from cabinpose.scene.body.sheets import Accessory, Cloud, Draped, drape

_ROUND = np.linspace(0.0, 2 * np.pi, 40, endpoint=False)


class Neck(NamedTuple):
    """A neck at rest, of a body of a `size`: what is worn on trunk and neck, the skin below, and the neck's root (3,) m."""

    cloud: Cloud
    skin: Cloud
    root: Floats
    size: float

    @property
    def tilted(self) -> Floats:
        """(3,) m up along the neck, by a metre: it leans forwards."""
        return np.array((0.35, 0.0, 1.0))


def _about(
    neck: Neck,
    over: Cloud,
    height: Floats,
    angle: Floats,
    off: Floats | float,
    *,
    closed: bool,
    by: tuple[float, int] = (0.025, 3),
) -> Draped:
    """Cloth over a cloud about the neck at heights (n, 1) or (n, m) m over its root, in directions (m,) rad.

    by: ball and sweeps of `drape`.
    """
    height = height + np.zeros((height.shape[0], len(angle)))
    direction = np.stack(
        [rp.cos(angle) + 0.0 * height, rp.sin(angle) + 0.0 * height, -0.30 * rp.cos(angle) + 0.0 * height], axis=2
    )
    origin = neck.root + height[..., None] * neck.tilted
    return drape(over, origin, direction, ball=by[0] * neck.size, off=off, sweeps=by[1], closed=closed)


def _standing(neck: Neck, angle: Floats, height: Floats, off: Floats, *, closed: bool) -> Draped:
    """Rows (n, m) of a collar up the neck, `height` m over its root and `off` m from the skin: the lowest are below the cloth."""
    return _about(neck, neck.skin, neck.size * height, angle, neck.size * off, closed=closed, by=(0.014, 2))


def _radius(neck: Neck, cloth: Draped, height: Floats) -> Floats:
    """(n, m) m from the neck's axis, along the rays, of cloth at heights (n, m) m."""
    origin = neck.root + height[..., None] * neck.tilted
    return np.asarray(np.einsum("ijk,ijk->ij", cloth.points - origin, cloth.outwards))


def _lower(angle: Floats) -> Floats:
    """(m,) m by which a collar is lower than behind: it ends under the jaw."""
    return np.asarray(0.007 * (1.0 + rp.cos(angle)) ** 2)


def _turned_down(neck: Neck, of: Garment, high: float, gap_deg: float) -> Accessory:
    """A collar that is turned down: from below the neckline to `high` m behind, its leaf on the cloth; open for twice the gap."""
    angle = np.radians(np.linspace(gap_deg, 360.0 - gap_deg, 41))
    front = np.clip(rp.cos(angle), 0, 1) ** 2
    rows = -0.012 + (high + 0.012 - _lower(angle)) * np.array((0.0, 0.22, 0.48, 0.74, 0.94, 1.0))[:, None]
    off = np.array((0.001, 0.002, 0.003, 0.004, 0.005, 0.009))[:, None] + 0.0 * angle
    stand = _standing(neck, angle, rows, off, closed=False)
    down = np.array((0.25, 0.6, 1.0))[:, None]
    low = neck.size * (rows[-1] - down * (0.015 + 0.010 * rp.cos(angle) ** 2 + 0.030 * front))
    leaf = _about(neck, neck.cloud, low, angle, 0.006 * neck.size, closed=False, by=(0.014, 1))
    lies = _radius(neck, leaf, low)
    hangs = _radius(neck, stand, neck.size * rows)[-1] + neck.size * (0.016 * down + 0.010 * down * front)
    points = leaf.points + leaf.outwards * np.maximum(hangs - lies, 0.0)[..., None]
    weights = stand.weights[-1] + down[..., None] * (leaf.weights - stand.weights[-1])
    whole = Draped(
        np.concatenate([stand.points, points]), np.concatenate([stand.outwards, leaf.outwards]),
        np.concatenate([stand.weights, weights]), np.concatenate([stand.label, leaf.label]),
    )  # fmt: skip
    return whole.cloth(0.002, of, closed=False)


def shirt_collar(neck: Neck, of: Garment) -> list[Accessory]:
    """The turned-down collar of a shirt."""
    return [_turned_down(neck, of, 0.050, 10.0)]


def coat_collar(neck: Neck, of: Garment) -> list[Accessory]:
    """That of a coat, which is higher."""
    return [_turned_down(neck, of, 0.064, 10.0)]


def jacket_collar(neck: Neck, of: Garment) -> list[Accessory]:
    """That of an open jacket, which runs into its fronts."""
    return [_turned_down(neck, of, 0.060, 34.0)]


def stand_collar(neck: Neck, of: Garment) -> list[Accessory]:
    """A collar that stands up about the whole neck, from below the neckline."""
    share = np.linspace(0.0, 1.0, 8)[:, None]
    rows = -0.014 + share * (0.080 - 1.5 * _lower(_ROUND))
    off = np.array((0.001, 0.004, 0.006, 0.007, 0.007, 0.007, 0.007, 0.006))[:, None] + 0.0 * _ROUND
    return [_standing(neck, _ROUND, rows, off, closed=True).cloth(0.004, of, closed=True)]


def _roll(path: Draped, across: Floats, up: Floats, half: Floats) -> Floats:
    """Sections (m, k, 3) of a roll along a row of cloth: half (m, 2) axes across and up, m."""
    turn = np.linspace(0.0, 2 * np.pi, 14, endpoint=False)
    round_off = half[:, None, 0, None] * rp.cos(turn)[None, :, None] * across[:, None]
    return np.asarray(path.points[0][:, None] + round_off + half[:, None, 1, None] * rp.sin(turn)[None, :, None] * up[:, None])


def _rolled(path: Draped, half: Floats, up: Floats, drop: Floats, of: Garment) -> Accessory:
    """A closed roll about the neck, lying outside of a row of cloth; drop: (m,) m that it hangs below."""
    across = path.outwards[0]
    sections = _roll(path, across, up, half) + across[:, None] * half[:, None, :1]
    sections[..., 2] -= drop[:, None]
    m, k, _ = sections.shape
    rolled = Draped(
        sections.transpose(1, 0, 2), np.broadcast_to(across, (k, m, 3)), np.repeat(path.weights, k, axis=0),
        np.repeat(path.label, k, axis=0),
    )  # fmt: skip
    return rolled.solid(of)


def hood_down(neck: Neck, of: Garment) -> list[Accessory]:
    """A hood that hangs down behind: a bag of cloth on the back, its edges run to the throat."""
    behind = 0.5 - 0.5 * rp.cos(_ROUND)
    path = _about(neck, neck.cloud, (0.016 + 0.018 * rp.sin(_ROUND) ** 2)[None] * neck.size, _ROUND, 0.0, closed=True)
    half = neck.size * np.stack([0.004 + 0.024 * behind**2, 0.006 + 0.056 * rp.power(behind, 3.0)], axis=1)
    up = np.stack([0.55 * behind**2 * rp.cos(_ROUND), 0.0 * behind, 1.0 + 0.0 * behind], axis=1)
    return [_rolled(path, half, up, neck.size * 0.045 * rp.power(behind, 3.0), of)]


def scarf(neck: Neck, of: Garment) -> list[Accessory]:
    """A scarf wound about the neck, with one end that hangs down the chest."""
    waves, up = rp.sin(3 * _ROUND + 0.7), np.broadcast_to((0.0, 0.0, 1.0), (len(_ROUND), 3))
    parts = []
    widest = np.full(len(_ROUND), np.inf)
    for level, thick, turn in ((0.056, 0.015, 0.0), (0.038, 0.018, 1.3)):
        height = neck.size * (level - 0.006 * rp.cos(_ROUND + turn) - _lower(_ROUND))[None]
        path = _about(neck, neck.skin, height, _ROUND, 0.0, closed=True, by=(0.014, 2))
        radius = _radius(neck, path, height)[0]
        path = path._replace(points=path.points + path.outwards * np.minimum(widest - radius, 0.0)[None, :, None])
        widest = (
            np.minimum(radius, widest) + 0.018 * neck.size
        )  # the outer turn lies on the inner one, also where the shoulders are wider
        half = neck.size * np.stack([thick + 0.003 * waves, thick * 1.35 - 0.003 * waves], axis=1)
        parts.append(_rolled(path, half, up, 0.0 * _ROUND, of))
    rows, columns = 16, 9
    share, across = np.linspace(0.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
    origin = np.zeros((rows, columns, 3)) + neck.root
    origin[..., 0] -= 0.03
    origin[..., 1] += neck.size * (0.028 + 0.012 * share + 0.058 * across * (0.7 + 0.3 * share))
    origin[..., 2] += neck.size * (0.015 - 0.315 * share)
    direction = np.broadcast_to((1.0, 0.0, 0.0), origin.shape)
    cloth = 0.008 + 0.003 * rp.cos(3 * np.pi * across + 2 * share)
    cloth = cloth - 0.045 * np.clip(1 - 5 * share, 0, 1) ** 2  # it comes from below the turns
    end = drape(neck.cloud, origin, direction, ball=0.04, off=cloth, sweeps=25, closed=False)
    return [*parts, end.cloth(0.006, of, closed=False)]
