"""Where the joints of each set lie in a body, and which parts of its surface are a joint's own.

Ours are points of its skeleton (`scene.body.skeleton`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from cabinpose.core import CABINPOSE, JOINTS, RIG, Floats, Skeleton
from cabinpose.scene.body.model import PosedBody
from cabinpose.scene.body.rig import SEGMENTS

Place: TypeAlias = Callable[[PosedBody], Floats]  # (3,) m, in the body's frame


def joints_in_body(skeleton: Skeleton, body: PosedBody) -> Floats:
    """(J, 3) m, in the body's frame: the joints of a set, as its definition says."""
    if skeleton == CABINPOSE:
        return body.joints
    if skeleton == RIG:
        return body.rig_joints
    places = _PLACES[skeleton.name]
    return np.stack([places[joint](body) if joint in places else _rig(joint)(body) for joint in skeleton.joints])


def _rig(joint: str) -> Place:
    """Where the rig has a joint."""
    return lambda body: body.rig_joints[RIG.index[joint]]


def _midway(a: Place, b: Place) -> Place:
    """Midway between two places."""
    return lambda body: np.asarray((a(body) + b(body)) / 2)


def _middle(segment: str) -> Place:
    """The middle of a segment's skin."""
    number = SEGMENTS.index(segment)
    return lambda body: np.asarray(body.skin[body.person.skin_segment == number].mean(axis=0, dtype=np.float64))


_BETWEEN_SHOULDERS = _midway(_rig("lshoulder"), _rig("rshoulder"))
# By set and joint; a joint that is not here is the rig's with the same name. ITOP's are the rig's, not anatomy's: its hips, neck
# and torso hold on its ground truth to a few millimetres.
_PLACES: Mapping[str, Mapping[str, Place]] = MappingProxyType(
    {
        "itop": {
            "head": _middle("head"), "neck": _BETWEEN_SHOULDERS,
            "torso": _midway(_BETWEEN_SHOULDERS, _midway(_rig("lpelvis"), _rig("rpelvis"))),
            "lhip": _rig("lpelvis"), "rhip": _rig("rpelvis"), "lfoot": _rig("lankle"), "rfoot": _rig("rankle"),
        },
    }
)  # fmt: skip

_WORN_ON_HEAD = ("hair", "headwear", "glasses")
_SIDED_PARTS = {
    "shoulder": ("shoulder", "upper_arm", "torso"),
    "elbow": ("elbow", "upper_arm", "forearm"),
    "wrist": ("wrist", "forearm", "hand"),
    "hand": ("hand", "wrist"),
    "pelvis": ("hip", "thigh"),
    "knee": ("knee", "thigh", "shin"),
    "ankle": ("ankle", "shin", "foot"),
    "foot": ("foot", "ankle"),
}
_CENTRE_PARTS = {
    "head": ("head_left", "head_right", "neck", *_WORN_ON_HEAD),
    "neck": ("neck", "torso_left", "torso_right", "shoulder_left", "shoulder_right", "hair"),
    "chest": ("torso_left", "torso_right", "hair"),
    "hip": ("hip_left", "hip_right", "hip_center", "torso_left", "torso_right"),
}
_SHARED_PARTS = {"pelvis": ("hip_center",), "shoulder": ("hair",)}


def _own_parts() -> dict[str, tuple[str, ...]]:
    parts = dict(_CENTRE_PARTS)
    for letter, side in (("l", "left"), ("r", "right")):
        for joint, names in _SIDED_PARTS.items():
            parts[letter + joint] = tuple(f"{name}_{side}" for name in names) + _SHARED_PARTS.get(joint, ())
    return {joint: parts[joint] for joint in JOINTS}


# The labels whose surface is the joint's own: its part and the two that meet there.
OWN_PARTS = MappingProxyType(_own_parts())
