"""What a configuration says of pictures beside the depth."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from cabinpose.core import ConfigError
from cabinpose.synth.people import Model


class Images(Model):
    """Pictures beside the depth, pixel by pixel of the same camera."""

    variables: tuple[Literal["rgb", "nir"], ...] = Field(
        ("rgb",), min_length=1, description="rgb: colour; nir: near infrared, by the camera's own light and the sun."
    )
    renderer: Literal["path_traced", "raster"] = Field(
        "path_traced", description="path_traced: with Mitsuba (extra rgb), seconds a frame; raster: a shaded preview."
    )
    samples: int = Field(32, ge=1, le=4096, description="Paths through a pixel; a multiple of 4.")
    denoise: bool = Field(True, description="Filter the noise of few paths, guided by the geometry.")
    light: Literal["any", "day", "night", "garage"] = Field("any", description="any: drawn for each frame.")

    @field_validator("variables")
    @classmethod
    def _once(cls, variables: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(variables)) < len(variables):
            raise ConfigError("images.variables names one picture twice", hint="name each of rgb and nir once at most")
        return variables
