"""Trained models by their names and files, as what their task makes of them."""

from __future__ import annotations

import json
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import FrameBatch, ModelError, Part
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.lifter import Lifter
from cabinpose.estimate.methods import ARRAYS_SUFFIX, METHODS
from cabinpose.estimate.onnx_model import METADATA_KEY, OnnxModel, TrainedModel, cameras_of, slices, view_inputs
from cabinpose.estimate.onnx_model import packaged_models as packaged_models


class PartSegmenter:
    """A trained model that gives every pixel of a camera a class; fulfils `core.ports.Segmenter`."""

    def __init__(self, model: TrainedModel) -> None:
        """model: of a method whose task is parts."""
        self.model, self.config, self.name, self.trained_on = model, model.config, model.name, model.trained_on
        self._doubted = False

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts: the number n of a label image is `parts[n - 1]`."""
        return tuple(self.config.parts)

    @property
    def images(self) -> tuple[str, ...]:
        """The images that the model reads."""
        return tuple(self.config.inputs)

    def segment(self, frames: FrameBatch) -> NDArray[np.uint8]:
        """Label images (N, H, W) in the frames' own pixels: 0 = nobody, or outside the model's view, else 1 + the position of the
        part.
        """
        return np.concatenate([self._segment(frames, which) for which in slices(len(frames["depth"]))])

    def _segment(self, frames: FrameBatch, which: slice) -> NDArray[np.uint8]:
        cameras = cameras_of(frames, which)
        doubts = [doubt for camera in dict.fromkeys(cameras) for doubt in self.config.view.doubts(camera)]
        if doubts and not self._doubted:
            self._doubted = True
            warnings.warn(f"{self.name}: {doubts[0]}", stacklevel=3)
        classes: NDArray[np.uint8] = self.model.run(view_inputs(frames, which, cameras, self.config.view, self.config.inputs))
        result = np.zeros(frames["depth"][which].shape, np.uint8)
        for image, own, camera in zip(result, classes, cameras, strict=True):
            image[...] = self.config.view.to_source(own, camera)
        return result


# By the task of the method.
_OPENED: dict[str, type[JointPredictor | Lifter | PartSegmenter]] = {
    "joints": JointPredictor, "lift": Lifter, "parts": PartSegmenter,
}  # fmt: skip


def open_model(model: str | Path, *, threads: int | None = None) -> JointPredictor | Lifter | PartSegmenter:
    """A trained model as what its method's task makes of it.

    Parameters
    ----------
    model
        The name of a packaged model, or an ONNX file or an .npz file of `cabinpose train`.
    threads
        Threads of a network; default: one a core.

    Returns
    -------
    JointPredictor, Lifter or PartSegmenter
        Of joints, of 2D joints lifted to 3D, of body parts.

    Raises
    ------
    ModelError
        For a file that is missing, damaged, of another program, or of a method that is not installed.
    """
    trained = _trained(packaged_models().get(str(model), Path(model)), threads)
    return _OPENED[trained.method.task](trained)


def load_model(model: str | Path, *, threads: int | None = None) -> JointPredictor:
    """A packaged model by its name, or the model in an ONNX file or in an .npz file of `cabinpose train`. Raises ModelError."""
    opened = open_model(model, threads=threads)
    if not isinstance(opened, JointPredictor):
        raise ModelError(
            f"{opened.model.path} is a model of {opened.model.method.name}",
            hint="`cabinpose predict` and `evaluate` run it; in Python cabinpose.estimate.open_model",
        )
    return opened


def describe_model(path: Path | str) -> dict[str, Any]:
    """What the file of a model says of itself, see `TrainedModel.describe`. Raises ModelError."""
    return _trained(Path(path), None).describe()


def _trained(path: Path, threads: int | None) -> TrainedModel:
    if path.suffix != ARRAYS_SUFFIX:
        return OnnxModel(path, threads=threads)
    from cabinpose.estimate.array_model import ArrayModel  # noqa: PLC0415 - a megabyte, which no network needs

    return ArrayModel(path)


def packaged_detectors() -> dict[str, Path]:
    """Those of the packaged models that find joints in images, by name."""
    return {name: path for name, path in packaged_models().items() if METHODS[_method(path)].task == "joints"}


@cache
def _method(path: Path) -> str:
    """The method of one of our ONNX files. Its text is read as it stands behind its key: a session takes 0.2 s to make."""
    data = path.read_bytes()
    text = data[data.index(b'{"', data.rindex(METADATA_KEY.encode() + b"\x12")) :]
    said, _ = json.JSONDecoder().raw_decode(text.decode("utf-8", errors="ignore"))
    return str(said["method"])
