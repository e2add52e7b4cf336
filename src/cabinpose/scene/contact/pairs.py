"""What of a body may touch what of it, and how deep: the closed solids a body is cut into, and their pairs.

Where bodies touch themselves flesh gives way, and linear-blend skinning lets it overlap instead. Every pair of solids has
a stated overlap; neighbours in the skeleton are held apart by the joint limits alone.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

# Skin and what lies under it yield under a light touch: 5-10 mm over most of the body at a few newtons.
FLESH_M = 0.008
# Between two people both yield.
BOTH_YIELD_M = 2 * FLESH_M

# What of a body collides, by name.
SOLIDS: tuple[str, ...] = (
    "torso", "head",
    "lupper_arm", "lforearm", "lhand", "rupper_arm", "rforearm", "rhand",
    "lthigh", "lshin", "lfoot", "rthigh", "rshin", "rfoot",
)  # fmt: skip
SOLID_OF_SEGMENT = MappingProxyType(  # by segment of the skin
    {"pelvis": "torso", "abdomen": "torso", "thorax": "torso", "neck": "head", "head": "head"}
    | {s + n: s + n for s in "lr" for n in ("upper_arm", "forearm", "hand", "thigh", "shin", "foot")}
)


class Pair(NamedTuple):
    """Two solids of one body: the overlap allowed (m), and the zone around a shared joint that is left to the joint limits.

    The zone is a sphere around `joint` with radius `zone` times the length from `joint` to `end`.
    """

    one: str
    two: str
    tolerance_m: float
    joint: str = ""
    end: str = ""
    zone: float = 0.0


def _pairs() -> tuple[Pair, ...]:
    held_by_joint_limits = {frozenset(s + n for n in two) for s in "lr" for two in (
        ("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shin"), ("shin", "foot"))}  # fmt: skip
    stated = [
        # The chin meets the chest; skin of neck and chest is one sheet there.
        Pair("torso", "head", 0.020, "neck", "head", 1.5),
        # The thighs meet at the crotch and yield to each other.
        Pair("lthigh", "rthigh", 0.030, "hip", "lpelvis", 1.2),
    ]
    for s in "lr":
        stated += [
            # Seated, the belly lies on the thighs: the fold of the groin is fat and bends by tens of millimetres.
            Pair("torso", s + "thigh", 0.050, s + "pelvis", s + "knee", 0.45),
            # A hanging arm lies against the side of the chest, and its muscle flattens there.
            Pair("torso", s + "upper_arm", 0.030, s + "shoulder", s + "elbow", 0.40),
            # An arm in the lap or crossed over the belly presses into it.
            Pair("torso", s + "forearm", 0.020),
            Pair("torso", s + "hand", 0.015),
            # A raised arm pushes the deltoid and trapezius against the neck.
            Pair("head", s + "upper_arm", 0.020, s + "shoulder", s + "elbow", 0.40),
        ]
        for t in "lr":
            # Hands and forearms rest on the thighs, whose muscle is slack when seated.
            stated += [Pair(s + "thigh", t + "forearm", 0.015), Pair(s + "thigh", t + "hand", 0.015)]
    known = {frozenset((p.one, p.two)) for p in stated}
    return tuple(stated) + tuple(
        Pair(one, two, FLESH_M)
        for i, one in enumerate(SOLIDS)
        for two in SOLIDS[i + 1 :]
        if frozenset((one, two)) not in known | held_by_joint_limits
    )


PAIRS: tuple[Pair, ...] = _pairs()
