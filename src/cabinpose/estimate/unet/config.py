"""Settings of the segmentation, the classes that it tells apart, and the dataset's classes that each of them merges.

The thesis trains on "8 body parts" (section 5.3.2.5) without a list of them; the eight here are those that an upper body in a
car is judged by, cut at the joints: head, torso, and left and right upper arm, forearm with hand, and leg.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from cabinpose.core import Part
from cabinpose.estimate.settings import ViewSettings
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


class UnetConfig(ViewSettings):
    """The two networks of the segmentation and the parts that they tell apart."""

    classes: Annotated[
        Literal["merged", "all", "person"], Field(description="8 merged parts, all parts of the dataset, or whole people alone.")
    ] = "merged"
    levels: Annotated[int, Field(ge=1, le=5, description="Times that the image is halved.")] = 4
    channels: Annotated[int, Field(ge=2, le=128, description="Channels at full resolution, doubled at each level.")] = 16
    dice: Annotated[float, Field(ge=0, description="Weight of the Dice loss beside the cross entropy.")] = 0.0

    @model_validator(mode="after")
    def _check_halves(self) -> UnetConfig:
        step = 2**self.levels
        if self.width % step or self.height % step:
            raise ValueError(f"{self.levels} levels need a width and height that {step} divides")
        return self

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts, of which the first has the number 1 in label images."""
        return {"merged": MERGED, "all": ALL, "person": WHOLE}[self.classes]
