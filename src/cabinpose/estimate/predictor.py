"""Trained models as predictors of body pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.ports import FrameBatch, PoseBatch, joined
from cabinpose.estimate.found import Found
from cabinpose.estimate.onnx_model import OnnxModel, cameras_of, packaged_models, slices, view_inputs


class OnnxPredictor(OnnxModel):
    """A model of joints in an ONNX file that `cabinpose export --onnx` wrote; fulfils `core.ports.Predictor`."""

    def __init__(self, path: Path | str, *, threads: int | None = None) -> None:
        """Raises ModelError for a file that is missing, truncated, not a model of this package, or not one of joints."""
        super().__init__(path, threads=threads)
        self.persons: tuple[str, ...] = tuple(self.config.slots)
        self.joints: tuple[str, ...] = tuple(self.config.joints)

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """The joints of N frames, in their order. Raises ConfigError where the model needs amplitudes and there are none."""
        batches = []
        for which in slices(len(frames["depth"])):
            cameras = cameras_of(frames, which)
            seen = self.seen(frames, which, cameras)
            batches.append(self.poses(self.outputs(seen), seen, cameras))
        return joined(batches)

    def seen(self, frames: FrameBatch, which: slice, cameras: Sequence[Camera]) -> dict[str, NDArray[np.float32]]:
        """What the model's view sees of some frames by name; the first of the three stages of `predict`."""
        return view_inputs(frames, which, cameras, self.config.view, amplitude="amplitude" in self.config.inputs)

    def poses(
        self, outputs: Mapping[str, NDArray[Any]], seen: Mapping[str, NDArray[Any]], cameras: Sequence[Camera]
    ) -> PoseBatch:
        """The joints in the frames' own cameras, from the network's outputs; the last of the stages."""
        found: Found = self.decode(outputs, seen)
        view = self.config.view
        joints_2d = np.empty_like(found.uv)
        for camera, uv, pixels in zip(cameras, found.uv, joints_2d, strict=True):
            pixels[...] = view.pixels(uv, camera)
        return PoseBatch(*(a.astype(np.float32) for a in (joints_2d, found.joints_3d, found.score, found.presence)))


def load_model(model: str | Path, *, threads: int | None = None) -> OnnxPredictor:
    """A packaged model by its name, or the model in an ONNX file. Raises ModelError."""
    return OnnxPredictor(packaged_models().get(str(model), Path(model)), threads=threads)


__all__ = ["OnnxPredictor", "load_model", "packaged_models"]
