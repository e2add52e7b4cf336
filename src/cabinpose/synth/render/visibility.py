"""How each joint is seen: the five states of `core.pose.Visibility`, decided on the ray through the joint.

A joint lies inside its body, so it is never the first thing on its ray. It counts as visible where the first thing is the
skin or clothing of the joint's own part, close to the joint. In full, for joint j of a person with instance number k:

- ABSENT: no position (NaN).
- OUTSIDE_IMAGE: at or behind the camera plane, or projected outside the image.
- Otherwise take the first surface h on the ray from the camera through j, beyond `NEAR_M` and nearer than j, leaving out
  what the eye passes over: transmissive materials (glass, spectacle lenses) and seat belts, which are 5 cm wide and lie on
  their wearer as clothing does. Then
  - no such h, or h of instance k, of a label in `OWN_PARTS[j]` and at most `REACH_M[j]` from j: VISIBLE;
  - any other h of instance k: SELF_OCCLUDED;
  - h of another person or of nobody (seat, wheel, trim): OCCLUDED.

Clothing, hair and headwear carry the instance of their wearer; clothing carries the label of the part under it. The
distance rules out a joint seen along its own limb, such as a knee behind the length of its own thigh.
The ray is exact (no pixel grid), so the answer does not depend on the resolution.
"""

from __future__ import annotations

from functools import cache
from types import MappingProxyType

import numpy as np

from cabinpose.core import JOINTS, REACH_M, Bools, Floats
from cabinpose.scene import LABEL_ID as LABEL
from cabinpose.scene import MATERIALS

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


@cache
def visibility_rules() -> tuple[Bools, Floats, Bools, Bools]:
    """(own (20, 256) by joint and label, reach (20,) m, passed-over labels (256,), passed-over materials (256,))."""
    own = np.zeros((len(JOINTS), 256), np.bool_)
    for j, joint in enumerate(JOINTS):
        own[j, [LABEL[name] for name in OWN_PARTS[joint]]] = True
    labels, materials = np.zeros(256, np.bool_), np.zeros(256, np.bool_)
    labels[LABEL["seat_belt"]] = True
    materials[[m.id for m in MATERIALS if m.transmissive]] = True
    return own, np.array([REACH_M[joint] for joint in JOINTS]), labels, materials
