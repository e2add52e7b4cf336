"""The methods by name: what belongs to each. The parts that need torch are only loaded to train or export."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from cabinpose.core.errors import ConfigError, unknown_name
from cabinpose.estimate.compact import decode as compact_decode
from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.lifting import decode as lifting_decode
from cabinpose.estimate.lifting.config import LiftingConfig
from cabinpose.estimate.paf import decode as paf_decode
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.unet import decode as unet_decode
from cabinpose.estimate.unet.config import UnetConfig

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Method:
    """A way to find joints or body parts.

    task: "joints" (images to joints), "parts" (images to pixel classes) or "lift" (joints in 2D to 3D); `estimate.tasks` has
    what training does for each · config: its settings (`estimate.settings.Settings`) · outputs: names of the network's outputs,
    in order · decode(outputs, settings, seen): what the task gives, from the outputs and what the view saw (`depth`, and
    `amplitude` where it is an input) as numpy arrays · network, loss, measure: import paths "module:name", loaded when a model
    is trained; measure(settings, frames) fills the settings that are measured on the training frames · mirrored: import path
    of what wraps a network to answer with the mean over a frame and its mirror image · learning_rate, weight_decay: what a
    run takes that names none.
    """

    name: str
    task: Literal["joints", "parts", "lift"]
    config: type[BaseModel]
    outputs: tuple[str, ...]
    decode: Callable[[Arrays, Any, Arrays], Any]
    network: str
    loss: str
    measure: str | None = None
    mirrored: str | None = None
    learning_rate: float = 3e-3
    weight_decay: float = 0.02

    def settings(self, values: Mapping[str, Any]) -> Any:
        """The settings that plain data describes; ConfigError names what is wrong."""
        try:
            return self.config.model_validate(values)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise ConfigError(
                f"{self.name}: {where}: {first['msg']}", hint=f"settings of {self.name}: {', '.join(self.config.model_fields)}"
            ) from error


METHODS = {
    method.name: method
    for method in (
        Method(
            "compact",
            "joints",
            CompactConfig,
            ("joints", "inside", "visible", "present"),
            compact_decode.decode,
            "cabinpose.estimate.compact.model:Compact",
            "cabinpose.estimate.compact.fit:loss",
            mirrored="cabinpose.estimate.compact.model:Mirrored",
        ),
        Method(
            "paf",
            "joints",
            PafConfig,
            ("fields", "heat", "presence"),
            paf_decode.decode,
            "cabinpose.estimate.paf.model:Paf",
            "cabinpose.estimate.paf.fit:loss",
            measure="cabinpose.estimate.paf.measure:measured",
            learning_rate=4e-4,
            weight_decay=0.01,
        ),
        Method(
            "lifting",
            "lift",
            LiftingConfig,
            ("relative", "root"),
            lifting_decode.decode,
            "cabinpose.estimate.lifting.model:Lifting",
            "cabinpose.estimate.lifting.fit:loss",
            learning_rate=1e-3,
            weight_decay=0.01,
        ),
        Method(
            "unet",
            "parts",
            UnetConfig,
            ("person", "parts"),
            unet_decode.decode,
            "cabinpose.estimate.unet.model:Unet",
            "cabinpose.estimate.unet.fit:loss",
            learning_rate=1e-3,
            weight_decay=0.01,
        ),
    )
}


def method_named(name: str) -> Method:
    """The method of this name; ConfigError lists the ones that exist."""
    if name not in METHODS:
        raise unknown_name("method", name, list(METHODS))
    return METHODS[name]
