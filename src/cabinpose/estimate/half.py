"""Weights of an ONNX file in half precision: half its bytes. ONNX Runtime widens them once, when it reads the file."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

_SUFFIX = ".half"
_LEAST = 256  # values of an array that is worth it
_GREATEST = float(np.finfo(np.float16).max)
_QUANTISERS = ("QuantizeLinear", "DequantizeLinear")


def halve(model: onnx.ModelProto) -> None:
    """Store the large float32 arrays of a model as float16, each widened by a node of its own; the rest computes as before."""
    graph = model.graph
    widening = []
    scales = {name for node in graph.node if node.op_type in _QUANTISERS for name in node.input}  # too small for it
    for array in graph.initializer:
        values = numpy_helper.to_array(array)
        if (
            array.data_type != TensorProto.FLOAT
            or values.size < _LEAST
            or array.name in scales
            or np.abs(values).max() > _GREATEST
        ):
            continue
        name = array.name
        array.CopyFrom(numpy_helper.from_array(values.astype(np.float16), name + _SUFFIX))
        widening.append(helper.make_node("Cast", [name + _SUFFIX], [name], name=name + _SUFFIX, to=TensorProto.FLOAT))
    nodes = [*widening, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)


def is_halved(model: onnx.ModelProto) -> bool:
    """Whether some arrays of a model are stored in half precision by `halve`."""
    return any(array.name.endswith(_SUFFIX) for array in model.graph.initializer)


def widen(model: onnx.ModelProto) -> None:
    """Undo `halve` but for what rounding has lost: every array is float32 again, and no node widens one."""
    graph = model.graph
    halves = {array.name: array for array in graph.initializer if array.name.endswith(_SUFFIX)}
    kept = []
    for node in graph.node:
        array = halves.get(node.input[0]) if node.op_type == "Cast" and node.input else None
        if array is None:
            kept.append(node)
        else:
            array.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(array).astype(np.float32), node.output[0]))
    del graph.node[:]
    graph.node.extend(kept)
