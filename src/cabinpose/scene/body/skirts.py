"""Cloth that hangs about both legs: skirts, dresses and the tails of coats. Of who sits it spans the lap between the thighs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cabinpose.core import Bytes, Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.folds import seen_chart
from cabinpose.scene.body.outfit import Garment
from cabinpose.scene.body.sheets import Accessory, Cloud, Draped, bound, hull_radius

_ROWS, _COLUMNS, _NEAR_M = 26, 56, 0.03


@dataclass(frozen=True)
class Hanging:
    """A garment about both legs.

    waist, end: where it begins up the trunk and ends along the leg, units of the chart · flare: m/m · gap: half of it, in front,
    rad · thick: m.
    """

    waist: float
    end: float
    flare: float
    gap: float
    thick: float


HANGING = {
    "skirt": Hanging(0.14, 0.90, 0.015, 0.0, 0.003),
    "long_skirt": Hanging(0.14, 1.62, 0.03, 0.0, 0.003),
    "dress": Hanging(0.30, 0.98, 0.03, 0.0, 0.003),
    "coat": Hanging(0.16, 0.92, 0.02, 0.10, 0.006),
}


def hanging(kind: str, of: Garment, cloud: Cloud, heads: tuple[Floats, Floats, Floats], folds: int) -> Accessory:
    """One of `HANGING` over a cloud of trunk and legs; heads: of hip, knee and ankle (3,) m on the left · folds: their number."""
    row, (hip, knee, ankle) = HANGING[kind], heads
    c = seen_chart()
    up = row.waist * load_chart().heads["neck01"][2]
    ends = np.array((up, 0.0, knee[2] - hip[2], ankle[2] - hip[2])) + (0.0, hip[2], hip[2], hip[2])
    stops = np.array((-0.2, 0.0, 1.0, 2.0))
    z = np.interp(np.linspace(stops[0], row.end, _ROWS), stops, ends)
    angle = np.linspace(row.gap, 2 * np.pi - row.gap, _COLUMNS, endpoint=row.gap > 0)
    points, leg = cloud.points, c.leg[cloud.vertex]
    radius = np.empty((_ROWS, _COLUMNS))
    centre = np.array((float(np.median(points[leg < 0.2, 0])) * 0.3, 0.0))
    for k, height in enumerate(z):
        near = np.abs(points[:, 2] - height) < _NEAR_M
        radius[k] = hull_radius(points[near][:, :2] - centre, angle)
    below = (z[0] - z)[:, None]
    fall = 0.20 - 0.10 * rp.cos(angle)  # behind it lies under who sits
    for k in range(1, _ROWS):  # from what is widest it hangs straight, or wider still
        radius[k] = np.maximum(radius[k], radius[k - 1] - fall * (z[k - 1] - z[k]))
    rng = np.random.Generator(np.random.Philox(key=2 * folds + 4099))
    start = rng.uniform(0.0, 2 * np.pi, 3)
    rippled = sum(rp.sin(n * angle + s) / n for n, s in zip((6, 9, 14), start, strict=True)) * 6.0
    free = np.clip((below - 0.16) / 0.3, 0.0, 1.0)
    edge = -0.014 * np.clip(2.5 - below / 0.03, 0.0, 1.0)  # it begins under what is worn above
    radius = radius + 0.004 + row.thick + edge + free * (0.006 + 0.004 * rippled) + row.flare * np.clip(below - 0.2, 0.0, None)
    direction = np.stack([rp.cos(angle) + 0.0 * radius, rp.sin(angle) + 0.0 * radius, 0.0 * radius], axis=2)
    at = np.concatenate([centre, [0.0]]) + direction * radius[..., None]
    at[..., 2] += z[:, None]
    weights, label = _two_legs(cloud, at, abs(float(hip[1])))
    made = Draped(at, direction, weights, label)
    return made.cloth(row.thick, of, closed=row.gap == 0)


def _two_legs(cloud: Cloud, at: Floats, aside: float) -> tuple[Floats, Bytes]:
    """Weights and labels of cloth at (n, m, 3) m: those of both legs' nearest points, by how far it is from each leg's middle."""
    share = np.clip(0.5 + at[..., 1] / (2.0 * aside), 0.0, 1.0)
    share = share * share * (3 - 2 * share)
    found = {}
    for side in (1.0, -1.0):
        own = cloud.where(cloud.points[:, 1] * side >= 0)
        nearest = np.empty(at.shape[:2], np.int64)
        for k, row in enumerate(at):
            level = np.flatnonzero(np.abs(own.points[:, 2] - row[0, 2]) < _NEAR_M)
            target = np.stack([row[:, 0], side * np.maximum(row[:, 1] * side, 0.4 * aside), row[:, 2]], axis=1)
            away = own.points[None, level] - target[:, None]
            nearest[k] = level[np.einsum("ijk,ijk->ij", away, away).argmin(axis=1)]
        found[side] = bound(own.vertex[nearest.ravel()], at.shape[:2], 10, closed=True)
    weights = share[..., None] * found[1.0][0] + (1 - share)[..., None] * found[-1.0][0]
    return weights, np.where(share > 0.5, found[1.0][1], found[-1.0][1]).astype(np.uint8)
