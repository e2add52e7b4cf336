"""A model in eight bits: static quantisation of its convolutions by ranges that training frames give (ONNX Runtime).

Weights are signed, by channel, and activations unsigned, which is what ONNX Runtime has its quick kernels on x86 for. Layers that
answer with places stay in float32 (`NetworkMethod.precise`): a depth of 3 m in 256 steps is known to 12 mm at best.
"""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
import onnx
import xarray as xr
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static

from cabinpose.core import ConfigError, FrameBatch, ModelError, make_folder, whole_file
from cabinpose.estimate.half import halve, is_halved, widen
from cabinpose.estimate.onnx_model import METADATA_KEY, OnnxModel, cameras_of, view_inputs
from cabinpose.store import frame_images

FRAMES = 100  # at most, evenly spread over the dataset, that give the ranges
_KINDS = ["Conv", "MaxPool", "Relu"]
_WHOLE = slice(0, 1)


class _Reader(CalibrationDataReader):
    """What a model's view sees of some frames of a dataset, one frame at a time."""

    def __init__(self, model: OnnxModel, dataset: xr.Dataset, count: int) -> None:
        self._next = self._seen(model, dataset, np.unique(np.linspace(0, dataset.sizes["frame"] - 1, count).astype(int)).tolist())

    @staticmethod
    def _seen(model: OnnxModel, dataset: xr.Dataset, which: list[int]) -> Iterator[dict[str, NDArray[np.float32]]]:
        images = list(model.config.inputs)
        for index in which:
            frame = slice(index, index + 1)
            rest = {name: dataset[name].isel(frame=frame).values for name in ("camera_k", "camera_dist")}
            frames = cast("FrameBatch", frame_images(dataset, frame, list(dict.fromkeys(["depth", *images]))) | rest)
            seen = view_inputs(frames, _WHOLE, cameras_of(frames, _WHOLE), model.config.view, images)
            yield {name: seen[name] for name in images}

    def get_next(self) -> dict[str, Any] | None:
        """The next frame's, or None after the last."""
        return next(self._next, None)


def write_int8(model: OnnxModel, dataset: xr.Dataset, out: Path, *, frames: int = FRAMES) -> None:
    """Write a model of images in eight bits; what it says of itself stays, and `load_model` takes it as any other.

    Parameters
    ----------
    model
        In float32, or with its weights in half precision; then what stays in float32 is stored so, too.
    dataset
        Frames as it was trained on, of which up to `frames` give the ranges of the activations.
    out
        The file, which is replaced.
    frames
        How many at most.

    Raises
    ------
    ConfigError
        For a model that reads no images, or that is in eight bits already.
    DatasetError
        Where the dataset lacks an image that the model reads.
    """
    network = onnx.load(str(model.path))
    if "pose" in model.config.inputs:
        raise ConfigError(f"{model.name} reads no images", hint="int8 is for convolutions: leave it out")
    if any(node.op_type == "DequantizeLinear" for node in network.graph.node):
        raise ConfigError(f"{model.path} is in eight bits already", hint="give the float32 model that it was made of")
    halved = is_halved(network)
    widen(network)
    _unshare(network.graph)
    precise = re.compile("|".join(rf"/{name}(?:_\d+)?[./]" for name in model.method.precise) or "(?!)")
    kept = [node.name for node in network.graph.node if precise.search(node.name)]
    make_folder(out.parent)
    with whole_file(out, kind=ModelError) as partial, TemporaryDirectory() as folder, _quiet():
        quantised = Path(folder) / "int8.onnx"
        quantize_static(
            network, str(quantised), _Reader(model, dataset, frames), activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8, per_channel=True, op_types_to_quantize=_KINDS, nodes_to_exclude=kept,
        )  # fmt: skip
        written = onnx.load(str(quantised))
        onnx.helper.set_model_props(written, {METADATA_KEY: model.session.get_modelmeta().custom_metadata_map[METADATA_KEY]})
        if halved:
            halve(written)
        onnx.save(written, str(partial))


def _unshare(graph: onnx.GraphProto) -> None:
    """Give each convolution weights of its own, which a mirrored model runs twice and the exporter hands on by Identity nodes.

    Shared ones would have one scale of their bias for two inputs, and handed on ones would be taken for activations.
    """
    arrays = {array.name: array for array in graph.initializer}
    handed = {node.output[0]: node.input[0] for node in graph.node if node.op_type == "Identity" and node.input[0] in arrays}
    used: Counter[str] = Counter()
    for node in graph.node:
        if node.op_type == "Conv":
            for i, given in enumerate(node.input):
                name = handed.get(given, given)
                if name in arrays:
                    node.input[i] = f"{name}.{used[name]}" if used[name] else name
                    if used[name]:
                        copy = graph.initializer.add()
                        copy.CopyFrom(arrays[name])
                        copy.name = node.input[i]
                    used[name] += 1
    needed = {name for node in graph.node for name in node.input}
    kept = [node for node in graph.node if node.op_type != "Identity" or node.output[0] not in handed or node.output[0] in needed]
    del graph.node[:]
    graph.node.extend(kept)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silences advice to prepare the graph, which the exporter has done."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
