"""ONNX files of others, within bounds: what one claims, before a runtime believes it, and the memory that it may take.

Tensors are held against their bytes, and there is no operator that may never end. An ONNX file is a Protocol Buffers message;
of its fields (onnx.proto, numbers below) those that matter here are read, without making anything of them.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import ModelError

_LARGEST = 2 << 30  # bytes of a message
_ROOM = 2 << 30  # bytes that the tensors of all models of a process may take together; in_car takes 55 MB for 16 frames
# Bytes of the first piece of memory. The runtime runs a shape first tensor by tensor and from then on in one block, 7 MB for a
# frame of in_car: in pieces of its own choice, of 1 MB and more, that block lies beside what the first run took.
_FIRST = 8 << 20
_SHAPED = ("ConstantOfShape", "Expand", "Tile")  # their last input says how much memory they take
_MOST_NUMBERS = 1 << 28
_FLOATS = {1: "<f4", 10: "<f2", 11: "<f8"}  # TensorProto.DataType
_INT64 = 7
_MODEL_GRAPH, _MODEL_FUNCTIONS = 7, 25
_NODE, _INITIALIZER, _SPARSE = 1, 5, 15
_FUNCTION_NODE = 7
_NODE_INPUT, _NODE_OUTPUT, _NODE_KIND, _NODE_ATTRIBUTE = 1, 2, 4, 5
_ATTRIBUTE_TENSOR, _ATTRIBUTE_GRAPH, _ATTRIBUTE_TENSORS, _ATTRIBUTE_GRAPHS, _ATTRIBUTE_SPARSE = 5, 6, 10, 11, 22
_DIMS, _TYPE, _FLOAT_DATA, _INT64_DATA, _NAME, _RAW, _EXTERNAL, _LOCATION = 1, 2, 4, 7, 8, 9, 13, 14


def check_onnx(path: Path) -> int:
    """How many of a model's tensors of weights hold NaN.

    Raises
    ------
    OSError
        Where the file cannot be read.
    ValueError
        Where it is no whole ONNX file, holds a tensor that is larger than its bytes or lies in another file, has an operator
        that may not end (Loop, If, Scan, SequenceMap), or one that makes more than 2^28 numbers of a constant shape.
    """
    if (size := path.stat().st_size) > _LARGEST:
        raise ValueError(f"it has {size / 1e9:.1f} GB, more than an ONNX file can have")
    found = _Found()
    for number, value in _fields(memoryview(path.read_bytes())):
        if number == _MODEL_GRAPH:
            found.graph(_message(value), node=_NODE)
        elif number == _MODEL_FUNCTIONS:
            found.graph(_message(value), node=_FUNCTION_NODE)
    found.check_shapes()
    return found.nan


def open_onnx(path: Path, *, threads: int) -> Any:
    """An `onnxruntime.InferenceSession` on the CPU, told to be quiet, whose runs fail where tensors would take more than 2 GB.

    What a file's operators make may depend on what they are given, so that nothing tells it before. All sessions of a process
    share the room, as much of it as they have needed so far.
    """
    runtime = importlib.import_module("onnxruntime")
    _set_room()
    options = runtime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.use_env_allocators", "1")
    return runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


@cache
def _set_room() -> None:
    """Bound the memory of all sessions to come, once a process."""
    runtime = importlib.import_module("onnxruntime")
    kind, of = runtime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, runtime.OrtMemType.DEFAULT
    arena = runtime.OrtArenaCfg({"max_mem": _ROOM, "initial_chunk_size_bytes": _FIRST})
    runtime.create_and_register_allocator(runtime.OrtMemoryInfo("Cpu", kind, 0, of), arena)


def run_onnx(session: Any, path: Path, names: Sequence[str], inputs: Mapping[str, NDArray[Any]]) -> list[NDArray[Any]]:
    """A model's outputs by name for a batch, in halves where that fails as a whole. Raises ModelError where it fails for one."""
    try:
        outputs: list[NDArray[Any]] = session.run(names, inputs)
    except Exception as error:  # ONNX Runtime's own errors share no base class
        count = min(len(array) for array in inputs.values())
        if count > 1:
            halves = slice(0, count // 2), slice(count // 2, None)
            parts = [run_onnx(session, path, names, {name: a[half] for name, a in inputs.items()}) for half in halves]
            return [np.concatenate(pair) for pair in zip(*parts, strict=True)]
        why = str(error).rpartition(") ")[2].strip()
        hint = f"models may take {_ROOM >> 30} GB while they run; export it again, or take another"
        raise ModelError(f"{path} cannot be run: {why}", hint=hint) from error
    return outputs


@dataclass
class _Found:
    """Tensors with NaN, small constants by name, and the names that say the shapes of what operators make."""

    nan: int = 0
    constants: dict[str, int] = field(default_factory=dict)  # the product of its numbers
    shapes: list[tuple[str, str]] = field(default_factory=list)  # operator, its input

    def graph(self, data: memoryview, node: int) -> None:
        for number, value in _fields(data):
            if number == node:
                self.node(_message(value))
            elif node == _NODE and number == _INITIALIZER:
                self.nan += self.tensor(_message(value), "")
            elif node == _NODE and number == _SPARSE:
                raise ValueError("it has sparse weights, which are not read")

    def node(self, data: memoryview) -> None:
        kind, inputs, output, tensors = "", [], "", []
        for number, value in _fields(data):
            if number == _NODE_KIND:
                kind = str(_message(value), "utf-8", "replace")
            elif number == _NODE_INPUT:
                inputs.append(str(_message(value), "utf-8", "replace"))
            elif number == _NODE_OUTPUT:
                output = output or str(_message(value), "utf-8", "replace")
            elif number == _NODE_ATTRIBUTE:
                for key, content in _fields(_message(value)):
                    if key in (_ATTRIBUTE_GRAPH, _ATTRIBUTE_GRAPHS, _ATTRIBUTE_SPARSE):
                        what = kind or "an operator"  # a Loop's body, which need not end
                        raise ValueError(f"{what} holds a graph or sparse numbers, which are not run: nothing could interrupt it")
                    if key in (_ATTRIBUTE_TENSOR, _ATTRIBUTE_TENSORS):
                        tensors.append(_message(content))
        for tensor in tensors:
            self.tensor(tensor, output)
        if kind in _SHAPED and inputs:
            self.shapes.append((kind, inputs[-1]))

    def tensor(self, data: memoryview, name: str) -> bool:
        """Whether a tensor has NaN. ValueError where it claims more than it holds."""
        dims: list[int] = []
        kind, raw, packed = 0, memoryview(b""), memoryview(b"")
        whole: list[int] = []
        for number, value in _fields(data):
            if number == _DIMS:
                dims += _varints(value)
            elif number == _INT64_DATA:
                whole += _varints(value)[:16]
            elif number in (_EXTERNAL, _LOCATION) and value:
                raise ValueError("its weights lie in another file, which is not opened")
            elif number == _TYPE and isinstance(value, int):
                kind = value
            elif number == _NAME:
                name = name or str(_message(value), "utf-8", "replace")
            elif number == _RAW:
                raw = _message(value)
            elif number == _FLOAT_DATA and not isinstance(value, int):
                packed = value
        count = math.prod(dims)
        if count > 2 * len(data) + 16:  # the smallest have 4 bits
            raise ValueError(f"its tensor '{name}' claims {count} numbers in {len(data)} bytes")
        if kind == _INT64 and count <= 16:
            numbers = whole or np.frombuffer(raw[: len(raw) // 8 * 8], "<i8").tolist()
            self.constants[name] = math.prod(max(0, number) for number in numbers)
        values = raw or packed
        if kind not in _FLOATS or not len(values):
            return False
        size = np.dtype(_FLOATS[kind]).itemsize
        return bool(np.isnan(np.frombuffer(values[: len(values) // size * size], _FLOATS[kind])).any())

    def check_shapes(self) -> None:
        for kind, name in self.shapes:
            if self.constants.get(name, 0) > _MOST_NUMBERS:
                raise ValueError(f"its operator {kind} makes {self.constants[name]} numbers")


def _fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field of a message: an integer, or bytes."""
    at, end = 0, len(data)
    while at < end:
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == 0:
            value, at = _varint(data, at)
            yield number, value
            continue
        length = {1: 8, 5: 4}.get(wire, -1)
        if wire == 2:
            length, at = _varint(data, at)
        if not 0 <= length <= end - at or number == 0:
            raise ValueError("it is no whole ONNX file")
        yield number, data[at : at + length]
        at += length


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """An integer of up to 64 bits, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("it is no whole ONNX file")


def _varints(value: int | memoryview) -> list[int]:
    """Integers of a repeated field, in one or packed."""
    if isinstance(value, int):
        return [value]
    numbers, at = [], 0
    while at < len(value):
        number, at = _varint(value, at)
        numbers.append(number)
    return numbers


def _message(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise ValueError("it is no whole ONNX file")
    return value
