"""The bytes of Xsens MVN's network streaming: datagrams read and built. No sockets, no axes changed, no units changed.

Source: "MVN real-time network streaming protocol specification", MV0305P revision N (2018), and the vendor's public-domain C++
reader where the two differ: point ids are 256·segment + point everywhere, a time code has a length before it, a tracker's
item has 44 or 68 bytes (told apart by payload ÷ items), a centre of mass 12 or 36.

Nothing that a datagram says of its own size is trusted: sizes are held against the bytes that came before anything is read,
and what contradicts them raises `MalformedError`.
"""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAGIC = b"MXTP"
DEFAULT_PORT = 9763
HEADER = struct.Struct(">4s2sIBBIBBBBHH")
LAST_PIECE = 0x80
MAX_PIECES = 128  # the datagram counter has 7 bits
MAX_PAYLOAD = 0xFFFF
SEGMENT_STRIDE = 256  # a point's id is this times its segment's id, plus its own

EULER, QUATERNION, POINTS, UNITY, META, SCALE = 1, 2, 3, 5, 12, 13
JOINT_ANGLES, LINEAR, ANGULAR, TRACKERS, CENTRE_OF_MASS, TIME_CODE = 20, 21, 22, 23, 24, 25
# Types that come once for every sample. Name and scale come now and then: their gaps in the sample counter say nothing.
COUNTED = frozenset({EULER, QUATERNION, POINTS, UNITY, JOINT_ANGLES, LINEAR, ANGULAR, TRACKERS, CENTRE_OF_MASS, TIME_CODE})


def _item(*fields: tuple[str, int]) -> np.dtype[Any]:
    return np.dtype([("id", "=i4")] + [(name, "=f4", (size,)) for name, size in fields])


_TRACKER_LONG = _item(
    ("orientation_wxyz", 4), ("free_acceleration", 3), ("acceleration", 3), ("angular_velocity", 3), ("magnetic_field", 3)
)  # fmt: skip
# type -> item size in bytes -> fields, in this machine's byte order: all are of four bytes, swapped at once
ITEMS: Mapping[int, Mapping[int, np.dtype[Any]]] = MappingProxyType(
    {
        kind: MappingProxyType({dtype.itemsize: dtype for dtype in dtypes})
        for kind, dtypes in {
            EULER: [_item(("position", 3), ("euler_deg", 3))],
            QUATERNION: [_item(("position", 3), ("orientation_wxyz", 4))],
            POINTS: [_item(("position", 3))],
            UNITY: [_item(("position", 3), ("orientation_wxyz", 4))],
            JOINT_ANGLES: [np.dtype([("id", "=i4"), ("child", "=i4"), ("angles_deg", "=f4", (3,))])],
            LINEAR: [_item(("position", 3), ("velocity", 3), ("acceleration", 3))],
            ANGULAR: [_item(("orientation_wxyz", 4), ("angular_velocity", 3), ("angular_acceleration", 3))],
            TRACKERS: [_item(("orientation_wxyz", 4), ("free_acceleration", 3), ("magnetic_field", 3)), _TRACKER_LONG],
        }.items()
    }
)


_WORD = np.dtype("=u4")
_SWAPPED = sys.byteorder == "little"


class MalformedError(ValueError):
    """Bytes that are no datagram of MVN, or contradict themselves."""


class Header(NamedTuple):
    """The first 24 bytes. `sample` is the sample counter, `piece` the index within a split sample, `time_ms` since the recording
    began; `body`, `props` and `fingers` are 0 from releases before 2019.
    """

    kind: int
    sample: int
    piece: int
    last: bool
    items: int
    time_ms: int
    character: int
    body: int
    props: int
    fingers: int
    payload: int


_KINDS = {f"{kind:02d}".encode(): kind for kind in sorted(COUNTED | {META, SCALE})}
_KIND_BYTES = {kind: name for name, kind in _KINDS.items()}


