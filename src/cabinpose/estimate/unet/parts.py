"""The classes that the segmentation tells apart, and the dataset's classes that each of them merges.

The thesis trains on "8 body parts" (section 5.3.2.5) without a list of them; the eight here are those that an upper body in a
car is judged by, cut at the joints: head, torso, and left and right upper arm, forearm with hand, and leg.
"""

from __future__ import annotations

from cabinpose.core import Part
from cabinpose.scene import BODY_PARTS, FIRST_BODY_ID, LABEL_ID, LAST_BODY_ID


def _both(name: str, members: tuple[str, ...]) -> tuple[Part, Part]:
    left, right = (Part(f"{name}_{side}", tuple(LABEL_ID[f"{m}_{side}"] for m in members)) for side in ("left", "right"))
    return left, right


MERGED: tuple[Part, ...] = (
    Part("head", tuple(LABEL_ID[name] for name in ("head_left", "head_right", "hair", "headwear", "glasses", "neck"))),
    Part("torso", tuple(LABEL_ID[name] for name in ("torso_left", "torso_right", "hip_left", "hip_right", "hip_center"))),
    *_both("upper_arm", ("shoulder", "upper_arm")),
    *_both("forearm", ("elbow", "forearm", "wrist", "hand")),
    *_both("leg", ("thigh", "knee", "shin", "ankle", "foot")),
)
WHOLE: tuple[Part, ...] = (Part("person", tuple(range(FIRST_BODY_ID, LAST_BODY_ID + 1))),)  # TICaM's masks know no parts
ALL: tuple[Part, ...] = tuple(Part(label.name, (label.id,)) for label in BODY_PARTS)
