"""Trained models as predictors of body pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.ports import FrameBatch, PoseBatch
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
        results = [self._predict(frames, which) for which in slices(len(frames["depth"]))]
        return PoseBatch(*(np.concatenate(arrays) for arrays in zip(*results, strict=True)))

    def _predict(self, frames: FrameBatch, which: slice) -> tuple[NDArray[np.float32], ...]:
        cameras = cameras_of(frames, which)
        view = self.config.view
        found: Found = self.run(view_inputs(frames, which, cameras, view, amplitude="amplitude" in self.config.inputs))
        joints_2d = np.empty_like(found.uv)
        for camera, uv, pixels in zip(cameras, found.uv, joints_2d, strict=True):
            pixels[...] = view.pixels(uv, camera)
        return tuple(a.astype(np.float32) for a in (joints_2d, found.joints_3d, found.score, found.presence))


def load_model(model: str | Path, *, threads: int | None = None) -> OnnxPredictor:
    """A packaged model by its name, or the model in an ONNX file. Raises ModelError."""
    return OnnxPredictor(packaged_models().get(str(model), Path(model)), threads=threads)


__all__ = ["OnnxPredictor", "load_model", "packaged_models"]
