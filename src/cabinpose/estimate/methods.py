"""The methods by name: what belongs to each. The parts that need torch are only loaded to train or export."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from cabinpose.core.errors import ConfigError, unknown_name
from cabinpose.estimate.compact import decode as compact_decode
from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.found import Found


@dataclass(frozen=True)
class Method:
    """A way to find joints.

    config: its settings, with `view`, `slots`, `skeleton` and `joints` · outputs: names of the network's outputs, in order ·
    decode: outputs as numpy arrays to joints · network, loss: import paths "module:name", loaded when a model is trained ·
    labels: whether it learns from pixel classes.
    """

    name: str
    config: type[BaseModel]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    decode: Callable[[Mapping[str, NDArray[Any]], Any], Found]
    network: str
    loss: str
    labels: bool = False

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
    "compact": Method(
        "compact",
        CompactConfig,
        ("depth", "amplitude"),
        ("joints", "inside", "visible", "present"),
        compact_decode.decode,
        "cabinpose.estimate.compact.model:Compact",
        "cabinpose.estimate.compact.fit:loss",
    ),
}


def method_named(name: str) -> Method:
    """The method of this name; ConfigError lists the ones that exist."""
    if name not in METHODS:
        raise unknown_name("method", name, list(METHODS))
    return METHODS[name]
