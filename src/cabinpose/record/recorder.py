"""Several sources into one file, side by side: a thread each, and one that writes.

No source waits for another or for the disk: between each and the file is a queue with a limit in bytes and seconds, and what
finds it full is dropped and counted. The writing thread takes from the queues in turn.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from cabinpose.core import CabinposeError, RecordingError
from cabinpose.record.lane import Lane, LaneStatus
from cabinpose.record.split import SplitWriter
from cabinpose.signals import HostClock
from cabinpose.store.recording import SourceStatus

_TURN_BYTES = 1 << 20  # that one source may write before the next has its turn
_STATUS_S = 1.0
_IDLE_S = 0.05
_STOP_S = 5.0  # for a source to stop; after that it is left behind


@dataclass(frozen=True)
class RecorderStatus:
    """What the panel shows. bytes_per_s: of the last second · free_bytes: on the disk."""

    lanes: tuple[LaneStatus, ...]
    elapsed_s: float
    bytes_written: int
    bytes_per_s: float
    free_bytes: int


@dataclass(frozen=True)
class Outcome:
    """How a take ended: the counts of its sources, its files, their bytes, and the error that ended it, if one did.

    started_ns, ended_ns: host time at which all sources were open, and at which they were asked to stop · doubts: by source,
    what speaks against its camera or bodies.
    """

    sources: tuple[SourceStatus, ...]
    started_ns: int
    ended_ns: int
    files: tuple[Path, ...]
    bytes_written: int
    error: CabinposeError | None
    doubts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """How long the take was."""
        return (self.ended_ns - self.started_ns) / 1e9


class Recorder:
    """Records until it is stopped, all sources or one that leads the take have ended, or the disk refuses."""

    def __init__(
        self, lanes: Sequence[Lane], writer: SplitWriter, clock: HostClock, wake: threading.Event, *, min_free_bytes: int = 0
    ) -> None:
        """wake: that of the lanes · min_free_bytes: the take ends before the disk has less."""
        self._lanes, self._writer, self._clock, self._wake = tuple(lanes), writer, clock, wake
        self._min_free = min_free_bytes
        self._stopping = threading.Event()
        self._started_ns = self._ended_ns = clock.now_ns()
        self._free = self._min_free
        self._rate = (clock.now_s(), 0, 0.0)  # when, bytes then, bytes a second before
        self._error: RecordingError | None = None
        self._thread = threading.Thread(target=self._run, name="recording-writer", daemon=True)

    def start(self, timeout_s: float = 30.0) -> None:
        """Open all sources and begin. Raises RecordingError or DependencyError where one cannot be opened; none is left open."""
        until = self._clock.now_s() + timeout_s
        try:
            for lane in self._lanes:
                lane.start()
            for lane in self._lanes:
                if not self._clock.wait(lane.opened, until - self._clock.now_s()) or lane.failure is not None:
                    raise lane.failure or RecordingError(
                        f"{lane.name} does not answer", hint="`cabinpose record --check` says what is missing"
                    )
        except BaseException:  # Ctrl-C among them
            self._halt_sources()
            self._writer.close()
            raise
        self._started_ns = self._ended_ns = self._clock.now_ns()
        self._thread.start()
        for lane in self._lanes:
            lane.begin()

    @property
    def running(self) -> bool:
        """Whether there is still something to record."""
        over = all(lane.ended for lane in self._lanes) or any(lane.leads and lane.ended for lane in self._lanes)
        return self._thread.is_alive() and self._error is None and not over

    def status(self) -> RecorderStatus:
        """What the panel shows."""
        lanes = tuple(lane.live(self._writer.samples(lane.name)) for lane in self._lanes)
        elapsed = (self._clock.now_ns() - self._started_ns) / 1e9
        return RecorderStatus(lanes, elapsed, self._writer.bytes_written, self._rate[2], self._free)

    def stop(self) -> Outcome:
        """Stop the sources, write what waits, end the file. Samples that a disk refused are among the dropped."""
        self._ended_ns = self._clock.now_ns()
        self._halt_sources()
        self._stopping.set()
        self._wake.set()
        self._clock.join(self._thread, float("inf"))
        counts = tuple(self._account(lane) for lane in self._lanes)
        error = next((lane.failure for lane in self._lanes if lane.failure is not None), self._error)
        doubts = {lane.name: lane.doubts for lane in self._lanes if lane.doubts}
        return Outcome(counts, self._started_ns, self._ended_ns, self._writer.files, self._writer.bytes_written, error, doubts)

    def _halt_sources(self) -> None:
        for lane in self._lanes:
            lane.stop()
        until = self._clock.now_s() + _STOP_S
        for lane in self._lanes:
            lane.join(max(until - self._clock.now_s(), 0.01))

    def _run(self) -> None:
        try:
            self._tell_counts(self._started_ns)  # the first and the last of them say when the take began and ended
            self._write()
            self._tell_counts(self._ended_ns, final=True)
        except RecordingError as error:
            self._error = error
        except Exception as error:  # noqa: BLE001 - whatever it is, the file gets its end first
            self._error = RecordingError(
                f"the recorder failed: {error!r}", hint="this is a defect; the recording is whole up to here"
            )
            self._error.__cause__ = error
        try:
            self._writer.close()
        except RecordingError as error:
            self._error = self._error or error

    def _write(self) -> None:
        next_status = self._clock.now_s() + _STATUS_S
        while True:
            self._clock.wait(self._wake, _IDLE_S)
            self._wake.clear()
            stopping = self._stopping.is_set()
            wrote = True
            while wrote:
                wrote = False
                for lane in self._lanes:
                    for sample in lane.take(_TURN_BYTES):
                        lane.written(sample, self._writer.write(lane.name, sample))
                        self._writer.poll()  # after each: where much waits, a chunk must not become old before it is full
                        if self._writer.full:
                            self._go_on()
                        wrote = True
                self._writer.poll()
                if self._clock.now_s() >= next_status:
                    next_status = self._clock.now_s() + _STATUS_S
                    self._tick()
            if stopping:
                return

    def _go_on(self) -> None:
        """Begin the next file, with the counts at the end of the one and at the beginning of the other."""
        now_ns = self._clock.now_ns()
        self._tell_counts(now_ns)
        self._writer.go_on()
        self._tell_counts(now_ns)

    def _tick(self) -> None:
        """Once a second: the counts into the file, and a look at the disk."""
        self._tell_counts(self._clock.now_ns())
        now, before = self._clock.now_s(), self._rate
        done = self._writer.bytes_written
        self._rate = (now, done, (done - before[1]) / max(now - before[0], 1e-9))
        self._free = shutil.disk_usage(self._writer.path.parent).free
        if self._free < self._min_free:
            raise RecordingError(
                f"less than {self._min_free / 1e6:.0f} MB are free beside {self._writer.path}: the take was ended",
                hint="free disk space, or record to another disk; the recording is whole up to here",
            )

    def _tell_counts(self, now_ns: int, *, final: bool = False) -> None:
        for lane in self._lanes:
            self._writer.write_status(lane.status(self._writer.samples(lane.name), now_ns, final=final), now_ns)

    def _account(self, lane: Lane) -> SourceStatus:
        """The counts of a source that has stopped: what it gave and is not in the file has been dropped."""
        written = self._writer.samples(lane.name)
        status = lane.status(written, self._ended_ns, final=True)
        return replace(status, dropped=lane.given - written, queue_bytes=0)
