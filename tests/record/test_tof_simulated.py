"""The simulated camera against the ground truth that it keeps: every frame is there, or in the counted losses."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from cabinpose.core.errors import RecordingError, SourceEndedError
from cabinpose.record.config import parse_rig
from cabinpose.record.emulate.tof import TofFaults
from cabinpose.record.lane import Lane
from cabinpose.record.session import start_recorder
from cabinpose.record.sources.tof.simulated import SimulatedSettings, SimulatedSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample, ToFFrame
from cabinpose.store import open_dataset


def few(count: int = 40) -> Iterator[dict[str, Any]]:
    for i in range(count):
        depth = np.full((4, 6), 1.0 + i / 100, np.float32)
        depth[0, 0] = np.nan
        yield {"depth": depth, "camera_k": np.eye(3), "amplitude": np.full((4, 6), i, np.uint16)}


def play(source: SimulatedSource, *, seconds: float = 120.0) -> list[Sample]:
    """Everything until the end."""
    samples: list[Sample] = []
    end = time.monotonic() + seconds
    source.open()
    try:
        while time.monotonic() < end:
            samples += source.read(0.1)
    except SourceEndedError:
        return samples
    finally:
        source.close()
    pytest.fail("the source did not end")


def make(frames: Any, **settings: Any) -> SimulatedSource:
    faults = TofFaults(**{"rate_hz": 400.0} | settings.pop("faults", {}))
    return SimulatedSource("tof", SimulatedSettings(loop=False, queue_frames=500, faults=faults, **settings), HostClock(), frames)


def numbered(samples: list[Sample]) -> list[Sample]:
    return [s for s in samples if s.sequence is not None]


def test_every_frame_arrives_or_is_counted() -> None:
    source = make(few, faults={"loss": 0.2, "jitter_s": 0.001, "stall_every_s": 0.03, "stall_s": 0.01, "seed": 3})
    samples = numbered(play(source))
    log = source.camera.log
    assert len(log) == 40
    assert {entry.fate for entry in log} == {"sent", "lost", "stalled"}
    sent = [entry for entry in log if entry.fate == "sent"]
    assert [s.sequence for s in samples] == [entry.counter - sent[0].counter for entry in sent]
    assert [s.device_ns for s in samples] == [entry.device_ns for entry in sent]
    inner = [entry for entry in log[sent[0].counter : sent[-1].counter] if entry.fate != "sent"]
    assert source.counts.lost == len(inner) > 0
    assert source.counts.received == len(sent)
    for sample, entry in zip(samples, sent, strict=True):
        (frame,) = sample.messages
        assert isinstance(frame, ToFFrame)
        assert frame.amplitude[0, 0] == entry.counter
        assert frame.depth[0, 0] == 0
        assert frame.depth[1, 1] == 10_000 + entry.counter * 100
        assert sample.host_ns >= entry.taken_ns


def test_the_clock_of_the_camera_has_its_own_rate() -> None:
    source = make(lambda: few(20), faults={"clock_offset_s": -5.0, "clock_drift_ppm": 5000.0, "rate_hz": 200.0})
    samples = numbered(play(source))
    log = source.camera.log
    assert log[0].device_ns == log[0].taken_ns - 5_000_000_000
    elapsed_device, elapsed_host = log[-1].device_ns - log[0].device_ns, log[-1].taken_ns - log[0].taken_ns
    assert elapsed_device / elapsed_host == pytest.approx(1.005, abs=1e-7)
    assert len(samples) == 20


def test_the_same_seed_loses_the_same_frames() -> None:
    fates = []
    for seed in (1, 1, 2):
        source = make(few, faults={"loss": 0.5, "rate_hz": 1000.0, "seed": seed})
        play(source)
        fates.append([entry.fate for entry in source.camera.log])
    assert fates[0] == fates[1] != fates[2]


def test_a_reader_that_is_late_loses_frames_and_says_so() -> None:
    source = SimulatedSource(
        "tof", SimulatedSettings(loop=False, queue_frames=4, faults=TofFaults(rate_hz=1000)), HostClock(), few
    )
    source.open()
    while not source.camera.ended:
        time.sleep(0.005)
    samples = numbered(list(source.read(0.1)))
    assert [s.sequence for s in samples] == [0, 1, 2, 3]
    assert source.counts.lost == 36
    source.close()


def test_it_goes_round_until_it_is_closed() -> None:
    settings = SimulatedSettings(faults=TofFaults(rate_hz=500))
    source = SimulatedSource("tof", settings, HostClock(), lambda: few(3))
    source.open()
    found: list[Sample] = []
    while len(found) < 10:
        found += numbered(list(source.read(1.0)))
    source.close()
    assert [m.amplitude[0, 0] for s in found[:7] for m in s.messages if isinstance(m, ToFFrame)] == [0, 1, 2, 0, 1, 2, 0]
    assert source.camera._thread is None


def test_the_first_frame_is_ready_before_the_camera_is_connected(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the first frame takes to read, the take begins with it: it is made before `open` returns, and made once."""
    made: list[str] = []

    def slow() -> Iterator[dict[str, Any]]:
        made.append("first")
        yield from few(3)

    source = make(slow)
    monkeypatch.setattr(source.camera, "_run", lambda: made.append("the clock starts"))
    source.open()
    assert source.camera.join(10)
    assert made == ["first", "the clock starts"]
    source.close()


