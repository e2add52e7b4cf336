"""A whole recording out of what is left of one: after a crash, a power cut, or with bits flipped."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Metadata, Schema

from cabinpose.core import RecordingError, whole_file
from cabinpose.store.recording.container import ContainerWriter
from cabinpose.store.recording.reader import sound_messages
from cabinpose.store.recording.scan import Chunk, Damage, Scanner
from cabinpose.store.recording.schemas import HOST_ONLY, RAW
from cabinpose.store.recording.writer import LIBRARY, PROFILE, recording_errors

RECOVERED_METADATA = "cabinpose.recovered"
_CHUNK_BYTES = 4 << 20


@dataclass(frozen=True)
class Recovered:
    """What was saved: messages, samples by source, host times of the first and last message (0 without one), the damage."""

    messages: int
    samples: dict[str, int]
    first_ns: int
    last_ns: int
    damage: Damage


def recover(damaged: Path, out: Path, *, progress: Callable[[int, int], None] = lambda *_: None) -> Recovered:
    """Copy every sound message, schema, channel, metadata record and attachment of an MCAP file to a new one with an index.

    Messages are copied byte by byte. Those of a sample that the end of the file cuts are left out: in a file with an end, the
    sample would pass for whole.

    Parameters
    ----------
    damaged
        The file, in whatever state.
    out
        The new file; it appears when it is whole.
    progress
        Called with the bytes done and those of the file.

    Raises
    ------
    RecordingError
        Where `out` exists, nothing can be read, or the disk refuses.
    """
    if out.exists():
        raise RecordingError(f"{out} exists", hint="name another file")
    with Scanner(damaged) as scanner:
        schemas, channels = scanner.definitions()
        beside = [found for found in scanner.walk() if not isinstance(found, Chunk)]
        if not channels and not beside:
            raise RecordingError(
                f"nothing in {damaged} can be recovered: no channel and no take was found in {scanner.size} bytes",
                hint="check that it is an MCAP file",
            )
        with recording_errors(out), whole_file(out, kind=RecordingError) as temporary:
            writer = ContainerWriter(temporary, library=LIBRARY, profile=PROFILE)
            result = _copy(scanner, writer, schemas, channels, beside, progress)
    return result


def _copy(
    scanner: Scanner,
    writer: ContainerWriter,
    schemas: Mapping[int, Schema],
    channels: Mapping[int, Channel],
    beside: Sequence[Metadata | Attachment],
    progress: Callable[[int, int], None],
) -> Recovered:
    try:
        for record in beside:
            if isinstance(record, Metadata):
                writer.metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                writer.attachment(
                    record.name, record.media_type, record.data, log_time=record.log_time, create_time=record.create_time
                )
        schema_ids = {0: 0} | {i: writer.schema(s.name, s.encoding, s.data) for i, s in sorted(schemas.items())}
        channels = {i: c for i, c in sorted(channels.items()) if c.schema_id in schema_ids}
        ids = {i: writer.channel(c.topic, c.message_encoding, schema_ids[c.schema_id], c.metadata) for i, c in channels.items()}
        raw = {
            i: c.metadata["source"]
            for i, c in channels.items()
            if "source" in c.metadata and c.topic.endswith((f"/{RAW}", f"/{RAW}{HOST_ONLY}"))
        }
        samples = dict.fromkeys(sorted(raw.values()), 0)
        count, first, last = 0, 0, 0
        for found in scanner.walk():
            if not isinstance(found, Chunk):
                continue
            for message in sound_messages(found, channels, scanner.damage):
                writer.add(ids[message.channel_id], message.sequence, message.log_time, message.publish_time, [message.data])
                first = message.log_time if count == 0 else min(first, message.log_time)
                last, count = max(last, message.log_time), count + 1
                if message.channel_id in raw:
                    samples[raw[message.channel_id]] += 1
            if writer.chunk_size >= _CHUNK_BYTES:
                writer.end_chunk()
            progress(found.offset, scanner.size)
        damage = scanner.damage
        writer.metadata(RECOVERED_METADATA, {"messages": str(count)} | {k: str(v) for k, v in asdict(damage).items()})
        writer.finish()
    finally:
        writer.close()
    return Recovered(count, samples, first, last, damage)
