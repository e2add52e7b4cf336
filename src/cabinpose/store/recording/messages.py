"""Messages of `signals.recorded` as records of a recording, and back, bit by bit the same.

A `ToFFrame` is written on up to five topics; `depth` is always there and comes last: it completes the frame.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from cabinpose.core import RecordingError
from cabinpose.signals import (
    ARRAYS,
    F64,
    FRAME_IMAGES,
    TOPICS,
    Channels,
    Facts,
    Markers,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    ToFFrame,
)
from cabinpose.store.recording.container import Buffer
from cabinpose.store.recording.schemas import FACTS, SourceStatus

WORLD = "world"
_DATA_TAG = bytes([6 << 3 | 2])  # field 6 of foxglove.RawImage, `data`, with its length before it
_FLOAT64 = PackedElementField.FLOAT64


@dataclass(frozen=True)
class Record:
    """One message of a topic: the last part of the topic's name, the name of its schema, its bytes in parts.

    about: facts that hold for all messages of the channel.
    """

    topic: str
    schema: str
    parts: tuple[Buffer, ...]
    about: tuple[tuple[str, str], ...] = ()


def encode(source: str, message: Message, host_ns: int) -> list[Record]:
    """The records of a message, in the order in which they are written.

    Image data are referred to, not copied. Raises RecordingError where arrays and names do not fit each other, or a value
    is of a kind that the schema has no place for.
    """
    try:
        return _ENCODERS[type(message)](source, message, host_ns)
    except (ValueError, TypeError, KeyError, OverflowError, AttributeError) as error:
        raise RecordingError(f"{source}: a {type(message).__name__} cannot be written: {error}") from error


def encode_json(values: Mapping[str, Any]) -> bytes:
    """Plain data as JSON bytes; ValueError for NaN and infinities, which JSON does not have."""
    return json.dumps(values, allow_nan=False, separators=(",", ":")).encode()


def encode_status(status: SourceStatus) -> bytes:
    """The bytes of a `SourceStatus`."""
    return encode_json(asdict(status))


class Decoder:
    """Turns the records of one source back into messages; keeps the parts of a frame until it is whole."""

    def __init__(self) -> None:
        self._parts: dict[str, Any] = {}

    def begin_sample(self) -> None:
        """Parts of a frame that never became whole are forgotten."""
        self._parts.clear()

    def __call__(self, topic: str, schema: str, about: Mapping[str, str], data: memoryview) -> Message | None:
        """The message that this record completes. Raises RecordingError where the bytes are not of the schema."""
        try:
            if topic in ("calibration", "amplitude_calibration"):
                self._parts[topic] = CameraCalibration.FromString(data)
            elif topic in FRAME_IMAGES:
                self._parts[topic] = _image(RawImage.FromString(data))
            elif topic == "depth":
                return self._frame(RawImage.FromString(data), about)
            elif topic == "poses":
                return _poses(FrameTransforms.FromString(data), about)
            elif (kind := _JSON_KINDS.get(schema)) is not None:
                return _from_json(kind, json.loads(bytes(data)))
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError, DecodeError) as error:
            raise RecordingError(f"a record on {topic} is not a {schema}: {error}") from error
        return None

    def _frame(self, depth: RawImage, about: Mapping[str, str]) -> ToFFrame:
        calibration, other = self._parts["calibration"], self._parts["amplitude_calibration"]
        frame = ToFFrame(
            depth=_image(depth),
            depth_unit_m=float(about["depth_unit_m"]),
            amplitude=self._parts.get("amplitude", np.zeros((0, 0), np.uint16)),
            confidence=self._parts.get("confidence", np.zeros((0, 0), np.uint8)),
            camera_k=np.array(calibration.K, np.float64).reshape(3, 3),
            camera_dist=np.array(calibration.D, np.float64),
            amplitude_dist=np.array(other.D, np.float64),
            **{name: self._parts[name] for name in ("noise", "balance") if name in self._parts},
        )
        self._parts.clear()
        return frame


def decode_status(data: memoryview) -> SourceStatus:
    """A `SourceStatus`; RecordingError where the bytes are none."""
    try:
        values = json.loads(bytes(data))
        # Files of earlier versions lack the later fields, which have defaults.
        return SourceStatus(**{field.name: values[field.name] for field in fields(SourceStatus) if field.name in values})
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise RecordingError(f"a record on status is no SourceStatus: {error}") from error


def decode_facts(data: memoryview) -> Facts | None:
    """Facts as a recording has them; None where they are damaged."""
    try:
        facts = json.loads(bytes(data))
        return Facts(str(facts["about"]), facts["values"]) if isinstance(facts["values"], dict) else None
    except (ValueError, TypeError, KeyError, RecursionError):
        return None


def sample_bytes(messages: Sequence[Message]) -> int:
    """Bytes that messages hold in memory, about."""
    total = 0
    for message in messages:
        total += 256 + sum(value.nbytes for value in vars(message).values() if isinstance(value, np.ndarray))
    return total


# -------------------------------------------------------------------------------------------------------- Foxglove's


def _time(host_ns: int) -> Timestamp:
    return Timestamp(seconds=host_ns // 1_000_000_000, nanos=host_ns % 1_000_000_000)


def _encode_poses(source: str, message: SegmentPoses, host_ns: int) -> list[Record]:
    count = len(message.names)
    position = _checked(message.position_m, (count, 3), "position_m")
    orientation = _checked(message.orientation_wxyz, (count, 4), "orientation_wxyz")
    prefix = f"{source}/{message.subject}/" if message.subject else f"{source}/"
    time, transforms = _time(host_ns), []
    for name, (x, y, z), (qw, qx, qy, qz) in zip(message.names, position.tolist(), orientation.tolist(), strict=True):
        transform = FrameTransform(timestamp=time, parent_frame_id=WORLD, child_frame_id=prefix + name)
        translation, rotation = transform.translation, transform.rotation
        translation.x, translation.y, translation.z = x, y, z
        rotation.x, rotation.y, rotation.z, rotation.w = qx, qy, qz, qw
        transforms.append(transform)
    data = FrameTransforms(transforms=transforms).SerializeToString()
    return [Record("poses", "foxglove.FrameTransforms", (data,), (("subject", message.subject), ("prefix", prefix)))]


def _poses(message: FrameTransforms, about: Mapping[str, str]) -> SegmentPoses:
    skipped = len(about["prefix"])
    position = [(t.translation.x, t.translation.y, t.translation.z) for t in message.transforms]
    orientation = [(t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z) for t in message.transforms]
    return SegmentPoses(
        subject=about["subject"],
        names=tuple(t.child_frame_id[skipped:] for t in message.transforms),
        position_m=np.array(position, np.float64).reshape(-1, 3),
        orientation_wxyz=np.array(orientation, np.float64).reshape(-1, 4),
    )


def _encode_frame(source: str, message: ToFFrame, host_ns: int) -> list[Record]:
    depth, k = message.depth, _checked(message.camera_k, (3, 3), "camera_k")
    named: dict[str, NDArray[Any]] = {name: getattr(message, name) for name in FRAME_IMAGES}
    for name, image in named.items():
        if image.shape not in (depth.shape, (0, 0)) and depth.size:
            raise ValueError(f"{name} is {image.shape}, depth {depth.shape}")
    time, records = _time(host_ns), []
    for topic, dist in (("calibration", message.camera_dist), ("amplitude_calibration", message.amplitude_dist)):
        height, width = (depth if depth.size else message.amplitude).shape
        calibration = CameraCalibration(
            timestamp=time, frame_id=source, width=width, height=height, distortion_model="plumb_bob",
            D=_checked(dist, (5,), topic).tolist(), K=k.ravel().tolist(), R=np.eye(3).ravel().tolist(),
            P=np.column_stack((k, np.zeros(3))).ravel().tolist(),
        )  # fmt: skip
        records.append(Record(topic, "foxglove.CameraCalibration", (calibration.SerializeToString(),)))
    for name, image in named.items():
        if image.shape != (0, 0):
            records.append(_image_record(source, name, image, "mono8" if name == "confidence" else "mono16", time))
    unit = (("depth_unit_m", repr(float(message.depth_unit_m))),)
    records.append(_image_record(source, "depth", depth, "16UC1", time, unit))
    return records


_PIXEL: Mapping[str, np.dtype[Any]] = {"16UC1": np.dtype("<u2"), "mono16": np.dtype("<u2"), "mono8": np.dtype("u1")}


def _image_record(
    source: str, topic: str, image: NDArray[Any], encoding: str, time: Timestamp, about: tuple[tuple[str, str], ...] = ()
) -> Record:
    dtype = _PIXEL[encoding]
    if image.ndim != 2 or image.dtype.newbyteorder("<") != dtype:
        raise ValueError(f"{topic} is {image.dtype} of shape {image.shape}")
    pixels = np.ascontiguousarray(image, dtype)
    height, width = image.shape
    head = RawImage(
        timestamp=time, frame_id=source, width=width, height=height, encoding=encoding, step=width * dtype.itemsize
    ).SerializeToString()
    if not pixels.size:
        return Record(topic, "foxglove.RawImage", (head,), about)
    # The last field of a protobuf message may follow the others as bytes: so the image is not copied.
    data: Buffer = memoryview(pixels.data).cast("B")
    return Record(topic, "foxglove.RawImage", (head + _DATA_TAG + _varint(pixels.nbytes), data), about)


def _image(message: RawImage) -> NDArray[Any]:
    return np.frombuffer(message.data, _PIXEL[message.encoding]).reshape(message.height, message.width).copy()


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 127:
        encoded.append(value & 127 | 128)
        value >>= 7
    return bytes([*encoded, value])


# -------------------------------------------------------------------------------------------------------------- JSON

_JSON = tuple(kind for kind in TOPICS if kind is not SegmentPoses)  # poses have a schema of Foxglove's
_OPTIONAL = (SegmentKinematics, SensorReadings)  # whose arrays may be empty
_JSON_KINDS: Mapping[str, type] = {f"cabinpose.{kind.__name__}": kind for kind in _JSON}


def _encode_table(_: str, message: Any, host_ns: int) -> list[Record]:
    kind = type(message)
    values: dict[str, Any] = {} if kind is Channels else {"subject": _word(message.subject)}
    values["names"] = [_word(name) for name in message.names]
    for name, width in ARRAYS[kind].items():
        array = np.asarray(getattr(message, name), np.float64)
        rows = 0 if kind in _OPTIONAL and len(array) == 0 else len(message.names)
        values[name] = _numbers(_checked(array, (rows, width) if width else (rows,), name))
    records = [Record(TOPICS[kind], f"cabinpose.{kind.__name__}", (encode_json(values),))]
    return records if kind is not Markers else [*records, _cloud(message, host_ns)]


def _cloud(message: Markers, host_ns: int) -> Record:
    """The markers as what Foxglove and Rerun draw; nothing that the JSON beside it does not say better."""
    cloud = PointCloud(timestamp=_time(host_ns), frame_id=WORLD, point_stride=24, data=message.position_m.astype("<f8").tobytes())
    cloud.pose.position.SetInParent()  # zeros, but there: Rerun takes a pose without a position as damaged
    cloud.pose.orientation.w = 1.0
    for i, axis in enumerate("xyz"):
        cloud.fields.append(PackedElementField(name=axis, offset=8 * i, type=_FLOAT64))
    return Record("markers_cloud", "foxglove.PointCloud", (cloud.SerializeToString(),))


def _encode_facts(_: str, message: Facts, __: int) -> list[Record]:
    return [Record(FACTS, "cabinpose.Facts", (encode_json({"about": _word(message.about), "values": dict(message.values)}),))]


def _from_json(kind: type, values: Mapping[str, Any]) -> Any:
    if kind is Facts:
        return Facts(values["about"], values["values"])
    arrays = {name: _array(values[name], width) for name, width in ARRAYS[kind].items()}
    names = tuple(values["names"])
    return Channels(names, **arrays) if kind is Channels else kind(values["subject"], names, **arrays)


def _word(value: str) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    value.encode()  # text that is not Unicode is refused here, not by the reader
    return value


def _numbers(array: F64) -> list[Any]:
    if np.isfinite(array).all():
        return array.tolist()
    plain = [_number(value) for value in array.ravel().tolist()]
    if array.ndim == 1:
        return plain
    width = array.shape[1]
    return [plain[i : i + width] for i in range(0, len(plain), width)]


def _number(value: float) -> float | str | None:
    if value != value:
        return None
    return value if abs(value) != float("inf") else ("Infinity" if value > 0 else "-Infinity")


def _array(values: Sequence[Any], width: int) -> F64:
    flat = [item for row in values for item in row] if width else list(values)
    array = np.array([np.nan if item is None else float(item) for item in flat], np.float64)
    return array.reshape(-1, width) if width else array


def _checked(array: F64, shape: tuple[int, ...], name: str) -> F64:
    array = np.asarray(array, np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, not {shape}")
    return array


_ENCODERS: Mapping[type, Callable[[str, Any, int], list[Record]]] = {
    **dict.fromkeys(ARRAYS, _encode_table),
    SegmentPoses: _encode_poses,
    ToFFrame: _encode_frame,
    Facts: _encode_facts,
}
