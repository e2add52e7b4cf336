"""What the settings of all methods have in common, and how training varies frames."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import CABINPOSE, OCCUPANT_SLOTS, OTHER_SKELETONS, DriveSide, Skeleton
from cabinpose.estimate.inputs import InputView

Probability = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0)]
DepthUnit = Literal["m", "mm"]  # of a program's depth images: float32 metres, or uint16 millimetres
_Shares = tuple[float, float, float]
_FOCAL_PER_WIDTH = 139 / 352  # 103 deg across: all but 0.1 % of the joints that a Monstar sees, which 95.5 deg lose 6 % of
_OLDER_FOCAL_PER_WIDTH = 160 / 352
# What `body` chooses: of our joints the upper body's or all, or another set.
_BODIES = {"upper": CABINPOSE.subset(CABINPOSE.sets["upper body"]), "full": CABINPOSE} | {
    each.name: each for each in OTHER_SKELETONS
}
if TYPE_CHECKING:
    BodyName: TypeAlias = str
else:
    BodyName = Literal[tuple(_BODIES)]


class Settings(BaseModel):
    """The settings of any method: what training, export and predictors read of them.

    A subclass also has `view`, an `InputView`, as a class variable, field or property.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @property
    def joint_set(self) -> Skeleton:
        """The joints that it finds, as a set."""
        return CABINPOSE

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,) names of the joints that it finds."""
        return self.joint_set.joints

    @property
    def shared_joints(self) -> tuple[str, ...]:
        """(J,) the same joints, those of another set by the names of ours where they are the same point."""
        same = {theirs: ours for ours, theirs in CABINPOSE.maps.get(self.joint_set.name, {}).items()}
        return tuple(same.get(joint, joint) for joint in self.joints)

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
    max_depth_m: Annotated[
        float, Field(gt=0, le=20, description="What lies farther counts as invalid (m); training takes 6.5 at most.")
    ] = 3.0
    slots: Annotated[tuple[str, ...], Field(min_length=1, description="Places that people are predicted for.")] = OCCUPANT_SLOTS

    @cached_property
    def view(self) -> InputView:
        """The view of a model with these settings."""
        focal = self.focal if self.focal is not None else _OLDER_FOCAL_PER_WIDTH * self.width
        return InputView(self.width, self.height, focal, self.max_depth_m)


class PlacedSettings(ViewSettings):
    """The settings of a method that does not see where the wheel is, and so has to be told which seat is the driver's."""

    drive_side: Annotated[DriveSide, Field(description="Side of the wheel in the cars that it learns from.")] = "left"


class BodySettings(PlacedSettings):
    """The settings of a method that can predict the upper body alone, and that ties joints along the limbs."""

    body: Annotated[BodyName, Field(description="Joints: the upper body's 14, all 20, or those of another set.")] = "upper"

    @property
    def joint_set(self) -> Skeleton:
        """The joints that it finds, as a set; the limbs of the whole of it are a tree that ties all of them."""
        return _BODIES[self.body]


class AugmentConfig(BaseModel):
    """How training frames are varied. Probabilities are per frame; the thesis' are those of docs/models/paf-thesis.yaml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    shift: Annotated[Probability, Field(description="Probability that the cloud is moved at all.")] = 0.8
    shift_axes: Annotated[_Shares, Field(description="Probability of a shift along x, y, z.")] = (0.5, 0.5, 0.8)
    shift_m: Annotated[NotNegative, Field(description="Standard deviation, or greatest value, of the shift (m).")] = 0.15
    shift_law: Annotated[
        Literal["normal", "uniform"], Field(description="Law of the shift; uniform: from 0 to shift_m, as the thesis prints it.")
    ] = "normal"
    rotate_deg: Annotated[NotNegative, Field(description="Standard deviation of the rotation about each axis (deg).")] = 4.0
    flip: Annotated[Probability, Field(description="Probability of a mirror image, sides swapped.")] = 0.5
    noise_m: Annotated[NotNegative, Field(description="Greatest standard deviation of added depth noise (m).")] = 0.008
    lost: Annotated[Probability, Field(description="Greatest share of pixels that are lost.")] = 0.03
    gain: Annotated[float, Field(ge=1, description="Amplitudes are multiplied by up to this factor, or divided.")] = 2.0
    occluder: Annotated[Probability, Field(description="Probability of an object in front of the scene.")] = 0.2
    rescale: Annotated[Probability, Field(description="Probability that depths lose their scale (joints keep theirs).")] = 0.0
    rescale_sigma: Annotated[NotNegative, Field(description="Standard deviation of the logarithm of the lost scale.")] = 0.15
