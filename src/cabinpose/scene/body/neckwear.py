"""What is worn about the neck: collars, a hood that hangs down, a scarf."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.outfit import Garment
from cabinpose.scene.body.sheets import Accessory, Cloud, Draped, drape

_ROUND = np.linspace(0.0, 2 * np.pi, 40, endpoint=False)
_DOWN = np.array((0.25, 0.6, 1.0))[:, None]  # of a collar's leaf: rows from its fold to its end
_RISE, _LEVELS = 0.75, 7  # of rays beside the neck; heights at which a leaf is draped
_NEAR_M = 0.16  # of the neck's root, forwards, aside and up: no leaf reaches as far
_OVER_SCARF_M = 0.018  # of the skin of a neck, behind, over the middle of the upper turn of a scarf


class Neck(NamedTuple):
    """A neck at rest, of a body of a `size`: what is worn on trunk and neck, the skin below, and the neck's root (3,) m.

    long: what heights over the root are in proportion to; less than `size` on children, whose necks are short.
    """

    cloud: Cloud
    skin: Cloud
    root: Floats
    size: float
    long: float

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
    return _about(neck, neck.skin, neck.long * height, angle, neck.size * off, closed=closed, by=(0.014, 2))


def _radius(neck: Neck, cloth: Draped, height: Floats) -> Floats:
    """(n, m) m from the neck's axis, along the rays, of cloth at heights (n, m) m."""
    origin = neck.root + height[..., None] * neck.tilted
    return np.asarray(np.einsum("ijk,ijk->ij", cloth.points - origin, cloth.outwards))


def _lower(angle: Floats) -> Floats:
    """(m,) m by which a collar is lower than behind: it ends under the jaw."""
    return np.asarray(0.007 * (1.0 + rp.cos(angle)) ** 2)


def _evened(around: Floats) -> Floats:
    """Columns (m,) evened along the angle; both ends have themselves beyond."""
    for _ in range(6):
        beyond = np.concatenate([around[:1], around, around[-1:]])
        around = 0.25 * (beyond[:-2] + beyond[2:]) + 0.5 * around
    return around


def _rise(angle: Floats) -> Floats:
    """(m,) of rays outwards, m/m: beside the neck, where the shoulders lie flat, level ones would meet them far out."""
    return np.asarray(_RISE * rp.sin(angle) ** 2 - 0.30 * rp.cos(angle))


def _leaf(neck: Neck, angle: Floats, fold: Floats, height: Floats, length: Floats) -> Draped:
    """The leaf of a collar from its fold (m, 3) at heights (m,) m: it hangs, or lies on cloth, for a length (m,) m."""
    front, share = np.clip(rp.cos(angle), 0, 1) ** 2, np.linspace(0.0, 1.0, _LEVELS + 1)[1:, None]
    across = np.stack([rp.cos(angle), rp.sin(angle)], axis=1)
    rise = _rise(angle)
    low = height + share * (neck.long * (-0.025 - 0.030 * front) - height)
    reach = _evened(np.einsum("ij,ij->i", fold[:, :2] - neck.root[:2] - height[:, None] * neck.tilted[:2], across))
    hangs = reach + neck.size * share * (0.020 + 0.008 * front)
    origin = neck.root + low[..., None] * neck.tilted
    origin[..., 2] -= rise * hangs
    direction = np.concatenate([across, rise[:, None]], axis=1) + np.zeros(origin.shape)
    far = np.abs(neck.cloud.points - neck.root).max(axis=1)
    near = neck.cloud.where(far < _NEAR_M * neck.size)  # others cost time alone
    made = drape(near, origin, direction, ball=0.014 * neck.size, off=0.006 * neck.size, sweeps=2, closed=False)
    lies = np.einsum("ijk,ijk->ij", made.points - origin, made.outwards)
    hangs = hangs * rp.power(1.0 + rise * rise, 0.5)
    line = np.concatenate([fold[None], origin + made.outwards * np.maximum(hangs, lies)[..., None]])
    step = np.diff(line, axis=0)
    along = np.cumsum(rp.power(np.einsum("ijk,ijk->ij", step, step), 0.5), axis=0)
    ends = _DOWN * np.minimum(length * neck.size, along[-1])
    points, level = np.empty((len(ends), len(angle), 3)), np.empty(ends.shape, np.int64)
    for j in range(len(angle)):
        level[:, j] = np.searchsorted(along[:-1, j], ends[:, j])
        for k in range(3):
            points[:, j, k] = np.interp(ends[:, j], np.append(0.0, along[:, j]), line[:, j, k])
    column = np.arange(len(angle))
    return Draped(points, made.outwards[: len(ends)], made.weights[level, column], made.label[level, column])


