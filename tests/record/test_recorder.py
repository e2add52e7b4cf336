"""Nothing is lost silently: each sample that a device sent is in the file or in the counts, whatever happens meanwhile."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_clock import VirtualClock

from cabinpose.core.errors import RecordingError, SourceEndedError
from cabinpose.record.config import parse_rig
from cabinpose.record.lane import Lane
from cabinpose.record.recorder import Outcome, Recorder
from cabinpose.record.session import begin
from cabinpose.record.sources.numbered import NumberedSettings, NumberedSource
from cabinpose.record.split import SplitWriter
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Channels, Counts, Sample
from cabinpose.store.recording import Chunking, Recording, RecordingWriter, SourceStatus
from cabinpose.store.recording.scan import Chunk, Scanner

PATIENCE_S = 60.0  # of a busy machine


def until(holds: Callable[[], bool], clock: HostClock) -> None:
    limit = clock.now_s() + PATIENCE_S
    while not holds():
        assert clock.now_s() < limit, "never came to be"
        clock.sleep(0.01)


class Scripted:
    """A source that gives what a list says: samples, an exception to raise, or a function to call."""

    def __init__(self, name: str, script: Sequence[Any], clock: HostClock | None = None) -> None:
        self.name, self.counts, self._script = name, Counts(), list(script)
        self._clock = clock or HostClock()
        self.opened = self.closed = 0

    def check(self) -> Sequence[str]:
        return []

    def open(self) -> None:
        self.opened += 1

    def read(self, timeout_s: float) -> Sequence[Sample]:
        if not self._script:
            self._clock.sleep(timeout_s)
            return []
        step = self._script.pop(0)
        if isinstance(step, Exception):
            raise step
        if callable(step):
            step()
            return []
        self.counts.received += len(step)
        return step

    def close(self) -> None:
        self.closed += 1


class SetClock(HostClock):
    """A clock that a test sets."""

    time_ns = 0

    def now_ns(self) -> int:
        return self.time_ns


def plain(number: int, size: int = 8) -> Sample:
    return Sample(
        number, HostClock().now_ns(), number, number.to_bytes(size, "little"), (Channels(("n",), np.array([1.0 * number])),)
    )


def recorder_of(
    path: Path, sources: Sequence[Any], clock: HostClock | None = None, *, queue_bytes: int = 1 << 26, **options: Any
) -> Recorder:
    clock, wake = clock or HostClock(), threading.Event()
    lanes = [Lane(source, "scripted", clock, wake, queue_bytes=queue_bytes) for source in sources]
    writer = SplitWriter(path, lambda file, part: RecordingWriter(file, part=part, chunking=Chunking(sync_s=0, **options)), clock)
    return Recorder(lanes, writer, clock, wake)


def recorded(path: Path) -> tuple[dict[str, list[int]], dict[str, SourceStatus]]:
    """Numbers in the file of each source, as its raw bytes say, and its last counts."""
    numbers: dict[str, list[int]] = {}
    with Recording(path) as recording:
        for source, found in recording.samples():
            number = int.from_bytes(found.raw[:8], "little")
            assert found.sequence == number
            numbers.setdefault(source, []).append(number)
        assert not recording.damage.any
        statuses = recording.statuses()
    assert all(series[-1][1].final for series in statuses.values())
    return numbers, {name: series[-1][1] for name, series in statuses.items()}


def finished(recorder: Recorder, clock: HostClock | None = None) -> Outcome:
    until(lambda: not recorder.running, clock or HostClock())
    return recorder.stop()


def test_every_sample_is_in_the_file_or_counted(tmp_path: Path) -> None:
    """Three sources at once, one that loses, one that dies and returns; the file's own numbers are the witness."""
    rig = parse_rig(
        {
            "sources": {
                "steady": {"kind": "numbered", "rate_hz": 500, "samples": 1000},
                "lossy": {"kind": "numbered", "rate_hz": 800, "samples": 1600, "lose_every": 7, "burst": 20},
                "mortal": {"kind": "numbered", "rate_hz": 400, "samples": 800, "die_every": 150, "dead_s": 0.2},
            },
            "storage": {"sync_s": 0, "chunk_mb": 0.01},
        }
    )
    clock = VirtualClock()
    outcome = finished(begin(rig, tmp_path / "a.mcap", clock), clock)
    assert outcome.error is None
    numbers, statuses = recorded(tmp_path / "a.mcap")
    assert {s.source: s for s in outcome.sources} == statuses
    for name, sent in (("steady", 1000), ("lossy", 1600), ("mortal", 800)):
        status = statuses[name]
        assert numbers[name] == sorted(set(numbers[name]))
        assert (status.state, status.dropped) == ("ended", 0)
        assert len(numbers[name]) == status.written == status.received
        assert sent == status.written + status.lost
    assert numbers["steady"] == list(range(1000))
    assert numbers["lossy"] == [n for n in range(1600) if n % 7 != 6]
    assert statuses["mortal"].restarts >= 2
    assert statuses["mortal"].lost > 0
    assert "went away" in statuses["mortal"].error


