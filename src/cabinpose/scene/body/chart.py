"""Where each vertex lies on the body: coordinates along the limbs, and the skin's segments.

Worked out once, on the average adult, for the topology that all people share.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np

from cabinpose.core import Bytes, Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.phenotype import Phenotype
from cabinpose.scene.body.rig import BONE_INDEX, BONES, SEGMENTS
from cabinpose.scene.body.shape import load_shape_space

_ARM = ("shoulder_half", "upperarm", "elbow", "forearm", "wrist", "hand", "finger")
_LEG = ("hip_half", "thigh", "knee", "shank", "ankle", "foot")


@dataclass(frozen=True)
class Chart:
    """Coordinates of the skin's vertices (V,) on the average adult.

    side: +1 left, -1 right, 0 on the midline · arm, leg, head, neck: share of the skinning weights (arm from the shoulder
    joint on) · along_arm: 0 shoulder, 1 elbow, 2 wrist, 3 third knuckle · along_leg: 0 hip, 1 knee, 2 ankle, 3 sole ·
    up: 0 hip joints, 1 C7, beyond on the neck and head · rest: (V, 3) the average adult at rest, root origin, m.
    """

    rest: Floats
    side: Floats
    arm: Floats
    leg: Floats
    neck: Floats
    head: Floats
    along_arm: Floats
    along_leg: Floats
    up: Floats
    heads: MappingProxyType[str, Floats]


def along_chain(points: Floats, chain: list[Floats]) -> Floats:
    """Position along a polyline, 1 per piece, by the nearest piece; beyond its ends in lengths of the end pieces."""
    best = np.full(len(points), np.inf)
    result = np.zeros(len(points))
    for k, (a, b) in enumerate(itertools.pairwise(chain)):
        t = rp.matmul(points - a, b - a) / (rp.matmul(b - a, b - a))
        low = -np.inf if k == 0 else 0.0
        high = np.inf if k == len(chain) - 2 else 1.0
        t = np.clip(t, low, high)
        distance = np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)
        closer = distance < best
        best[closer], result[closer] = distance[closer], k + t[closer]
    return result


@cache
def load_chart() -> Chart:
    """The chart of the packaged topology."""
    space = load_shape_space()
    skin, heads = space.shape(Phenotype())
    origin = (heads[space.heads["lupperleg01"]] + heads[space.heads["rupperleg01"]]) / 2
    points = skin - origin
    dense = np.zeros((len(points), len(BONES)))
    np.put_along_axis(dense, space.bone_index.astype(np.int64), 0.0, axis=1)
    for k in range(space.bone_index.shape[1]):
        np.add.at(dense, (np.arange(len(points)), space.bone_index[:, k]), space.bone_weight[:, k])

    def share(*stems: str) -> Floats:
        columns = [i for i, b in enumerate(BONES) if any(b == t or (b[0] in "lr" and b[1:].startswith(t)) for t in stems)]
        return np.asarray(dense[:, columns].sum(axis=1))

    named = {name: heads[i] - origin for name, i in space.heads.items()}
    along_arm, along_leg = np.zeros(len(points)), np.zeros(len(points))
    for side, mask in (("l", points[:, 1] >= 0), ("r", points[:, 1] < 0)):
        arm = [named[side + b] for b in ("upperarm01", "lowerarm01", "wrist", "finger3_1")]
        leg = [named[side + b] for b in ("upperleg01", "lowerleg01", "foot")]
        leg.append(np.array([*leg[-1][:2], points[:, 2].min()]))
        along_arm[mask] = along_chain(points[mask], arm)
        along_leg[mask] = along_chain(points[mask], leg)
    head = share("head") + dense[:, BONE_INDEX["head"]]
    neck = dense[:, [BONE_INDEX[b] for b in ("neck01", "neck02", "neck03")]].sum(axis=1)
    return Chart(
        points, np.sign(np.round(points[:, 1], 5)), share(*_ARM), share(*_LEG), neck, head,
        along_arm, along_leg, points[:, 2] / named["neck01"][2], MappingProxyType(named),
    )  # fmt: skip


@cache
def vertex_segments() -> Bytes:
    """(V,) index into `rig.SEGMENTS`."""
    c = load_chart()
    names = np.full(len(c.up), "thorax", dtype="<U12")
    names[c.up < 0.55] = "abdomen"
    names[c.up < 0.16] = "pelvis"
    names[c.neck > 0.5] = "neck"
    names[c.head >= 0.5] = "head"
    for prefix, on_side in (("l", c.side >= 0), ("r", c.side < 0)):
        arm, leg = (c.arm > 0.5) & on_side, (c.leg > 0.5) & on_side & (c.along_leg > 0.12)
        for where, coordinate, low, high, name in (
            (arm, c.along_arm, -np.inf, 1.0, "upper_arm"), (arm, c.along_arm, 1.0, 2.0, "forearm"),
            (arm, c.along_arm, 2.0, np.inf, "hand"), (leg, c.along_leg, -np.inf, 1.0, "thigh"),
            (leg, c.along_leg, 1.0, 2.0, "shin"), (leg, c.along_leg, 2.0, np.inf, "foot"),
        ):  # fmt: skip
            names[where & (coordinate >= low) & (coordinate < high)] = prefix + name
    return np.array([SEGMENTS.index(n) for n in names], np.uint8)