def _turned_down(neck: Neck, of: Garment, high: float, gap_deg: float) -> Accessory:
    """A collar that is turned down: from below the neckline to `high` m behind, its leaf on the cloth; open for twice the gap."""
    angle = np.radians(np.linspace(gap_deg, 360.0 - gap_deg, 41))
    rows = -0.012 + (high + 0.012 - _lower(angle)) * np.array((0.0, 0.22, 0.48, 0.74, 0.94, 1.0))[:, None]
    off = np.array((0.001, 0.002, 0.003, 0.004, 0.005, 0.009))[:, None] + 0.0 * angle
    stand = _standing(neck, angle, rows, off, closed=False)
    length = 0.8 * high + 0.035 * rp.power(np.clip(rp.cos(angle), 0, 1), 6.0)  # its corners are pointed
    leaf = _leaf(neck, angle, stand.points[-1], neck.long * rows[-1], length)
    weights = stand.weights[-1] + _DOWN[..., None] * (leaf.weights - stand.weights[-1])
    whole = Draped(
        np.concatenate([stand.points, leaf.points]), np.concatenate([stand.outwards, leaf.outwards]),
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
    height = neck.long * (0.016 + 0.012 * rp.sin(_ROUND) ** 2)
    rise = _rise(_ROUND)
    origin = neck.root + height[None, :, None] * neck.tilted
    origin[..., 2] -= 0.075 * neck.size * _RISE * rp.sin(_ROUND) ** 2  # its rays come out as high
    direction = np.stack([rp.cos(_ROUND), rp.sin(_ROUND), rise], axis=1)[None]
    path = drape(neck.cloud, origin, direction, ball=0.025 * neck.size, off=0.0, sweeps=3, closed=True)
    half = neck.size * np.stack([0.004 + 0.024 * behind**2, 0.006 + 0.056 * rp.power(behind, 3.0)], axis=1)
    up = np.stack([0.55 * behind**2 * rp.cos(_ROUND), 0.0 * behind, 1.0 + 0.0 * behind], axis=1)
    return [_rolled(path, half, up, neck.size * 0.045 * rp.power(behind, 3.0), of)]


def scarf(neck: Neck, of: Garment) -> list[Accessory]:
    """A scarf wound about the neck, with one end that hangs down the chest."""
    waves, up = rp.sin(3 * _ROUND + 0.7), np.broadcast_to((0.0, 0.0, 1.0), (len(_ROUND), 3))
    highest = (neck.skin.points[:, 2].max() - neck.root[2]) / neck.size
    lower = max(_OVER_SCARF_M + 0.056 - highest, 0.0)  # children's necks are shorter: above them no ray meets any skin
    parts = []
    widest = np.full(len(_ROUND), np.inf)
    for level, thick, turn in ((0.056, 0.015, 0.0), (0.038, 0.018, 1.3)):
        height = neck.size * (level - lower - 0.006 * rp.cos(_ROUND + turn) - _lower(_ROUND))[None]
        path = _about(neck, neck.skin, height, _ROUND, 0.0, closed=True, by=(0.014, 2))
        radius = _radius(neck, path, height)[0]
        path = path._replace(points=path.points + path.outwards * np.minimum(widest - radius, 0.0)[None, :, None])
        widest = (
            np.minimum(radius, widest) + 0.018 * neck.size
        )  # the outer turn lies on the inner one, also where the shoulders are wider
        half = np.stack([neck.size * (thick + 0.003 * waves), neck.long * (thick * 1.35 - 0.003 * waves)], axis=1)
        parts.append(_rolled(path, half, up, 0.0 * _ROUND, of))
    rows, columns = 16, 9
    share, across = np.linspace(0.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
    origin = np.zeros((rows, columns, 3)) + neck.root
    origin[..., 0] -= 0.03
    origin[..., 1] += neck.long * (0.028 + 0.012 * share + 0.058 * across * (0.7 + 0.3 * share))
    origin[..., 2] += neck.long * (0.015 - 0.315 * share)
    direction = np.broadcast_to((1.0, 0.0, 0.0), origin.shape)
    cloth = 0.008 + 0.003 * rp.cos(3 * np.pi * across + 2 * share)
    cloth = cloth - 0.045 * np.clip(1 - 5 * share, 0, 1) ** 2  # it comes from below the turns
    end = drape(neck.cloud, origin, direction, ball=0.04, off=cloth, sweeps=25, closed=False)
    return [*parts, end.cloth(0.006, of, closed=False)]
