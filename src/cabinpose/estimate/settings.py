"""What the settings of all methods have in common."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import ITOP_JOINTS, ITOP_LIMBS, JOINTS, LIMBS, OCCUPANT_SLOTS, UPPER_BODY, index_pairs
from cabinpose.estimate.inputs import InputView

_FOCAL_PER_WIDTH = 139 / 352  # 103 deg across: all but 0.1 % of the joints that a Monstar sees, which 95.5 deg lose 6 % of
_OLDER_FOCAL_PER_WIDTH = 160 / 352


class Settings(BaseModel):
    """The settings of any method: what training, export and predictors read of them.

    A subclass also has `skeleton` ("cabinpose" or "itop": the variable of the dataset that holds the joints) and `view`, an
    `InputView`, as class variables, fields or properties.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,) names of the joints."""
        return JOINTS

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the network's inputs."""
        return ("depth",)


class ViewSettings(Settings):
    """The settings of a method that sees images: its view, and the slots that it knows."""

    width: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Width of the network's view (px).")] = 352
    height: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Height of the network's view (px).")] = 288
    focal: Annotated[
        float | None,
        Field(gt=0, description="Focal length of the view (px); default: 139 at 352 px width; null, in older models: 160."),
    ] = Field(default_factory=lambda settings: _FOCAL_PER_WIDTH * settings["width"])
    max_depth_m: Annotated[float, Field(gt=0, le=20, description="What lies farther counts as invalid (m).")] = 3.0
    slots: Annotated[tuple[str, ...], Field(min_length=1, description="Places that people are predicted for.")] = OCCUPANT_SLOTS

    @cached_property
    def view(self) -> InputView:
        """The view of a model with these settings."""
        focal = self.focal if self.focal is not None else _OLDER_FOCAL_PER_WIDTH * self.width
        return InputView(self.width, self.height, focal, self.max_depth_m)


class BodySettings(ViewSettings):
    """The settings of a method that can predict the upper body alone, and that ties joints along the limbs."""

    body: Annotated[Literal["upper", "full", "itop"], Field(description="Joints: the upper body's 14, all 20, or ITOP's.")] = (
        "upper"
    )

    @property
    def skeleton(self) -> str:
        """Which of the dataset's skeletons the joints are of."""
        return "itop" if self.body == "itop" else "cabinpose"

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,) names of the joints that it predicts."""
        return {"upper": UPPER_BODY, "full": JOINTS, "itop": ITOP_JOINTS}[self.body]

    @property
    def limbs(self) -> tuple[tuple[int, int], ...]:
        """(C,) pairs of joints, parent first: the tree that ties all of them."""
        return index_pairs(self.joints, ITOP_LIMBS if self.body == "itop" else LIMBS)
