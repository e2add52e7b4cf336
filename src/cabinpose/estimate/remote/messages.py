"""Arrays in the protocol's messages, for both ends: raw bytes, typed contents, and bytes in shared memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.remote.tensors import DTYPES, Arrays, TensorError, TensorSpec, bind_shape, names_of, pack, unpack

Read = Callable[[str, int, int], bytes | bytearray]  # name of a region, offset, number of bytes
_CONTENTS = {
    "FP32": "fp32_contents",
    "FP64": "fp64_contents",
    "UINT16": "uint_contents",
    "UINT8": "uint_contents",
    "BYTES": "bytes_contents",
}


def read_tensors(
    tensors: Iterable[Any], raw: Sequence[bytes], table: Sequence[TensorSpec], *, read: Read | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays of a request's inputs or a response's outputs, by name.

    Parameters
    ----------
    tensors
        `inputs` or `outputs` of the message.
    raw
        Its `raw_input_contents` or `raw_output_contents`: one entry for each tensor that is not in shared memory, or none at
        all where the values stand in the tensors' own `contents`.
    table
        The tensors that there may be.
    read
        Reads bytes of a shared memory region; None where there are none.

    Raises
    ------
    TensorError
        For tensors unknown, twice, of another type or shape, or of another number of bytes than the shape says. Nothing is
        read before type and shape are known to be right.
    """
    known, sizes = {spec.name: spec for spec in table}, dict[str, int]()
    found: dict[str, NDArray[Any]] = {}
    contents = iter(raw)
    for tensor in tensors:
        spec = known.get(tensor.name)
        if spec is None or tensor.name in found:
            raise TensorError(f"{tensor.name[:64]!r} is {'there twice' if spec else 'unknown'}; known: {', '.join(known)}")
        shape = list(tensor.shape)
        bind_shape(spec, tensor.datatype, shape, sizes)
        if read is not None and "shared_memory_region" in tensor.parameters:
            length = tensor.parameters["shared_memory_byte_size"].int64_param
            if spec.datatype == "BYTES" or length != math.prod(shape) * DTYPES[spec.datatype].itemsize:
                raise TensorError(f"{spec.name} {shape} cannot be {length} bytes of shared memory")
            region, offset = tensor.parameters["shared_memory_region"], tensor.parameters["shared_memory_offset"]
            found[spec.name] = unpack(read(region.string_param, offset.int64_param, length), spec, shape)
        elif raw:
            data = next(contents, None)
            if data is None:
                raise TensorError(f"{spec.name} has no raw contents")
            found[spec.name] = unpack(data, spec, shape)
        else:
            found[spec.name] = _typed(getattr(tensor.contents, _CONTENTS[spec.datatype]), spec, shape)
    if next(contents, None) is not None:
        raise TensorError("there are more raw contents than tensors")
    return found


def _typed(values: Any, spec: TensorSpec, shape: Sequence[int]) -> NDArray[Any]:
    """An array of a tensor's own contents."""
    if spec.datatype == "BYTES":
        return names_of(spec, values, shape)
    if len(values) != math.prod(shape):
        raise TensorError(f"{spec.name} {list(shape)} has {len(values)} values")
    array = np.asarray(values)
    dtype = DTYPES[spec.datatype]
    if dtype.kind == "u" and (array > np.iinfo(dtype).max).any():
        raise TensorError(f"{spec.name} has a value beyond {8 * dtype.itemsize} bits")
    return array.astype(DTYPES[spec.datatype]).reshape(shape)


def add_tensors(tensors: Any, raw: Any, arrays: Arrays, table: Sequence[TensorSpec]) -> None:
    """Put arrays into `inputs` and `raw_input_contents` of a message, or into its `outputs` and their contents."""
    for spec in table:
        if spec.name in arrays:
            values = arrays[spec.name]
            tensors.add(name=spec.name, datatype=spec.datatype, shape=values.shape)
            raw.append(pack(values, spec))
