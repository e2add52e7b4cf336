"""What survives: kill -9 at any instant, and a disk that is full."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from cabinpose.signals.recorded import Sample
from cabinpose.store.recording import Recording, recover
from cabinpose.store.recording.container import ContainerWriter

SUBJECT = Path(__file__).with_name("crash_subject.py")
LOST_S = 1.0


def killed(
    out: Path, after_s: float, storage: dict[str, Any], tof: dict[str, Any] | None = None
) -> dict[str, list[tuple[int, int]]]:
    """Host time and number of each sample that a recording process sent before it was killed, `after_s` after the first."""
    environment = {**os.environ, "STORAGE": json.dumps(storage), "TOF": json.dumps(tof or {})}
    told = out.with_suffix(".txt")  # not a pipe: one that is full would hold up the device
    with told.open("w") as file, subprocess.Popen([sys.executable, SUBJECT, out, "0"], stdout=file, env=environment) as process:
        try:
            limit = time.monotonic() + 60
            while not told.stat().st_size:
                assert time.monotonic() < limit
                time.sleep(0.01)
            time.sleep(after_s)
        finally:
            process.kill()
    lines = told.read_text().splitlines(keepends=True)
    sent: dict[str, list[tuple[int, int]]] = {}
    for line in lines:
        if line.endswith("\n") and not line.startswith(("end", "error")):
            source, host_ns, number = line.split()
            sent.setdefault(source, []).append((int(host_ns), int(number)))
    return sent


def check_killed(folder: Path, after_s: float, storage: dict[str, Any], tof: dict[str, Any] | None = None) -> tuple[float, int]:
    """Seconds that were lost at the end, and samples before that; the mcap package opens the recovered file."""
    sent = killed(folder / "take.mcap", after_s, storage, tof)
    recover(folder / "take.mcap", folder / "fixed.mcap")
    with (folder / "fixed.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    with Recording(folder / "fixed.mcap") as recording:
        found: dict[str, list[tuple[int, int]]] = {}
        cut: Sample | None = None
        for source, sample in recording.samples():
            if not sample.messages:  # the kill came while its chunk was written: the bytes are there, the image is not
                cut = sample
                continue
            assert cut is None, "only the last of all is cut"
            assert sample.sequence is not None
            found.setdefault(source, []).append((sample.host_ns, sample.sequence))
        assert not recording.damage.any
    lost, dropped = 0.0, 0
    for source, given in sent.items():
        kept = found.get(source, [])
        assert kept == sorted(set(kept))
        there = [sample for sample in given if sample <= kept[-1]] if kept else []
        assert {sample for sample in kept if sample <= given[-1]} <= set(there)  # the last may be in the file and not yet told
        dropped += len(there) - len(set(there) & set(kept))
        missing = given[len(there) :]
        if missing:
            lost = max(lost, (given[-1][0] - missing[0][0]) / 1e9)
    return lost, dropped


@contextmanager
def busy_cores(count: int) -> Iterator[None]:
    """Processes that each keep a core busy."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


@pytest.mark.parametrize(("seed", "compression"), [(1, "none"), (2, "none"), (3, "lz4"), (4, "zstd")])
def test_kill_9_costs_less_than_a_second(tmp_path: Path, seed: int, compression: str) -> None:
    rng = np.random.default_rng(seed)
    lost, dropped = check_killed(tmp_path, float(rng.uniform(1.5, 2.5)), {"compression": compression})
    assert lost < LOST_S
    assert dropped == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_kill_9_on_a_busy_machine_costs_what_the_rig_allows(tmp_path: Path, seed: int) -> None:
    """Two busy cores, and a camera that gives 28 MB/s."""
    after_s = float(np.random.default_rng(seed).uniform(1.5, 3.5))
    storage = {"queue_s": 0.75, "flush_s": 0.25}
    with busy_cores(2):
        lost, _ = check_killed(tmp_path, after_s, storage, {"width": 640, "height": 480, "rate_hz": 18})
    assert lost <= LOST_S


def test_half_a_write_is_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes a part of a chunk and refuses the rest; with room again, the file is whole and has its index."""
    writer = ContainerWriter(tmp_path / "a.mcap", library="test")
    channel = writer.channel("a", "octet-stream", 0, {})
    writer.add(channel, 1, 10, 10, [b"kept"])
    writer.end_chunk()
    writev, calls = os.writev, []

    def refusing(fd: int, buffers: list[memoryview]) -> int:
        calls.append(fd)
        if len(calls) > 1:
            raise OSError(errno.ENOSPC, "full")
        return writev(fd, [buffers[0][:7]])

    monkeypatch.setattr(os, "writev", refusing)
    writer.add(channel, 2, 20, 20, [b"lost"])
    with pytest.raises(OSError, match="full"):
        writer.end_chunk()
    monkeypatch.setattr(os, "writev", writev)
    writer.add(channel, 3, 30, 30, [b"kept too"])
    writer.finish()
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [message.data for _, _, message in reader.iter_messages()] == [b"kept", b"kept too"]
        summary = reader.get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 2


@pytest.mark.parametrize("limit", [700_000, 1_000_000])
def test_a_full_disk_ends_the_take_and_not_the_file(tmp_path: Path, limit: int) -> None:
    out = tmp_path / "take.mcap"
    done = subprocess.run([sys.executable, SUBJECT, out, str(limit)], capture_output=True, text=True, check=True, timeout=120)
    lines = done.stdout.splitlines()
    error = lines[-1]
    assert error.startswith("error no space left while writing")
    assert out.stat().st_size <= limit
    with out.open("rb") as file:
        read = list(make_reader(file, validate_crcs=True).iter_messages())
    assert len(read) > 50  # how many fit depends on how many of the large frames are among them
    sent = {"suit": 0, "tof": 0}
    for line in lines:
        if line.split()[0] in sent:
            sent[line.split()[0]] += 1
    with Recording(out) as recording:
        sources = [source for source, _ in recording.samples()]
        assert not recording.damage.any
    for _, source, written, dropped in (line.split() for line in lines if line.startswith("end")):
        assert sources.count(source) == int(written)
        assert int(written) + int(dropped) == sent[source]
