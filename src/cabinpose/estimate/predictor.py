"""Trained models as predictors: ONNX files, run by ONNX Runtime without torch."""

from __future__ import annotations

import json
import os
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, ModelError
from cabinpose.core.ports import FrameBatch, PoseBatch
from cabinpose.estimate.inputs import InputView
from cabinpose.estimate.methods import Method, method_named

METADATA_KEY = "cabinpose"
_BATCH = 16


class OnnxPredictor:
    """A model in an ONNX file that `cabinpose export --onnx` wrote; fulfils `core.ports.Predictor`."""

    def __init__(self, path: Path | str, *, threads: int | None = None) -> None:
        """Raises ModelError for a file that is missing, truncated, or not a model of this package."""
        self.path = Path(path)
        if not self.path.is_file():
            raise ModelError(
                f"there is no model {self.path}", hint=f"give an ONNX file, or one of: {', '.join(packaged_models())}"
            )
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        options.intra_op_num_threads = threads or os.cpu_count() or 1
        try:
            self._session = onnxruntime.InferenceSession(str(self.path), options, providers=["CPUExecutionProvider"])
            self.metadata: dict[str, Any] = json.loads(self._session.get_modelmeta().custom_metadata_map[METADATA_KEY])
        except KeyError:
            raise ModelError(
                f"{self.path} is an ONNX file of another program", hint="export models with `cabinpose export`"
            ) from None
        except Exception as error:
            raise ModelError(
                f"{self.path} cannot be read: {error}", hint="copy the file again, or export the model again"
            ) from error
        self.method: Method = method_named(str(self.metadata["method"]))
        self.config = self.method.settings(self.metadata["config"])
        self.name = str(self.metadata.get("name", self.path.stem))
        self.persons: tuple[str, ...] = tuple(self.config.slots)
        self.joints: tuple[str, ...] = tuple(self.config.joints)

    def predict(self, frames: FrameBatch) -> PoseBatch:
        """The joints of N frames, in their order. Raises ConfigError where the model needs amplitudes and there are none."""
        results = [self._predict(frames, slice(i, i + _BATCH)) for i in range(0, max(len(frames["depth"]), 1), _BATCH)]
        return PoseBatch(*(np.concatenate(arrays) for arrays in zip(*results, strict=True)))

    def _predict(self, frames: FrameBatch, which: slice) -> tuple[NDArray[np.float32], ...]:
        cameras = cameras_of(frames, which)
        inputs = view_inputs(frames, which, cameras, self.config.view, amplitude="amplitude" in self._inputs)
        values = self._session.run(self.method.outputs, inputs)
        found = self.method.decode(dict(zip(self.method.outputs, values, strict=True)), self.config)
        joints_2d = np.stack([camera.project(p) for camera, p in zip(cameras, found.joints_3d, strict=True)])
        return tuple(a.astype(np.float32) for a in (joints_2d, found.joints_3d, found.score, found.presence))

    @property
    def _inputs(self) -> set[str]:
        return {node.name for node in self._session.get_inputs()}


def cameras_of(frames: FrameBatch, which: slice) -> list[Camera]:
    """The camera of each of some frames."""
    depth = frames["depth"][which]
    count, height, width = depth.shape
    k = np.broadcast_to(frames["camera_k"] if np.ndim(frames["camera_k"]) == 2 else frames["camera_k"][which], (count, 3, 3))
    dist = np.broadcast_to(
        frames["camera_dist"] if np.ndim(frames["camera_dist"]) == 1 else frames["camera_dist"][which], (count, 5)
    )
    return [
        Camera(width, height, m[0, 0], m[1, 1], m[0, 2], m[1, 2], tuple(d.tolist()))  # type: ignore[arg-type]
        for m, d in zip(k.astype(float), dist, strict=True)
    ]


def view_inputs(
    frames: FrameBatch, which: slice, cameras: list[Camera], view: InputView, *, amplitude: bool
) -> dict[str, NDArray[np.float32]]:
    """Arrays (N, h, w) of a view from frames of their cameras: depth (m, 0 = invalid) and, where asked for, amplitude."""
    inputs = {"depth": np.stack([view.depth(d, c) for d, c in zip(frames["depth"][which], cameras, strict=True)])}
    if amplitude:
        if "amplitude" not in frames:
            raise ConfigError("this model reads amplitudes, and the frames have none", hint="take a model of depth alone")
        seen = [view.resample(a, c) for a, c in zip(frames["amplitude"][which], cameras, strict=True)]
        inputs["amplitude"] = np.stack(seen).astype(np.float32)
    return inputs


def packaged_models() -> dict[str, Path]:
    """The models that come with the package, by name."""
    folder = resources.files("cabinpose.estimate") / "models"
    return {Path(str(f)).stem: Path(str(f)) for f in sorted(folder.iterdir(), key=str) if f.name.endswith(".onnx")}


def load_model(model: str | Path, *, threads: int | None = None) -> OnnxPredictor:
    """A packaged model by its name, or the model in an ONNX file. Raises ModelError."""
    return OnnxPredictor(packaged_models().get(str(model), Path(model)), threads=threads)
