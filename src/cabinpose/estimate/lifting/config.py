"""Settings of the lifting network."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from cabinpose.core import CABINPOSE, OCCUPANT_SLOTS, Skeleton
from cabinpose.estimate.inputs import InputView
from cabinpose.estimate.settings import Settings

ROOT = "neck"  # in a car the joint that is hidden least; the hip is under the belt, the wheel, or outside the image


class LiftingConfig(Settings):
    """Lifting: the joints, the size of the network, and how its 2D joints are disturbed in training."""

    view: ClassVar = InputView(352, 288, 160.0)  # of the training joints' pixels; the network reads directions, of any camera
    body: Annotated[Literal["upper", "full"], Field(description="Joints: the upper body's 14, or all 20.")] = "upper"
    slots: Annotated[tuple[str, ...], Field(min_length=1, description="Places whose people it learns from.")] = OCCUPANT_SLOTS
    width: Annotated[int, Field(ge=4, description="Neurons in a layer.")] = 1024
    blocks: Annotated[int, Field(ge=1, description="Residual blocks of two layers.")] = 2
    dropout: Annotated[float, Field(ge=0, lt=1, description="Share of neurons that are dropped in training.")] = 0.5
    noise: Annotated[float, Field(ge=0, description="Greatest noise of 2D joints in training, in focal lengths.")] = 0.015
    drop: Annotated[float, Field(ge=0, lt=1, description="Greatest share of joints that are dropped in training.")] = 0.3
    min_joints: Annotated[int, Field(ge=1, description="People of fewer 2D joints are not lifted.")] = 3
    presence: Annotated[float, Field(ge=0, le=1, description="2D joints of a lower presence are ignored.")] = 0.5

    @property
    def joint_set(self) -> Skeleton:
        """The joints that it finds, as a set."""
        return CABINPOSE if self.body == "full" else CABINPOSE.subset(CABINPOSE.sets["upper body"])

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the network's inputs."""
        return ("pose",)
