"""A take from its rig: the sources, the file and the recorder that joins them, and what the computer is meanwhile."""

from __future__ import annotations

import hashlib
import platform
import threading
from collections.abc import Sequence
from pathlib import Path

from cabinpose.record.config import Rig
from cabinpose.record.lane import Lane
from cabinpose.record.recorder import Recorder
from cabinpose.record.split import Limit, SplitWriter
from cabinpose.signals import HostClock
from cabinpose.store.recording import Chunking, RecordingWriter

_CLOCK = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_INTERFACES = Path("/sys/class/net")


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

    chunking = Chunking(
        compression=storage.compression, chunk_bytes=int(storage.chunk_mb * 1e6), flush_s=storage.flush_s, sync_s=storage.sync_s
    )  # fmt: skip

    def make(path: Path, part: int | None) -> RecordingWriter:
        return RecordingWriter(
            path, rig.take, rig=rig.text, host=host, started_ns=started_ns, part=part, chunking=chunking
        )  # fmt: skip

    writer = SplitWriter(out, make, clock, None if storage.split_every is None else Limit.of(storage.split_every))
    recorder = Recorder(lanes, writer, clock, wake, min_free_bytes=int(storage.min_free_mb * 1e6))
    try:
        recorder.start()
    except BaseException:  # Ctrl-C while a device does not answer, too
        out.unlink()
        raise
    return recorder


def host_facts(clock: Path = _CLOCK, interfaces: Path = _INTERFACES) -> dict[str, str]:
    """The computer (a hash of its name), its kernel, its clock source, and each network interface that is up: the delays of a
    calibration hold as long as these stay.

    clock, interfaces: where Linux states them. Where another system does not, they are left out.
    """
    facts = {
        "computer": hashlib.sha256(platform.node().encode()).hexdigest()[:12],
        "kernel": f"{platform.system()} {platform.release()}",
    }
    if found := _read(clock):
        facts["clock source"] = found
    for interface in sorted(interfaces.glob("*")):
        if _read(interface / "operstate") == "up":
            speed = _read(interface / "speed")  # -1 where the interface has none, as a wireless one
            rate = f", {speed} Mb/s" if speed and int(speed) > 0 else ""
            facts[f"network {interface.name}"] = f"MTU {_read(interface / 'mtu')}{rate}"
    return facts


def _read(path: Path) -> str:
    """The one line of a file of the kernel, "" where it has none."""
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""
