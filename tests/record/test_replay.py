"""A recording played again is what it was."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from recorded_things import bits, take_samples

from cabinpose.core.errors import RecordingError, SourceEndedError
from cabinpose.record.config import parse_rig
from cabinpose.record.session import begin
from cabinpose.record.sources.replay import ReplaySettings, ReplaySource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample
from cabinpose.store.recording import Chunking, Recording, RecordingWriter

SAMPLES = take_samples(60, rng=np.random.default_rng(2))


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("take") / "a.mcap"
    with RecordingWriter(path, chunking=Chunking(sync_s=0)) as writer:
        for source, sample in SAMPLES:
            writer.write(source, sample)
    return path


def played(source: ReplaySource) -> list[Sample]:
    samples: list[Sample] = []
    try:
        while True:
            samples += source.read(0.1)
    except SourceEndedError:
        return samples


def test_as_fast_as_it_goes_with_its_own_times(take: Path) -> None:
    source = ReplaySource("suit", ReplaySettings(path=take, source="suit", speed=0, host_time=True), HostClock())
    source.open()
    found = played(source)
    assert [bits(s) for s in found] == [bits(s) for name, s in SAMPLES if name == "suit"]
    assert source.counts.received == len(found) == 20
    source.close()


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_at_its_pace(take: Path, speed: float) -> None:
    """Never early; stamped with the time at which it is played; all else as it was."""
    clock = HostClock()
    source = ReplaySource("tof", ReplaySettings(path=take, source="tof", speed=speed), clock)
    began = clock.now_ns()
    source.open()
    found = played(source)
    truth = [s for name, s in SAMPLES if name == "tof"]
    assert [(s.sequence, s.device_ns, s.raw) for s in found] == [(s.sequence, s.device_ns, s.raw) for s in truth]
    for sample, recorded in zip(found, truth, strict=True):
        assert sample.host_ns - began >= (recorded.host_ns - truth[0].host_ns) / speed
    assert [s.host_ns for s in found] == sorted(s.host_ns for s in found)


def test_recorded_again_it_is_the_same(take: Path, tmp_path: Path) -> None:
    """A rig that replays all sources of a recording gives that recording, and says that these are no bodies."""
    sources = {
        name: {"kind": "replay", "path": str(take), "source": name, "speed": 0, "host_time": True}
        for name in ("suit", "optical", "tof")
    }
    recorder = begin(parse_rig({"sources": sources}), tmp_path / "again.mcap", HostClock())
    limit = time.monotonic() + 60
    while recorder.running and time.monotonic() < limit:
        time.sleep(0.01)
    assert recorder.stop().error is None
    for name in sources:
        with Recording(take) as before, Recording(tmp_path / "again.mcap") as after:
            again = [s for _, s in after.samples([name]) if not any(isinstance(m, Facts) for m in s.messages)]
            assert [bits(s) for _, s in before.samples([name])] == [bits(s) for s in again]


def test_gaps_are_seen_as_they_were(tmp_path: Path) -> None:
    numbers = [0, 1, 4, 3, 3, 9]
    with RecordingWriter(tmp_path / "a.mcap", chunking=Chunking(sync_s=0)) as writer:
        for i, number in enumerate(numbers):
            writer.write("suit", Sample(number, 10 + i, None, b"x"))
    source = ReplaySource("suit", ReplaySettings(path=tmp_path / "a.mcap", speed=0), HostClock())
    source.open()
    assert [s.sequence for s in played(source)] == numbers
    counts = source.counts
    assert (counts.received, counts.lost, counts.reordered, counts.duplicate) == (6, 5, 1, 1)


def test_what_cannot_be_played(take: Path, tmp_path: Path) -> None:
    for settings, words in (
        (ReplaySettings(path=take, source=""), "unknown source of the recording"),
        (ReplaySettings(path=take, source="lidar"), "lidar"),
        (ReplaySettings(path=tmp_path / "missing.mcap"), "missing.mcap"),
    ):
        source = ReplaySource("a", settings, HostClock())
        (problem,) = source.check()
        assert words in problem
        with pytest.raises(RecordingError, match=words):
            source.open()
    assert ReplaySource("a", ReplaySettings(path=take, source="tof"), HostClock()).check() == []


def written(path: Path, *sources: str) -> Path:
    """A recording of some of the samples, those of the camera as any number of cameras."""
    with RecordingWriter(path, chunking=Chunking(sync_s=0)) as writer:
        for source in sources:
            of = source if source in ("suit", "optical") else "tof"
            for name, sample in SAMPLES[:6]:
                if name == of:
                    writer.write(source, sample)
    return path


def test_the_only_camera_among_several_sources_is_meant(take: Path, tmp_path: Path) -> None:
    source = ReplaySource("a", ReplaySettings(path=take, speed=0, host_time=True), HostClock())
    assert source.check() == []
    source.open()
    assert [bits(s) for s in played(source)] == [bits(s) for name, s in SAMPLES if name == "tof"]
    source.close()
    two = written(tmp_path / "two.mcap", "suit", "left", "right")
    with pytest.raises(RecordingError, match="has 2 ToF cameras") as error:
        ReplaySource("a", ReplaySettings(path=two), HostClock()).open()
    assert error.value.hint == "name one, with `source` or as two.mcap:NAME: left, right"
    none = written(tmp_path / "none.mcap", "suit", "optical")
    with pytest.raises(RecordingError, match="has 2 sources, none of them a ToF camera") as error:
        ReplaySource("a", ReplaySettings(path=none), HostClock()).open()
    assert error.value.hint == "name one, with `source` or as none.mcap:NAME: optical, suit"
