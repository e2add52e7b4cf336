"""Settings of the random tree walks."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from cabinpose.core import SKELETONS, Skeleton, SkeletonName
from cabinpose.estimate.settings import PlacedSettings

_Count = Annotated[int, Field(ge=1)]


class WalksConfig(PlacedSettings):
    """Random tree walks: the view, how trees are grown and how walks go."""

    width: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Width of the view (px).")] = 320
    height: Annotated[int, Field(ge=16, le=1024, multiple_of=8, description="Height of the view (px).")] = 240
    skeleton: Annotated[SkeletonName, Field(description="Joints to find.")] = "cabinpose"
    samples: Annotated[_Count, Field(description="Points in every training frame that a tree learns from.")] = 40
    spread_m: Annotated[
        float, Field(gt=0, description="Greatest standard deviation of them about the joint (m); half on the way there.")
    ] = 0.25
    features: Annotated[_Count, Field(description="Features that a node tries.")] = 200
    node_samples: Annotated[_Count, Field(description="Samples at most that a node tries them on.")] = 4000
    leaf_samples: Annotated[_Count, Field(description="Samples at least of a leaf.")] = 60
    depth: Annotated[_Count, Field(le=64, description="Splits at most between root and leaf.")] = 24
    clusters: Annotated[_Count, Field(le=64, description="Directions of a leaf.")] = 8
    steps: Annotated[_Count, Field(le=10_000, description="Steps of a walk.")] = 64
    skipped: Annotated[int, Field(ge=0, description="First steps that do not count for the joint, the mean of the others.")] = 24
    step_m: Annotated[float, Field(gt=0, le=1, description="Length of a step (m).")] = 0.03

    @model_validator(mode="after")
    def _some_steps_count(self) -> Self:
        if self.skipped >= self.steps:
            raise ValueError("skipped has to be less than steps")
        return self

    @property
    def joint_set(self) -> Skeleton:
        """The joints that it finds, as a set."""
        return SKELETONS[self.skeleton]

    @property
    def order(self) -> tuple[tuple[int, int], ...]:
        """(J, 2) joints in the order of their walks, and the joint at which each walk begins, -1 for the belly's."""
        limbs = self.joint_set.limbs
        ways = sorted({*limbs, *((b, a) for a, b in limbs)})
        order = [(self.joints.index(self.joint_set.spine[-1]), -1)]
        for joint, parent in order:  # grows while it is read
            order += [(child, joint) for a, child in ways if a == joint and child != parent]
        return tuple(order)
