"""Recordings as ADTF files (`.adtfdat`), and ADTF files as messages.

Written, a source has a stream for each kind of message, subject and set of names, `<source>.<kind>`. Numbers are samples of
`adtf/default` whose structure a media description tells (host_ns, device_ns, sequence, then arrays of tFloat64), so that ADTF
and the tools around it decode them; what they mean is in the stream's properties. Facts, markers without labels and
camera frames are `adtf/anonymous`: JSON, for frames followed by the images. The file's time begins with its first sample.

Read by the vendor's package (`adtf`, module `adtf_file`): ours come back as they were; of other files, the numbers of every
sample that its media description decodes, as channels named by their place in it. The package tells times in microseconds.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import RecordingError
from cabinpose.core.optional import optional_module
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import (
    Channels,
    Facts,
    JointAngles,
    Markers,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    ToFFrame,
)
from cabinpose.store.convert.adtfdat_write import IndexedFileWriter
from cabinpose.store.convert.apart import CrashedError, items_apart
from cabinpose.store.convert.rows import whole_file

_KINDS: Mapping[str, tuple[type[Any], tuple[tuple[str, int], ...]]] = {
    "poses": (SegmentPoses, (("position_m", 3), ("orientation_wxyz", 4))),
    "kinematics": (
        SegmentKinematics,
        (("velocity", 3), ("acceleration", 3), ("angular_velocity", 3), ("angular_acceleration", 3)),
    ),
    "sensors": (
        SensorReadings,
        (("orientation_wxyz", 4), ("acceleration", 3), ("angular_velocity", 3), ("magnetic_field", 3)),
    ),
    "joint_angles": (JointAngles, (("angles", 3),)),
    "markers": (Markers, (("position_m", 3), ("residual_m", 1))),
    "channels": (Channels, (("values", 1),)),
}
_IMAGES = ("depth", "amplitude", "confidence")
_LENS = ("camera_k", "camera_dist", "amplitude_dist")
_UNKNOWN = -(1 << 63)  # of device_ns and sequence
_STAMPS = ("host_ns", "device_ns", "sequence")
_MOST_LEAVES = 10_000
Stamped = tuple[str, int, int | None, int | None, Message]  # stream, host_ns, device_ns, sequence, message


@dataclass(frozen=True)
class _Described:
    """A message of numbers as a structure: its kind, subject, names, and arrays by field."""

    kind: str
    subject: str
    names: tuple[str, ...]
    arrays: tuple[tuple[str, NDArray[np.float64]], ...]

    @property
    def key(self) -> tuple[Any, ...]:
        return self.kind, self.subject, self.names, tuple((name, array.size) for name, array in self.arrays)


def write_adtfdat(path: Path, samples: Iterable[tuple[str, Sample]], *, overwrite: bool = False) -> Path:
    """Write the samples of a recording (`Recording.samples()`); the file appears when it is whole.

    Raises RecordingError where it exists or cannot be written, or has more streams than ADTF's format takes (511).
    """
    with whole_file(path, overwrite=overwrite, binary=True) as file:
        writer: IndexedFileWriter | None = None
        streams: dict[tuple[Any, ...], int] = {}
        numbers: dict[str, int] = {}
        begin_ns = 0
        for source, sample in samples:
            if writer is None:
                begin_ns = sample.host_ns
                writer = IndexedFileWriter(file, created_s=begin_ns // 1_000_000_000, description="cabinpose recording")
            stamps = (sample.host_ns, _or_unknown(sample.device_ns), _or_unknown(sample.sequence))
            for message in sample.messages:
                described = _described(message)
                kind = described.kind if described is not None else _plain_kind(message)
                key = (source, *(described.key if described is not None else (kind,)))
                try:
                    if key not in streams:
                        numbers[f"{source}.{kind}"] = number = numbers.get(f"{source}.{kind}", 0) + 1
                        name = f"{source}.{kind}{f'-{number}' if number > 1 else ''}"
                        streams[key] = writer.stream(name, *_stream_type(source, kind, described))
                    data = _plain(message, stamps) if described is None else _structure(described, stamps)
                    writer.sample(streams[key], max(sample.host_ns - begin_ns, 0), data)
                except ValueError as error:
                    hint = "choose fewer sources, or those whose names stay the same"
                    raise RecordingError(f"ADTF's format cannot hold {error}", hint=hint) from error
        if writer is None:
            writer = IndexedFileWriter(file)
        writer.close()
    return path


def read_adtfdat(path: Path) -> Iterator[Stamped]:
    """(stream, host_ns, device_ns, sequence, message) in the order of the file, after facts on each stream.

    Times and sequence are as they were written; of other files, both times are the file's, and there is no sequence.
    Raises DependencyError without the package `adtf`, RecordingError where the file cannot be read.
    """
    _adtf_file()  # an error of its own where it is missing
    if not path.is_file():
        raise RecordingError(f"{path} does not exist", hint="check the path")
    try:
        yield from items_apart(_read, path)
    except (CrashedError, RuntimeError) as error:
        raise RecordingError(f"{path} is no whole ADTF file: {error}", hint="copy or record it again") from error


def _adtf_file() -> Any:
    return optional_module("adtf_file", purpose="an ADTF file", hint="pip install adtf (Linux and Windows, 64 bits)")


def _read(path: Path) -> Iterator[Stamped]:
    """As `read_adtfdat`. The package trusts the file: to be called in a process of its own."""
    adtf_file = _adtf_file()
    reader = adtf_file.create_reader(str(path))
    streams: dict[int, _Stream] = {}
    for stream in reader.streams:
        streams[stream.stream_id] = found = _Stream(adtf_file, stream)
        yield found.name, 0, None, None, found.facts
    while (item := reader.get_next_item()) is not None:
        if item.type == adtf_file.ItemType.Sample and item.stream_id in streams:
            found = streams[item.stream_id]
            message = found.message(item.sample)
            if message is not None:
                yield found.name, *message


class _Stream:
    """A stream that is read: what makes messages of its samples."""

    def __init__(self, adtf_file: Any, stream: Any) -> None:
        kind = stream.initial_type
        properties = {name: value.value for name, value in kind.properties.items()}
        self.name = str(properties.get("cabinpose_source") or stream.name)
        self._kind = properties.get("cabinpose_kind")
        self._subject = properties.get("cabinpose_subject", "")
        self._names = tuple(str(name) for name in json.loads(properties.get("cabinpose_names", "[]")))
        self._decoder = adtf_file.SampleDecoder(kind)
        about = {"stream": str(stream.name), "meta_type": str(kind.meta_type), "samples": int(stream.item_count)}
        self.facts = Facts("adtf stream", about | {"properties": properties})

    def message(self, sample: Any) -> tuple[int, int | None, int | None, Message] | None:
        """host_ns, device_ns, sequence and message; None for a sample of others that is not described."""
        if self._kind in {"facts", "frames", "unlabelled"}:
            return _from_plain(self._kind, bytes(sample.buffer))
        decoded = self._decoder.decode(sample)
        if self._kind in _KINDS:
            return self._ours(decoded)
        leaves = dict(_leaves(decoded))
        if not leaves:
            return None
        time_ns = round(sample.time_stamp.total_seconds() * 1e6) * 1000
        return time_ns, time_ns, None, Channels(tuple(leaves), np.array(list(leaves.values()), dtype=np.float64))

    def _ours(self, decoded: Any) -> tuple[int, int | None, int | None, Message]:
        kind, fields = _KINDS[str(self._kind)]
        stamps = int(decoded.host_ns), _known(int(decoded.device_ns)), _known(int(decoded.sequence))
        arrays = {}
        for name, width in fields:
            values = np.atleast_1d(np.asarray(getattr(decoded, name, ()), dtype=np.float64))
            arrays[name] = values if width == 1 else values.reshape(-1, width)
        subject = {} if kind is Channels else {"subject": self._subject}
        return *stamps, kind(names=self._names, **subject, **arrays)


def _described(message: Message) -> _Described | None:
    """Messages of numbers; None for those without fixed names."""
    if isinstance(message, (Facts, ToFFrame)) or (isinstance(message, Markers) and not message.subject):
        return None
    kind, (_, fields) = next((k, v) for k, v in _KINDS.items() if isinstance(message, v[0]))
    arrays = [(name, np.asarray(getattr(message, name), dtype=np.float64)) for name, _ in fields]
    given = tuple((name, array) for name, array in arrays if array.size)
    return _Described(kind, getattr(message, "subject", ""), message.names, given)


def _plain_kind(message: Message) -> str:
    return "facts" if isinstance(message, Facts) else "frames" if isinstance(message, ToFFrame) else "unlabelled"


def _stream_type(source: str, kind: str, described: _Described | None) -> tuple[str, dict[str, tuple[str, str]]]:
    """The meta type and properties of a stream."""
    about = {"cabinpose_source": ("cString", source), "cabinpose_kind": ("cString", kind)}
    if described is None:
        return "adtf/anonymous", about
    about["cabinpose_subject"] = ("cString", described.subject)
    about["cabinpose_names"] = ("cString", json.dumps(described.names))
    return "adtf/default", about | {
        "md_struct": ("cString", "Message"),
        "md_definitions": ("cString", _media_description(described)),
        "md_data_serialized": ("tBool", "false"),
    }


def _media_description(described: _Described) -> str:
    """The structure of a stream's samples in ADTF's description language (DDL)."""
    fields = [(name, "tInt64", 1) for name in _STAMPS] + [(name, "tFloat64", array.size) for name, array in described.arrays]
    elements, at = [], 0
    for name, kind, size in fields:
        elements.append(f'<element alignment="1" arraysize="{size}" byteorder="LE" bytepos="{at}" name="{name}" type="{kind}"/>')
        at += 8 * size
    return (
        '<?xml version="1.0" encoding="iso-8859-1" standalone="no"?><adtf:ddl xmlns:adtf="adtf"><header>'
        "<language_version>4.00</language_version><author>cabinpose</author><date_creation>20200101</date_creation>"
        "<date_change>20200101</date_change><description>a message</description></header><units/><datatypes>"
        '<datatype description="predefined" name="tInt64" size="64"/>'
        '<datatype description="predefined" name="tFloat64" size="64"/>'
        f'</datatypes><enums/><structs><struct alignment="1" name="Message" version="1">{"".join(elements)}</struct></structs>'
        "<streams/></adtf:ddl>"
    )


def _structure(described: _Described, stamps: Sequence[int]) -> bytes:
    parts = [struct.pack("<3q", *stamps), *(np.asarray(array, dtype="<f8").tobytes() for _, array in described.arrays)]
    return b"".join(parts)


def _plain(message: Message, stamps: Sequence[int]) -> bytes:
    """JSON with its length, then images."""
    head: dict[str, Any] = dict(zip(_STAMPS, stamps, strict=True))
    images: list[bytes] = []
    if isinstance(message, Facts):
        head |= {"about": message.about, "values": dict(message.values)}
    elif isinstance(message, Markers):
        place, residual = (_none_for_nan(values) for values in (message.position_m, message.residual_m))
        head |= {"names": message.names, "position_m": place, "residual_m": residual}
    elif isinstance(message, ToFFrame):
        head |= {name: getattr(message, name).tolist() for name in _LENS} | {"depth_unit_m": message.depth_unit_m}
        head["shapes"] = {name: getattr(message, name).shape for name in _IMAGES}
        images = [np.ascontiguousarray(getattr(message, name)).astype(_dtype(name)).tobytes() for name in _IMAGES]
    text = json.dumps(head).encode()
    return struct.pack("<I", len(text)) + text + b"".join(images)


def _none_for_nan(values: NDArray[np.float64]) -> Any:
    """Plain lists with None for NaN, which JSON does not have."""
    return np.where(np.isfinite(values), values.astype(object), np.array(None, dtype=object)).tolist()


def _from_plain(kind: str, data: bytes) -> tuple[int, int | None, int | None, Message]:
    (size,) = struct.unpack_from("<I", data)
    head = json.loads(data[4 : 4 + size])
    stamps = int(head["host_ns"]), _known(int(head["device_ns"])), _known(int(head["sequence"]))
    if kind == "facts":
        return *stamps, Facts(str(head["about"]), head["values"])
    if kind == "unlabelled":
        place = np.array(head["position_m"], dtype=np.float64).reshape(-1, 3)
        return *stamps, Markers("", tuple(head["names"]), place, np.array(head["residual_m"], dtype=np.float64))
    at = 4 + size
    images: dict[str, Any] = {}
    for name in _IMAGES:
        shape = tuple(int(n) for n in head["shapes"][name])
        images[name] = np.frombuffer(data[at:], _dtype(name), count=shape[0] * shape[1]).reshape(shape)
        at += images[name].nbytes
    lens: dict[str, Any] = {name: np.array(head[name], dtype=np.float64) for name in _LENS}
    return *stamps, ToFFrame(depth_unit_m=float(head["depth_unit_m"]), **images, **lens)


def _dtype(image: str) -> str:
    return "<u1" if image == "confidence" else "<u2"


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """The numbers of a decoded sample by their place: structures by names, arrays by indices."""
    if isinstance(value, (bool, int, float)):
        yield name or "value", float(value)
        return
    parts: Iterable[tuple[str, Any]] = ()
    if isinstance(value, (list, tuple)):
        parts = ((f"{name}[{i}]", each) for i, each in enumerate(value[:_MOST_LEAVES]))
    elif hasattr(value, "__dict__"):
        parts = ((f"{name}.{key}" if name else key, each) for key, each in vars(value).items())
    for key, each in parts:
        yield from _leaves(each, key)


def _or_unknown(value: int | None) -> int:
    return _UNKNOWN if value is None else value


def _known(value: int) -> int | None:
    return None if value == _UNKNOWN else value
