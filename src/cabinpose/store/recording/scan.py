"""Reading MCAP record by record, whatever state the file is in.

A file whose end is missing has no index, so the file is read from its start. Where a record contradicts itself, the next chunk
is looked for; a chunk whose checksum is wrong is left out and counted; of a chunk that the end of the file cuts, the whole
messages at its beginning are given, marked as not verified. Sizes in the file are compared with the file's own size and with
`MAX_CHUNK` before they are used.

The `mcap` package's `StreamReader` parses the small records. It cannot read the file as a whole: it raises at the first damage,
and takes a chunk that is cut short for a whole one.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from cabinpose.core import RecordingError

MAX_CHUNK = 1 << 30
"""Bytes of a chunk, as stored and uncompressed, beyond which it is taken as damaged."""
_WINDOW = 1 << 22  # bytes that are searched at once for the next chunk
_STEP = 1 << 20  # bytes that are decompressed at once
_HEADER = bytes([Opcode.HEADER])
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # start, end, uncompressed size, its CRC, length of the compression's name
_MESSAGE = struct.Struct("<HIQQ")
_LIKE_A_CHUNK = re.compile(
    rb"\x06(?=.{5}\x00\x00\x00.{28}(?:\x00\x00\x00\x00|\x03\x00\x00\x00lz4|\x04\x00\x00\x00zstd))", re.DOTALL
)
_ALWAYS = 0, 1 << 64
_LOOK_AHEAD = 64  # bytes of a chunk's head with the name of its compression, and some
_Small = TypeVar("_Small", Schema, Channel, Metadata, Attachment)
_INSIDE = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)


@dataclass
class Damage:
    """What was wrong with a file; nothing, where all counts are 0 and it is whole.

    chunks: left out for a wrong checksum or content · skipped_bytes: that belong to no record · unverified: messages of a
    chunk that the end of the file cuts, so that its checksum says nothing · unfinished: samples at such a cut, left out since
    some of their messages may be missing · orphans: messages whose channel is not known · records: attachments and the like
    that contradict themselves · indexes: summaries with a wrong checksum, which are not used · whole: the file
    has its end.
    """

    chunks: int = 0
    skipped_bytes: int = 0
    unverified: int = 0
    unfinished: int = 0
    orphans: int = 0
    records: int = 0
    indexes: int = 0
    whole: bool = False

    @property
    def any(self) -> bool:
        """Whether something is missing or doubtful."""
        return not self.whole or bool(self.counted())

    def counted(self) -> list[str]:
        """What was found, in words; nothing of a file that is whole, or that its end alone is missing from."""
        counts = (
            (self.chunks, "damaged chunks"),
            (self.skipped_bytes, "bytes skipped"),
            (self.unverified, "messages of a cut chunk not verified"),
            (self.unfinished, "samples left out at a cut"),
            (self.orphans, "messages without a channel"),
            (self.records, "damaged records"),
            (self.indexes, "damaged indexes"),
        )
        return [f"{count} {what}" for count, what in counts if count]


class RawMessage(NamedTuple):
    """A message as it lies in the file."""

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: memoryview


class Chunk(NamedTuple):
    """The records of one chunk, uncompressed. verified: the checksum was right; cut: the file ends within."""

    offset: int
    records: bytes
    start_time: int
    end_time: int
    verified: bool
    cut: bool


class Scanner:
    """One file, read from its start as often as asked. `damage` is that of the last complete walk."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError where the file cannot be opened."""
        try:
            self._file: BinaryIO = path.open("rb")
        except FileNotFoundError:
            raise RecordingError(f"the recording {path} does not exist", hint="give the path of a recording") from None
        except OSError as error:
            raise RecordingError(f"cannot read {path}: {error.strerror}", hint="give the path of a recording") from error
        self.path = path
        self.size = self._file.seek(0, 2)
        self.damage = Damage()
        self._ended = self._chunked = False

    def __enter__(self) -> Scanner:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def walk(self, start_time: int = _ALWAYS[0], end_time: int = _ALWAYS[1]) -> Iterator[Chunk | Metadata | Attachment]:
        """What the file holds, in its order; of chunks only those with messages between the times (end excluded).

        Schemas, channels and messages outside chunks come as chunks of one record. Between times, a file with a sound index
        is not gone through: only its chunks are given.
        """
        if (start_time, end_time) != _ALWAYS and (index := self._index) is not None:
            yield from self._indexed(index, start_time, end_time)
            return
        self.damage = damage = Damage()
        self._ended = self._chunked = False
        head = self._bytes(0, 9)
        position = 8 if head[:8] == MCAP0_MAGIC or head[8:] == _HEADER else 0
        if head[:8] != MCAP0_MAGIC:
            damage.skipped_bytes += position
        while position < self.size:
            if self.size - position == 8 and self._bytes(position, 8) == MCAP0_MAGIC:
                damage.whole = self._ended
                damage.indexes = int(self._has_summary and self._summary() is None)
                return
            found, end = self._record(position, start_time, end_time)
            if end is None:
                end = self._next_chunk(position + 1)
                damage.skipped_bytes += end - position
            elif found is not None:
                yield found
            position = end

    def definitions(self) -> tuple[dict[int, Schema], dict[int, Channel]]:
        """All schemas and channels by their ids: of the summary where there is a sound one, else of the whole file."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        summary = self._summary()
        if summary is not None:
            collect(summary, schemas, channels)
            return schemas, channels
        doubtful: tuple[dict[int, Schema], dict[int, Channel]] = {}, {}
        for found in self.walk():
            if isinstance(found, Chunk):
                collect(found.records, *((schemas, channels) if found.verified else doubtful))
        return doubtful[0] | schemas, doubtful[1] | channels

    @cached_property
    def _index(self) -> list[tuple[int, int, int]] | None:
        """Offset, first and last time of each chunk; None without a sound summary, or where it has no chunks."""
        summary = self._summary()
        records = () if summary is None else records_in(summary)
        found = [struct.unpack_from("<QQQ", content) for opcode, content in records if opcode == Opcode.CHUNK_INDEX]
        return [(offset, first, last) for first, last, offset in found] or None

    def _indexed(self, index: list[tuple[int, int, int]], start_time: int, end_time: int) -> Iterator[Chunk]:
        self.damage = Damage(whole=True)
        for offset, first, last in index:
            if last < start_time or first >= end_time:
                continue
            found, end = self._record(offset, start_time, end_time)
            if isinstance(found, Chunk):
                yield found
            elif end is None:
                self.damage.chunks += 1

    def _bytes(self, position: int, count: int) -> bytes:
        self._file.seek(position)
        return self._file.read(max(min(count, self.size - position), 0))

    def _record(self, position: int, start: int, end: int) -> tuple[Chunk | Metadata | Attachment | None, int | None]:
        """What the record at `position` gives, and where the next begins; None for that where this is no record."""
        head = self._bytes(position, _HEAD.size + _LOOK_AHEAD)
        if len(head) < _HEAD.size:
            return None, None
        opcode, length = _HEAD.unpack_from(head)
        if opcode == Opcode.CHUNK:
            return self._chunk(position, head, start, end)
        after = position + _HEAD.size + length
        if after > self.size or length > MAX_CHUNK:
            return None, None
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            self._ended = opcode == Opcode.FOOTER
            return None, after if length == (20 if self._ended else 4) else None
        if opcode == Opcode.MESSAGE_INDEX:
            sound = length >= 6 and struct.unpack_from("<I", head, _HEAD.size + 2)[0] == length - 6
            return None, after if sound else None
        if not self._is_start(after):
            return None, None
        if opcode in _SKIPPED or opcode >= 0x80:
            return None, after
        record = self._bytes(position, after - position)
        if opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            try:
                if opcode == Opcode.METADATA:
                    return _parsed(Metadata, record), after
                _check_attachment(record)
                return _parsed(Attachment, record), after
            except _UNREADABLE:
                self.damage.records += 1
                return None, after
        first, last = _ALWAYS
        if opcode == Opcode.MESSAGE:
            if self._chunked or length < _MESSAGE.size:
                return None, None  # a file has chunks or messages outside of them; both is another record with a wrong opcode
            first = last = _MESSAGE.unpack_from(record, _HEAD.size)[2]
        return (Chunk(position, record, first, last, False, False), after) if opcode in _INSIDE else (None, None)

    def _chunk(self, position: int, head: bytes, start: int, end: int) -> tuple[Chunk | None, int | None]:
        layout = _chunk_layout(head)
        if layout is None:
            return None, None
        self._chunked = True
        compression, data_at, stored, first, last, size, crc = layout
        after = position + data_at + stored
        cut = after > self.size
        if not cut and (last < start or first >= end):
            return None, after if self._is_start(after) else None
        data = self._bytes(position + data_at, stored)
        records, whole = _uncompressed(data, compression, size)
        if whole and (zlib.crc32(records) == crc or crc == 0):
            return Chunk(position, records, first, last, crc != 0, cut=False), after
        if not cut:
            self.damage.chunks += 1
            return None, after if self._is_start(after) else self._next_chunk(position + 1)
        kept = _whole_records(records, first, last)
        self.damage.unverified += sum(1 for opcode, _ in records_in(kept) if opcode == Opcode.MESSAGE)
        if not kept:
            return None, None
        consumed = data_at + len(kept) if compression == "" else self.size - position
        return Chunk(position, kept, first, last, verified=False, cut=True), position + consumed

    def _is_start(self, position: int) -> bool:
        """Whether a record, the closing magic or the end of the file can be at `position`."""
        if position == self.size:
            return True
        head = self._bytes(position, 9)
        return head[:8] == MCAP0_MAGIC or 0 < head[0] <= Opcode.DATA_END or head[0] >= 0x80

    def _next_chunk(self, position: int) -> int:
        """Where the next chunk begins, or the end of the file."""
        while position < self.size:
            window = self._bytes(position, _WINDOW)
            for match in _LIKE_A_CHUNK.finditer(window):
                at = position + match.start()
                layout = _chunk_layout(self._bytes(at, _HEAD.size + _LOOK_AHEAD))
                if layout is not None and (at + layout.data_at + layout.stored <= self.size or layout.first <= layout.last):
                    return at
            if len(window) < _WINDOW:
                break
            position += _WINDOW - _LOOK_AHEAD
        return self.size

    @property
    def _has_summary(self) -> bool:
        """Whether the file's end says that there is a summary under a checksum."""
        start, _, crc = struct.unpack("<QQI", self._bytes(max(self.size - 28, 0), 20))
        return bool(start and crc)

    def _summary(self) -> bytes | None:
        """The summary section of a file that ends as it should, if its checksum is there and right."""
        footer = self._bytes(max(self.size - 37, 0), 37)
        if len(footer) < 37 or footer[29:] != MCAP0_MAGIC or _HEAD.unpack_from(footer) != (Opcode.FOOTER, 20):
            return None
        start, _, crc = struct.unpack_from("<QQI", footer, _HEAD.size)
        length = self.size - 37 - start
        if start == 0 or crc == 0 or not 0 <= length <= MAX_CHUNK:
            return None
        summary = self._bytes(start, length)
        return summary if zlib.crc32(footer[:25], zlib.crc32(summary)) == crc else None


