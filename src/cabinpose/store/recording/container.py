"""MCAP as a recorder needs it: chunks that are closed when the clock says so, written in one call without copying images.

The `mcap` package closes a chunk only when it is full and copies each message five times on its way to the file. Here a
chunk is a list of buffers that goes to the kernel with `writev`; all other records are those of the `mcap` package. When
`end_chunk` has returned, the chunk is with the kernel and survives the death of the process; after `sync`, a power cut too.

Specification: https://mcap.dev/spec (version 0).
"""

from __future__ import annotations

import os
import struct
import time
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, TypeAlias

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

Buffer: TypeAlias = bytes | bytearray | memoryview
Compression = Literal["none", "lz4", "zstd"]
MAX_CHANNELS = 4096
"""Channels of one file: a device that keeps renaming its subjects must not fill memory."""
DEFINITIONS_S = 10.0
"""Pause between repetitions of schemas and channels, so that losing the first chunk loses that chunk alone."""
_REFERENCED = 16384  # bytes from which a buffer is not copied into the chunk
_VECTORS = 512  # buffers of one call; Linux takes 1024


class _Open:
    """The chunk that is being filled."""

    def __init__(self) -> None:
        self.parts: list[Buffer] = []
        self.small = bytearray()  # what follows the last of `parts`
        self.parts_size = 0
        self.index: dict[int, list[int]] = {}  # times and places of the messages, by channel
        self.start = self.end = self.messages = 0

    @property
    def size(self) -> int:
        return self.parts_size + len(self.small)

    def refer(self, view: memoryview) -> None:
        """Add bytes without copying them."""
        self.parts += [self.small, view]
        self.parts_size += len(self.small) + len(view)
        self.small = bytearray()


