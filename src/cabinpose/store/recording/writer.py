"""Writing a recording: samples of several sources into one MCAP file that can be read at every instant.

A chunk goes to the kernel when it is full or `flush_s` old, so that the death of the process loses no more than that. To survive
a power cut, a thread asks the disk every `sync_s` to write all of it; it is a thread of its own, since a disk may take long to
answer.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from cabinpose import __version__
from cabinpose.core import FULL_DISK, RecordingError, unwritable, whole_file
from cabinpose.signals import Sample
from cabinpose.store.part import sync
from cabinpose.store.recording.container import DEFINITIONS_S, Compression, ContainerWriter
from cabinpose.store.recording.messages import Record, encode, encode_json, encode_status
from cabinpose.store.recording.schemas import (
    FACTS,
    FORMAT,
    HOST_METADATA,
    HOST_ONLY,
    RAW,
    RAW_ENCODING,
    RIG_ATTACHMENT,
    STATUS,
    TAKE_METADATA,
    TAKE_TOPIC,
    SourceStatus,
    schema_record,
)
from cabinpose.store.recording.take import Take

LIBRARY = f"cabinpose {__version__}"
PROFILE = "cabinpose"
_About = tuple[tuple[str, str], ...]


@contextmanager
def whole_recording(path: Path) -> Iterator[Path]:
    """The name of a recording to write, which is called `path` when the block ends without an error, else is removed.

    Raises RecordingError where the disk refuses: in words of an output, since a writer's are of a recording that goes on.
    """
    with whole_file(path, kind=RecordingError) as partial:
        try:
            yield partial
        except RecordingError as error:
            cause = error.__cause__
            if isinstance(cause, OSError) and str(partial) in str(error):
                raise unwritable(path, cause, RecordingError) from cause
            raise


@contextmanager
def recording_errors(path: Path) -> Iterator[None]:
    """Turn what a disk or the system refuses into a RecordingError that says what it means for the recording."""
    try:
        yield
    except FileExistsError:
        raise RecordingError(f"{path} exists", hint="name another file: recordings are never overwritten") from None
    except OSError as error:
        if error.errno in FULL_DISK:
            raise RecordingError(
                f"no space left while writing {path}: the recording ends before this",
                hint="free disk space, or record to another disk; what was recorded so far is in the file",
            ) from error
        raise RecordingError(
            f"cannot write {path}: {error.strerror}", hint="`cabinpose recover` reads what is in the file, if it is there"
        ) from error


@dataclass(frozen=True, kw_only=True)
class Chunking:
    """How samples become chunks of a recording, and when the disk holds them.

    compression: of the chunks · chunk_bytes, flush_s: a chunk is closed when it is so large or so old · sync_s: pause between
    requests to the disk to hold all of the file; 0: only at the end · definitions_s: how often schemas and channels are repeated,
    so that a damaged file can be read. Infinite, with no call of `poll`: the same samples give the same bytes.
    """

    compression: Compression = "none"
    chunk_bytes: int = 4 << 20
    flush_s: float = 0.25
    sync_s: float = 1.0
    definitions_s: float = DEFINITIONS_S


class RecordingWriter:
    """Writes one recording; leaving the `with` block ends the file as it should.

    One thread uses it. Arrays of samples are referred to until their chunk is written, and must not change.
    """

    def __init__(
        self,
        path: Path,
        take: Take | None = None,
        *,
        rig: str = "",
        host: Mapping[str, str] | None = None,
        started_ns: int = 0,
        part: int | None = None,
        chunking: Chunking | None = None,
        **old: Any,
    ) -> None:
        """Makes the file.

        Parameters
        ----------
        path
            The file, which must not exist.
        take
            Who does what, where.
        rig
            The rig's configuration as YAML text, kept as an attachment.
        host
            Facts of the computer that records.
        started_ns
            `HostClock` time of the take.
        part
            The number of this file, from 0, of a take in several files.
        chunking
            When chunks are closed and the disk is asked to hold them.
        **old
            The fields of `chunking` as keywords, with a warning, for one release.

        Raises
        ------
        RecordingError
            Where the file exists or cannot be made.
        """
        chunking = chunking or Chunking()
        if old:
            chunking = replace(chunking, **old)  # TypeError for what was never a keyword
            told = f"RecordingWriter({', '.join(old)}) is RecordingWriter(chunking=Chunking(...)) now"
            warnings.warn(told, DeprecationWarning, stacklevel=2)
        self.path = path
        self._take = take or Take()
        self._chunk_bytes, self._flush_s = chunking.chunk_bytes, chunking.flush_s
        self._channels: dict[tuple[str, str, str, str, str, _About], int] = {}
        self._schemas: dict[str, int] = {}
        self._oldest: float | None = None  # time.monotonic of the first message in the open chunk
        self._closed = False
        self._samples: Counter[str] = Counter()
        self._in_chunk: Counter[str] = Counter()
        self._in_last_chunk: Counter[str] = Counter()
        with recording_errors(path):
            self._file = ContainerWriter(
                path,
                library=LIBRARY,
                profile=PROFILE,
                compression=chunking.compression,
                definitions_s=chunking.definitions_s,
            )
            values = {"format": FORMAT, "started_ns": str(started_ns), **self._take.as_metadata()}
            self._file.metadata(TAKE_METADATA, values if part is None else {**values, "part": str(part)})
            if host:
                self._file.metadata(HOST_METADATA, host)
            if rig:
                self._file.attachment(RIG_ATTACHMENT, "application/yaml", rig.encode(), log_time=started_ns)
            sync(path.parent)
        take_channel = self._channel("", TAKE_TOPIC, "cabinpose.Take", "none", "none", ())
        self._file.add(take_channel, 0, started_ns, started_ns, [encode_json(self._take.model_dump(mode="json"))])
        with recording_errors(path):
            self._file.end_chunk()
        self._stop = threading.Event()
        self._syncing = threading.Thread(target=self._sync, args=(chunking.sync_s,), name="recording-sync", daemon=True)
        if chunking.sync_s > 0:
            self._syncing.start()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @property
    def bytes_written(self) -> int:
        """Bytes that the kernel has."""
        return self._file.offset

    def samples(self, source: str) -> int:
        """Samples of a source that were written; where the disk refused some, after `close`, those that are in the file."""
        return self._samples[source]

    def write(self, source: str, sample: Sample) -> list[str]:
        """Add one sample of a source: its raw bytes, then what they mean.

        Returns why messages were left out, if any were: their arrays do not fit each other. The raw bytes are written in any
        case. Raises RecordingError where the disk refuses; samples of the open chunk are then lost.
        """
        refused: list[str] = []
        if not 0 <= sample.host_ns <= _LAST_NS:
            refused.append(f"{source}: {sample.host_ns} is no host time")
            sample = replace(sample, host_ns=0)
        records: list[Record] = []
        for message in sample.messages:
            try:
                records += encode(source, message, sample.host_ns)
            except RecordingError as error:
                refused.append(str(error))
        self._add(source, sample, Record(RAW, "", (sample.raw,)))
        for record in records:
            try:
                self._add(source, sample, record)
            except ValueError as error:
                refused.append(f"{source}/{record.topic}: {error}")
        self._samples[source] += 1
        self._in_chunk[source] += 1
        self._written()
        return refused

    def write_status(self, status: SourceStatus, host_ns: int) -> None:
        """Add the counts of a source."""
        channel = self._channel(status.source, STATUS, "cabinpose.SourceStatus", "none", "none", ())
        self._file.add(channel, 0, host_ns, host_ns, [encode_status(status)])
        self._written()

    def poll(self) -> None:
        """Close the chunk if it is old enough; to be called often."""
        if self._oldest is not None and time.monotonic() - self._oldest >= self._flush_s:
            self.flush()

    def flush(self) -> None:
        """Close the chunk: what was written so far outlives this process. Raises RecordingError where the disk refuses."""
        self._oldest = None
        with recording_errors(self.path), self._counted():
            self._file.end_chunk()

    def close(self) -> None:
        """End the file with its summary; harmless if it is closed. Raises RecordingError where the disk has no room for
        it: the file then ends without one, and readers go through it from its start.
        """
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        if self._syncing.is_alive():
            self._syncing.join()
        with recording_errors(self.path):
            try:
                self.flush()
            finally:
                try:
                    self._file.finish()
                finally:
                    if self._file.last_chunk_removed:
                        self._samples -= self._in_last_chunk

    @contextmanager
    def _counted(self) -> Iterator[None]:
        """Samples of a chunk that the disk refuses are not in the file."""
        in_chunk, self._in_chunk = self._in_chunk, Counter()
        try:
            yield
        except OSError:
            self._samples -= in_chunk
            raise
        self._in_last_chunk = in_chunk

    def _add(self, source: str, sample: Sample, record: Record) -> None:
        sequence = sample.sequence
        epoch = "none" if sequence is None else str(sequence >> 32)
        device = "none" if sample.device_ns is None else "device"
        untimed = sample.device_ns is None and record.topic in (RAW, FACTS)
        topic = record.topic + HOST_ONLY if untimed else record.topic
        channel = self._channel(source, topic, record.schema, epoch, device, record.about)
        time_of_device = sample.host_ns if sample.device_ns is None else sample.device_ns & _U64
        self._file.add(channel, (sequence or 0) & _U32, sample.host_ns, time_of_device, record.parts)

    def _channel(self, source: str, topic: str, schema: str, epoch: str, device: str, about: _About) -> int:
        key = (source, topic, schema, epoch, device, about)
        known = self._channels.get(key)
        if known is not None:
            return known
        schema_id, encoding = 0, RAW_ENCODING
        if schema:
            encoding, schema_encoding, data = schema_record(schema)
            if schema not in self._schemas:
                self._schemas[schema] = self._file.schema(schema, schema_encoding, data)
            schema_id = self._schemas[schema]
        facts = {"source": source, "sequence_epoch": epoch, "publish_time": device, **dict(about)}
        name = f"{source}/{topic}" if source else topic
        self._channels[key] = self._file.channel(name, encoding, schema_id, facts)
        return self._channels[key]

    def _written(self) -> None:
        if self._file.chunk_size >= self._chunk_bytes:
            self.flush()
        elif self._oldest is None:
            self._oldest = time.monotonic()

    def _sync(self, pause_s: float) -> None:
        while not self._stop.wait(pause_s):
            try:
                self._file.sync()
            except OSError:  # the writing thread meets the same error, and tells
                return


_U32, _U64 = (1 << 32) - 1, (1 << 64) - 1
_LAST_NS = (1 << 63) - 1
