"""Settings of the segmentation."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from cabinpose.core import Part
from cabinpose.estimate.settings import ViewSettings
from cabinpose.estimate.unet.parts import ALL, MERGED, WHOLE


class UnetConfig(ViewSettings):
    """The two networks of the segmentation and the parts that they tell apart."""

    skeleton: ClassVar = "cabinpose"
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
