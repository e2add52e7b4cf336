"""What the settings of all methods have in common."""

from __future__ import annotations

from typing import Annotated, Protocol

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.estimate.inputs import InputView

_FOCAL_PER_WIDTH = 160 / 352  # the view that every method's default has: 95.5 deg across


class Settings(Protocol):
    """What training, export and predictors ask of any method's settings.

    skeleton: "cabinpose" or "itop", the variable of the dataset that holds the joints · inputs: names of the network's inputs.
    """

    @property
    def view(self) -> InputView: ...

    @property
    def slots(self) -> tuple[str, ...]: ...

    @property
    def skeleton(self) -> str: ...

    @property
    def joints(self) -> tuple[str, ...]: ...

    @property
    def inputs(self) -> tuple[str, ...]: ...


class ViewSettings(BaseModel):
    """The settings of a method that looks through a view, and the places that it knows."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Width of the network's view (px).")] = 352
    height: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Height of the network's view (px).")] = 288
    focal: Annotated[float | None, Field(gt=0, description="Focal length of the view (px); default: 160 at 352 px width.")] = None
    max_depth_m: Annotated[float, Field(gt=0, le=20, description="What lies farther counts as invalid (m).")] = 3.0
    slots: Annotated[tuple[str, ...], Field(min_length=1, description="Places that people are predicted for.")] = OCCUPANT_SLOTS

    @property
    def view(self) -> InputView:
        """The view of a model with these settings."""
        focal = self.focal if self.focal is not None else _FOCAL_PER_WIDTH * self.width
        return InputView(self.width, self.height, focal, self.max_depth_m)
