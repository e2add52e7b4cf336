"""Joints of one definition told as another's: weighted means of a few joints, which are as near as the joints alone can say.

The tables are those of `tools/joint_map.py`: the rig's found on 1 500 generated frames of 200 random people, Plug-in Gait's on
200 adults who sit with its markers on, with 8 mm of noise on each joint. Behind each joint: mean distance in mm without and with
the table, of people it was not found on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import reproducible as rp
from cabinpose.core.skeleton import CABINPOSE, PLUG_IN_GAIT, RIG, Skeleton

_Table: TypeAlias = Mapping[str, Mapping[str, float]]
# Of the left side and the middle; those of the right side are their mirror image. Elbows and wrists are the same in both.
_FROM_RIG: _Table = MappingProxyType(
    {
        "head": {"head": 0.714, "neck": 0.427, "chest": -0.141},  # 16 -> 11
        "neck": {"neck": 0.083, "head": 0.363, "chest": 0.026, "lshoulder": 0.264, "rshoulder": 0.264},  # 34 -> 15
        "chest": {"chest": 0.72, "neck": 0.132, "hip": 0.117, "lshoulder": 0.0155, "rshoulder": 0.0155},  # 28 -> 10
        "hip": {"hip": 0.415, "chest": 0.126, "lpelvis": 0.2855, "rpelvis": 0.2855, "lknee": -0.056, "rknee": -0.056},  # 67 -> 19
        "lshoulder": {"lshoulder": 0.826, "rshoulder": -0.09, "neck": 0.178, "chest": 0.056, "lelbow": 0.03},  # 10 -> 7
        "lhand": {"lhand": 1.15, "lwrist": 0.021, "lelbow": -0.171},  # 53 -> 19
        "lpelvis": {"lpelvis": 0.686, "hip": 0.251, "lknee": 0.063},  # 37 -> 12
        "lknee": {"lknee": 0.991, "lpelvis": 0.009},  # 4 -> 4
        "lankle": {"lankle": 0.995, "lknee": -0.009, "lfoot": 0.014},  # 5 -> 4
        "lfoot": {"lfoot": 0.939, "lankle": 0.061},  # 9 -> 3
    }
)
_TO_RIG: _Table = MappingProxyType(
    {
        "head": {"head": 0.685, "neck": 0.506, "chest": -0.191},  # 16 -> 9
        "neck": {"neck": -0.004, "head": 0.602, "chest": 0.259, "lshoulder": 0.0715, "rshoulder": 0.0715},  # 34 -> 20
        "chest": {"chest": 1.234, "neck": -0.257, "hip": -0.138, "lshoulder": 0.0805, "rshoulder": 0.0805},  # 28 -> 14
        "hip": {"hip": 0.274, "lpelvis": 0.368, "rpelvis": 0.368, "lknee": -0.005, "rknee": -0.005},  # 67 -> 12
        "lshoulder": {"lshoulder": 0.926, "rshoulder": -0.091, "neck": 0.088, "chest": 0.069, "lelbow": 0.008},  # 10 -> 8
        "lhand": {"lhand": 0.412, "lwrist": 0.58, "lelbow": 0.008},  # 53 -> 4
        "lpelvis": {"lpelvis": 1.221, "rpelvis": -0.152, "hip": -0.006, "lknee": -0.063},  # 37 -> 14
        "lknee": {"lknee": 1.007, "lpelvis": -0.007},  # 4 -> 4
        "lankle": {"lankle": 0.976, "lknee": 0.015, "lfoot": 0.009},  # 5 -> 4
        "lfoot": {"lfoot": 1.048, "lankle": -0.048},  # 9 -> 3
    }
)
_FROM_GAIT: _Table = MappingProxyType(
    {
        "head": {"head": 0.2822, "chest": -0.146, "lshoulder": 0.5529, "rshoulder": 0.5529, "hip": -0.242},  # 121 -> 19
        "neck": {"head": 0.0874, "chest": 0.166, "lshoulder": 0.4188, "rshoulder": 0.4188, "hip": -0.091},  # not there -> 10
        "chest": {
            "chest": -0.0052, "head": -0.056, "lshoulder": 0.4325, "rshoulder": 0.4325, "lpelvis": 0.1286, "rpelvis": 0.1286,
            "lknee": -0.0305, "rknee": -0.0305,
        },  # 163 -> 16
        "hip": {
            "chest": -0.1274, "lshoulder": 0.1551, "rshoulder": 0.1551, "lpelvis": 0.4758, "rpelvis": 0.4758, "lknee": -0.0672,
            "rknee": -0.0672,
        },  # 115 -> 17
        "lelbow": {"lelbow": 0.926, "lshoulder": 0.027, "lwrist": 0.047},  # 14 -> 10
        "lhand": {"lhand": 0.547, "lwrist": 0.582, "lelbow": -0.129},  # 21 -> 16
        "lpelvis": {"lpelvis": 0.734, "rpelvis": 0.231, "lshoulder": 0.202, "chest": -0.167},  # 24 -> 11
        "lknee": {"lknee": 1.026, "lpelvis": -0.006, "lankle": -0.02},  # 11 -> 7
        "lankle": {"lankle": 0.97, "lknee": 0.003, "lfoot": 0.027},  # 5 -> 4
        "lfoot": {"lfoot": 0.968, "lankle": 0.075, "lknee": -0.043},  # 20 -> 11
    }
)  # fmt: skip
_TO_GAIT: _Table = MappingProxyType(
    {
        "head": {"head": -0.0788, "neck": 1.859, "chest": -1.345, "lshoulder": 0.2824, "rshoulder": 0.2824},  # 121 -> 54
        "chest": {
            "chest": -1.0816, "neck": 1.765, "head": -0.743, "lshoulder": 0.4368, "rshoulder": 0.4368, "hip": 0.186,
        },  # 163 -> 31
        "hip": {"hip": -0.0916, "lpelvis": 0.5344, "rpelvis": 0.5344, "lknee": 0.0114, "rknee": 0.0114},  # 115 -> 11
        "lelbow": {"lelbow": 1.054, "lshoulder": -0.017, "lwrist": -0.037},  # 14 -> 10
        "lpelvis": {"lpelvis": 1.084, "rpelvis": -0.017, "hip": -0.09, "lknee": 0.023},  # 24 -> 13
        "lknee": {"lknee": 0.968, "lpelvis": 0.009, "lankle": 0.023},  # 11 -> 7
        "lankle": {"lankle": 1.003, "lknee": 0.001, "lfoot": -0.004},  # 5 -> 4
        "lfoot": {"lfoot": 1.004, "lankle": -0.045, "lknee": 0.041},  # 20 -> 12
    }
)  # fmt: skip
_TABLES: Mapping[tuple[str, str], _Table] = MappingProxyType(
    {
        (RIG.definition, CABINPOSE.definition): _FROM_RIG, (CABINPOSE.definition, RIG.definition): _TO_RIG,
        (PLUG_IN_GAIT.definition, CABINPOSE.definition): _FROM_GAIT,
        (CABINPOSE.definition, PLUG_IN_GAIT.definition): _TO_GAIT,
    }
)  # fmt: skip


def has_joint_map(of: Skeleton, to: Skeleton) -> bool:
    """Whether joints of one definition can be told as another's, or are the same."""
    return of.definition == to.definition or (of.definition, to.definition) in _TABLES


