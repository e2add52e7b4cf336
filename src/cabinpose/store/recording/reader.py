"""Reading a recording: the samples as their sources gave them, whether or not the file has its end."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Literal, NamedTuple

import numpy as np
from mcap.records import Attachment, Channel, Metadata

from cabinpose.core.errors import RecordingError
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import Message
from cabinpose.store.recording.messages import Decoder, decode_status
from cabinpose.store.recording.scan import Chunk, Damage, RawMessage, Scanner, messages_in
from cabinpose.store.recording.schemas import (
    FORMAT,
    HOST_METADATA,
    HOST_ONLY,
    RAW,
    RIG_ATTACHMENT,
    STATUS,
    TAKE_METADATA,
    TAKE_TOPIC,
    SourceStatus,
)
from cabinpose.store.recording.take import Take

_END = 1 << 64


class Place(NamedTuple):
    """Where a message stands: the source, the last part of the topic, and the times and number of its sample."""

    source: str
    topic: str
    sequence: int | None
    host_ns: int
    device_ns: int | None


@dataclass(frozen=True)
class Head:
    """What a file says of itself before its first chunk."""

    take: Take
    rig: str
    started_ns: int
    format: str
    host: dict[str, str]


class Recording:
    """A recording, read lazily, in the order in which it was written.

    damaged: what to do where a checksum is wrong or bytes belong to nothing: raise RecordingError at the end of the walk, or
    skip; `damage` says what was found. A file without its end is read as far as it goes, in either case.
    """

    def __init__(self, path: Path, *, damaged: Literal["raise", "skip"] = "raise") -> None:
        """Raises RecordingError where the file cannot be read or is no recording of this version."""
        self.path = path
        self._damaged = damaged
        self._scanner = Scanner(path)
        try:
            self.head = read_head(self._scanner)
        except RecordingError:
            self.close()
            raise

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._scanner.close()

    @property
    def take(self) -> Take:
        """What was recorded."""
        return self.head.take

    @property
    def damage(self) -> Damage:
        """What was wrong with the file on the last walk through all of it."""
        return self._scanner.damage

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources that gave samples."""
        named = (channel.metadata.get("source", "") for channel in self.channels.values())
        return tuple(sorted({name for name in named if name}))

    @cached_property
    def channels(self) -> dict[int, Channel]:
        """Channels by their ids."""
        return self._definitions[1]

    @cached_property
    def _definitions(self) -> tuple[dict[int, str], dict[int, Channel]]:
        schemas, channels = self._scanner.definitions()
        return {i: schema.name for i, schema in schemas.items()}, channels

    def records(
        self, sources: Collection[str] | None = None, *, start_ns: int = 0, end_ns: int = _END
    ) -> Iterator[tuple[Place, str, Channel, memoryview]]:
        """Place, schema name, channel and bytes of each message, of the named sources (None: all), host time in the span."""
        names, channels = self._definitions
        wanted = {i for i, c in channels.items() if sources is None or c.metadata.get("source", "") in sources}
        for found in self._scanner.walk(start_ns, end_ns):
            if not isinstance(found, Chunk):
                continue
            for message in sound_messages(found, channels, self.damage):
                if message.channel_id in wanted and start_ns <= message.log_time < end_ns:
                    channel = channels[message.channel_id]
                    yield _place(channel, message), names.get(channel.schema_id, ""), channel, message.data
        found_damage = self.damage
        if self._damaged == "raise" and (found_damage.chunks or (found_damage.skipped_bytes and found_damage.whole)):
            raise RecordingError(
                f"{self.path} is damaged: {found_damage.chunks} chunks with a wrong checksum, "
                f"{found_damage.skipped_bytes} bytes that belong to nothing",
                hint="`cabinpose recover` makes a recording of what is sound",
            )

    def samples(
        self, sources: Collection[str] | None = None, *, start_ns: int = 0, end_ns: int = _END
    ) -> Iterator[tuple[str, Sample]]:
        """Name of the source and sample, for each sample of the named sources (None: all) with its host time in the span."""
        decoders: dict[str, Decoder] = {}
        place: Place | None = None
        raw, messages = b"", list[Message]()
        for here, schema, channel, data in self.records(sources, start_ns=start_ns, end_ns=end_ns):
            if here.topic in (STATUS, TAKE_TOPIC) or not here.source:
                continue
            decoder = decoders.setdefault(here.source, Decoder())
            if place is None or here.topic == RAW or place[0] != here.source or place[2:] != here[2:]:
                if place is not None:
                    yield place.source, Sample(place.sequence, place.host_ns, place.device_ns, raw, tuple(messages))
                place, raw, messages = here, b"", []
                decoder.begin_sample()
            if here.topic == RAW:
                raw = bytes(data)
            elif (message := decoder(here.topic, schema, channel.metadata, data)) is not None:
                messages.append(message)
        if place is not None:
            yield place.source, Sample(place.sequence, place.host_ns, place.device_ns, raw, tuple(messages))

    def statuses(self) -> dict[str, list[tuple[int, SourceStatus]]]:
        """Host time and counts of each source, in the order of time."""
        found: dict[str, list[tuple[int, SourceStatus]]] = {}
        for place, schema, _, data in self.records():
            if place.topic == STATUS and schema == "cabinpose.SourceStatus":
                found.setdefault(place.source, []).append((place.host_ns, decode_status(data)))
        return found


