"""XDF files of the Lab Streaming Layer (LabRecorder): read by `pyxdf`, written here. One stream of the file is one source.

Numbers are channels, strings facts. Time stamps are the sender's LSL clock as it was recorded; a file also holds how that clock
lay to the recording computer's, measured again and again, which makes host_ns. XDF keeps no epoch but the moment at which the
file was begun: host_ns counts from it, with the first sample of the file at that moment, so that it is right to seconds, while
times between the streams of the file are as good as LSL's measurements.

Source of the layout: the XDF specification 1.0 (SCCN).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import RecordingError
from cabinpose.core.optional import optional_module
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import Channels, Facts, Message
from cabinpose.store.convert.apart import items_apart
from cabinpose.store.convert.rows import Row, whole_file

_HEADER, _STREAM, _SAMPLES, _OFFSET, _FOOTER = 1, 2, 3, 4, 6
_AT_ONCE = 1000  # samples a chunk
_MOST_CHANNELS = 100_000
_LATEST_S = 4e9  # of a clock: nanoseconds have 64 bits, twice of it still fit


@dataclass(frozen=True)
class XdfStream:
    """A stream of a file: its name, its labels, and its samples (N, C) or lists of strings, with stamps (N,) s.

    offsets: (M, 2) when the sender's clock was measured (its own time) and what to add to get the recorder's, s ·
    start_ns: host time of the recorder's `zero_s`.
    """

    name: str
    type: str
    rate_hz: float
    labels: tuple[str, ...]
    stamps_s: NDArray[np.float64]
    values: Any
    offsets: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    start_ns: int = 0
    zero_s: float = 0.0

    @property
    def is_text(self) -> bool:
        """Whether its samples are strings."""
        return not isinstance(self.values, np.ndarray)

    def recorder_s(self, stamps_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Stamps on the recorder's clock: a straight line through the offsets (one offset: a constant)."""
        if not len(self.offsets):
            return stamps_s
        at, offset = self.offsets.T
        if len(at) < 3 or np.ptp(at) == 0:
            return stamps_s + np.median(offset)
        slope, constant = np.polyfit(at - at[0], offset, 1)
        return stamps_s + constant + slope * (stamps_s - at[0])

    def rows(self) -> Iterator[Row]:
        """Facts on the stream, then its samples."""
        host = np.rint((self.recorder_s(self.stamps_s) - self.zero_s) * 1e9).astype(np.int64) + self.start_ns
        facts = {"name": self.name, "type": self.type, "rate_hz": self.rate_hz, "channels": list(self.labels)}
        measured = {"clock_offsets_s": self.offsets.tolist()} if len(self.offsets) else {}
        yield int(host[0]) if len(host) else self.start_ns, None, Facts("stream", facts | measured)
        for host_ns, stamp, value in zip(host, self.stamps_s, self.values, strict=True):
            message: Message
            if self.is_text:
                message = Facts(self.name, dict(zip(self.labels, map(str, value), strict=True)))
            else:
                message = Channels(self.labels, np.asarray(value, dtype=np.float64))
            yield int(host_ns), round(float(stamp) * 1e9), message


def read_xdf(path: Path) -> dict[str, XdfStream]:
    """The streams of a file by name (`-2` after a name that is there twice).

    Raises DependencyError without `pyxdf`, RecordingError where the file is none, or holds no stream; of a damaged one, what
    `pyxdf` finds.
    """
    _pyxdf()  # an error of its own where it is missing
    try:
        ((found, header),) = items_apart(_load, path)
        streams = [_stream(each) for each in found]
        firsts = [float(s.recorder_s(s.stamps_s)[0]) for s in streams if s is not None and len(s.stamps_s)]
    except Exception as error:
        hint = "check the path; record it again with LabRecorder"
        raise RecordingError(f"cannot read {path} as XDF: {error}", hint=hint) from error
    streams = [stream for stream in streams if stream is not None]
    if not streams:
        raise RecordingError(f"{path} holds no stream", hint="record it again, with the streams selected")
    start_ns, zero_s = _begun(header), min(firsts, default=0.0)
    result: dict[str, XdfStream] = {}
    for stream in streams:
        name, number = stream.name, 1
        while name in result:
            number += 1
            name = f"{stream.name}-{number}"
        values = {**stream.__dict__, "name": name, "start_ns": start_ns, "zero_s": zero_s}
        result[name] = XdfStream(**values)
    return result