def told_as(points: NDArray[np.floating], joints: Sequence[str], of: Skeleton, to: Skeleton) -> NDArray[np.floating]:
    """Joints of a definition as another one has them.

    A joint whose table names one that is not there stays where it is.

    Parameters
    ----------
    points
        (..., J, D): places of joints in space or in an image, NaN = not known.
    joints
        (J,) their names.
    of, to
        Sets of ours with the definition that the joints have, and with the one that is wanted (`Skeleton.marked_by`).

    Returns
    -------
    ndarray
        (..., J, D), of the same kind of numbers. What is told as the same definition is the array itself.

    Raises
    ------
    ValueError
        Where no table is known: see `has_joint_map`.
    """
    if of.definition == to.definition:
        return points
    if not has_joint_map(of, to):
        raise ValueError(f"no table tells joints that are {of.definition} as those that are {to.definition}")
    weights = _weights(tuple(joints), of.definition, to.definition)
    known = np.isfinite(points).all(axis=-1)
    found = rp.matmul(weights, np.where(known[..., None], points, 0.0))
    whole = (known[..., None, :] | (weights == 0)).all(axis=-1)  # each joint that a row has a weight for
    return np.where(whole[..., None], found, points).astype(points.dtype)


@lru_cache(maxsize=64)
def _weights(joints: tuple[str, ...], of: str, to: str) -> NDArray[np.float64]:
    """(J, J) weights; a row of whose joints one is not among `joints` is that of the joint alone."""
    table, at = _TABLES[of, to], {joint: i for i, joint in enumerate(joints)}
    weights = np.eye(len(joints))
    for joint, i in at.items():
        row = table.get(joint) or {_other(name): value for name, value in table.get(_other(joint), {}).items()}
        if row and all(name in at for name in row):
            weights[i] = 0.0
            for name, value in row.items():
                weights[i, at[name]] = value
    return weights


def _other(joint: str) -> str:
    """The joint of the other side; of the middle itself."""
    swapped = {"l": "r", "r": "l"}.get(joint[0], "") + joint[1:]
    return swapped if swapped in CABINPOSE.index else joint
