"""Cloth that hangs about both legs: skirts, dresses and the tails of coats. Of who sits it spans the lap between the thighs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import Bytes, Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.folds import seen_chart
from cabinpose.scene.body.outfit import Garment
from cabinpose.scene.body.sheets import Accessory, Cloud, Draped, bound, hull_radius

_ROWS, _COLUMNS, _NEAR_M = 26, 56, 0.03
_OVER_SKIRT_M, _ON_THIGHS_M = 0.009, 0.010  # of a coat, off the skirt below; of cloth on the lap of who sits, off the thighs


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


class Legs(NamedTuple):
    """What cloth hangs about: a cloud of trunk and legs, and the heads of hip, knee and ankle (3,) m on the left."""

    cloud: Cloud
    heads: tuple[Floats, Floats, Floats]


def hanging(kind: str, of: Garment, legs: Legs, folds: int, over: str = "none") -> Accessory:
    """One of `HANGING`; folds: their number · over: another below it. Of who sits it lies on the thighs."""
    row, (hip, knee, ankle), cloud = HANGING[kind], legs.heads, legs.cloud
    up = row.waist * load_chart().heads["neck01"][2]
    ends = np.array((up, 0.0, knee[2] - hip[2], ankle[2] - hip[2])) + (0.0, hip[2], hip[2], hip[2])
    stops = np.array((-0.2, 0.0, 1.0, 2.0))
    z = np.interp(np.linspace(stops[0], row.end, _ROWS), stops, ends)
    angle = np.linspace(row.gap, 2 * np.pi - row.gap, _COLUMNS, endpoint=row.gap > 0)
    points, leg = cloud.points, seen_chart().leg[cloud.vertex]
    bare, on_thighs = np.empty((2, _ROWS, _COLUMNS))
    centre = np.array((float(np.median(points[leg < 0.2, 0])) * 0.3, 0.0))
    for k, height in enumerate(z):
        near = np.abs(points[:, 2] - height) < _NEAR_M
        bare[k] = hull_radius(points[near][:, :2] - centre, angle)
        thighs = near & (leg > 0.5)
        on_thighs[k] = hull_radius(points[thighs][:, :2] - centre, angle) if height < hip[2] - _NEAR_M else bare[k]
    radius, on_thighs = _hung(row, bare, z, angle, folds), on_thighs + _ON_THIGHS_M + row.thick
    if over != "none":
        radius = np.maximum(radius, _hung(HANGING[over], bare, z, angle, folds) + _OVER_SKIRT_M)
        on_thighs = on_thighs + _OVER_SKIRT_M
    direction = np.stack([rp.cos(angle) + 0.0 * radius, rp.sin(angle) + 0.0 * radius, 0.0 * radius], axis=2)
    at = np.concatenate([centre, [0.0]]) + direction * radius[..., None]
    at[..., 2] += z[:, None]
    weights, label = _two_legs(cloud, at, abs(float(hip[1])))
    made = Draped(at, direction, weights, label).cloth(row.thick, of, closed=row.gap == 0)
    front = np.clip(2.0 * rp.cos(angle), 0.0, 1.0) * np.clip((hip[2] - z[:, None]) / 0.10, 0.0, 1.0)
    lowered = direction * (front * np.minimum(on_thighs - radius, 0.0))[..., None]
    return replace(made, seated=np.tile(lowered.reshape(-1, 3), (2, 1)))


def _hung(row: Hanging, bare: Floats, z: Floats, angle: Floats, folds: int) -> Floats:
    """Radius (n, m) m of hanging cloth at heights z (n,) m in directions (m,) rad, about what has the hull `bare` (n, m) m."""
    radius, below = bare.copy(), (z[0] - z)[:, None]
    fall = 0.20 - 0.10 * rp.cos(angle)  # behind it lies under who sits
    for k in range(1, len(z)):  # from what is widest it hangs straight, or wider still
        radius[k] = np.maximum(radius[k], radius[k - 1] - fall * (z[k - 1] - z[k]))
    rng = np.random.Generator(np.random.Philox(key=2 * folds + 4099))
    start = rng.uniform(0.0, 2 * np.pi, 3)
    rippled = sum(rp.sin(n * angle + s) / n for n, s in zip((6, 9, 14), start, strict=True)) * 6.0
    free = np.clip((below - 0.16) / 0.3, 0.0, 1.0)
    edge = -0.014 * np.clip(2.5 - below / 0.03, 0.0, 1.0)  # it begins under what is worn above
    ripples = free * (0.006 + 0.004 * rippled)
    return np.asarray(radius + 0.004 + row.thick + edge + ripples + row.flare * np.clip(below - 0.2, 0.0, None))


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