def test_a_take_begins_with_a_frame_under_load(tmp_path: Path) -> None:
    """A camera whose first frame takes long, beside two busy processes: a frame is there within two periods of the beginning."""

    def slow() -> Iterator[dict[str, Any]]:
        time.sleep(0.5)
        yield from few(200)

    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        clock, wake = HostClock(), threading.Event()
        settings = SimulatedSettings(faults=TofFaults(rate_hz=5))
        lane = Lane(SimulatedSource("tof", settings, clock, slow), "simulated", clock, wake)
        rig = parse_rig({"sources": {"tof": {"kind": "simulated"}}})
        recorder = start_recorder(rig, [lane], tmp_path / "take.mcap", clock, wake)
        time.sleep(0.7)
        outcome = recorder.stop()
    finally:
        for process in busy:
            process.kill()
            process.wait()
    (status,) = outcome.sources
    assert status.first_ns is not None
    assert status.first_ns - outcome.started_ns < 2e9 / 5


def test_frames_that_fail_or_make_no_sense() -> None:
    def broken() -> Iterator[dict[str, Any]]:
        yield {"depth": np.zeros((2, 2), np.float32)}
        yield from few(1)
        raise ValueError("no scene found")

    source = make(broken)
    source.open()
    while not source.camera.ended:
        time.sleep(0.005)
    samples = list(source.read(0.1))
    with pytest.raises(RecordingError, match="no scene found"):
        source.read(0.1)
    assert source.counts.malformed == 1
    assert [len(s.messages) for s in numbered(samples)] == [0, 1]
    source.close()
    broken_at_once = make(lambda: (1 / 0 for _ in range(1)))
    broken_at_once.open()
    assert broken_at_once.camera.join(10)
    broken_at_once.read(0.1)  # what it says of itself
    with pytest.raises(RecordingError, match="division by zero"):
        broken_at_once.read(0.1)
    broken_at_once.close()
    with pytest.raises(RecordingError, match="no frames to see"):
        SimulatedSource("tof", SimulatedSettings(), HostClock()).open()
    assert "no frames to see" in SimulatedSource("tof", SimulatedSettings(), HostClock()).check()[0]
    missing = SimulatedSource("tof", SimulatedSettings(dataset=Path("nowhere")), HostClock())
    assert "nowhere" in missing.check()[0]


@pytest.fixture(scope="module")
def spheres() -> ModuleType:
    folder = str(Path(__file__).parents[1] / "store")
    sys.path.insert(0, folder)
    try:
        import sphere_people  # the tests of the store have it

        return sphere_people
    finally:
        sys.path.remove(folder)


def test_a_dataset_is_seen_as_it_is(spheres: ModuleType, tmp_path: Path) -> None:
    folder = spheres.write(tmp_path / "dataset", spheres.manifest())
    faults = TofFaults(rate_hz=200)
    settings = SimulatedSettings(dataset=folder, loop=False, queue_frames=100, faults=faults)
    source = SimulatedSource("tof", settings, HostClock())
    assert source.check() == []
    samples = play(source)
    (about,) = [m for s in samples for m in s.messages if isinstance(m, Facts)]
    assert about.values["rate_hz"] == 200
    frames = [m for s in samples for m in s.messages if isinstance(m, ToFFrame)]
    dataset = open_dataset(folder)
    assert len(frames) == dataset.sizes["frame"]
    for i, frame in enumerate(frames):
        depth = dataset["depth"].isel(frame=i).values
        np.testing.assert_allclose(frame.depth * frame.depth_unit_m, np.nan_to_num(depth), atol=1e-6)
        np.testing.assert_array_equal(frame.amplitude, dataset["amplitude"].isel(frame=i).values)
        np.testing.assert_array_equal(frame.confidence, dataset["confidence"].isel(frame=i).values)
