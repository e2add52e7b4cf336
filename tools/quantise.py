"""Static quantisation of a model to int8, and what it gains and costs: `quantise.py MODEL CALIBRATE TEST OUT.onnx`.

CALIBRATE and TEST are datasets; the first gives the ranges of activations, on the second both models are judged. CPU time is of
one thread and a frame at a time, the models in turn, as medians. Activations are unsigned and weights signed, which is what ONNX
Runtime has its quick kernels on x86 for; only convolutions and what lies between them are quantised.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static

import cabinpose
from cabinpose.estimate.half import widen
from cabinpose.estimate.onnx_model import METADATA_KEY, OnnxModel, cameras_of, packaged_models, view_inputs
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset

_FIGURES = (("PCKh", "2d", None), ("AUC of PCKh", "2d", None), ("PCK", "3d", 10.0), ("median error", "3d", None))


class _Frames(CalibrationDataReader):  # type: ignore[misc] # the library is untyped
    """The network's inputs of some frames, evenly spread over a dataset, one frame at a time."""

    def __init__(self, model: OnnxModel, dataset: Any, count: int) -> None:
        self._next = self._seen(model, dataset, np.linspace(0, dataset.sizes["frame"] - 1, count).astype(int))

    @staticmethod
    def _seen(model: OnnxModel, dataset: Any, which: Any) -> Iterator[dict[str, Any]]:
        for index in which:
            frames, one = frame_batch(dataset, slice(index, index + 1)), slice(0, 1)
            inputs = model.config.inputs
            seen = view_inputs(frames, one, cameras_of(frames, one), model.config.view, amplitude="amplitude" in inputs)
            yield {name: seen[name] for name in inputs}

    def get_next(self) -> dict[str, Any] | None:
        """The next frame's, or None after the last."""
        return next(self._next, None)


def main() -> None:
    """Quantise, and print a line for each of the two models."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("model", "calibrate", "test", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--frames", type=int, default=200)
    given = parser.parse_args()
    source = packaged_models().get(str(given.model), given.model)
    model, calibrate = OnnxModel(source, threads=1), open_dataset(given.calibrate)
    float32 = onnx.load(str(source))
    widen(float32)
    quantize_static(
        float32, str(given.out), _Frames(model, calibrate, 100), activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8, per_channel=True, op_types_to_quantize=["Conv", "MaxPool", "Relu"],
    )  # fmt: skip
    quantised = onnx.load(str(given.out))
    onnx.helper.set_model_props(quantised, {METADATA_KEY: model.session.get_modelmeta().custom_metadata_map[METADATA_KEY]})
    onnx.save(quantised, str(given.out))
    models = {"float32": model, "int8": OnnxModel(given.out, threads=1)}
    took: dict[str, list[float]] = {name: [] for name in models}
    frames = _Frames(model, calibrate, 30)
    while (seen := frames.get_next()) is not None:
        for name, each in models.items():
            began = time.process_time()
            each.outputs(seen)
            took[name].append(time.process_time() - began)
    test = open_dataset(given.test).isel(frame=slice(0, given.frames))
    for name, each in models.items():
        report = cabinpose.evaluate_predictions(test, each.path)
        found = {f"{metric} {space}": report.value(metric, space, threshold=at) for metric, space, at in _FIGURES}
        took_ms, size = 1000 * np.median(took[name][5:]), each.path.stat().st_size / 1e6
        figures = ", ".join(f"{metric} {value.value:.2f}" for metric, value in found.items() if value is not None)
        print(f"{name}: {took_ms:.1f} ms of CPU a frame, {size:.1f} MB, {figures}", flush=True)


if __name__ == "__main__":
    main()
