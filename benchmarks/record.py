"""`cabinpose bench record`: MB/s into one file, and the samples that were dropped."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import psutil

from benchmarks import Say
from cabinpose.core.errors import ConfigError
from cabinpose.record.config import Rig, parse_rig
from cabinpose.record.session import begin
from cabinpose.signals.clock import HostClock
from cabinpose.store.recording import Recording

_WIDTH, _HEIGHT = 640, 576  # of an Azure Kinect's depth image, the largest in the field
_PIXEL_BYTES = 5  # depth and amplitude 2, confidence 1
_CAMERAS = 2
_SUIT_HZ, _SUIT_BYTES = 240.0, 760  # MVN's fastest stream
_SAY_S = 10.0


def run(*, seconds: float, rate_mb: float, folder: Path | None, say: Say) -> dict[str, Any]:
    """Record two emulated ToF cameras, raw bytes and decoded images, and an emulated suit, at a steady rate.

    The sources work in this process, so that the figures include their cost. Every sample is counted in the file afterwards.

    Parameters
    ----------
    seconds
        Length of the take, s.
    rate_mb
        MB/s of the sources; the frame rate follows from it.
    folder
        On the disk to measure; None: that of temporary files.
    say
        Called with the state every ten seconds.

    Returns
    -------
    dict
        mb_per_s into the file; dropped, lost: samples; peak_rss_mb and rss_mb over the take; cpu_share of one core;
        cpu_s_per_gb, which other load hardly changes; latency_ms: maximum time from arrival to file; frames_hz of a camera;
        accounted: whether written + dropped + lost = sent, by the samples found in the file.
    """
    if seconds <= 0 or rate_mb <= 0:
        raise ConfigError("a bench needs seconds and a rate", hint="give both more than 0")
    where = Path(tempfile.gettempdir()) if folder is None else folder
    needed = 1.3 * seconds * rate_mb * 1e6
    if shutil.disk_usage(where).free < needed:
        raise ConfigError(f"{where} has no room for {needed / 1e9:.1f} GB", hint="--folder on another disk, or fewer --seconds")
    load = list(os.getloadavg())
    with tempfile.TemporaryDirectory(prefix="cabinpose-bench-", dir=where) as name:
        result = _take(_rig(rate_mb), Path(name) / "bench.mcap", seconds, say)
    loads = {"before": load, "after": list(os.getloadavg())}
    return {"seconds": seconds, "cores": os.cpu_count(), "load_average": loads, **result}


def _rig(rate_mb: float) -> Rig:
    frame = _WIDTH * _HEIGHT * _PIXEL_BYTES
    rate = rate_mb * 1e6 / (_CAMERAS * 2 * frame)  # once raw and once decoded
    camera = {"kind": "numbered", "rate_hz": rate, "width": _WIDTH, "height": _HEIGHT, "raw_bytes": frame}
    suit = {"kind": "numbered", "rate_hz": _SUIT_HZ, "raw_bytes": _SUIT_BYTES}
    return parse_rig({"sources": {"tof_0": camera, "tof_1": camera, "suit": suit}})


def _take(rig: Rig, out: Path, seconds: float, say: Say) -> dict[str, Any]:
    process = psutil.Process()
    recorder = begin(rig, out, HostClock())
    began, cpu = time.monotonic(), time.process_time()
    rss: list[float] = []
    latency, said = 0.0, began
    while recorder.running and time.monotonic() - began < seconds:
        time.sleep(0.25)
        status = recorder.status()
        rss.append(process.memory_info().rss / 1e6)
        latency = max(latency, *(lane.latency_ms for lane in status.lanes))
        if time.monotonic() - said >= _SAY_S:
            said = time.monotonic()
            queues = ", ".join(f"{lane.counts.source} {100 * lane.queue:.0f} %" for lane in status.lanes)
            say(f"{status.elapsed_s:.0f} s, {status.bytes_written / 1e6:.0f} MB; queues {queues}")
    taken = time.monotonic() - began
    outcome = recorder.stop()
    cpu = time.process_time() - cpu
    with Recording(out) as recording:
        found = dict.fromkeys(recording.sources, 0)
        for place, _, _, _ in recording.records():
            found[place.source] = found.get(place.source, 0) + (place.topic == "raw")
    total = {key: sum(getattr(s, key) for s in outcome.sources) for key in ("written", "dropped", "lost", "received", "refused")}
    return {
        "mb_per_s": outcome.bytes_written / 1e6 / outcome.seconds,
        "bytes": outcome.bytes_written,
        **total,
        "accounted": all(found[s.source] == s.written == s.received - s.dropped for s in outcome.sources),
        "frames_hz": rig.sources[0].settings.model_dump()["rate_hz"],
        "latency_ms": latency,
        "cpu_share": cpu / taken,
        "cpu_s_per_gb": cpu / (outcome.bytes_written / 1e9),
        "peak_rss_mb": max(rss, default=0.0),
        "rss_mb": [round(x, 1) for x in rss[:: max(len(rss) // 30, 1)]],
        "error": None if outcome.error is None else str(outcome.error),
        "sources": {s.source: asdict(s) for s in outcome.sources},
    }
