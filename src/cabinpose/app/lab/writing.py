"""Writing what the sources of a virtual rig gave as one recording."""

from __future__ import annotations

import hashlib
import heapq
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from cabinpose.app.lab.clocks import Clock, Times
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.signals import Facts, Message, Sample
from cabinpose.store.recording import Chunking, RecordingWriter, Take


def samples(clock: Clock, true_ns: Times, host_ns: Times, messages: Callable[[int], tuple[Message, ...]]) -> Iterator[Sample]:
    """The samples of a source at true times (T,), which arrive at host_ns (T,); `messages(k)` is called one after the other."""
    for k, (device, host) in enumerate(zip(clock.stamps(true_ns).tolist(), host_ns.tolist(), strict=True)):
        yield Sample(k, host, device, b"", messages(k))


def write_recording(
    path: Path, rig: VirtualRig, take: Take, streams: Mapping[str, Iterable[Sample]], *, start_s: float = 0.0
) -> None:
    """Write samples by source, each in the order of arrival, as the recorder would: merged by arrival.

    start_s: when the take began, after the rig's start. The same samples make the same bytes. Raises RecordingError where the
    file exists.
    """

    def arrivals(source: str, samples: Iterable[Sample]) -> Iterator[tuple[int, str, Sample]]:
        return ((sample.host_ns, source, sample) for sample in samples)

    started_ns = rig.start_ns + round(start_s * 1e9)
    chunking = Chunking(compression="lz4", sync_s=0, definitions_s=math.inf)
    with RecordingWriter(path, take, started_ns=started_ns, chunking=chunking) as writer:
        named = False
        for _, source, sample in heapq.merge(*(arrivals(*stream) for stream in streams.items()), key=lambda row: row[:2]):
            if source == "tof" and not named:
                named = True
                sample = replace(sample, messages=(_camera(rig), *sample.messages))
            writer.write(source, sample)


def _camera(rig: VirtualRig) -> Facts:
    """What the camera of a rig says of itself: its serial number is that of the rig."""
    digest = hashlib.sha256(rig.model_dump_json().encode()).hexdigest()[:12]
    return Facts("camera", {"vendor": "virtual laboratory", "model": rig.sensor, "serial": digest})
