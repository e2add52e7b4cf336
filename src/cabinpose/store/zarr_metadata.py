"""The `zarr.json` files of a part, as the Zarr v3 specification describes arrays and groups.

Written here rather than by the Zarr library, whose import takes as long as the rest of a first frame; `tests/store` compare them
with the library's own, byte by byte.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from cabinpose.core import OTHER_SKELETONS
from cabinpose.store.schema import Manifest, checksum, variable_attributes
from cabinpose.store.shard import FRAMES_PER_SHARD, LEVEL
from cabinpose.store.variables import joint_dimension, joints_variable

_FILL: dict[str, float | str] = {"U": "", "f": "NaN", "u": 0, "i": 0}  # by numpy's kind of type
_CHECKSUM = {"name": "crc32c"}


@dataclass(frozen=True)
class ZarrArray:
    """One array of a part as its Zarr metadata describes it; hashable, so that equal parts share its text.

    dtype: a numpy name, or "str".
    """

    name: str
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: str
    attrs: tuple[tuple[str, Any], ...]

    @property
    def is_image(self) -> bool:
        return "y" in self.dims


def zarr_arrays(manifest: Manifest, frames: int) -> tuple[ZarrArray, ...]:
    """The arrays of a part that holds so many frames."""
    arrays = [ZarrArray("frame", ("frame",), (frames,), "int64", (("long_name", "index of the frame in the dataset"),))]
    arrays += [ZarrArray(dim, (dim,), (len(labels),), "str", ()) for dim, labels in dimension_labels(manifest).items()]
    for variable in manifest.stored:
        attrs = variable_attributes(manifest, variable)
        if variable.scale is not None:
            attrs |= {"scale_factor": variable.scale, "_FillValue": 0}
        shape = (frames, *manifest.frame_shape(variable))
        arrays.append(ZarrArray(variable.name, variable.dims, shape, variable.dtype, tuple(attrs.items())))
    return tuple(arrays)


def dimension_labels(manifest: Manifest) -> dict[str, tuple[str, ...]]:
    """The names along the dimensions that have some."""
    beside = [each for each in OTHER_SKELETONS if joints_variable(each.name) in manifest.variables]
    return {"person": manifest.persons, "joint": manifest.joints} | {joint_dimension(each.name): each.joints for each in beside}


@lru_cache(maxsize=256)
def array_json(array: ZarrArray) -> str:
    """The `zarr.json` of one array."""
    return json.dumps(_described(array), indent=2)


def group_json(arrays: tuple[ZarrArray, ...], attributes: Mapping[str, Any]) -> str:
    """The `zarr.json` of the group, with a copy of that of its arrays, so that a reader opens one file.

    The attribute `checksum`, which is given empty, becomes that of the text with it empty.
    """
    own = json.dumps(attributes, indent=1).replace("\n", "\n ")
    text = _group_json(arrays).replace("null", own, 1)
    return text.replace('"checksum": ""', f'"checksum": "{checksum(text)}"', 1)


def describes(found: Any, array: ZarrArray) -> bool:
    """Whether metadata read from a part are of this array and its classes; other attributes may be worded anew."""
    expected = _described(array)
    try:
        return all(found[key] == expected[key] for key in ("shape", "data_type", "dimension_names")) and all(
            found["attributes"][key] == (list(value) if isinstance(value, tuple) else value)
            for key, value in array.attrs
            if key.startswith("flag_")
        )
    except (KeyError, TypeError):
        return False


@lru_cache(maxsize=16)
def _group_json(arrays: tuple[ZarrArray, ...]) -> str:
    """The same with a null, the first one, in place of the group's own attributes."""
    group = {
        "attributes": None,
        "zarr_format": 3,
        "consolidated_metadata": {
            "kind": "inline",
            "must_understand": False,
            "metadata": {array.name: _described(array) for array in sorted(arrays, key=lambda array: array.name)},
        },
        "node_type": "group",
    }
    return json.dumps(group, indent=1)


def _described(array: ZarrArray) -> dict[str, Any]:
    """The metadata of one array: images in shards of one frame a chunk, everything else in one chunk."""
    whole = list(array.shape)
    codecs = _chunk_codecs(array.dtype)
    if array.is_image:
        whole[0] = FRAMES_PER_SHARD
        sharding = {
            "chunk_shape": [1, *array.shape[1:]],
            "codecs": codecs,
            "index_codecs": [_bytes(8), _CHECKSUM],
            "index_location": "end",
        }
        codecs = [{"name": "sharding_indexed", "configuration": sharding}]
    return {
        "shape": list(array.shape),
        "data_type": "string" if array.dtype == "str" else array.dtype,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": whole}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": _FILL[np.dtype(array.dtype).kind],
        "codecs": codecs,
        "attributes": dict(array.attrs),
        "dimension_names": list(array.dims),
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }


def _chunk_codecs(dtype: str) -> list[dict[str, Any]]:
    """What `store.shard.compressed` does to a chunk."""
    size = 1 if dtype == "str" else np.dtype(dtype).itemsize
    first = {"name": "vlen-utf8", "configuration": {}} if dtype == "str" else _bytes(size)
    blosc = {"typesize": size, "cname": "lz4", "clevel": LEVEL, "shuffle": "bitshuffle", "blocksize": 0}
    return [first, {"name": "blosc", "configuration": blosc}, _CHECKSUM]


def _bytes(item_size: int) -> dict[str, Any]:
    """Numbers as little-endian bytes; a single byte has no order."""
    return {"name": "bytes"} | ({"configuration": {"endian": "little"}} if item_size > 1 else {})
