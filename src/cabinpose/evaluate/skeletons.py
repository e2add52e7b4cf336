"""What metrics need to know of a skeleton: its groups, bones, symmetric pairs and OKS falloffs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import GROUPS, ITOP_JOINTS, ITOP_LIMBS, LIMBS, SYMMETRIC_PAIRS, index_pairs, oks_sigma

_ITOP_GROUPS = MappingProxyType(
    {
        "Head": ("head", "neck"), "Shoulder": ("lshoulder", "rshoulder"), "Elbow": ("lelbow", "relbow"),
        "Hand": ("lhand", "rhand"), "Torso": ("torso",), "Hip": ("lhip", "rhip"), "Knee": ("lknee", "rknee"),
        "Foot": ("lfoot", "rfoot"),
    }
)  # fmt: skip


@dataclass(frozen=True)
class EvaluatedSkeleton:
    """The joints that are evaluated, in the order of all arrays; groups, bones and pairs hold indices into them.

    groups: joints by group · limbs: (parent, child) · pairs: (left, right) · sigma: (J,) OKS falloff ·
    head: the ends of the head segment, or None where a joint of it is not evaluated.
    """

    joints: tuple[str, ...]
    groups: MappingProxyType[str, tuple[int, ...]]
    limbs: tuple[tuple[int, int], ...]
    pairs: tuple[tuple[int, int], ...]
    sigma: NDArray[np.float64]
    head: tuple[int, int] | None


def evaluated_skeleton(joints: Sequence[str]) -> EvaluatedSkeleton:
    """What is known of some of the joints of ours, or of ITOP's; the groups that none of them belongs to are left out."""
    index = {name: i for i, name in enumerate(joints)}
    itop = set(joints) <= set(ITOP_JOINTS) and "torso" in index
    groups = _ITOP_GROUPS if itop else GROUPS
    limbs = ITOP_LIMBS if itop else LIMBS
    pairs = tuple((n, "r" + n[1:]) for n in ITOP_JOINTS if n[0] == "l") if itop else SYMMETRIC_PAIRS
    chosen = {name: tuple(index[j] for j in members if j in index) for name, members in groups.items()}
    return EvaluatedSkeleton(
        joints=tuple(joints),
        groups=MappingProxyType({name: members for name, members in chosen.items() if members}),
        limbs=index_pairs(joints, limbs),
        pairs=index_pairs(joints, pairs),
        sigma=np.array([oks_sigma(name) for name in joints]),
        head=(index["head"], index["neck"]) if {"head", "neck"} <= index.keys() else None,
    )
