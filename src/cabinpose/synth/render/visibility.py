"""How each joint is seen: the five states of `core.pose.Visibility`, decided on the ray through the joint.

A joint lies inside its body, so it is never the first thing on its ray. It counts as visible where the first thing is the
skin or clothing of the joint's own part, close to the joint. In full, for joint j of a person with instance number k:

- ABSENT: no position (NaN).
- OUTSIDE_IMAGE: at or behind the camera plane, or projected outside the image.
- Otherwise take the first surface h on the ray from the camera through j, beyond `NEAR_M` and nearer than j, leaving out
  what the eye passes over: transmissive materials (glass, spectacle lenses) and seat belts, which are 5 cm wide and lie on
  their wearer as clothing does. Then
  - no such h, or h of instance k, of a label in `OWN_PARTS[j]` and at most `CABINPOSE.reach_m[j]` from j: VISIBLE;
  - any other h of instance k: SELF_OCCLUDED;
  - h of another person or of nobody (seat, wheel, trim): OCCLUDED.

Clothing, hair and headwear carry the instance of their wearer; clothing carries the label of the part under it. The
distance rules out a joint seen along its own limb, such as a knee behind the length of its own thigh.
The ray is exact (no pixel grid), so the answer does not depend on the resolution.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from cabinpose.core import CABINPOSE, JOINTS, Bools, Floats
from cabinpose.scene import LABEL_ID as LABEL
from cabinpose.scene import MATERIALS
from cabinpose.scene.body import OWN_PARTS


@cache
def visibility_rules() -> tuple[Bools, Floats, Bools, Bools]:
    """(own (20, 256) by joint and label, reach (20,) m, passed-over labels (256,), passed-over materials (256,))."""
    own = np.zeros((len(JOINTS), 256), np.bool_)
    for j, joint in enumerate(JOINTS):
        own[j, [LABEL[name] for name in OWN_PARTS[joint]]] = True
    labels, materials = np.zeros(256, np.bool_), np.zeros(256, np.bool_)
    labels[LABEL["seat_belt"]] = True
    materials[[m.id for m in MATERIALS if m.transmissive]] = True
    return own, np.array([*CABINPOSE.reach_m.values()]), labels, materials
