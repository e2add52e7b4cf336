"""What is worn on the head: beanie, brimmed hat, headscarf, hood, face mask. Each is cloth draped over head and hair."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.outfit import Garment
from cabinpose.scene.body.sheets import Accessory, Cloud, Draped, drape, rod

_ROUND = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)


class Head(NamedTuple):
    """A head at rest: cloud of it with hair and neck, eyes and neck (3,) m; of `size` times the average adult's."""

    cloud: Cloud
    eyes: Floats
    neck: Floats
    size: float

    @property
    def middle(self) -> Floats:
        """(3,) m: about the middle of the skull."""
        return self.eyes + self.size * np.array((-0.085, 0.0, 0.015))


def _dome(head: Head, rim: Floats, off: Floats, rows: int) -> Draped:
    """Cloth over the top of the head, from elevation `rim` (m,) rad, seen from the skull's middle, upwards; off: (rows, m) m."""
    share = np.linspace(0.0, 1.0, rows)[:, None]
    up = rim + share * (np.radians(88.0) - rim)
    direction = np.stack([rp.cos(up) * rp.cos(_ROUND), rp.cos(up) * rp.sin(_ROUND), rp.sin(up)], axis=2)
    return drape(head.cloud, head.middle + 0.0 * direction, direction, ball=0.03 * head.size, off=off, sweeps=20, closed=True)


def beanie(head: Head, of: Garment) -> list[Accessory]:
    """A knitted cap over the tops of the ears, its edge turned up."""
    rim = np.radians(12.0 + 16.0 * rp.cos(_ROUND))
    rows = 18
    edge = np.zeros((rows, 1))
    edge[:5, 0] = (0.003, 0.006, 0.006, 0.005, 0.001)
    crown = 0.012 * rp.power(np.linspace(0.0, 1.0, rows)[:, None], 3.0)  # stands up a little
    ribs = 0.0008 * rp.cos(24 * _ROUND)
    made = _dome(head, rim, 0.004 + edge + crown + ribs, rows)
    return [made.cloth(0.004, of, closed=True)]


def hat(head: Head, of: Garment) -> list[Accessory]:
    """A hat with a crown and a brim all round."""
    rim, rows = np.radians(26.0 + 6.0 * rp.cos(_ROUND)), 14
    crown = 0.004 + 0.022 * rp.power(np.linspace(0.0, 1.0, rows)[:, None], 0.5)
    made = _dome(head, rim, crown + np.zeros(len(_ROUND)), rows)
    out = np.linspace(1.0, 0.0, 5)[:, None, None]
    flat = made.outwards[:1] * (1.0, 1.0, 0.0)
    flat = flat / np.maximum(rp.hypot(flat[..., 0], flat[..., 1]), 1e-9)[..., None]
    sides = np.abs(rp.sin(_ROUND))
    brim = made.points[:1] + flat * out * 0.062 * head.size
    brim[..., 2] += out[..., 0] ** 2 * head.size * (0.014 * rp.power(sides, 4.0) - 0.008 * (1 - sides))
    n = len(brim) - 1
    upright = np.broadcast_to((0.0, 0.0, 1.0), (n, len(_ROUND), 3))
    whole = Draped(
        np.concatenate([brim[:n], made.points]), np.concatenate([upright, made.outwards]),
        np.concatenate([np.repeat(made.weights[:1], n, axis=0), made.weights]),
        np.concatenate([np.repeat(made.label[:1], n, axis=0), made.label]),
    )  # fmt: skip
    return [whole.cloth(0.003, of, closed=True)]


