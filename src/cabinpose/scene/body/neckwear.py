"""What is worn about the neck: collars, a hood that hangs down, a scarf."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.outfit import Garment
from cabinpose.scene.body.sheets import Accessory, Cloud, Draped, drape

_MIDDLE_M = 0.052  # of the neck over its root
_ROUND = np.linspace(0.0, 2 * np.pi, 40, endpoint=False)


class Neck(NamedTuple):
    """A neck at rest: cloud of what is worn on trunk and neck, and root of the neck (3,) m, of a body of a `size`."""

    cloud: Cloud
    root: Floats
    size: float

    @property
    def tilted(self) -> Floats:
        """(3,) m up along the neck, by a metre: it leans forwards."""
        return np.array((0.35, 0.0, 1.0))


def _about(neck: Neck, height: Floats, angle: Floats, off: Floats | float, *, closed: bool, sweeps: int = 3) -> Draped:
    """Cloth about the neck at heights (n, 1) or (n, m) m over its root, in directions (m,) rad."""
    height = height + np.zeros((height.shape[0], len(angle)))
    direction = np.stack(
        [rp.cos(angle) + 0.0 * height, rp.sin(angle) + 0.0 * height, -0.30 * rp.cos(angle) + 0.0 * height], axis=2
    )
    origin = neck.root + height[..., None] * neck.tilted
    return drape(neck.cloud, origin, direction, ball=0.025 * neck.size, off=off, sweeps=sweeps, closed=closed)


def _folded(neck: Neck, angle: Floats, out: Floats, up: Floats) -> Draped:
    """Cloth about the neck that is folded: rows (n, 1) or (n, m) `out` m off its middle and `up` m over it, along its axis."""
    path = _about(neck, np.full((1, 1), _MIDDLE_M * neck.size), angle, 0.0, closed=False)
    out, up = (neck.size * each + np.zeros((len(out), len(angle))) for each in (out, up))
    points = path.points + path.outwards * out[..., None] + neck.tilted * up[..., None]
    rows = len(out)
    outwards, weights = np.repeat(path.outwards, rows, axis=0), np.repeat(path.weights, rows, axis=0)
    return Draped(points, outwards, weights, np.repeat(path.label, rows, axis=0))


def shirt_collar(neck: Neck, of: Garment) -> list[Accessory]:
    """The turned-down collar of a shirt, open before the throat; where the leaf dips into the shoulders it lies on them."""
    angle = np.linspace(np.radians(10.0), np.radians(350.0), 41)
    front = np.clip(rp.cos(angle), 0, 1) ** 2
    leaf = np.array((0.0, 0.0, 0.0, 0.0, 0.2, 0.6, 1.0))[:, None]
    out = np.array((0.003, 0.004, 0.005, 0.009, 0.014, 0.018, 0.023))[:, None] + 0.012 * leaf * front
    up = np.array((-0.055, -0.020, -0.004, 0.001, -0.005, -0.018, -0.034))[:, None] - (0.018 + 0.022 * leaf) * front
    return [_folded(neck, angle, out, up).cloth(0.002, of, closed=False)]


def stand_collar(neck: Neck, of: Garment) -> list[Accessory]:
    """A collar that stands up about the whole neck."""
    rows = np.linspace(-0.06, 0.018, 9)[:, None]
    bulge = 0.006 + 0.003 * rp.sin(90.0 * rows) + np.clip(-rows - 0.03, 0, None) * 0.3
    return [
        _folded(
            neck, _ROUND, bulge, rows * (1 - 0.45 * np.clip(rp.cos(_ROUND), 0, 1) + 0.4 * np.clip(-rp.cos(_ROUND), 0, 1))
        ).cloth(0.004, of, closed=True)
    ]


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
    path = _about(neck, (0.016 + 0.018 * rp.sin(_ROUND) ** 2)[None] * neck.size, _ROUND, 0.0, closed=True)
    half = neck.size * np.stack([0.004 + 0.024 * behind**2, 0.006 + 0.056 * rp.power(behind, 3.0)], axis=1)
    up = np.stack([0.55 * behind**2 * rp.cos(_ROUND), 0.0 * behind, 1.0 + 0.0 * behind], axis=1)
    return [_rolled(path, half, up, neck.size * 0.045 * rp.power(behind, 3.0), of)]


def scarf(neck: Neck, of: Garment) -> list[Accessory]:
    """A scarf wound about the neck, with one end that hangs down the chest."""
    waves = rp.sin(3 * _ROUND + 0.7)
    parts = []
    for level, thick, turn in ((0.058, 0.016, 0.0), (0.038, 0.019, 1.3)):
        tilt = 0.010 * rp.cos(_ROUND + turn)
        path = _about(neck, (level - tilt - 0.012 * rp.cos(_ROUND))[None] * neck.size, _ROUND, -0.002, closed=True, sweeps=6)
        half = neck.size * np.stack([thick + 0.003 * waves, thick * 1.35 - 0.003 * waves], axis=1)
        up = np.broadcast_to((0.0, 0.0, 1.0), (len(_ROUND), 3))
        parts.append(_rolled(path, half, up, 0.0 * _ROUND, of))
    rows, columns = 16, 9
    share, across = np.linspace(0.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
    origin = np.zeros((rows, columns, 3)) + neck.root
    origin[..., 0] -= 0.03
    origin[..., 1] += neck.size * (0.028 + 0.012 * share + 0.058 * across * (0.7 + 0.3 * share))
    origin[..., 2] += neck.size * (0.0 - 0.30 * share)
    direction = np.broadcast_to((1.0, 0.0, 0.0), origin.shape)
    cloth = 0.028 - 0.020 * np.minimum(4 * share, 1) + 0.003 * rp.cos(3 * np.pi * across + 2 * share)
    end = drape(neck.cloud, origin, direction, ball=0.04, off=cloth, sweeps=25, closed=False)
    return [*parts, end.cloth(0.006, of, closed=False)]
