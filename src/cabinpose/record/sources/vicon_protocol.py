"""The bytes of Vicon's DataStream (TCP, little-endian): packets read and built. No sockets, no axes or units changed.

A packet is a u32 0x1A2B0001, a u32 length and blocks of that length together; a block is a u32 type, a u32 length and data. A
string, vector, set or map is a u32 count and its items. Lengths are mm, rotations row-major matrices, latencies seconds.

Source: the types and layouts of the vendor's DataStream SDK, whose C++ source is public (1.11, MIT). The server speaks first: the
types that it has (ObjectEnums). The client answers with those that it wants, now and whenever they change, and asks for
frames: RequestFrame 0 for the newest one, 1 for all as they come, RequestNextFrame n for the next n. Static objects come when
they change, or when the set of types does; Contents then says which types are as before. A Ping comes back as it was sent.

The first frame has the number 0 in the bytes and 1 in the SDK (`GetFrameNumber`). `Packet.frame` is the SDK's number, so that a
recording agrees with what Vicon's own programs show.

Nothing that a packet says of its own size is trusted: reading ends where the bytes end, and nothing is allocated for more. A
block that does not hold what its type needs is left out and counted; the packet's other blocks stand.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

DEFAULT_PORT = 801
MAGIC = 0x1A2B0001
FRAME_COUNTER = 1 << 32  # where the numbers of the frames wrap
TICKS_PER_SECOND = 135_000_000  # of the clock that frame periods are given in
MAX_PACKET = 4 << 20  # bytes; a frame of 100 segments and 1000 markers has 0.2 MB
_HEADER = struct.Struct("<II")
_MAGIC_BYTES = MAGIC.to_bytes(4, "little")
_BYTE, _U32, _I64, _U64, _F64 = (struct.Struct(layout) for layout in ("<B", "<I", "<q", "<Q", "<d"))


class Type(IntEnum):
    """Types of blocks; those that are read here. Others are skipped."""

    STREAM_INFO = 1
    SUBJECT_INFO = 2
    FRAME_INFO = 5
    LABELED_RECONS = 6
    UNLABELED_RECONS = 7
    LOCAL_SEGMENTS = 8
    GLOBAL_SEGMENTS = 9
    LATENCY_INFO = 26
    SUBJECT_TOPOLOGY = 28
    HARDWARE_FRAME_INFO = 36
    APPLICATION_INFO = 37
    FRAME_RATE_INFO = 39
    PING = 42
    OBJECT_ENUMS = 100_001
    REQUEST_FRAME = 100_002
    CONTENTS = 100_004
    REQUEST_NEXT_FRAME = 100_008


STATIC = frozenset({Type.STREAM_INFO, Type.SUBJECT_INFO, Type.SUBJECT_TOPOLOGY, Type.APPLICATION_INFO})

SEGMENT = np.dtype([("segment", "<u4"), ("translation", "<f8", (3,)), ("rotation", "<f8", (9,))])
_RECON = [("radius", "<f8"), ("position", "<f8", (3,)), ("covariance", "<f8", (9,)), ("trajectory", "<u4")]
UNLABELED = np.dtype(_RECON)
LABELED = np.dtype([("subject", "<u4"), ("marker", "<u4"), *_RECON])
_ATTACHMENT = np.dtype([("marker", "<u4"), ("segment", "<u4")])
Rows: TypeAlias = NDArray[Any]  # of one of the dtypes above


class SegmentInfo(NamedTuple):
    """A segment of a subject: ids (the root's parent is 0), its bounding box (min and max), its name."""

    parent: int
    segment: int
    name: str
    bounds: tuple[float, ...] = (0.0,) * 6


@dataclass(frozen=True)
class SubjectInfo:
    """A subject: its segments, its markers (id, name), and which marker is attached to which segment (ids)."""

    subject: int
    name: str
    segments: tuple[SegmentInfo, ...] = ()
    markers: tuple[tuple[int, str], ...] = ()
    attachments: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class Contents:
    """How many objects of each type are in the packet, and the types whose objects are those of the packet before."""

    counts: Mapping[int, int] = field(default_factory=dict)
    unchanged: frozenset[int] = frozenset()


@dataclass
class Packet:
    """What a packet says; None, or nothing, where it says nothing of it. `faults`: blocks that are malformed.

    enums: types that the server has, or the client wants · streaming: a request for a frame, or for all to come · next_frames: a
    request for so many frames, none of which was captured yet · frame: of the stream, as the SDK numbers it, from 1 · period: 135
    MHz ticks a frame · y_up: the server's axes · latency: (what took it, s), to be summed · labeled, unlabeled: rows of
    `LABELED`, `UNLABELED` · segments: rows of `SEGMENT` of each subject's id, in the world or in the parent's frame ·
    neutral: rows of `SEGMENT` of the subjects in their neutral pose, in the parent's frame.
    """

    enums: frozenset[int] | None = None
    streaming: bool | None = None
    next_frames: int | None = None
    ping: int | None = None
    contents: Contents | None = None
    frame: int | None = None
    hardware_frame: int | None = None
    period: int | None = None
    y_up: bool | None = None
    rates: Mapping[str, float] | None = None
    latency: tuple[tuple[str, float], ...] | None = None
    subjects: list[SubjectInfo] = field(default_factory=list)
    neutral: dict[int, Rows] = field(default_factory=dict)
    labeled: Rows | None = None
    unlabeled: Rows | None = None
    global_segments: dict[int, Rows] = field(default_factory=dict)
    local_segments: dict[int, Rows] = field(default_factory=dict)
    faults: int = 0


class _MalformedError(ValueError):
    """A block does not hold what its type needs."""


class _Reader:
    """Reads a block from its beginning; never past its end."""

    def __init__(self, data: memoryview) -> None:
        self._data, self._at = data, 0

    def _take(self, size: int) -> memoryview:
        if size > len(self._data) - self._at:
            raise _MalformedError
        self._at += size
        return self._data[self._at - size : self._at]

    def number(self, kind: struct.Struct = _U32) -> Any:
        return kind.unpack(self._take(kind.size))[0]

    def text(self) -> str:
        return str(self._take(self.number()), "utf-8", "replace")

    def rows(self, dtype: np.dtype[Any]) -> Rows:
        count: int = self.number()
        return np.frombuffer(self._take(count * dtype.itemsize), dtype)

    def floats(self, count: int) -> tuple[float, ...]:
        return struct.unpack(f"<{count}f", self._take(4 * count))

    def enums(self) -> frozenset[int]:
        return frozenset(self.rows(np.dtype("<u4")).tolist())


def decode(payload: bytes | memoryview) -> Packet:
    """What the blocks of a packet say (its bytes without magic and length). Never raises; what is malformed is in `faults`."""
    packet, view, at = Packet(), memoryview(payload), 0
    while at < len(view):
        if at + _HEADER.size > len(view):
            packet.faults += 1
            break
        kind, size = _HEADER.unpack_from(view, at)
        at += _HEADER.size
        if size > len(view) - at:
            packet.faults += 1
            break
        block = BLOCKS.get(kind)
        if block is not None:
            try:
                value = block.read(_Reader(view[at : at + size]))
            except _MalformedError:
                packet.faults += 1
            else:
                _put(packet, block, value)
        at += size
    return packet


def _put(packet: Packet, block: Block, value: Any) -> None:
    if not block.each:
        setattr(packet, block.field, value)
    elif isinstance(held := getattr(packet, block.field), dict):
        held.update([value])
    else:
        held.append(value)


def encode(packet: Packet) -> bytes:
    """The bytes of a packet, magic and length first; the blocks in the order of `BLOCKS`."""
    body = b""
    for kind, block in BLOCKS.items():
        value = getattr(packet, block.field)
        values = [] if value is None else [value]
        if block.each:
            values = list(value.items()) if isinstance(value, dict) else value
        for each in values:
            data = block.write(each)
            body += _HEADER.pack(kind, len(data)) + data
    return _HEADER.pack(MAGIC, len(body)) + body


def _read_subject(data: _Reader) -> SubjectInfo:
    subject, name = data.number(), data.text()
    segments = []
    for _ in range(data.number()):
        parent, segment, bounds = data.number(), data.number(), data.floats(6)
        segments.append(SegmentInfo(parent, segment, data.text(), bounds))
    markers = tuple((data.number(), data.text()) for _ in range(data.number()))
    return SubjectInfo(subject, name, tuple(segments), markers, tuple(data.rows(_ATTACHMENT).tolist()))


def _write_subject(info: SubjectInfo) -> bytes:
    segments = [struct.pack("<II6f", s.parent, s.segment, *s.bounds) + _text(s.name) for s in info.segments]
    markers = [_U32.pack(identity) + _text(name) for identity, name in info.markers]
    attachments = _rows(np.array(list(info.attachments), _ATTACHMENT), _ATTACHMENT)
    return _U32.pack(info.subject) + _text(info.name) + _vector(segments) + _vector(markers) + attachments


def _read_contents(data: _Reader) -> Contents:
    counts = {data.number(): data.number() for _ in range(data.number())}
    return Contents(counts, data.enums())


def _write_contents(contents: Contents) -> bytes:
    return _vector([_HEADER.pack(*pair) for pair in sorted(contents.counts.items())]) + _set(contents.unchanged)


def _read_named(data: _Reader) -> tuple[tuple[str, float], ...]:
    return tuple((data.text(), data.number(_F64)) for _ in range(data.number()))


def _write_named(values: Iterable[tuple[str, float]]) -> bytes:
    return _vector([_text(name) + _F64.pack(value) for name, value in values])


def _vector(items: Sequence[bytes]) -> bytes:
    return _U32.pack(len(items)) + b"".join(items)


def _set(values: frozenset[int]) -> bytes:
    return _vector([_U32.pack(value) for value in sorted(values)])


def _text(text: str) -> bytes:
    data = text.encode()
    return _U32.pack(len(data)) + data


def _rows(rows: Rows, dtype: np.dtype[Any]) -> bytes:
    if rows.dtype != dtype:
        raise ValueError(f"rows of {rows.dtype}, not {dtype}")
    return _U32.pack(len(rows)) + rows.tobytes()


class Block(NamedTuple):
    """How a type of block becomes a field of `Packet` and back; each: every entry of the field has a block of its own."""

    field: str
    read: Callable[[_Reader], Any]
    write: Callable[[Any], bytes]
    each: bool = False


def _number(field: str, layout: struct.Struct) -> Block:
    return Block(field, lambda data: data.number(layout), layout.pack)


def _markers(field: str, dtype: np.dtype[Any]) -> Block:
    return Block(field, lambda data: data.rows(dtype), lambda rows: _rows(rows, dtype))


def _segments(field: str) -> Block:
    """Of each subject: its id, and rows of `SEGMENT`."""
    return Block(
        field, lambda data: (data.number(), data.rows(SEGMENT)), lambda item: _U32.pack(item[0]) + _rows(item[1], SEGMENT), True
    )


BLOCKS: Mapping[int, Block] = MappingProxyType(
    {
        Type.OBJECT_ENUMS: Block("enums", _Reader.enums, _set),
        Type.REQUEST_FRAME: Block("streaming", lambda data: bool(data.number(_BYTE)), _BYTE.pack),
        Type.REQUEST_NEXT_FRAME: _number("next_frames", _U32),
        Type.PING: _number("ping", _U64),
        Type.CONTENTS: Block("contents", _read_contents, _write_contents),
        Type.FRAME_INFO: Block(
            "frame", lambda data: (data.number() + 1) % FRAME_COUNTER, lambda frame: _U32.pack((frame - 1) % FRAME_COUNTER)
        ),
        Type.HARDWARE_FRAME_INFO: _number("hardware_frame", _U32),
        Type.STREAM_INFO: _number("period", _I64),
        Type.APPLICATION_INFO: Block("y_up", lambda data: data.number(_BYTE) == 1, _BYTE.pack),
        Type.FRAME_RATE_INFO: Block(
            "rates", lambda data: dict(_read_named(data)), lambda rates: _write_named(sorted(rates.items()))
        ),
        Type.LATENCY_INFO: Block("latency", _read_named, _write_named),
        Type.SUBJECT_INFO: Block("subjects", _read_subject, _write_subject, True),
        Type.SUBJECT_TOPOLOGY: _segments("neutral"),
        Type.LABELED_RECONS: _markers("labeled", LABELED),
        Type.UNLABELED_RECONS: _markers("unlabeled", UNLABELED),
        Type.GLOBAL_SEGMENTS: _segments("global_segments"),
        Type.LOCAL_SEGMENTS: _segments("local_segments"),
    }
)


class PacketSplitter:
    """Cuts the bytes of a connection into packets. Holds no more than one packet and what was fed last.

    `malformed` counts the places where no packet begins or its length is over the limit; from there the next magic is sought.
    """

    def __init__(self, limit: int = MAX_PACKET) -> None:
        self.malformed = 0
        self._limit = limit
        self._buffer = bytearray()
        self._lost = False  # between packets: nothing since the last fault has been a packet

    def feed(self, data: bytes) -> list[bytes]:
        """The packets that are now whole, magic and length included."""
        self._buffer += data
        packets, at, buffer = [], 0, self._buffer
        while len(buffer) - at >= _HEADER.size:
            magic, size = _HEADER.unpack_from(buffer, at)
            if magic != MAGIC or size > self._limit:
                self.malformed += not self._lost
                self._lost = True
                found = buffer.find(_MAGIC_BYTES, at + 1)
                # The last three bytes may be the beginning of a magic.
                at = found if found >= 0 else max(at + 1, len(buffer) - 3)
                continue
            end = at + _HEADER.size + size
            if end > len(buffer):
                break
            packets.append(bytes(memoryview(buffer)[at:end]))
            self._lost = False
            at = end
        del buffer[:at]
        return packets


def payload(packet: bytes) -> memoryview:
    """The blocks of a packet that `PacketSplitter` cut."""
    return memoryview(packet)[_HEADER.size :]