class ContainerWriter:
    """Writes one MCAP file. One thread uses it, except for `sync`.

    Buffers given to `add` may be kept until the chunk is closed and must not change. An OSError of the disk leaves the file
    as it was after the last whole chunk, of which `finish` can still make a readable file.
    """

    def __init__(
        self,
        path: Path,
        *,
        library: str,
        profile: str = "",
        compression: Compression = "none",
        definitions_s: float = DEFINITIONS_S,
    ) -> None:
        """Creates the file. definitions_s: as DEFINITIONS_S. Raises FileExistsError if there is one."""
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        self.offset = 0
        self._compression = "" if compression == "none" else compression
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._definitions_s, self._defined_at = definitions_s, time.monotonic()
        self._chunk_indexes = bytearray()
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._statistics = Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)
        self._open = _Open()
        self.last_chunk_removed = False
        self._write([MCAP0_MAGIC, _bytes(Header(profile, library))])
        self._last_chunk = self.offset

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """The id of a new schema."""
        schema = Schema(len(self._schemas) + 1, data, encoding, name)
        self._schemas[schema.id] = schema
        self._open.small += _bytes(schema)
        return schema.id

    def channel(self, topic: str, message_encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """The id of a new channel; schema 0 = none. Raises ValueError beyond `MAX_CHANNELS`, or where a text is not UTF-8."""
        if len(self._channels) >= MAX_CHANNELS:
            raise ValueError(f"more than {MAX_CHANNELS} channels")
        channel = Channel(len(self._channels) + 1, topic, message_encoding, dict(metadata), schema_id)
        record = _bytes(channel)  # before it is known: text that cannot be encoded raises here
        self._channels[channel.id] = channel
        self._open.small += record
        return channel.id

    def add(self, channel_id: int, sequence: int, log_time: int, publish_time: int, parts: Sequence[Buffer]) -> None:
        """Add a message to the chunk; its data are the parts, one after the other (C-contiguous bytes)."""
        chunk = self._open
        views = [memoryview(part).cast("B") for part in parts]
        size = sum(map(len, views))
        chunk.index.setdefault(channel_id, []).extend((log_time, chunk.size))
        chunk.small += _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - 9 + size, channel_id, sequence, log_time, publish_time)
        for view in views:
            if len(view) < _REFERENCED:
                chunk.small += view
            else:
                chunk.refer(view)
        chunk.start = log_time if chunk.messages == 0 else min(chunk.start, log_time)
        chunk.end = max(chunk.end, log_time)
        chunk.messages += 1

    @property
    def chunk_size(self) -> int:
        """Bytes in the open chunk."""
        return self._open.size

    def end_chunk(self) -> None:
        """Hand the open chunk to the kernel, if it has messages. Raises OSError; the messages of the chunk are then lost."""
        chunk = self._open
        if not chunk.messages:
            return
        self._open = _Open()
        size, parts = chunk.size, [*chunk.parts, chunk.small]
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        stored = list(_compressed(parts, size, self._compression))
        stored_size = sum(map(len, stored))
        name = self._compression.encode()
        head = _CHUNK.pack(Opcode.CHUNK, 40 + len(name) + stored_size, chunk.start, chunk.end, size, crc, len(name))
        head += name + struct.pack("<Q", stored_size)
        offset, length = self.offset, len(head) + stored_size
        indexes, offsets = bytearray(), {}
        for channel_id, records in chunk.index.items():
            offsets[channel_id] = offset + length + len(indexes)
            indexes += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + 8 * len(records), channel_id, 8 * len(records))
            indexes += struct.pack(f"<{len(records)}Q", *records)
        self._write([head, *stored, indexes])
        self._last_chunk = offset
        self._chunk_indexes += _bytes(
            ChunkIndex(length, offset, self._compression, stored_size, chunk.end, len(indexes), offsets, chunk.start, size)
        )
        self._count(chunk)
        if time.monotonic() - self._defined_at >= self._definitions_s:
            self._defined_at = time.monotonic()
            self._open.small += self._definitions()

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self.end_chunk()
        record = _bytes(Metadata(name, dict(values)))
        index = MetadataIndex(self.offset, len(record), name)
        self._write([record])
        self._metadata_indexes.append(index)

    def attachment(self, name: str, media_type: str, data: bytes, *, log_time: int, create_time: int = 0) -> None:
        """Write an attachment."""
        self.end_chunk()
        record = _bytes(Attachment(create_time, log_time, name, media_type, data))
        index = AttachmentIndex(self.offset, len(record), log_time, create_time, len(data), name, media_type)
        self._write([record])
        self._attachment_indexes.append(index)

    def sync(self) -> None:
        """Wait until what was handed to the kernel would survive a power cut; other threads may write meanwhile."""
        os.fdatasync(self._fd)

    def finish(self) -> None:
        """End the file with its summary, and close it.

        Where the disk has no room for the summary, the file ends without one, at the cost of the last chunk if need be:
        readers then go through it from the start. Raises the OSError after that.
        """
        problem: OSError | None = None
        try:
            try:
                self.end_chunk()
            except OSError as error:
                problem = error
            data_end = self.offset
            try:
                self._write([_bytes(DataEnd(0)), *self._summary(data_end + 13)])
            except OSError as error:
                problem = error
                self._end_without_summary((data_end, self._last_chunk))
            os.fsync(self._fd)
        finally:
            self.close()
        if problem is not None:
            raise problem

    def close(self) -> None:
        """Close the file as it is; harmless if it is closed."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _write(self, parts: Iterable[Buffer]) -> None:
        """All parts at the end of the file, or the file as it was before and OSError."""
        views = [view for part in parts if len(view := memoryview(part).cast("B"))]
        written = 0
        try:
            while views:
                count = os.writev(self._fd, views[:_VECTORS])
                written += count
                done = 0
                while done < len(views) and count >= len(views[done]):
                    count -= len(views[done])
                    done += 1
                del views[:done]
                if count:
                    views[0] = views[0][count:]
        except OSError:
            os.ftruncate(self._fd, self.offset)
            os.lseek(self._fd, self.offset, os.SEEK_SET)
            raise
        self.offset += written

    def _count(self, chunk: _Open) -> None:
        total = self._statistics
        total.message_start_time = min(total.message_start_time, chunk.start) if total.message_count else chunk.start
        total.message_end_time = max(total.message_end_time, chunk.end)
        total.message_count += chunk.messages
        total.chunk_count += 1
        for channel_id, records in chunk.index.items():
            total.channel_message_counts[channel_id] = total.channel_message_counts.get(channel_id, 0) + len(records) // 2

    def _definitions(self) -> bytes:
        return b"".join(map(_bytes, [*self._schemas.values(), *self._channels.values()]))

    def _summary(self, start: int) -> list[bytes]:
        """Summary, offsets, footer and magic of a summary that begins at `start`."""
        total = self._statistics
        total.schema_count, total.channel_count = len(self._schemas), len(self._channels)
        total.attachment_count, total.metadata_count = len(self._attachment_indexes), len(self._metadata_indexes)
        groups = [
            (Opcode.SCHEMA, b"".join(map(_bytes, self._schemas.values()))),
            (Opcode.CHANNEL, b"".join(map(_bytes, self._channels.values()))),
            (Opcode.STATISTICS, _bytes(total)),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, b"".join(map(_bytes, self._attachment_indexes))),
            (Opcode.METADATA_INDEX, b"".join(map(_bytes, self._metadata_indexes))),
        ]
        summary, offsets = bytearray(), bytearray()
        for opcode, data in groups:
            if data:
                offsets += _bytes(SummaryOffset(opcode, start + len(summary), len(data)))
                summary += data
        offsets_start = start + len(summary)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(footer, zlib.crc32(offsets, zlib.crc32(summary)))
        return [bytes(summary), bytes(offsets), footer + struct.pack("<I", crc), MCAP0_MAGIC]

    def _end_without_summary(self, ends: Iterable[int]) -> None:
        """End the file in the shortest valid way, after the first of the offsets at which the disk has room for that."""
        for end in ends:
            os.ftruncate(self._fd, end)
            os.lseek(self._fd, end, os.SEEK_SET)
            self.last_chunk_removed = end != self.offset
            self.offset = end
            try:
                self._write([_bytes(DataEnd(0)), _bytes(Footer(0, 0, 0)), MCAP0_MAGIC])
            except OSError:
                continue
            return


_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_CHUNK = struct.Struct("<BQQQQII")  # opcode, length, start, end, uncompressed size, its CRC, length of the compression's name
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of (time, offset) pairs


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _compressed(parts: Iterable[Buffer], size: int, compression: str) -> Iterable[Buffer]:
    """The parts as one frame of the compression; themselves where there is none."""
    if compression == "lz4":
        lz4_frame = lz4.frame.LZ4FrameCompressor()
        yield lz4_frame.begin(source_size=size)
        for part in parts:
            yield lz4_frame.compress(part)
        yield lz4_frame.flush()
    elif compression == "zstd":
        zstd_frame = zstandard.ZstdCompressor(level=1).compressobj(size=size)
        for part in parts:
            yield zstd_frame.compress(part)
        yield zstd_frame.flush()
    else:
        yield from parts
