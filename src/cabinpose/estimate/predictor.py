"""Trained models by their names and files: networks in ONNX files, arrays in .npz files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cabinpose.estimate.array_model import SUFFIX, ArrayModel, ArrayPredictor
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.onnx_model import OnnxModel, packaged_models


class OnnxPredictor(JointPredictor, OnnxModel):
    """A model of joints in an ONNX file that `cabinpose export --onnx` wrote."""


def load_model(model: str | Path, *, threads: int | None = None) -> JointPredictor:
    """A packaged model by its name, or the model in an ONNX file or in an .npz file of `cabinpose train`. Raises ModelError."""
    path = packaged_models().get(str(model), Path(model))
    return ArrayPredictor(path) if path.suffix == SUFFIX else OnnxPredictor(path, threads=threads)


def describe_model(path: Path | str) -> dict[str, Any]:
    """What the file of a model says of itself, see `TrainedModel.describe`. Raises ModelError."""
    return (ArrayModel(path) if Path(path).suffix == SUFFIX else OnnxModel(path)).describe()


__all__ = ["ArrayPredictor", "OnnxPredictor", "describe_model", "load_model", "packaged_models"]
