"""The tensors that a detector takes and gives on the wire: one table, and the checks of what arrived against it.

docs/algorithms.md holds the same table for whoever writes an algorithm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import PoseBatch

Arrays = Mapping[str, NDArray[Any]]

PLATFORM = "cabinpose_pose_"  # what a model's metadata may give as its platform, with the version of this table behind it
VERSION = 1
DTYPES: dict[str, np.dtype[Any]] = {
    "FP32": np.dtype("<f4"),
    "FP64": np.dtype("<f8"),
    "UINT16": np.dtype("<u2"),
    "UINT8": np.dtype("u1"),
    "BYTES": np.dtype(object),
}
MOST = {"N": 64, "H": 8192, "W": 8192, "P": 64, "J": 256, "R": 64}  # greatest sizes, checked before any memory is asked for
_LONGEST_NAME, _LONGEST_SENTENCE = 64, 500


class TensorError(ValueError):
    """A tensor is not as the table has it; the message names the tensor."""


@dataclass(frozen=True)
class TensorSpec:
    """One tensor. shape: numbers, or the letters of `MOST`, which mean the same size in all tensors of a message."""

    name: str
    datatype: str
    shape: tuple[int | str, ...]
    unit: str
    required: bool
    meaning: str


INPUTS = (  # tensors of a batch of frames that a model on a server may take
    TensorSpec("depth", "FP32", ("N", "H", "W"), "m", True, "z along the optical axis, NaN where the camera saw nothing"),
    TensorSpec("camera_k", "FP64", ("N", 3, 3), "px", True, "intrinsics; an integer pixel is a pixel's centre"),
    TensorSpec("camera_dist", "FP64", ("N", 5), "1", False, "OpenCV's distortion k1 k2 p1 p2 k3"),
    TensorSpec("amplitude", "UINT16", ("N", "H", "W"), "camera's", False, "active infrared light"),
    TensorSpec("confidence", "UINT8", ("N", "H", "W"), "camera's", False, "the camera's confidence in its depth"),
    TensorSpec("noise", "UINT16", ("N", "H", "W"), "µm", False, "the camera's own sigma of its depth, 0: unknown"),
    TensorSpec("depth_styled", "FP32", ("N", "H", "W"), "m", False, "style-transferred depth, NaN where there is none"),
    TensorSpec("labels", "UINT8", ("N", "H", "W"), "class", False, "the true class of each pixel, by the dataset's table"),
    TensorSpec("rgb", "UINT8", ("N", "H", "W", 3), "sRGB", False, "colour image of the same camera"),
    TensorSpec("nir", "UINT16", ("N", "H", "W"), "electrons", False, "near-infrared image of the same camera"),
    TensorSpec("cloud", "FP32", ("N", "H", "W", 3), "m", False, "each pixel's point in the camera frame, NaN where depth is"),
    TensorSpec("points", "FP32", ("N", "H", "W", 3), "m", False, "older name of cloud"),
)
USUAL = ("depth", "camera_k", "camera_dist", "amplitude")  # what a model gets that does not say what it takes
OUTPUTS = (  # tensors that it may answer with
    TensorSpec("joints_2d", "FP32", ("N", "P", "J", 2), "px", False, "u, v in the frame's image; NaN: no answer"),
    TensorSpec("joints_3d", "FP32", ("N", "P", "J", 3), "m", False, "x, y, z in the camera frame; NaN: no answer"),
    TensorSpec("score", "FP32", ("N", "P", "J"), "any", False, "confidence, more is better; left out: the presence"),
    TensorSpec("presence", "FP32", ("N", "P", "J"), "0 to 1", False, "probability that the joint is in the image; left out: 1"),
    TensorSpec("expected_error_m", "FP32", ("N", "P", "J"), "m", False, "mean 3D error of such joints; NaN: not known"),
    TensorSpec("person_names", "BYTES", ("P",), "", False, "seats such as driver; left out: named in the address"),
    TensorSpec("joint_names", "BYTES", ("J",), "", False, "joints such as lhand; left out: named in the address"),
    TensorSpec("reason", "BYTES", ("N",), "", False, "why nobody can be seen, or empty; only to those who ask for it"),
    TensorSpec("remarks", "BYTES", ("R",), "", False, "what stood out in the frames, or one empty; only to those who ask for it"),
)
SENTENCES = ("reason", "remarks")  # outputs for those who ask for them


def bind_shape(spec: TensorSpec, datatype: str, shape: Sequence[int], sizes: dict[str, int]) -> None:
    """Check a tensor's type and shape; `sizes` learns what its letters stand for. Raises TensorError."""
    wanted = f"{spec.datatype} [{', '.join(str(sizes.get(str(n), n)) for n in spec.shape)}]"
    fits = datatype == spec.datatype and len(shape) == len(spec.shape)
    for length, name in zip(shape, spec.shape if fits else ()):  # noqa: B905 - nothing to compare where the ranks differ
        if isinstance(name, str) and 0 < length <= MOST[name]:
            fits &= sizes.setdefault(name, int(length)) == length
        else:
            fits &= length == name
    if not fits:
        raise TensorError(f"{spec.name} is {datatype} {[int(n) for n in shape][:8]}, not {wanted}")


