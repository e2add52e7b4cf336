"""Settings of the part affinity fields."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from cabinpose.estimate.settings import BodySettings


class PafConfig(BodySettings):
    """The part affinity fields: input, stages and size of the network, and how people are read off its maps."""

    input: Annotated[Literal["depth", "cloud", "amplitude", "rgb"], Field(description="What the network sees.")] = "depth"
    stages: Annotated[int, Field(ge=1, le=6, description="1 = the thesis; the original refines in 5 more.")] = 1
    channels: Annotated[float, Field(gt=0, le=2, description="Factor on the thesis' numbers of channels.")] = 1.0
    presence_labels: Annotated[
        Literal[0, 2, 3],
        Field(
            description="Labels of the presence branch: 2 = in the image or not; 3 = visible, occluded, outside; 0 = no branch."
        ),
    ] = 2
    depth_scale_m: Annotated[float, Field(gt=0, description="Depth (m) that is mapped to 255.")] = 1.8
    sigma_px: Annotated[float, Field(gt=0, description="Spread of a joint's peak in the training maps (px).")] = 8.0
    limb_px: Annotated[float, Field(gt=0, description="Half width of a limb in the training fields (px).")] = 8.0
    peak: Annotated[float, Field(gt=0, lt=1, description="Least height of a peak.")] = 0.1
    affinity: Annotated[float, Field(ge=-1, le=1, description="Least mean of the field along a limb.")] = 0.05
    presence: Annotated[float, Field(ge=0, le=1, description="Least presence of a joint; 0 = the branch gates nothing.")] = 0.5
    min_joints: Annotated[int, Field(ge=1, description="People of fewer joints are dropped.")] = 3
    slot_anchors: Annotated[
        dict[str, tuple[float, float]] | None,
        Field(description="Mean (u, v) of the neck in the view by place; measured on the training frames if not given."),
    ] = None
    skin_offset_m: Annotated[
        dict[str, float] | None,
        Field(description="From skin to joint along the view (m); measured on the training frames if not given."),
    ] = None

    @field_validator("slot_anchors")
    @classmethod
    def _some_anchor(cls, value: dict[str, tuple[float, float]] | None) -> dict[str, tuple[float, float]] | None:
        if value is not None and not value:
            raise ValueError("no place has an anchor")
        return value

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the network's inputs."""
        return ("depth",) if self.input == "cloud" else (self.input,)

    @property
    def offsets_m(self) -> tuple[float, ...]:
        """(J,) from the skin to the joint, m: measured, or half the depth of an adult's body."""
        measured = self.skin_offset_m or {}
        return tuple(measured.get(name, usual) for name, usual in self.joint_set.skin_m.items())
