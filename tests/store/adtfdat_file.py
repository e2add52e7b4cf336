"""ADTF files (`.adtfdat`) for the tests: ADTF's indexed file, version 5 (times in nanoseconds).

A header of 2048 bytes, chunks of 32 + n bytes on 16-byte borders, then tables: an index of the chunks (`index0`) and, of every
stream, its name, type and the places of its chunks in that index. Little-endian. Source of the layout: the headers of
`adtf_file`, which are public (MPL-2.0).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO
from xml.sax.saxutils import escape, quoteattr

_HEADER = struct.Struct("<4sIIIQQQQQQQBQBQQQ30s1912s")
_CHUNK = struct.Struct("<QIIIHHQ")
_CHUNK_REF = struct.Struct("<QIHHQQQI")
_EXTENSION = struct.Struct("<384sHHIIIQQ96s")
_STREAM_INFO = struct.Struct("<QQQI228s")
_SERIALIZER = "sample_copy_serialization_ns.serialization.adtf.cid"
_VERSION = 0x500
_KEY = 1  # a chunk that stands in the index
MOST_STREAMS = 511
LARGEST_SAMPLE = (1 << 31) - 1


@dataclass
class _Stream:
    name: bytes
    info: bytes
    chunks: int = 0
    first_ns: int = 0
    last_ns: int = 0
    refs: list[int] = field(default_factory=list)


class IndexedFileWriter:
    """Writes streams of samples; `close` writes the tables and the header. Samples come in any order of their streams."""

    def __init__(self, file: IO[bytes], *, created_s: int = 0, description: str = "") -> None:
        self._file = file
        self._created_s, self._description = created_s, description.encode()[:1911]
        self._streams: list[_Stream] = []
        self._index: list[bytes] = []
        self._position = _HEADER.size
        self._before = 0  # distance to the chunk before
        self._largest = 0
        self._first_ns = self._last_ns = 0
        file.write(bytes(_HEADER.size))

    def stream(self, name: str, meta_type: str, properties: dict[str, tuple[str, str]]) -> int:
        """The id of a new stream; properties are (type, value) by name. ValueError for too many streams, or too long a name."""
        encoded = name.encode("ascii", "replace")
        if len(self._streams) >= MOST_STREAMS or len(encoded) > 227:
            raise ValueError(f"stream {len(self._streams) + 1} '{name}'")
        values = "".join(
            f"<property name={quoteattr(key)} type={quoteattr(kind)}>{escape(value)}</property>"
            for key, (kind, value) in properties.items()
        )
        xml = (
            '<?xml version="1.0" encoding="UTF-8" standalone="no" ?>'
            f'<stream xmlns="adtf/xsd/stream_description" name="" meta_type={quoteattr(meta_type)}>{values}</stream>'
        )
        self._streams.append(_Stream(encoded, _text(xml) + _text(_SERIALIZER)))
        return len(self._streams)

    def sample(self, stream_id: int, time_ns: int, data: bytes) -> None:
        """Append a sample; times are not negative."""
        stream = self._streams[stream_id - 1]
        payload = struct.pack("<qIQ", time_ns, 0, len(data)) + data
        size = _CHUNK.size + len(payload)
        if size > LARGEST_SAMPLE or time_ns < 0:
            raise ValueError(f"a sample of {len(data)} bytes at {time_ns}")
        number = len(self._index)
        self._file.write(_CHUNK.pack(time_ns, number, self._before, size, stream_id, _KEY, stream.chunks))
        padding = -size % 16
        self._file.write(payload + bytes(padding))
        self._index.append(
            _CHUNK_REF.pack(time_ns, size, stream_id, _KEY, self._position, number, stream.chunks, len(stream.refs))
        )
        stream.refs.append(number)
        stream.first_ns = time_ns if not stream.chunks else min(stream.first_ns, time_ns)
        stream.last_ns = max(stream.last_ns, time_ns)
        self._first_ns = time_ns if not number else min(self._first_ns, time_ns)
        self._last_ns = max(self._last_ns, time_ns)
        stream.chunks += 1
        self._before = size + padding
        self._position += size + padding
        self._largest = max(self._largest, size)

    def close(self) -> None:
        """Write the tables, and the header with what is known now. The file itself stays open."""
        end = self._position
        tables = [("index0", 0, b"".join(self._index)), ("index_add0", 0, bytes(32))]
        for number, stream in enumerate(self._streams, 1):
            info = _STREAM_INFO.pack(stream.chunks, stream.first_ns, stream.last_ns, len(stream.info), stream.name)
            references = struct.pack(f"<{len(stream.refs)}I", *stream.refs)
            tables += [(f"index{number}", number, info + stream.info + references), (f"index_add{number}", number, bytes(32))]
        at = end
        headers = []
        for name, number, data in tables:
            headers.append(_EXTENSION.pack(name.encode(), number, 0, 0, 0, 0, at, len(data), b""))
            self._file.write(data)
            at += len(data)
        self._file.write(b"".join(headers))
        self._file.seek(0)
        self._file.write(
            _HEADER.pack(
                b"IFHD", _VERSION, 0, len(headers), at, _HEADER.size, end - _HEADER.size, len(self._index), self._largest,
                self._last_ns - self._first_ns, self._created_s, 1, self._first_ns, 0, _HEADER.size, _HEADER.size, _HEADER.size,
                b"", self._description,
            )
        )  # fmt: skip


def _text(value: str) -> bytes:
    """A string with its length, which counts the zero at its end."""
    data = value.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


_DDL = (
    '<?xml version="1.0" encoding="iso-8859-1" standalone="no"?><adtf:ddl xmlns:adtf="adtf"><header>'
    "<language_version>4.00</language_version><author>x</author><date_creation>20200101</date_creation>"
    "<date_change>20200101</date_change><description>d</description></header><units/><datatypes>"
    '<datatype description="predefined" name="tFloat32" size="32"/>'
    '<datatype description="predefined" name="tInt16" size="16"/>'
    '</datatypes><enums/><structs><struct alignment="1" name="Imu" version="1">'
    '<element alignment="1" arraysize="2" byteorder="LE" bytepos="0" name="acc" type="tFloat32"/>'
    '<element alignment="1" arraysize="1" byteorder="LE" bytepos="8" name="n" type="tInt16"/>'
    "</struct></structs><streams/></adtf:ddl>"
)


def write_imu(path: Path, samples: list[tuple[float, float, int]], *, first_ns: int = 5_000_000) -> Path:
    """A file of a stream `imu` with a media description, a sample every 10 ms, and a stream `video` without one."""
    with path.open("wb") as file:
        writer = IndexedFileWriter(file)
        properties = {
            "md_struct": ("cString", "Imu"), "md_definitions": ("cString", _DDL), "md_data_serialized": ("tBool", "false"),
        }  # fmt: skip
        imu, video = writer.stream("imu", "adtf/default", properties), writer.stream("video", "adtf/anonymous", {})
        for k, sample in enumerate(samples):
            writer.sample(imu, first_ns + k * 10_000_000, struct.pack("<2fh", *sample))
            writer.sample(video, first_ns + k * 10_000_000 + 1_000_000, b"not described")
        writer.close()
    return path