def pack(values: NDArray[Any], spec: TensorSpec) -> bytes:
    """The bytes of a tensor: little-endian in C order, for names the length (uint32) before each text in UTF-8."""
    if spec.datatype == "BYTES":
        texts = [str(name).encode() for name in values.ravel()]
        return b"".join(len(text).to_bytes(4, "little") + text for text in texts)
    return np.ascontiguousarray(values, DTYPES[spec.datatype]).tobytes()


def unpack(data: bytes | memoryview | bytearray, spec: TensorSpec, shape: Sequence[int]) -> NDArray[Any]:
    """The array that the bytes hold, a view of them where it is of numbers. Raises TensorError for another length."""
    if spec.datatype == "BYTES":
        return names_of(spec, _texts(spec, bytes(data)), shape)
    dtype, count = DTYPES[spec.datatype], math.prod(shape)
    if len(data) != count * dtype.itemsize:
        raise TensorError(f"{spec.name} {[int(n) for n in shape]} has {len(data)} bytes, not {count * dtype.itemsize}")
    return np.frombuffer(data, dtype).reshape(shape)


def names_of(spec: TensorSpec, texts: Sequence[bytes], shape: Sequence[int]) -> NDArray[Any]:
    """Names that came one by one. Raises TensorError where there are not as many as the shape says, or for bad ones."""
    try:
        names = [bytes(text).decode() for text in texts]
    except UnicodeDecodeError:
        raise TensorError(f"{spec.name} holds a text that is not UTF-8") from None
    if [len(names)] != list(shape):
        raise TensorError(f"{spec.name} {[int(n) for n in shape]} holds {len(names)} names")
    if spec.name in SENTENCES:
        if not all((not n or n.isprintable()) and len(n) <= _LONGEST_SENTENCE for n in names):
            raise TensorError(f"{spec.name} are not printable texts of up to {_LONGEST_SENTENCE} letters")
        return np.array(names, object)
    if len(set(names)) < len(names) or not all(n.isprintable() and 0 < len(n) <= _LONGEST_NAME for n in names):
        raise TensorError(f"{spec.name} are not different, printable names of up to {_LONGEST_NAME} letters")
    return np.array(names, object)


def _texts(spec: TensorSpec, data: bytes) -> list[bytes]:
    texts, at = [], 0
    while at < len(data):
        start = at + 4
        at = start + int.from_bytes(data[at:start], "little")
        if at > len(data) or start > len(data):
            raise TensorError(f"{spec.name} ends within a text")
        texts.append(data[start:at])
    return texts


def pose_batch(answer: Arrays, persons: Sequence[str], joints: Sequence[str]) -> PoseBatch:
    """An answer's joints. Raises TensorError for numbers that mean nothing, naming the person and the joint.

    A joint without a position has presence 0; a position is whole (all of its numbers finite) or missing (all NaN).
    """
    positions = {name: answer[name] for name in ("joints_2d", "joints_3d") if name in answer}
    if not positions:
        raise TensorError("there is neither joints_2d nor joints_3d")
    shape = next(iter(positions.values())).shape[:-1]
    if shape[1:] != (len(persons), len(joints)):
        raise TensorError(f"joints are of {shape[1]} persons and {shape[2]} joints, not of {len(persons)} and {len(joints)}")
    found = np.zeros(shape, bool)
    for name, values in positions.items():
        whole, none = np.isfinite(values).all(axis=-1), np.isnan(values).all(axis=-1)
        _refuse(np.logical_not(whole | none), f"{name} is partly NaN or infinite", persons, joints)
        found |= whole
    presence = answer.get("presence", found.astype(np.float32))
    _refuse(~((presence >= 0) & (presence <= 1)), "presence is not from 0 to 1", persons, joints)
    _refuse((presence > 0) & ~found, "presence is above 0 and the position NaN", persons, joints)
    score = answer.get("score", presence)
    score = np.where(np.isnan(score) & ~found, np.float32(0), score)  # nothing was found that it could be of
    _refuse(~np.isfinite(score), "score is not finite", persons, joints)
    expected = answer.get("expected_error_m", np.full(shape, np.nan, np.float32))
    _refuse((expected < 0) | np.isinf(expected), "expected_error_m is not a distance", persons, joints)
    two, three = (positions.get(f"joints_{n}d", np.full((*shape, n), np.nan, np.float32)) for n in (2, 3))
    reason = answer.get("reason", np.full(shape[:1], "", object))
    remarks = tuple(filter(None, answer.get("remarks", ())))
    return PoseBatch(two, three, score, presence, expected_error_m=expected, reason=reason, remarks=remarks)


def _refuse(wrong: NDArray[np.bool_], what: str, persons: Sequence[str], joints: Sequence[str]) -> None:
    if wrong.any():
        _, p, j = np.argwhere(wrong)[0]
        raise TensorError(f"{joints[j]} of {persons[p]}: {what}")