def _wrapped(head: Head, opening: tuple[float, float, float, float, float], ends: tuple[float, float], off: Floats) -> Draped:
    """Cloth from an opening before the face over head and neck to the shoulders.

    opening: half width, half height and middle over the eyes, how far before the eyes at brow and chin, m · ends: below
    the neck, m, before and behind · off: (rows, 1) or (rows, m) m.
    """
    wide, high, middle, brow, chin = (head.size * value for value in opening)
    share = np.linspace(0.0, 1.0, len(off))[:, None]
    lean = (0.5 + 0.5 * rp.cos(_ROUND))[:, None]  # 1 at the brow, 0 at the chin
    edge = (
        np.stack([chin + lean[:, 0] * (brow - chin), wide * rp.sin(_ROUND), middle + high * rp.cos(_ROUND)], axis=1) + head.eyes
    )
    # Seen from the skull above, from the neck below; further on from the neck's root and level.
    start = head.middle + (1 - lean) * (head.neck + head.size * np.array((0.012, 0.0, 0.035)) - head.middle)
    low = (ends[0] + (ends[1] - ends[0]) * lean) * (1 - 1.1 * rp.sin(_ROUND)[:, None] ** 2)  # aside it ends before the shoulder
    end = head.neck + head.size * (np.array((0.010, 0.0, 0.0)) - low * (0.0, 0.0, 1.0))
    first = edge - start
    first /= np.linalg.norm(first, axis=1)[:, None]
    last = np.stack([-rp.cos(_ROUND), rp.sin(_ROUND), 0.0 * _ROUND], axis=1)
    angle = rp.arccos(np.clip(np.einsum("ij,ij->i", first, last), -0.98, 0.9999))
    along = np.clip(share / 0.6, 0.0, 1.0)
    direction = (rp.sin((1 - along) * angle)[..., None] * first + rp.sin(along * angle)[..., None] * last) / rp.sin(angle)[
        :, None
    ]
    down = np.clip((share - 0.5 * lean[:, 0]) / (1 - 0.5 * lean[:, 0]), 0.0, 1.0)[..., None]
    return drape(head.cloud, start + down * (end - start), direction, ball=0.035 * head.size, off=off, sweeps=8, closed=True)


def headscarf(head: Head, of: Garment) -> list[Accessory]:
    """A scarf over hair, ears and neck, tight about the face, that ends on chest and shoulders (hijab)."""
    rows = 30
    share = np.linspace(0.0, 1.0, rows)[:, None]
    folds = 0.004 * np.clip(3 * share - 1.4, 0, 1) * rp.sin(7 * _ROUND + 9 * share + 1.0)
    made = _wrapped(head, (0.066, 0.090, -0.040, -0.010, -0.012), (0.07, 0.05), 0.004 + 0.004 * share + folds)
    return [made.cloth(0.003, of, closed=True)]


def hood(head: Head, of: Garment) -> list[Accessory]:
    """The hood of a jumper over the head: it stands off, and its edge is before the temples."""
    rows = 26
    share = np.linspace(0.0, 1.0, rows)[:, None]
    folds = 0.003 * rp.sin(5 * _ROUND + 6 * share + 0.5)
    loose = 0.014 + 0.010 * rp.sin(np.pi * share) + 0.010 * np.clip(rp.cos(_ROUND), 0, 1) * rp.sin(np.pi * share)
    made = _wrapped(head, (0.085, 0.105, -0.030, 0.005, -0.035), (0.010, 0.035), loose + folds)
    thick = 0.004 + 0.005 * np.clip(1 - 8 * share, 0, 1)
    return [made.cloth(thick, of, closed=True)]


def mask(head: Head, ear: float, of: Garment) -> list[Accessory]:
    """A folded mask over nose, mouth and chin with loops to the ears, `ear` m aside."""
    rows, columns = 12, 25
    share, across = np.linspace(0.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
    azimuth = np.radians(62.0 - 6.0 * share) * across
    top = -0.022 - 0.016 * across**2
    z = head.size * (top + share * (-0.128 - top + 0.022 * across**2))
    start = head.eyes + head.size * np.array((-0.055, 0.0, 0.0)) + np.zeros((rows, columns, 3))
    start[..., 2] += z
    direction = np.stack([rp.cos(azimuth), rp.sin(azimuth), 0.0 * azimuth - 0.25 * np.clip(share - 0.75, 0, 1)], axis=2)
    pleats = 0.0012 * rp.cos(6 * np.pi * share) + 0.0 * across
    made = drape(head.cloud, start, direction, ball=0.02 * head.size, off=0.004 + pleats, sweeps=40, closed=False)
    parts = [made.cloth(0.002, of, closed=False)]
    for column, side in ((0, -1.0), (-1, 1.0)):
        for row in (1, rows - 2):
            behind = head.eyes + (-0.088 * head.size, side * ear, (0.012 if row == 1 else -0.045) * head.size)
            loop = rod(made.points[row, column], behind, 0.0012, "head_left" if side > 0 else "head_right", of.material)
            parts.append(replace(loop, worn=of.coat))
    return parts