def test_a_slow_disk_costs_what_is_counted_and_memory_stays_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, gate = tmp_path / "a.mcap", threading.Event()
    write = RecordingWriter.write

    def slow(self: RecordingWriter, source: str, given: Sample) -> list[str]:
        gate.wait(PATIENCE_S)
        return write(self, source, given)

    monkeypatch.setattr(RecordingWriter, "write", slow)
    batches = [[plain(10 * i + k, 1000) for k in range(10)] for i in range(200)]
    source = Scripted("tof", [*batches, gate.set, SourceEndedError("over")])
    recorder = recorder_of(path, [source], queue_bytes=500_000)
    recorder.start()
    outcome = finished(recorder)
    numbers, statuses = recorded(path)
    status = statuses["tof"]
    assert status == outcome.sources[0]
    assert len(numbers["tof"]) == status.written
    assert status.written + status.dropped == 2000
    assert 200 < status.written < 700
    assert status.dropped_bytes >= 1000 * status.dropped
    assert numbers["tof"][:300] == list(range(300)), "the newest are dropped, not what waits"


def test_a_queue_is_bounded_in_seconds(tmp_path: Path) -> None:
    """While the oldest sample waits for longer than the rig allows, none is taken in: a kill cannot cost more."""
    clock = SetClock()
    lane = Lane(Scripted("tof", []), "scripted", clock, threading.Event(), queue_s=2.0)
    for second in range(6):
        clock.time_ns = second * 1_000_000_000
        lane._put([plain(second)])
    assert [int(sample.device_ns or 0) for sample in lane.take(1 << 30)] == [0, 1, 2]
    assert (lane.status(3, clock.now_ns()).dropped, lane.given) == (3, 6)
    lane._put([plain(6)])
    assert len(lane.take(1 << 30)) == 1, "room again"