def _pyxdf() -> Any:
    return optional_module("pyxdf", purpose="an XDF file", hint="pip install pyxdf")


def _load(path: Path) -> Iterator[tuple[Any, Any]]:
    """What the package finds. It believes a file's counts of channels and samples: to be called in a process of its own."""
    yield _pyxdf().load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)


def _stream(found: Mapping[str, Any]) -> Any:
    """A stream as `pyxdf` gives it; None for one without channels."""
    info = found["info"]
    text = info["channel_format"][0] == "string"
    stamps = np.asarray(found["time_stamps"], dtype=np.float64)
    values = found["time_series"] if text else np.asarray(found["time_series"])
    count = int(info["channel_count"][0])
    if count < 1:
        return None
    if count > _MOST_CHANNELS or len(values) != len(stamps) or (len(stamps) and np.shape(values)[1:] != (count,)):
        raise ValueError(f"samples {np.shape(values)} of {count} channels at {len(stamps)} times")
    offsets = np.array([found.get("clock_times", []), found.get("clock_values", [])], dtype=np.float64).T
    if not all((np.abs(times) < _LATEST_S).all() for times in (stamps, offsets)):  # False for NaN
        raise ValueError("times that are none")
    return XdfStream(
        name=str(info["name"][0]),
        type=str((info.get("type") or [""])[0] or ""),
        rate_hz=float(info["nominal_srate"][0]),
        labels=_labels(info, count),
        stamps_s=stamps,
        values=values,
        offsets=offsets.reshape(-1, 2),
    )


def _labels(info: Mapping[str, Any], count: int) -> tuple[str, ...]:
    """Labels of the channels, each once; numbers where the description has none."""
    try:
        channels = info["desc"][0]["channels"][0]["channel"]
        labels = [str(channel["label"][0] or "") for channel in channels][:count]
    except (KeyError, TypeError, IndexError):
        labels = []
    labels += [""] * (count - len(labels))
    result: list[str] = []
    for i, label in enumerate(labels):
        name = label or f"channel{i}"
        result.append(name if name not in result else f"{name}_{i}")
    return tuple(result)