def read_header(data: bytes | memoryview) -> Header:
    """The header at the start of `data`. Raises MalformedError where it is none of a known type."""
    if len(data) < HEADER.size:
        raise MalformedError(f"{len(data)} bytes are no header")
    magic, name, sample, counter, items, time_ms, character, body, props, fingers, _, payload = HEADER.unpack_from(data)
    kind = _KINDS.get(name)
    if magic != MAGIC or kind is None:
        raise MalformedError("no datagram of a known type")
    piece, last = counter & ~LAST_PIECE, counter >= LAST_PIECE
    return Header(kind, sample, piece, last, items, time_ms, character, body, props, fingers, payload)


def read_datagram(data: bytes) -> tuple[Header, bytes]:
    """The header and payload of one datagram; a payload size of 0 (old releases) means the rest.

    Raises MalformedError, also where the payload does not hold the items that the header counts.
    """
    header = read_header(data)
    size = len(data) - HEADER.size
    if header.payload not in (0, size):
        raise MalformedError(f"{size} bytes follow a header that promises {header.payload}")
    sizes = ITEMS.get(header.kind)
    if sizes is not None and (header.items == 0 or size % header.items or size // header.items not in sizes):
        raise MalformedError(f"{size} bytes are not {header.items} items of type {header.kind:02d}")
    return header, data[HEADER.size :]


def stream_length(header: Header) -> int | None:
    """Bytes of the datagram that begins with `header` in a stream (TCP); None where its header does not tell."""
    if header.payload:
        return HEADER.size + header.payload
    sizes = ITEMS.get(header.kind)
    return None if sizes is None else HEADER.size + header.items * max(sizes)


def read_items(kind: int, items: int, payload: bytes) -> NDArray[Any]:
    """The items (N,) of a sample as a structured array, with the fields of `ITEMS`."""
    sizes = ITEMS[kind]
    size, rest = divmod(len(payload), items) if items else (0, 1)
    dtype = sizes.get(size)
    if rest or dtype is None:
        raise MalformedError(f"{len(payload)} bytes are not {items} items of type {kind:02d}")
    words = np.frombuffer(payload, _WORD)
    return (words.byteswap() if _SWAPPED else words).view(dtype)


def read_centre_of_mass(payload: bytes) -> NDArray[np.float64]:
    """Position (3,); newer releases append velocity and acceleration: (9,)."""
    if len(payload) not in (12, 36):
        raise MalformedError(f"a centre of mass of {len(payload)} bytes")
    return np.frombuffer(payload, ">f4").astype(np.float64)


_TIME_CODE = re.compile(r"[0-9]{2}:[0-9]{2}:[0-9]{2}.[0-9]{3}")


def read_time_code(payload: bytes) -> str:
    """`HH:MM:SS.mmm`, with the length before it that MVN sends, or without it, as the specification has it."""
    text = _Reader(payload).text() if len(payload) == 16 else _utf8(payload)
    if not _TIME_CODE.fullmatch(text):
        raise MalformedError("no time code")
    return text


def read_meta(payload: bytes) -> dict[str, str]:
    """The tags of a character: name, xmid (BodyPack or station), color (RRGGBB), and what else is sent."""
    lines = _Reader(payload).text().splitlines()
    return {key.strip(): value.strip() for key, found, value in (line.partition(":") for line in lines) if found}


class ScalePoint(NamedTuple):
    """A point of a segment: its ids, name, flags and offset (x, y, z) from the segment's origin, m, in the null pose."""

    segment: int
    point: int
    name: str
    flags: int
    offset: tuple[float, float, float]


class Scale(NamedTuple):
    """Some of a character's measures, standing with all orientations identity: origins of segments by name (m), and points."""

    segments: dict[str, tuple[float, float, float]]
    points: tuple[ScalePoint, ...]


def read_scale(payload: bytes) -> Scale:
    """The measures in one datagram: MVN sends the segments in a first one and the points in several others."""
    reader = _Reader(payload)
    segments = {reader.text(): reader.vector() for _ in reader.things()}
    points = []
    # The vendor's reader finds no count of points after the segments; the specification has one of 0 there.
    if reader.left or not segments:
        for _ in reader.things():
            segment, point = reader.unpack(_IDS)
            name = reader.text()
            points.append(ScalePoint(segment, point, name, reader.unpack(_U32)[0], reader.vector()))
    if reader.left:
        raise MalformedError(f"{reader.left} bytes too many in a scale")
    return Scale(segments, tuple(points))


_U32, _I32, _IDS, _VECTOR = struct.Struct(">I"), struct.Struct(">i"), struct.Struct(">HH"), struct.Struct(">3f")


def _utf8(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise MalformedError("a string that is no UTF-8") from error


class _Reader:
    """Reads a payload from its start; asking for more than there is raises MalformedError."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def left(self) -> int:
        return len(self._data) - self._at

    def unpack(self, layout: struct.Struct) -> tuple[Any, ...]:
        if self.left < layout.size:
            raise MalformedError("a payload ends within a value")
        self._at += layout.size
        return layout.unpack_from(self._data, self._at - layout.size)

    def text(self) -> str:
        (size,) = self.unpack(_I32)
        if not 0 <= size <= self.left:
            raise MalformedError(f"a string of {size} bytes in {self.left}")
        self._at += size
        return _utf8(self._data[self._at - size : self._at])

    def vector(self) -> tuple[float, float, float]:
        x, y, z = self.unpack(_VECTOR)
        if not np.isfinite((x, y, z)).all():
            raise MalformedError("a length that is no number")
        return x, y, z

    def things(self) -> range:
        """As many things as a number before them says; reading more than there are raises before it takes long."""
        return range(self.unpack(_U32)[0])


# ------------------------------------------------------------------------------------------------------------- building
def build_header(header: Header) -> bytes:
    """The 24 bytes of a header."""
    counter = header.piece | (LAST_PIECE if header.last else 0)
    kind = _KIND_BYTES[header.kind]
    return HEADER.pack(MAGIC, kind, header.sample, counter, header.items, *header[5:10], 0, header.payload)


def build_items(kind: int, fields: Mapping[str, NDArray[Any]], *, long_trackers: bool = True) -> bytes:
    """The payload of N items of type `kind`, from arrays by the names of its fields in `ITEMS`; trackers of 68 bytes or 44."""
    sizes = ITEMS[kind]
    dtype = sizes[max(sizes) if long_trackers else min(sizes)]
    items = np.zeros(len(fields["id"]), dtype)
    for name in dtype.names or ():
        items[name] = fields[name]
    words = items.view(_WORD)
    return (words.byteswap() if _SWAPPED else words).tobytes()


def build_sample(header: Header, payload: bytes, *, pieces_of: int | None = None) -> list[bytes]:
    """The datagrams of one sample of `header.items` items; its piece, last and payload size are filled in here.

    `pieces_of` is the number of items that a datagram may carry, None = all.
    """
    items, size = header.items, len(payload) // max(header.items, 1)
    step = max(items, 1) if pieces_of is None else pieces_of
    chunks = [payload[i * size : (i + step) * size] for i in range(0, items, step)] if items else [payload]
    if len(chunks) > MAX_PIECES or max(map(len, chunks)) > MAX_PAYLOAD:
        raise ValueError(f"a sample of {len(payload)} bytes does not fit into {MAX_PIECES} datagrams so")
    datagrams = []
    for i, chunk in enumerate(chunks):
        held = min(step, items - i * step)
        piece = header._replace(piece=i, last=i == len(chunks) - 1, items=held, payload=len(chunk))
        datagrams.append(build_header(piece) + chunk)
    return datagrams


def build_text(text: str) -> bytes:
    """A string with its length before it."""
    data = text.encode()
    return _I32.pack(len(data)) + data


def build_meta(tags: Mapping[str, str]) -> bytes:
    """The payload of type 12."""
    return build_text("".join(f"{key}:{value}\n" for key, value in tags.items()))


def build_scale(segments: Mapping[str, Sequence[float]], points: Iterable[ScalePoint]) -> bytes:
    """The payload of one datagram of type 13: origins of segments (m), points."""
    listed = tuple(points)
    payload = _U32.pack(len(segments)) + b"".join(build_text(name) + _VECTOR.pack(*at) for name, at in segments.items())
    payload += _U32.pack(len(listed))
    for p in listed:
        payload += _IDS.pack(p.segment, p.point) + build_text(p.name) + _U32.pack(p.flags) + _VECTOR.pack(*p.offset)
    return payload