def test_a_chunk_is_closed_by_its_age_while_samples_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A writer that is short of time, with much to write at once: what it wrote goes to the system all the same."""
    write = RecordingWriter.write

    def slow(self: RecordingWriter, source: str, given: Sample) -> list[str]:
        time.sleep(0.02)
        return write(self, source, given)

    monkeypatch.setattr(RecordingWriter, "write", slow)
    source = Scripted("tof", [[plain(i) for i in range(100)], SourceEndedError("over")])
    recorder = recorder_of(tmp_path / "a.mcap", [source], flush_s=0.1)
    recorder.start()
    outcome = finished(recorder)
    assert outcome.sources[0].written == 100
    with Scanner(tmp_path / "a.mcap") as scanner:
        assert sum(isinstance(found, Chunk) for found in scanner.walk()) > 10, "one and its status, if by volume alone"


def test_a_stalled_source_keeps_no_other_waiting(tmp_path: Path) -> None:
    """One hangs in its vendor's library, for longer than the take; the other's samples are all there."""
    hang, clock = threading.Event(), VirtualClock()
    stuck = Scripted("tof", [[plain(0)], lambda: clock.wait(hang, PATIENCE_S)])
    lively = Scripted("suit", [[plain(i)] for i in range(300)], clock)
    recorder = recorder_of(tmp_path / "a.mcap", [stuck, lively], clock)
    recorder.start()
    try:
        until(lambda: recorder.status().lanes[1].counts.written == 300, clock)
        assert recorder.running
        outcome = recorder.stop()
    finally:
        hang.set()
    numbers, _ = recorded(tmp_path / "a.mcap")
    assert numbers == {"tof": [0], "suit": list(range(300))}
    assert outcome.sources[0].error == "does not stop"


@pytest.mark.parametrize("problem", [RecordingError("gone"), OSError("usb"), ZeroDivisionError("a defect")])
def test_a_source_that_dies_is_reached_again(tmp_path: Path, problem: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.record.lane.RETRY_S", 0.01)
    source = Scripted("suit", [[plain(0)], problem, [plain(1)], problem, [plain(2)], SourceEndedError("over")])
    recorder = recorder_of(tmp_path / "a.mcap", [source])
    recorder.start()
    (status,) = finished(recorder).sources
    assert (status.restarts, status.written, status.state) == (2, 3, "ended")
    assert str(problem) in status.error
    assert source.opened == source.closed == 3


def test_a_source_that_cannot_be_opened_is_told_at_once(tmp_path: Path) -> None:
    class Absent(Scripted):
        def open(self) -> None:
            raise RecordingError("no camera", hint="plug it in")

    other = Scripted("suit", [])
    recorder = recorder_of(tmp_path / "a.mcap", [other, Absent("tof", [])])
    with pytest.raises(RecordingError, match="no camera"):
        recorder.start()
    assert other.closed == 1
    assert not any(thread.name.startswith(("source-", "recording-")) for thread in threading.enumerate())


def test_ctrl_c_while_a_device_does_not_answer_leaves_nothing(tmp_path: Path) -> None:
    """The recorder waits for its sources to be open in the thread that Ctrl-C interrupts."""

    class Interrupted(HostClock):
        def wait(self, event: threading.Event, timeout_s: float) -> bool:
            if threading.current_thread() is threading.main_thread():
                raise KeyboardInterrupt
            return super().wait(event, timeout_s)

    rig = parse_rig({"sources": {"suit": {"kind": "numbered"}}})
    with pytest.raises(KeyboardInterrupt):
        begin(rig, tmp_path / "a.mcap", Interrupted())
    assert list(tmp_path.iterdir()) == []
    assert not [thread for thread in threading.enumerate() if thread.name == "source-suit"]


def test_a_failed_start_leaves_no_file(tmp_path: Path) -> None:
    rig = parse_rig({"sources": {"a": {"kind": "replay", "path": "missing.mcap"}}}, base=tmp_path)
    with pytest.raises(RecordingError, match=r"missing\.mcap"):
        begin(rig, tmp_path / "a.mcap", HostClock())
    assert list(tmp_path.iterdir()) == []


def test_stopping_writes_what_waits(tmp_path: Path) -> None:
    clock = VirtualClock()
    source = NumberedSource("suit", NumberedSettings(rate_hz=2000), clock)
    recorder = recorder_of(tmp_path / "a.mcap", [source], clock)
    recorder.start()
    until(lambda: source.sent > 500, clock)
    (status,) = recorder.stop().sources
    numbers, _ = recorded(tmp_path / "a.mcap")
    assert numbers["suit"] == list(range(source.sent))
    assert status.state == "stopped"


def test_a_message_that_cannot_be_written_is_counted(tmp_path: Path) -> None:
    bad = Sample(0, HostClock().now_ns(), 0, bytes(8), (Channels(("a", "b"), np.zeros(1)),))
    recorder = recorder_of(tmp_path / "a.mcap", [Scripted("suit", [[bad, plain(1)], SourceEndedError("over")])])
    recorder.start()
    (status,) = finished(recorder).sources
    assert (status.refused, status.written) == (1, 2)
    assert "values has shape" in status.error


def test_too_little_space_ends_the_take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, wake = VirtualClock(), threading.Event()
    lane = Lane(NumberedSource("suit", NumberedSettings(rate_hz=200), clock), "numbered", clock, wake)
    writer = SplitWriter(tmp_path / "a.mcap", lambda file, _: RecordingWriter(file), clock)
    recorder = Recorder([lane], writer, clock, wake, min_free_bytes=1 << 62)
    recorder.start()
    outcome = finished(recorder, clock)
    assert outcome.error is not None
    assert "are free" in str(outcome.error)
    assert outcome.error.hint
    with Recording(tmp_path / "a.mcap") as recording:
        assert len(list(recording.samples())) == outcome.sources[0].written > 50
        assert not recording.damage.any
    given = lane.given
    assert given == outcome.sources[0].written + outcome.sources[0].dropped


def test_the_panel_tells_rates(tmp_path: Path) -> None:
    """What the clock says exactly: a sample each 4 ms, of which each is delivered 3 ms after it came."""
    clock = VirtualClock()

    class Late(NumberedSource):
        def read(self, timeout_s: float) -> Sequence[Sample]:
            samples = super().read(timeout_s)
            clock.sleep(0.003)
            return samples

    source = Late("suit", NumberedSettings(rate_hz=250), clock)
    recorder = recorder_of(tmp_path / "a.mcap", [source, Scripted("tof", [], clock)], clock)
    recorder.start()
    until(lambda: source.sent > 500 and recorder.status().lanes[1].counts.state == "waiting", clock)
    suit, tof = recorder.status().lanes
    recorder.stop()
    assert suit.rate_hz == pytest.approx(250, rel=1e-3)
    assert suit.jitter_ms < 1.1
    assert suit.counts.state == "recording"
    assert suit.latency_ms == pytest.approx(3, abs=0.01)
    assert 0 <= suit.queue < 1
    assert (tof.rate_hz, tof.jitter_ms, tof.latency_ms) == (0, 0, 0)
