"""Settings of the compact detector."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from cabinpose.core import SKELETONS, Skeleton, SkeletonName
from cabinpose.estimate.settings import ViewSettings

_Positive = Annotated[float, Field(gt=0)]
_Heads = Annotated[int, Field(gt=0, multiple_of=4)]  # channels that the heads of the attention share


class BackboneConfig(ViewSettings):
    """The view, the images, the joints, and the size of the backbone."""

    width: Annotated[int, Field(ge=32, le=1024, multiple_of=16, description="Width of the network's view (px).")] = 176
    height: Annotated[int, Field(ge=32, le=1024, multiple_of=16, description="Height of the network's view (px).")] = 144
    input: Annotated[Literal["depth", "amplitude", "rgb"], Field(description="What the network sees.")] = "depth"
    amplitude: Annotated[bool, Field(description="Use the amplitude image beside the depth.")] = True
    skeleton: Annotated[SkeletonName, Field(description="Joints to predict.")] = "cabinpose"
    channels: Annotated[
        tuple[int, int, int, _Heads], Field(description="Channels at strides 2, 4, 8 and 16, the last a multiple of 4.")
    ] = (16, 32, 80, 128)
    blocks: Annotated[tuple[int, int, int], Field(description="Blocks at strides 4, 8 and 16.")] = (1, 3, 4)

    @property
    def joint_set(self) -> Skeleton:
        """The joints that it finds, as a set."""
        return SKELETONS[self.skeleton]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the network's inputs."""
        return ("depth", "amplitude") if self.input == "depth" and self.amplitude else (self.input,)


class CompactConfig(BackboneConfig):
    """The compact detector: its backbone and its refinements."""

    looks_px: Annotated[
        tuple[_Positive, ...],
        Field(description="Refinements of each joint, one after the other: distance of their samples in the view (px)."),
    ] = (4.0, 2.0)
