"""Settings of the grid regression."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from cabinpose.estimate.compact.config import BackboneConfig
from cabinpose.estimate.settings import PlacedSettings

OFFSET_M = 0.1  # unit of the depth behind the surface


class YoloConfig(BackboneConfig, PlacedSettings):
    """The grid regression: its backbone, its grid, its boxes, and the weights of its loss."""

    cell_px: Annotated[Literal[4, 8], Field(description="Side of a cell of the grid (px of the view).")] = 4
    boxes: Annotated[int, Field(ge=1, le=8, description="Boxes that each cell answers with.")] = 2
    box_m: Annotated[float, Field(gt=0, le=2, description="Side of the box about a joint, at the joint's depth (m).")] = 0.25
    coord: Annotated[float, Field(gt=0, description="Weight of places and sizes in the loss.")] = 5.0
    noobj: Annotated[float, Field(gt=0, description="Weight of the confidence of boxes without a joint in the loss.")] = 0.5
    least: Annotated[
        float, Field(gt=0, lt=1, description="Least confidence times class probability of a joint that is found.")
    ] = 0.02