def _begun(header: Any) -> int:
    """Nanoseconds since the Unix epoch at which the file was begun; 0 where it does not tell."""
    try:
        moment = datetime.fromisoformat(str(header["info"]["datetime"][0]))
    except (KeyError, TypeError, IndexError, ValueError):
        return 0
    return round((moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp() * 1e9)


def write_xdf(path: Path, streams: Sequence[XdfStream], *, overwrite: bool = False) -> Path:
    """Write streams to a file; it appears when it is whole. Times are the streams' stamps and offsets."""
    start_ns = min((stream.start_ns for stream in streams), default=0)
    with whole_file(path, overwrite=overwrite, binary=True) as file:
        file.write(b"XDF:")
        begun = datetime.fromtimestamp(start_ns / 1e9, UTC).isoformat()
        _chunk(file, _HEADER, _xml("info", version="1.0", datetime=begun))
        for number, stream in enumerate(streams, 1):
            identity = struct.pack("<I", number)
            _chunk(file, _STREAM, identity, _stream_header(stream))
            for first in range(0, len(stream.stamps_s), _AT_ONCE):
                part = slice(first, first + _AT_ONCE)
                _chunk(file, _SAMPLES, identity, _samples(stream, stream.stamps_s[part], stream.values[part]))
            for at, offset in stream.offsets:
                _chunk(file, _OFFSET, identity, struct.pack("<dd", at, offset))
            count = len(stream.stamps_s)
            ends = (
                {"first_timestamp": repr(float(stream.stamps_s[0])), "last_timestamp": repr(float(stream.stamps_s[-1]))}
                if count
                else {}
            )
            _chunk(file, _FOOTER, identity, _xml("info", sample_count=str(count), **ends))
    return path


def streams_of_samples(samples: Iterable[tuple[str, Sample]]) -> list[XdfStream]:
    """The channels of a recording's sources as streams. Text and everything else that is no channel stays in the recording.

    Streams that came from an XDF file keep how their senders' clocks lay to the recorder's; of devices, it is the median of
    what lies between the device's time and arrival. Raises RecordingError where no source has channels, or they change.
    """
    rows: dict[str, list[Row]] = {}
    told: dict[str, Mapping[str, Any]] = {}
    for source, sample in samples:
        for message in sample.messages:
            if isinstance(message, Channels):
                rows.setdefault(source, []).append((sample.host_ns, sample.device_ns, message))
            elif isinstance(message, Facts) and message.about == "stream":
                told[source] = message.values
    if not rows:
        raise RecordingError("no source has channels", hint="XDF holds streams of numbers; choose sources that have some")
    streams = []
    begun_ns = min(each[0][0] for each in rows.values())
    measured = all("clock_offsets_s" in told.get(source, {}) for source in rows)
    for source, each in rows.items():
        about = told.get(source, {})
        stream = stream_of_rows(
            str(about.get("name") or source), each, type_=str(about.get("type") or ""), rate_hz=float(about.get("rate_hz") or 0.0)
        )
        if measured:
            offsets = np.array(about["clock_offsets_s"], dtype=np.float64).reshape(-1, 2)
        else:
            host_s = np.array([host_ns - begun_ns for host_ns, _, _ in each]) / 1e9
            offsets = np.array([[stream.stamps_s[0], np.median(host_s - stream.stamps_s)]])
        streams.append(replace(stream, offsets=offsets, start_ns=begun_ns))
    return streams


def stream_of_rows(name: str, rows: Sequence[Row], *, type_: str = "", rate_hz: float = 0.0) -> XdfStream:
    """The channels of a recording's source as a stream; its stamps are the device's time, or the host's.

    Raises RecordingError where there are none, or they change.
    """
    found = [(host, host if device is None else device, m) for host, device, m in rows if isinstance(m, Channels)]
    if not found:
        raise RecordingError(f"{name} has no channels", hint="XDF holds streams of numbers")
    labels = found[0][2].names
    if any(m.names != labels for _, _, m in found):
        raise RecordingError(f"the channels of {name} change", hint="cut the recording where they do")
    stamps = np.array([device for _, device, _ in found]) / 1e9
    first_ns = found[0][0]
    return XdfStream(
        name,
        type_,
        rate_hz,
        labels,
        stamps,
        np.array([m.values for _, _, m in found]),
        start_ns=first_ns,
        zero_s=float(stamps[0]),
    )


def _chunk(file: IO[bytes], tag: int, *parts: bytes) -> None:
    size = 2 + sum(len(part) for part in parts)
    file.write(_length(size) + struct.pack("<H", tag))
    for part in parts:
        file.write(part)


def _length(size: int) -> bytes:
    """A length with the number of its bytes before it."""
    return struct.pack("<BI", 4, size) if size < 1 << 32 else struct.pack("<BQ", 8, size)


def _xml(root: str, **values: str) -> bytes:
    element = Element(root)
    for key, value in values.items():
        SubElement(element, key).text = value
    return b'<?xml version="1.0"?>' + tostring(element, encoding="utf-8")


def _stream_header(stream: XdfStream) -> bytes:
    info = Element("info")
    values = {
        "name": stream.name,
        "type": stream.type,
        "channel_count": str(len(stream.labels)),
        "nominal_srate": repr(stream.rate_hz),
        "channel_format": "string" if stream.is_text else "double64",
    }
    for key, value in values.items():
        SubElement(info, key).text = value
    channels = SubElement(SubElement(info, "desc"), "channels")
    for label in stream.labels:
        SubElement(SubElement(channels, "channel"), "label").text = label
    return b'<?xml version="1.0"?>' + tostring(info, encoding="utf-8")


def _samples(stream: XdfStream, stamps: NDArray[np.float64], values: Any) -> bytes:
    """The content of a chunk of samples, each with its time stamp."""
    parts = [_length(len(stamps))]
    for stamp, value in zip(stamps, values, strict=True):
        parts.append(struct.pack("<Bd", 8, stamp))
        if stream.is_text:
            for cell in value:
                data = str(cell).encode()
                parts += [_length(len(data)), data]
        else:
            parts.append(np.asarray(value, dtype="<f8").tobytes())
    return b"".join(parts)
