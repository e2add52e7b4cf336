"""XDF files of the Lab Streaming Layer (LabRecorder), read by `pyxdf`. One stream of the file is one source.

Numbers become channels, strings facts. Time stamps are the sender's LSL clock as it was recorded; a file also holds the offset
of that clock to the recording computer's, measured again and again, which gives host_ns. XDF keeps no epoch but the moment at
which the file was begun: host_ns counts from it, with the first sample of the file at that moment. So host_ns is right to
seconds, while times between the streams of the file are as good as LSL's measurements.
"""

from __future__ import annotations

import heapq
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core import RecordingError, optional_module
from cabinpose.signals import F64, Channels, Facts, Message
from cabinpose.store.convert.apart import items_apart
from cabinpose.store.convert.format import NoOptions, RecordingFormat
from cabinpose.store.convert.rows import Entry, epoch_ns

_MOST_CHANNELS = 100_000
_TAGS = range(1, 7)  # header, stream, samples, clock offset, boundary, end of a stream
_LATEST_S = 4e9  # of a clock: nanoseconds have 64 bits, twice of it still fit


def read_xdf(path: Path) -> Iterator[Entry]:
    """The samples of all streams by host time, each stream after facts on it.

    Sources are the names of the streams, with `-2` after a name that is there twice. device_ns is the sender's clock.

    Raises
    ------
    DependencyError
        Without `pyxdf`.
    RecordingError
        Where the file is no XDF or holds no stream; of a damaged one, what `pyxdf` finds is given.

    Warns
    -----
    UserWarning
        Where something was left out: what `pyxdf` could not read, a chunk that is none, samples that a stream's end counts and
        the file does not give, or a stream without its end or without channels.
    """
    _pyxdf()  # an error of its own where it is missing
    try:
        ((found, header),) = items_apart(_load, path)
        streams = [stream for each in found if (stream := _stream(each)) is not None]
        notes = [*_notes(path), *(note for each in found if (note := _loss(each)))]
    except Exception as error:
        hint = "check the path; record it again with LabRecorder"
        raise RecordingError(f"cannot read {path} as XDF: {error}", hint=hint) from error
    if not streams:
        raise RecordingError(f"{path} holds no stream", hint="record it again, with the streams selected")
    for note in notes:
        warnings.warn(f"{path} {note}", stacklevel=2)
    zero_s = min((float(stream.host_s[0]) for stream in streams if len(stream.host_s)), default=0.0)
    names: list[str] = []
    for stream in streams:
        name, number = stream.name, 1
        while name in names:
            number += 1
            name = f"{stream.name}-{number}"
        names.append(name)
    begun_ns = _begun_ns(header)
    each = [stream.entries(name, begun_ns, zero_s) for name, stream in zip(names, streams, strict=True)]
    yield from heapq.merge(*each, key=lambda entry: entry[1])


class XdfFormat(RecordingFormat):
    """XDF files of LabRecorder."""

    def read(self, path: Path, _options: NoOptions, _subjects: Sequence[str]) -> Iterator[Entry]:
        """As `read_xdf`."""
        return read_xdf(path)


XDF = XdfFormat()


@dataclass(frozen=True)
class _Stream:
    """A stream of a file.

    stamps_s (N,): the sender's clock · host_s (N,): the recorder's · values: samples (N, C), or lists of strings ·
    offsets (M, 2): when the sender's clock was measured, on its own time, and what to add to it to get the recorder's, s.
    """

    name: str
    type: str
    rate_hz: float
    labels: tuple[str, ...]
    stamps_s: F64
    host_s: F64
    values: Any
    offsets: F64

    def entries(self, source: str, begun_ns: int, zero_s: float) -> Iterator[Entry]:
        """Facts on the stream, then its samples; the recorder's time `zero_s` is the host time `begun_ns`."""
        host = np.rint((self.host_s - zero_s) * 1e9).astype(np.int64) + begun_ns
        facts = {"name": self.name, "type": self.type, "rate_hz": self.rate_hz, "channels": list(self.labels)}
        measured = {"clock_offsets_s": self.offsets.tolist()} if len(self.offsets) else {}
        yield source, int(host[0]) if len(host) else begun_ns, None, Facts("stream", facts | measured)
        for host_ns, stamp, value in zip(host, self.stamps_s, self.values, strict=True):
            message: Message
            if isinstance(self.values, np.ndarray):
                message = Channels(self.labels, np.asarray(value, dtype=np.float64))
            else:
                message = Facts(self.name, dict(zip(self.labels, map(str, value), strict=True)))
            yield source, int(host_ns), round(float(stamp) * 1e9), message


