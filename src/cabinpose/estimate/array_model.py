"""Models that are arrays and no network: one .npz file without pickle, beside the arrays the method and its settings as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from cabinpose.core import ModelError, read_arrays, whole_file
from cabinpose.estimate.methods import ArrayMethod
from cabinpose.estimate.onnx_model import METADATA_KEY, TrainedModel, existing


class ArrayModel(TrainedModel):
    """What `cabinpose train` wrote for a method that is fitted to arrays."""

    kind = ArrayMethod
    method: ArrayMethod[Any]
    _again = "train it again with `cabinpose train`"

    def __init__(self, path: Path | str) -> None:
        """Raises ModelError for a file that is missing, damaged, of another program, or whose arrays do not fit its method."""
        path = existing(path)
        try:
            arrays = read_arrays(path)
        except (OSError, ValueError) as error:
            raise ModelError(f"{path} cannot be read: {error}", hint="copy the file again, or train the model again") from error
        if METADATA_KEY not in arrays:
            raise ModelError(f"{path} is an .npz file of another program", hint="give best.npz of a run of `cabinpose train`")
        super().__init__(path, arrays.pop(METADATA_KEY).tobytes())
        self.arrays: dict[str, NDArray[Any]] = arrays
        try:
            self.method.check(arrays, self.config)
        except (ValueError, KeyError) as error:
            raise ModelError(f"{path} does not fit {self.method.name}: {error}", hint=self._again) from error

    def run(self, seen: Mapping[str, NDArray[Any]]) -> Any:
        """What the method finds in a batch of what the view saw, by name."""
        return self.method.find(self.arrays, self.config, seen)


def write_arrays(
    path: Path, method: str, settings: BaseModel, arrays: Mapping[str, NDArray[Any]], *, name: str, card: Mapping[str, Any],
    **more: Any,
) -> None:  # fmt: skip
    """Write a model, with `more` in its metadata; the file gets its name when it is whole. The same model is the same bytes."""
    known = {"name": name, "method": method, "config": settings.model_dump(mode="json"), "card": dict(card)}
    rewrite(path, known | more, arrays)


def rewrite(path: Path, metadata: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """As `write_arrays`, of a model's whole metadata."""
    text = np.frombuffer(json.dumps(metadata).encode(), np.uint8)
    with whole_file(path, kind=ModelError) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **{METADATA_KEY: text}, **arrays)
