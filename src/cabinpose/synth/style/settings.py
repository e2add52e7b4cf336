"""What a configuration says of styled depth."""

from __future__ import annotations

from pydantic import Field, model_validator

from cabinpose.core import ConfigError
from cabinpose.synth.people import Model

STYLE_VARIABLES = ("depth_styled", "style", "style_edge_px", "style_part_mm", "style_lost")
METADATA_KEY = "cabinpose-style"  # of a model's file: what it was trained with
_STEPS = 150
LEFT = "left as it was"  # the style of a frame that would have moved too far against its labels


class Style(Model):
    """`depth_styled`: the depth with the texture, noise and losses of a real frame."""

    by: str = Field(
        description="A model of `cabinpose train-style` (.onnx), or a style frame with masks (.npz): each frame is optimised."
    )
    vgg19: str | None = Field(
        None,
        description="torchvision's weights of VGG-19 (.pth) for optimisation; left out: the package's own encoder.",
    )
    steps: int = Field(_STEPS, ge=1, le=5000, description="Steps of an optimisation.")
    most_edge_px: float = Field(
        3.0, gt=0, description="Frames whose edges at labels' borders move farther are left unstyled (95 of 100)."
    )
    most_part_mm: float = Field(
        2.0, gt=0, description="Frames in which the mean depth of a part moves farther are left unstyled."
    )

    @model_validator(mode="after")
    def _fits(self) -> Style:
        """A model is not optimised."""
        beside = [name for name, given in (("steps", self.steps != _STEPS), ("vgg19", self.vgg19 is not None)) if given]
        if beside and self.by.endswith(".onnx"):
            raise ConfigError(
                f"style.{beside[0]} says nothing of a model",
                hint=f"leave it out, or give a style frame (.npz) as style.by in place of {self.by}; behind a configuration"
                f" 'style={{by: {self.by}}}' takes the place of all that it says of style",
            )
        return self