def sound_messages(chunk: Chunk, channels: Mapping[int, Channel], damage: Damage) -> Iterator[RawMessage]:
    """The messages of a chunk that have a channel, without the sample that a cut may have taken messages from.

    A sample is written as its raw bytes and then what they mean, so only what follows tells that it is whole. What is left out
    is counted in `damage`.
    """
    messages = [message for message in messages_in(chunk.records) if message.channel_id in channels]
    damage.orphans += sum(1 for _ in messages_in(chunk.records)) - len(messages)
    if chunk.cut and messages and not _is_beside(channels[messages[-1].channel_id]):
        begins = [i for i, message in enumerate(messages) if _topic(channels[message.channel_id]) == RAW]
        if begins:
            damage.unfinished += 1
            damage.unverified -= len(messages) - begins[-1]
            del messages[begins[-1] :]
    yield from messages


def _place(channel: Channel, message: RawMessage) -> Place:
    facts = channel.metadata
    epoch = facts.get("sequence_epoch", "none")
    sequence = None if epoch == "none" else (int(epoch) << 32) + message.sequence
    device = None if facts.get("publish_time") != "device" else int(np.uint64(message.publish_time).astype(np.int64))
    return Place(facts.get("source", ""), _topic(channel), sequence, message.log_time, device)


def _topic(channel: Channel) -> str:
    """The last part of a topic's name, behind the source; the same for what has no time of its device."""
    source = channel.metadata.get("source", "")
    return (channel.topic[len(source) + 1 :] if source else channel.topic).removesuffix(HOST_ONLY)


def _is_beside(channel: Channel) -> bool:
    """Whether messages of the channel belong to no sample."""
    return _topic(channel) in (STATUS, TAKE_TOPIC) or not channel.metadata.get("source")


def read_head(scanner: Scanner) -> Head:
    """The take and the rig of a file, which may be without its end. Raises RecordingError where it has none."""
    values: dict[str, str] | None = None
    take: Take | None = None
    host: dict[str, str] = {}
    rig, chunks = "", 0
    for found in scanner.walk():
        if isinstance(found, Metadata) and found.name == TAKE_METADATA and values is None:
            values = found.metadata
        elif isinstance(found, Metadata) and found.name == HOST_METADATA:
            host = found.metadata
        elif isinstance(found, Attachment) and found.name == RIG_ATTACHMENT:
            rig = found.data.decode("utf-8", "replace")
        elif isinstance(found, Chunk):
            take = take or _take_in(found)
            chunks += 1
            if values is not None or chunks > _HEAD_CHUNKS:
                break
    if values is None and take is None:
        raise RecordingError(f"{scanner.path} is no recording of cabinpose", hint="give a file of `cabinpose record`")
    values = values or {}
    version = values.get("format", FORMAT)
    if version != FORMAT:
        raise RecordingError(f"{scanner.path} has format {version}, this program reads format {FORMAT}", hint="upgrade cabinpose")
    started = values.get("started_ns", "0")
    try:
        take = take or Take.from_metadata(values)
    except ValueError as error:
        raise RecordingError(f"{scanner.path}: its take cannot be read: {error}", hint="check the file by hand") from error
    return Head(take, rig, int(started) if started.isdigit() else 0, version, host)


_HEAD_CHUNKS = 8  # in which the take is looked for where its metadata record is lost


def _take_in(chunk: Chunk) -> Take | None:
    """The take that the first messages of a verified chunk state: unlike the metadata record, they are under a checksum."""
    if not chunk.verified:
        return None
    for message in messages_in(chunk.records):
        try:
            return Take.model_validate_json(bytes(message.data))
        except ValueError:
            return None
    return None
