"""Everything of an outfit that is cloth on its own, draped over a body in its close clothes and hair."""

from __future__ import annotations

import numpy as np

from cabinpose.core import Floats, Floats32
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.coverage import bump
from cabinpose.scene.body.folds import seen_chart
from cabinpose.scene.body.garments import half_opening
from cabinpose.scene.body.headgear import Head, beanie, hat, headscarf, hood, mask
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.scene.body.neckwear import Neck, coat_collar, hood_down, jacket_collar, scarf, shirt_collar, stand_collar
from cabinpose.scene.body.outfit import COVERING_HAIR, Garment, Outfit, worn
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.body.sheets import Accessory, Cloud, drape
from cabinpose.scene.body.skirts import HANGING, Legs, hanging

_HEAD_M = 0.116  # height of the average adult's head over the eyes
_NECK_M = 0.100  # from the neck's root to the head, by the average adult's size: of who has a longer one, size tells heights
_BREADTHS = (0.6, 1.5)  # least and most of an open jacket's fronts, by the average
_ON_HEADS = {"beanie": beanie, "hat": hat, "headscarf": headscarf, "hood": hood}
_AT_NECKS = {
    "shirt": shirt_collar,
    "turtleneck": stand_collar,
    "coat": coat_collar,
    "open_jacket": jacket_collar,
    "hoodie": hood_down,
}


def draped(
    surface: Floats32, bare: Floats32, rest: RestArrays, eyes: Floats, head: tuple[float, float, float, float], outfit: Outfit
) -> list[Accessory]:
    """The cloth of an outfit over seen vertices (V + N, 3) m in close clothes and hair.

    bare: the same vertices of the skin · eyes: (3,) m between them · head: half width, front, back and top of it from there.
    """
    c, everything = seen_chart(), Cloud(surface.astype(np.float64), np.arange(len(surface)))
    neck = rest.heads[BONE_INDEX["neck01"]]
    size = head[3] / _HEAD_M
    made: list[Accessory] = []
    wears = worn(outfit)
    collar = None if outfit.headwear in COVERING_HAIR else _AT_NECKS.get(outfit.top)  # what covers the hair covers the neck
    if collar is not None or outfit.scarf:
        skin = Cloud(bare.astype(np.float64), everything.vertex).where((c.head < 0.5) & (c.up > 0.7) & (c.arm < 0.4))
        long = min(size, float(rp.norm(rest.heads[BONE_INDEX["head"]] - neck)) / _NECK_M)
        at = Neck(everything.where((c.head < 0.5) & (c.up > 0.45) & (c.arm < 0.5)), skin, neck, size, long)
        if collar is not None:
            made += collar(at, wears["top"])
        if outfit.scarf:
            made += scarf(at, wears["scarf"])
    if outfit.headwear in _ON_HEADS or outfit.mask:
        there = (c.head + c.neck > 0.3) | ((c.up > 0.75) & (c.arm < 0.5))
        there[1::2] = False  # half of the vertices are near enough to each other
        somebody = Head(everything.where(there), eyes, neck, size)
        if outfit.mask:
            made += mask(somebody, head[0] + 0.002, wears["mask"])
        if outfit.headwear in _ON_HEADS:
            made += _ON_HEADS[outfit.headwear](somebody, wears["headwear"])
    if outfit.top == "open_jacket":
        chest = everything.where((c.arm < 0.4) & (c.up > -0.15) & (c.neck + c.head < 0.5))
        made += [_front(chest, neck, side, wears["top"]) for side in (1.0, -1.0)]
    for place, kind in (("bottom", outfit.bottom), ("top", outfit.top)):
        if kind in HANGING:
            legs = rest.heads[[BONE_INDEX["l" + bone] for bone in ("thigh", "shank", "foot")]]
            about = Legs(everything.where((c.arm < 0.3) & (c.up < 0.5)), (legs[0], legs[1], legs[2]))
            over = outfit.bottom if place == "top" and outfit.bottom in HANGING else "none"
            made.append(hanging(kind, wears[place], about, outfit.folds, over))
    return made


def _broadness(cloud: Cloud, side: float, z: Floats, aside: Floats) -> Floats:
    """(rows, 1) how much broader than the average somebody is in front, at heights z and `aside` from the middle (rows, 1) m.

    Where few points tell, it tends to 1.
    """
    own = cloud.where((cloud.points[:, 0] > 0.0) & (cloud.points[:, 1] * side > 0.0))
    average, broad = np.abs(seen_chart().rest[own.vertex, 1]), np.abs(own.points[:, 1])
    near = bump(own.points[:, 2] - z, 0.0, 0.04) * bump(average - aside, 0.0, 0.03)
    usual = aside[:, 0]
    return np.asarray(((near * broad).sum(axis=1) + usual) / ((near * average).sum(axis=1) + usual))[:, None]


def _front(cloud: Cloud, neck: Floats, side: float, of: Garment) -> Accessory:
    """The front of an open jacket, from its edge to where it lies on the chest; side: 1 left, -1 right.

    Towards the shoulder it is narrow, lies close, falls outwards as that does, and ends below the cloth.
    """
    rows, columns = 30, 10
    size = neck[2] / load_chart().heads["neck01"][2]
    up, out = np.linspace(1.02, 0.03, rows)[:, None], np.linspace(0.0, 1.0, columns)
    top = np.clip((up - 0.70) / 0.34, 0.0, 1.0)
    wide = np.clip(_broadness(cloud, side, up * neck[2], half_opening(up)), *_BREADTHS)
    aside = wide * (half_opening(up) + 0.085 * (1.0 - 0.65 * top) * out)
    origin = np.zeros((rows, columns, 3)) + (-0.03, 0.0, 0.0)
    origin[..., 1] = side * (aside - 0.006 * size)
    origin[..., 2] = up * neck[2] - top * 0.5 * (aside - aside[:, :1])
    free = rp.power(1 - out, 1.5)
    stands = 0.012 + 0.022 * np.clip((0.8 - up) / 0.6, 0.0, 1.0) + 0.004 * rp.sin(14.0 * up + side)
    off = 0.004 - 0.009 * out**2 + free * stands * (1.0 - top) - 0.009 * rp.power(top, 4.0)
    direction = np.broadcast_to((1.0, 0.0, 0.0), origin.shape)
    return drape(cloud, origin, direction, ball=0.03, off=off, sweeps=10, closed=False).cloth(0.004, of, closed=False)
