"""A take from its rig: the sources, the file and the recorder that joins them."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

from cabinpose.core import CabinposeError
from cabinpose.record.config import Rig
from cabinpose.record.host import host_facts
from cabinpose.record.lane import Lane
from cabinpose.record.recorder import Recorder
from cabinpose.record.split import Limit, SplitWriter
from cabinpose.signals import HostClock
from cabinpose.store.recording import RecordingWriter


def begin(rig: Rig, out: Path, clock: HostClock) -> Recorder:
    """Open every source of a rig and record.

    Parameters
    ----------
    rig
        The checked rig.
    out
        The file to write, or the first of several where the rig splits takes.
    clock
        Stamps and waits, of the recorder and of all sources.

    Returns
    -------
    Recorder
        Running; `stop` ends the take.

    Raises
    ------
    RecordingError
        Where a file of the take exists or a source cannot be opened (or what a source raises of its family); nothing is left
        behind then.
    """
    storage, wake = rig.storage, threading.Event()
    queue_bytes = int(storage.queue_mb * 1e6)
    lanes = [
        Lane(plan.build(clock), plan.kind, clock, wake, queue_bytes=queue_bytes, queue_s=storage.queue_s) for plan in rig.sources
    ]
    return start_recorder(rig, lanes, out, clock, wake)


def start_recorder(rig: Rig, lanes: Sequence[Lane], out: Path, clock: HostClock, wake: threading.Event) -> Recorder:
    """Record lanes that have not begun, as the rig's storage says; `begin` names arguments and errors."""
    storage, started_ns, host = rig.storage, clock.now_ns(), host_facts()

    def make(path: Path, part: int | None) -> RecordingWriter:
        return RecordingWriter(
            path,
            rig.take,
            rig=rig.text,
            host=host,
            started_ns=started_ns,
            compression=storage.compression,
            chunk_bytes=int(storage.chunk_mb * 1e6),
            flush_s=storage.flush_s,
            sync_s=storage.sync_s,
            part=part,
        )

    writer = SplitWriter(out, make, clock, None if storage.split_every is None else Limit.of(storage.split_every))
    recorder = Recorder(lanes, writer, clock, wake, min_free_bytes=int(storage.min_free_mb * 1e6))
    try:
        recorder.start()
    except CabinposeError:
        out.unlink()
        raise
    return recorder