class _Layout(NamedTuple):
    compression: str
    data_at: int
    stored: int
    first: int
    last: int
    size: int
    crc: int


def _chunk_layout(head: bytes) -> _Layout | None:
    """What the head of a chunk says; None where it contradicts itself."""
    if len(head) < _HEAD.size + _CHUNK.size + 8:
        return None
    _, length = _HEAD.unpack_from(head)
    first, last, size, crc, name_length = _CHUNK.unpack_from(head, _HEAD.size)
    name_at = _HEAD.size + _CHUNK.size
    if name_length > 16 or len(head) < name_at + name_length + 8:
        return None
    compression = head[name_at : name_at + name_length]
    (stored,) = struct.unpack_from("<Q", head, name_at + name_length)
    if compression not in (b"", b"lz4", b"zstd") or stored != length - _CHUNK.size - name_length - 8:
        return None
    if stored > MAX_CHUNK or size > MAX_CHUNK or (not compression and size != stored):
        return None
    return _Layout(compression.decode(), name_at + name_length + 8, stored, first, last, size, crc)


def _uncompressed(data: bytes, compression: str, size: int) -> tuple[bytes, bool]:
    """As much as `data` gives, up to `size` bytes, and whether that is all."""
    if compression == "":
        return data, len(data) == size
    pieces = bytearray()
    try:
        if compression == "lz4":
            lz4_frame = lz4.frame.LZ4FrameDecompressor()
            given = data
            while len(pieces) <= size and not lz4_frame.eof:
                piece = lz4_frame.decompress(given, max_length=_STEP)
                given = b""
                if not piece and lz4_frame.needs_input:
                    break
                pieces += piece
        else:
            with zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader(data) as stream:
                while len(pieces) <= size and (piece := stream.read(_STEP)):
                    pieces += piece
    except (RuntimeError, EOFError, zstandard.ZstdError):
        return bytes(pieces), False
    return bytes(pieces), len(pieces) == size


