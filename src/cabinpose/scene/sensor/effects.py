"""Noise models' common part, and the effects that installed packages add to any of them."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any

from numpy.random import Generator
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetJsonSchemaHandler, SerializeAsAny
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from cabinpose.core import Registry
from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.presets import Sensor


class NoiseEffect(BaseModel, ABC):
    """What a package adds to the noise of a camera: subclass it with the effect's settings, all with defaults, and `apply`.

    `kind` is the name under which it is registered in the entry point group *cabinpose.noise_effects*; give it as a default.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: str = Field(description="Name of the effect.")

    @abstractmethod
    def apply(self, frame: SensorFrame, buffers: GeometryBuffers, sensor: Sensor, *, rng: Generator) -> None:
        """Change a frame in place, as the camera's own filters have not yet seen it.

        Parameters
        ----------
        frame
            What the noise model made; `invalidate` takes out pixels.
        buffers
            The true geometry of the view.
        sensor
            The camera.
        rng
            Source of the effect's noise, after the model's own; equal bits must give equal bytes.
        """


NOISE_EFFECTS: Registry[type[NoiseEffect]] = Registry("cabinpose.noise_effects", "noise effect", NoiseEffect, subclass=True)


def _of_kind(data: Any) -> Any:
    return NOISE_EFFECTS[str(data.get("kind"))].model_validate(data) if isinstance(data, Mapping) else data


class _Installed:
    """Says in a JSON schema which effects are installed."""

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        known = [handler(effect.__pydantic_core_schema__) for _, effect in NOISE_EFFECTS.items()]
        return {"oneOf": known} if known else {"not": {}}


class CameraNoise(BaseModel):
    """What all noise models have."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: str
    effects: tuple[Annotated[SerializeAsAny[NoiseEffect], BeforeValidator(_of_kind), _Installed()], ...] = Field(
        default=(),
        exclude_if=operator.not_,
        description="Effects of installed packages, in the order in which they act: {kind: NAME} and the effect's own settings.",
    )
