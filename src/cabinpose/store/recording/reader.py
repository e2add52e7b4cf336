"""Reading a recording: the samples as their sources gave them, whether or not the file has its end."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Literal, NamedTuple

import numpy as np
from mcap.records import Channel

from cabinpose.core import RecordingError
from cabinpose.signals import Message, Sample
from cabinpose.store.recording.files import files_of_take, read_head
from cabinpose.store.recording.messages import Decoder, decode_status
from cabinpose.store.recording.scan import Chunk, Damage, RawMessage, Scanner, messages_in
from cabinpose.store.recording.schemas import HOST_ONLY, RAW, STATUS, TAKE_TOPIC, SourceStatus
from cabinpose.store.recording.take import Take

_END = 1 << 64


class Place(NamedTuple):
    """Where a message stands: the source, the last part of the topic, and the times and number of its sample."""

    source: str
    topic: str
    sequence: int | None
    host_ns: int
    device_ns: int | None


class Recording:
    """A recording, read lazily, in the order in which it was written; of one file, or of all files of a split take.

    damaged: what to do where a checksum is wrong or bytes belong to nothing: raise RecordingError at the end of the walk, or
    skip; `damage` says what was found. A file without its end is read as far as it goes, in either case.
    """

    def __init__(self, path: Path, *, damaged: Literal["raise", "skip"] = "raise") -> None:
        """path: a file, the first file of a take, or its folder. Raises RecordingError where a file cannot be read, is no
        recording of this version, or is missing between others.
        """
        self._damaged = damaged
        self.files = files_of_take(path, damaged=damaged)
        self.path = self.files[0]
        self._scanners = [Scanner(file) for file in self.files]
        try:
            self.head = read_head(self._scanners[0])
        except RecordingError:
            self.close()
            raise

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for scanner in self._scanners:
            scanner.close()

    @property
    def take(self) -> Take:
        """What was recorded."""
        return self.head.take

    @property
    def damage(self) -> Damage:
        """What was wrong with the files on the last walk through all of them; whole: each has its end."""
        found = [scanner.damage for scanner in self._scanners]
        counts = {field.name: sum(getattr(each, field.name) for each in found) for field in fields(Damage)}
        return Damage(**counts | {"whole": all(each.whole for each in found)})

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources that gave samples."""
        named = {channel.metadata.get("source", "") for _, channels in self._definitions for channel in channels.values()}
        return tuple(sorted(named - {""}))

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the sources that give frames of a ToF camera."""
        topics = self.topics
        return tuple(name for name in self.sources if f"{name}/depth" in topics)

    @property
    def topics(self) -> set[str]:
        """Names of the topics that have messages or could have."""
        return {channel.topic for _, channels in self._definitions for channel in channels.values()}

    @cached_property
    def _definitions(self) -> list[tuple[dict[int, str], dict[int, Channel]]]:
        """Of each file, the names of its schemas and its channels, by their ids."""
        found = [scanner.definitions() for scanner in self._scanners]
        return [({i: schema.name for i, schema in schemas.items()}, channels) for schemas, channels in found]

    def records(
        self, sources: Collection[str] | None = None, *, start_ns: int = 0, end_ns: int = _END
    ) -> Iterator[tuple[Place, str, Channel, memoryview]]:
        """Place, schema name, channel and bytes of each message, of the named sources (None: all), host time in the span."""
        for scanner, (names, channels) in zip(self._scanners, self._definitions, strict=True):
            wanted = {i for i, c in channels.items() if sources is None or c.metadata.get("source", "") in sources}
            for found in scanner.walk(start_ns, end_ns):
                if not isinstance(found, Chunk):
                    continue
                for message in sound_messages(found, channels, scanner.damage):
                    if message.channel_id in wanted and start_ns <= message.log_time < end_ns:
                        channel = channels[message.channel_id]
                        yield _place(channel, message), names.get(channel.schema_id, ""), channel, message.data
            damage = scanner.damage
            if self._damaged == "raise" and (damage.chunks or (damage.skipped_bytes and damage.whole)):
                raise RecordingError(
                    f"{scanner.path} is damaged: {damage.chunks} chunks with a wrong checksum, "
                    f"{damage.skipped_bytes} bytes that belong to nothing",
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