def records_in(records: bytes) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each whole record, up to the first that is none."""
    view, position = memoryview(records), 0
    while position + _HEAD.size <= len(view):
        opcode, length = _HEAD.unpack_from(view, position)
        position += _HEAD.size
        if length > len(view) - position:
            return
        yield opcode, view[position : position + length]
        position += length


def messages_in(records: bytes) -> Iterator[RawMessage]:
    """The messages among the records."""
    for opcode, content in records_in(records):
        if opcode == Opcode.MESSAGE and len(content) >= _MESSAGE.size:
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
            yield RawMessage(channel_id, sequence, log_time, publish_time, content[_MESSAGE.size :])


def collect(records: bytes, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    """Add the schemas and channels among the records."""
    for opcode, content in records_in(records):
        try:
            if opcode == Opcode.SCHEMA:
                schema = _parsed(Schema, _HEAD.pack(opcode, len(content)) + content)
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = _parsed(Channel, _HEAD.pack(opcode, len(content)) + content)
                channels[channel.id] = channel
        except _UNREADABLE:
            continue


def _whole_records(records: bytes, first: int, last: int) -> bytes:
    """The records up to the first that a chunk with messages between the two times cannot have."""
    kept = 0
    for opcode, content in records_in(records):
        if opcode not in _INSIDE:
            break
        if opcode == Opcode.MESSAGE and not (len(content) >= _MESSAGE.size and first <= _MESSAGE.unpack_from(content)[2] <= last):
            break
        kept += _HEAD.size + len(content)
    return records[:kept]


def _parsed(kind: type[_Small], data: bytes) -> _Small:
    """A record by the mcap package. Raises one of `_UNREADABLE` where it contradicts itself."""
    record = next(StreamReader(BytesIO(data), skip_magic=True).records)
    assert isinstance(record, kind)  # as its opcode says
    return record


def _check_attachment(record: bytes) -> None:
    """Raise ValueError where the checksum of an attachment's content is wrong."""
    if zlib.crc32(record[_HEAD.size : -4]) != struct.unpack("<I", record[-4:])[0]:
        raise ValueError("checksum")


_UNREADABLE = (EndOfFile, ValueError, struct.error, UnicodeDecodeError, MemoryError, OverflowError)
_SKIPPED = (
    Opcode.HEADER, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
)  # fmt: skip
