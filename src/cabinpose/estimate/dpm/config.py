"""Settings of the deformable parts, and the tree of parts that they say."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from cabinpose.estimate.settings import BodySettings

_LONG = ("elbow", "wrist", "hand", "knee", "ankle", "foot")  # ends of limbs that get a part of their own
_LONG_FROM = ("shoulder", "elbow", "hip", "pelvis", "knee")


class Tree(NamedTuple):
    """P parts, each after its parent.

    parent: (P,) −1 of the root · ends: (P, 2) the joints in whose middle a part lies; the same one twice where it is a joint.
    """

    parent: NDArray[np.int64]
    ends: NDArray[np.int64]

    @property
    def joints(self) -> NDArray[np.int64]:
        """(J,) the part of each joint."""
        own = np.flatnonzero(self.ends[:, 0] == self.ends[:, 1])
        return own[np.argsort(self.ends[own, 0])]


class DpmConfig(BodySettings):
    """The deformable parts: what is seen, how it is described, the parts and their training."""

    width: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Width of the view (px).")] = 176
    height: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Height of the view (px).")] = 144
    input: Annotated[Literal["depth", "amplitude"], Field(description="The image whose gradients are described.")] = "depth"
    pixel_m: Annotated[float, Field(gt=0, le=0.2, description="Size of a pixel on a body of a level's depth (m).")] = 0.025
    cell_px: Annotated[int, Field(ge=2, le=16, description="Side of a cell of the histograms (px).")] = 3
    filter_cells: Annotated[int, Field(ge=1, le=15, description="Side of a part's filter (cells), odd.")] = 5
    orientations: Annotated[int, Field(ge=4, le=36, multiple_of=2, description="Directions over 360 degrees.")] = 12
    level_step: Annotated[float, Field(gt=1, le=2, description="Ratio of the depths of neighbouring levels.")] = 1.2
    mixtures: Annotated[int, Field(ge=1, le=16, description="Types of each part.")] = 4
    limb_parts: Annotated[bool, Field(description="Parts in the middle of the arms' and legs' limbs, beside the joints.")] = True
    cost: Annotated[float, Field(gt=0, description="C of the structured support vector machine, for all frames together.")] = 50.0
    rounds: Annotated[int, Field(ge=1, description="Times that each frame is searched for what it confuses.")] = 4
    negatives: Annotated[float, Field(ge=0, le=1, description="Frames without people, as a share of those with them.")] = 0.2
    loss_m: Annotated[float, Field(gt=0, description="Error of a part in the image (m) that counts as wholly wrong.")] = 0.15

    @field_validator("filter_cells")
    @classmethod
    def _with_a_middle(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("a filter has a cell in its middle: give an odd number")
        return value

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the images that it reads; the depth tells the size of people in any case."""
        return ("depth", "amplitude") if self.input == "amplitude" else ("depth",)

    @cached_property
    def tree(self) -> Tree:
        """The skeleton's tree from the joint below the neck on."""
        joints, limbs = self.joints, self.joint_set.limbs
        root = joints.index(self.joint_set.spine[1])
        parent, ends, part_of = [-1], [(root, root)], {root: 0}
        queue = [root]
        while queue:
            here = queue.pop(0)
            for a, b in limbs:
                if here not in (a, b) or (other := b if here == a else a) in part_of:
                    continue
                before = part_of[here]
                if self.limb_parts and joints[here][1:] in _LONG_FROM and joints[other][1:] in _LONG:
                    parent.append(before)
                    ends.append((here, other))
                    before = len(parent) - 1
                parent.append(before)
                ends.append((other, other))
                part_of[other] = len(parent) - 1
                queue.append(other)
        return Tree(np.array(parent), np.array(ends))
