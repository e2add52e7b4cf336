"""How a person's sides differ: lengths and girths of limbs, heights of shoulders, the spine's curve, the head's tilt.

Right arms are longer than left ones by about 1 % and thicker by more, left legs a little longer than right ones (Auerbach & Ruff
2006, J. Hum. Evol. 50: limb bones). Legs differ by 5.2 mm (SD 4.1) in the mean, whichever is longer (Knutson 2005, Chiropr.
Osteopat. 13:11): a normal distribution of 6.5 mm. Spines curve by less than the 10 deg (Cobb) from which on it is a scoliosis.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Floats32, axis_rotation
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.anatomy import CENTRE
from cabinpose.scene.body.chart import along_chain, load_chart
from cabinpose.scene.body.coverage import step

# Right less left over their mean, mean and standard deviation: upper arm, forearm; thigh, shin; and of the limbs' girths.
_LENGTH = {"arm": ((0.010, 0.010), (0.007, 0.010)), "leg": ((-0.002, 0.011), (-0.002, 0.011))}
_GIRTH = {"arm": (0.015, 0.015), "leg": (0.0, 0.010)}
_CHAIN = {"arm": ("upperarm01", "lowerarm01", "wrist", "finger3_1"), "leg": ("upperleg01", "lowerleg01", "foot", "toe3_1")}
_STEMS = {"arm": ("upperarm", "lowerarm", "wrist", "metacarpal", "finger"), "leg": ("upperleg", "lowerleg", "foot", "toe")}
_SHOULDERS_M = 0.006  # standard deviation of the height of one over the other
_CURVE_M = 0.004  # of the spine's middle aside: 3.6 deg (Cobb) over 0.4 m
_TILT = np.radians(1.5)  # of the head
_MOST = 2.0  # standard deviations


class _Points(NamedTuple):
    """Points (N, 3) that move with the body: skin or bone heads, with their shares of each limb (left, right) and of the head."""

    at: Floats
    limbs: Mapping[tuple[str, str], Floats]
    head: Floats


def asymmetric(skin: Floats32, heads: Floats, named: Mapping[str, int], number: int) -> tuple[Floats32, Floats]:
    """A symmetric body's skin (V, 3) and bone heads (H, 3), m, with the differences between the sides of pattern `number`.

    named: index of each of Anny's bone heads, and of joint centres.
    """
    rng = np.random.Generator(np.random.Philox(key=number))
    z = np.clip(rng.standard_normal(9), -_MOST, _MOST)
    c = load_chart()
    names = [name.removesuffix(CENTRE) for name in sorted(named, key=named.__getitem__)]
    of_skin, of_heads = {}, {}
    for side, sign in (("l", 1), ("r", -1)):
        for limb, share in (("arm", c.arm), ("leg", c.leg)):
            of_skin[side, limb] = np.where(c.side == sign, share, 0.0)
            of_heads[side, limb] = np.array([float(n[0] == side and n[1:].startswith(_STEMS[limb])) for n in names])
    of_head = np.array([float(n in ("head", "leye", "reye")) + 0.5 * (n in ("neck02", "neck03")) for n in names])
    both = (
        _Points(skin.astype(np.float64), of_skin, np.clip(c.head + 0.5 * c.neck, 0.0, 1.0)),
        _Points(heads, of_heads, of_head),
    )
    at = {name: heads[i] for name, i in named.items()}
    moved = [_moved(points, at, z) for points in both]
    return moved[0].astype(np.float32), moved[1]


def _moved(points: _Points, at: Mapping[str, Floats], z: Floats) -> Floats:
    out = points.at.copy()
    for (side, limb), share in points.limbs.items():
        sign = 0.5 if side == "r" else -0.5
        first = 0 if limb == "arm" else 2
        chain = [at[side + name] for name in _CHAIN[limb]]
        bones = np.diff(chain, axis=0)
        along = np.clip(along_chain(points.at, chain), 0.0, None)
        for k, (mean, sigma) in enumerate(_LENGTH[limb]):
            longer = sign * (mean + sigma * z[first + k])
            out += (share * longer * np.clip(along - k, 0.0, 1.0))[:, None] * bones[k]
        k = np.minimum(along.astype(int), 1)
        off = points.at - np.array(chain)[k] - (along - k)[:, None] * bones[k]
        off[along > len(_LENGTH[limb])] = 0.0  # hands and feet keep their size
        mean, sigma = _GIRTH[limb]
        fade = step(along, 0.3, 0.5) * step(-along, -1.8, 0.4)
        out += (share * fade * sign * (mean + sigma * z[4 + first // 2]))[:, None] * off
        if limb == "arm":
            out[:, 2] += share * sign * _SHOULDERS_M * z[6]
    # The spine's curve carries the arms as it carries the shoulders; it begins at the pelvis and ends at the neck.
    low, high = at["root"][2], at["neck01"][2]
    arms = np.sum([share for (_, limb), share in points.limbs.items() if limb == "arm"], axis=0)
    level = points.at[:, 2] + arms * (at["lupperarm01"][2] - points.at[:, 2])
    out[:, 1] += _CURVE_M * z[7] * rp.sin(np.pi * np.clip((level - low) / (high - low), 0.0, 1.0))
    tilted = rp.matmul(out - at["neck01"], axis_rotation("x", _TILT * z[8]).T) + at["neck01"]
    return np.asarray(out + points.head[:, None] * (tilted - out))
