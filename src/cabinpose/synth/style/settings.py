"""What a configuration says of styled depth."""

from __future__ import annotations

from pydantic import Field

from cabinpose.synth.people import Model

STYLE_VARIABLES = ("depth_styled", "style", "style_edge_px", "style_part_mm", "style_lost")
METADATA_KEY = "cabinpose-style"  # of a model's file: what it was trained with
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
    steps: int = Field(150, ge=1, le=5000, description="Steps of an optimisation.")
    most_edge_px: float = Field(
        3.0, gt=0, description="Frames whose edges at labels' borders move farther are left unstyled (95 of 100)."
    )
    most_part_mm: float = Field(
        2.0, gt=0, description="Frames in which the mean depth of a part moves farther are left unstyled."
    )
