"""The table of tensors: bytes as others write and read them, shapes, and answers that mean nothing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tritonclient.grpc import service_pb2
from tritonclient.utils import deserialize_bytes_tensor, np_to_triton_dtype, serialize_byte_tensor

from cabinpose.estimate.remote.messages import read_tensors
from cabinpose.estimate.remote.tensors import (
    DTYPES,
    INPUTS,
    OUTPUTS,
    TensorError,
    TensorSpec,
    bind_shape,
    pack,
    pose_batch,
    unpack,
)

TABLE = INPUTS + OUTPUTS
DEPTH, JOINTS_3D, NAMES = INPUTS[0], OUTPUTS[1], OUTPUTS[5]
ROOT = Path(__file__).resolve().parents[2]


def test_types_are_the_protocols() -> None:
    for name, dtype in DTYPES.items():
        assert np_to_triton_dtype(dtype) == name


@pytest.mark.parametrize("spec", TABLE, ids=[s.name for s in TABLE])
def test_bytes_are_tritons(spec: TensorSpec) -> None:
    shape = [n if isinstance(n, int) else 2 for n in spec.shape]
    rng = np.random.default_rng(1)
    if spec.datatype == "BYTES":
        values = np.array(["lhand", "Füße"], object)
        theirs = serialize_byte_tensor(values).item()
        assert [text.decode() for text in deserialize_bytes_tensor(pack(values, spec))] == ["lhand", "Füße"]
    else:
        values = rng.uniform(0, 100, shape).astype(DTYPES[spec.datatype])
        theirs = values.tobytes()
    assert pack(values, spec) == theirs
    np.testing.assert_array_equal(unpack(theirs, spec, shape), values)


def test_other_layouts_are_packed_in_c_order() -> None:
    values = np.arange(12, dtype=np.float64).reshape(1, 3, 4).transpose(0, 2, 1)
    np.testing.assert_array_equal(unpack(pack(values, DEPTH), DEPTH, (1, 4, 3)), values)


@pytest.mark.parametrize(
    ("datatype", "shape"),
    [
        ("FP64", [1, 48, 64]), ("FP32", [48, 64]), ("FP32", [1, 48, 64, 1]), ("FP32", [1, -1, 64]), ("FP32", [0, 48, 64]),
        ("FP32", [1, 2**40, 2**40]), ("FP32", [65, 48, 64]), ("FP32", [1, 47, 64]), ("FP32", []),
    ],
)  # fmt: skip
def test_other_types_and_shapes_are_refused(datatype: str, shape: list[int]) -> None:
    with pytest.raises(TensorError, match="depth is"):
        bind_shape(DEPTH, datatype, shape, {"H": 48})
    bind_shape(DEPTH, "FP32", [1, 48, 64], {"H": 48})


def test_sizes_hold_over_all_tensors() -> None:
    request = service_pb2.ModelInferRequest()
    request.inputs.add(name="depth", datatype="FP32", shape=[1, 4, 6])
    request.inputs.add(name="amplitude", datatype="UINT16", shape=[1, 4, 5])
    with pytest.raises(TensorError, match=r"amplitude is UINT16 .*not UINT16 .1, 4, 6."):
        read_tensors(request.inputs, [bytes(96), bytes(40)], INPUTS)


@pytest.mark.parametrize(
    ("tensors", "raw", "message"),
    [
        ([("depth", "FP32", [1, 2, 2])], [bytes(15)], "has 15 bytes, not 16"),
        ([("depth", "FP32", [1, 2, 2])], [bytes(16), b""], "more raw contents"),
        ([("depth", "FP32", [1, 2, 2]), ("points", "FP32", [1, 2, 2, 3])], [bytes(16)], "points has no raw contents"),
        ([("depth", "FP32", [1, 2, 2])] * 2, [bytes(16)] * 2, "there twice"),
        ([("weights", "FP32", [1])], [bytes(4)], "'weights' is unknown; known: depth, camera_k"),
        ([("depth", "FP32", [1, 2, 2])], [], "has 0 values"),
    ],
)
def test_messages_that_contradict_themselves(tensors: list[tuple[str, str, list[int]]], raw: list[bytes], message: str) -> None:
    request = service_pb2.ModelInferRequest()
    for name, datatype, shape in tensors:
        request.inputs.add(name=name, datatype=datatype, shape=shape)
    with pytest.raises(TensorError, match=message):
        read_tensors(request.inputs, raw, INPUTS)


def test_typed_contents_are_read_too() -> None:
    response = service_pb2.ModelInferResponse()
    response.outputs.add(name="joints_3d", datatype="FP32", shape=[1, 1, 1, 3]).contents.fp32_contents.extend([0.25, -1, 2])
    response.outputs.add(name="joint_names", datatype="BYTES", shape=[1]).contents.bytes_contents.append(b"head")
    found = read_tensors(response.outputs, response.raw_output_contents, OUTPUTS)
    np.testing.assert_array_equal(found["joints_3d"], np.float32([[[[0.25, -1, 2]]]]))
    assert found["joint_names"].tolist() == ["head"]
    request = service_pb2.ModelInferRequest()
    request.inputs.add(name="amplitude", datatype="UINT16", shape=[1, 1, 1]).contents.uint_contents.append(65536)
    with pytest.raises(TensorError, match="beyond 16 bits"):
        read_tensors(request.inputs, [], INPUTS)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x05\0\0\0head", "ends within a text"),
        (b"\x04\0\0\0head\x01\0", "ends within a text"),
        (b"\xff\xff\xff\xffhead", "ends within a text"),
        (b"\x01\0\0\0\xff", "not UTF-8"),
        (b"\x04\0\0\0head\x04\0\0\0head", "holds 2 names"),
        (b"\x00\0\0\0", "different, printable names"),
        (b"\x05\0\0\0he\x1bad", "different, printable names"),
    ],
)
def test_names_that_are_none(data: bytes, message: str) -> None:
    with pytest.raises(TensorError, match=message):
        unpack(data, NAMES, [1])


def _answer(**changes: object) -> dict[str, np.ndarray]:
    answer = {
        "joints_2d": np.full((1, 1, 2, 2), 7, np.float32), "joints_3d": np.ones((1, 1, 2, 3), np.float32),
        **{name: np.ones((1, 1, 2), np.float32) for name in ("score", "presence", "expected_error_m")},
    }  # fmt: skip
    for name, value in changes.items():
        if value is None:
            del answer[name]
        else:
            answer[name].reshape(-1)[-1 if np.ndim(value) == 0 else slice(None)] = value
    return answer


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints_3d": np.nan}, "lhand of driver: joints_3d is partly NaN or infinite"),
        ({"joints_2d": np.inf}, "lhand of driver: joints_2d is partly NaN or infinite"),
        ({"expected_error_m": -0.1}, "lhand of driver: expected_error_m is not a distance"),
        ({"presence": np.nan}, "lhand of driver: presence is not from 0 to 1"),
        ({"presence": 1.5}, "lhand of driver: presence is not from 0 to 1"),
        ({"presence": -0.1}, "lhand of driver: presence is not from 0 to 1"),
        ({"score": np.nan}, "lhand of driver: score is not finite"),
        ({"score": np.inf}, "lhand of driver: score is not finite"),
        ({"joints_2d": [np.nan] * 4, "joints_3d": [np.nan] * 6}, "head of driver: presence is above 0 and the position NaN"),
        ({"joints_2d": None, "joints_3d": None}, "neither joints_2d nor joints_3d"),
    ],
)
def test_answers_that_mean_nothing(changes: dict[str, object], message: str) -> None:
    with pytest.raises(TensorError, match=message):
        pose_batch(_answer(**changes), ["driver"], ["head", "lhand"])


def test_no_answer_is_an_answer_and_what_is_left_out_is_filled() -> None:
    nothing = _answer(joints_2d=[np.nan] * 4, joints_3d=[np.nan] * 6, presence=[0, 0], score=[np.nan, 2])
    found = pose_batch(nothing, ["driver"], ["head", "lhand"])
    assert np.isnan(found.joints_2d).all()
    assert found.score.tolist() == [[[0, 2]]]  # of what was not found it may be anything, or nothing
    flat = pose_batch(_answer(joints_3d=None, presence=None, score=None), ["driver"], ["head", "lhand"])
    assert np.isnan(flat.joints_3d).all()
    assert flat.presence.tolist() == flat.score.tolist() == [[[1, 1]]]
    with pytest.raises(TensorError, match="of 1 persons and 2 joints, not of 1 and 1"):
        pose_batch(_answer(), ["driver"], ["head"])


def test_the_page_has_the_table() -> None:
    page = (ROOT / "docs/algorithms.md").read_text("utf-8")
    lines = [[cell.strip(" `") for cell in m[0].strip("|").split("|")] for m in re.finditer(r"^\| `.*\|$", page, re.M)]
    rows = {name: rest for name, *rest in lines if len(rest) == 4}
    for spec in TABLE:
        shape = f"[{', '.join(map(str, spec.shape))}]"
        assert rows[spec.name] == [f"{spec.datatype} {shape}", spec.unit, "yes" if spec.required else "no", spec.meaning]
    assert list(rows) == [spec.name for spec in TABLE]