def _pyxdf() -> Any:
    return optional_module("pyxdf", purpose="an XDF file", hint="pip install pyxdf")


def _load(path: Path) -> Iterator[tuple[Any, Any]]:
    """What the package finds. It believes a file's counts of channels and samples: to be called in a process of its own."""
    yield _pyxdf().load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)


def _stream(found: Mapping[str, Any]) -> _Stream | None:
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
    offsets = np.array([found.get("clock_times", []), found.get("clock_values", [])], dtype=np.float64).T.reshape(-1, 2)
    if not all((np.abs(times) < _LATEST_S).all() for times in (stamps, offsets)):  # False for NaN
        raise ValueError("times that are none")
    return _Stream(
        name=str(info["name"][0]),
        type=str((info.get("type") or [""])[0] or ""),
        rate_hz=float(info["nominal_srate"][0]),
        labels=_labels(info, count),
        stamps_s=stamps,
        host_s=_recorder_s(stamps, offsets),
        values=values,
        offsets=offsets,
    )


def _loss(found: Mapping[str, Any]) -> str:
    """What is wrong with a stream by its own end, which counts its samples; "" where nothing is."""
    name, there = found["info"]["name"][0], len(found["time_stamps"])
    if int(found["info"]["channel_count"][0]) < 1:
        return f"has a stream '{name}' without channels, which is left out"
    try:
        claimed = int(found["footer"]["info"]["sample_count"][0])
    except (KeyError, TypeError, IndexError, ValueError):
        return f"has no end of the stream '{name}': it was not closed, or is damaged; {there} samples are taken"
    return f"gives {there} of the {claimed} samples of the stream '{name}'" if there != claimed else ""


def _notes(path: Path) -> Iterator[str]:
    """What is wrong with the chunks of a file, one behind the other: where they stop, and those of no known kind."""
    if path.suffix != ".xdf":  # compressed, under a checksum
        return
    size, unknown = path.stat().st_size, 0
    with path.open("rb") as file:
        file.seek(4)
        while (at := file.tell()) < size:
            width = file.read(1)[0]
            length = int.from_bytes(file.read(width), "little") if width in (1, 4, 8) else 0
            tag = int.from_bytes(file.read(2), "little")
            if length < 2 or file.tell() - 2 + length > size:
                yield f"is damaged at byte {at}: no chunk is there; what follows may be left out"
                break
            unknown += tag not in _TAGS
            file.seek(length - 2, 1)
    if unknown:
        yield f"has {unknown} chunks of no known kind, which are left out"


def _recorder_s(stamps_s: F64, offsets: F64) -> F64:
    """Stamps on the recorder's clock: a straight line through the offsets; of one or two, their median."""
    if not len(offsets):
        return stamps_s
    at, offset = offsets.T
    if len(at) < 3 or np.ptp(at) == 0:
        return stamps_s + np.median(offset)
    slope, constant = np.polyfit(at - at[0], offset, 1)
    return stamps_s + constant + slope * (stamps_s - at[0])


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


def _begun_ns(header: Any) -> int:
    """Nanoseconds since the Unix epoch at which the file was begun; 0 where it does not tell."""
    try:
        return epoch_ns(str(header["info"]["datetime"][0]))
    except (KeyError, TypeError, IndexError, ValueError):
        return 0
