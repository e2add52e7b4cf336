"""One source at work: its thread, the bounded queue between it and the file, and what is known of both.

A source that fails is closed and opened again, for as long as the take lasts; but the take ends with a source that leads it
(`leads_take`, such as a motor). What the queue has no room for is counted.
"""

from __future__ import annotations

import itertools
import statistics
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from cabinpose.core import CabinposeError, RecordingError, SourceEndedError
from cabinpose.signals import DOUBTS, Counts, Facts, FrameSource, HostClock, LiveCheck, Sample
from cabinpose.store.recording import SourceStatus, sample_bytes

READ_S = 0.1  # how long a source waits for a sample before it looks whether the take is over
RETRY_S = 0.5  # pause before a source is opened again; it doubles up to
MOST_RETRY_S = 5.0
_WINDOW_S = 2.0  # over which rates are measured
_WINDOW_SAMPLES = 1000
_SILENT_S = 1.0  # a source without data for this long is silent
_SILENT_INTERVALS = 10  # if that is also longer than this many of its mean intervals
_OVERHEAD = 256  # bytes of a sample beside its raw bytes and arrays


@dataclass(frozen=True)
class LaneStatus:
    """What the panel shows of a source. rate_hz, jitter_ms (standard deviation of the intervals between arrivals) and
    latency_ms (from arrival to file, greatest) are of the last two seconds; queue: share of its room that is filled · doubts:
    what speaks against its camera or bodies.
    """

    counts: SourceStatus
    rate_hz: float
    jitter_ms: float
    latency_ms: float
    queue: float
    doubts: tuple[str, ...] = ()


class Lane:
    """A source, its thread and its queue. `wake` is set when samples wait.

    A sample is dropped where it would fill the queue beyond `queue_bytes`, or while the oldest in it has waited for `queue_s`.
    """

    def __init__(
        self,
        source: FrameSource,
        kind: str,
        clock: HostClock,
        wake: threading.Event,
        *,
        queue_bytes: int = 1 << 28,
        queue_s: float = 5.0,
    ) -> None:
        self.name, self.kind = source.name, kind
        self._source, self._clock, self._wake, self._room = source, clock, wake, queue_bytes
        self._longest_ns = round(queue_s * 1e9)
        self._lock = threading.Lock()
        self._queue: deque[tuple[int, int, Sample]] = deque()  # when it came here, ns; bytes
        self._queued = 0
        self._given = self._dropped = self._dropped_bytes = self._refused = self._restarts = 0
        self._state, self._error = "connecting", ""
        self._window: deque[tuple[int, int]] = deque(maxlen=_WINDOW_SAMPLES)  # arrival, nanoseconds from there to the file
        self._data = 0  # samples that carry data
        self._first_ns: int | None = None  # when they came, as their sources say
        self._last_ns: int | None = None
        self._began_ns = self._came_ns = 0  # when the first and the last of them came here; before the first: when it was opened
        self._away = False
        self._check = LiveCheck()
        self.doubts: tuple[str, ...] = ()
        self._stop, self._begun = threading.Event(), threading.Event()
        self.leads = getattr(source, "leads_take", False)
        self.opened = threading.Event()
        self.failure: CabinposeError | None = None
        self._thread = threading.Thread(target=self._run, name=f"source-{self.name}", daemon=True)

    def start(self) -> None:
        """Begin; `opened` is set once the source is there, or `failure` says why it is not."""
        self._thread.start()

    def begin(self) -> None:
        """All sources are open: one that leads the take may go on."""
        self._begun.set()

    def stop(self) -> None:
        """Ask the source to stop."""
        self._stop.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for it; False where it hangs, in which case it is left to itself."""
        if self._thread.ident is None:  # interrupted before it was started
            return True
        ended = self._clock.join(self._thread, timeout_s)
        if not ended:
            self._error = self._error or "does not stop"
        return ended

    @property
    def ended(self) -> bool:
        """Whether it gives no more samples."""
        return self.opened.is_set() and not self._thread.is_alive()

    @property
    def given(self) -> int:
        """Samples that the source gave: all are in the file, dropped, or still in the queue."""
        return self._given

    def take(self, most_bytes: int) -> list[Sample]:
        """The oldest samples of the queue, of about `most_bytes` in all."""
        taken: list[Sample] = []
        with self._lock:
            while self._queue and most_bytes > 0:
                _, size, sample = self._queue.popleft()
                self._queued -= size
                most_bytes -= size
                taken.append(sample)
        return taken

    def written(self, sample: Sample, refused: list[str]) -> None:
        """Note that a sample is in the file, but for what was refused of it."""
        with self._lock:
            self._window.append((sample.host_ns, self._clock.now_ns() - sample.host_ns))
            if refused:
                self._refused += len(refused)
                self._error = refused[-1]

    def status(self, written: int, now_ns: int, *, final: bool = False) -> SourceStatus:
        """Its counts; `written`: its samples in the file · now_ns: up to when its silence counts · final: the take is over."""
        seen: Counts = self._source.counts
        with self._lock:
            silence = self._silence(now_ns, final=final)
            waiting = silence or not self._data
            return SourceStatus(
                self.name, self.kind, "waiting" if waiting and self._state == "recording" else self._state,
                seen.received, seen.lost, seen.reordered, seen.duplicate, seen.malformed,
                seen.restarts + self._restarts, written, self._dropped, self._dropped_bytes, self._refused, self._queued,
                "; ".join(filter(None, (self._error, silence))), final, self._first_ns, self._last_ns, bool(silence),
            )  # fmt: skip

    def _silence(self, now_ns: int, *, final: bool) -> str:
        """What there is to say of a source that sends nothing, for longer than it usually does; "" while it does."""
        if self._state == "ended" or not self.opened.is_set():
            return ""
        quiet_s = max(now_ns - self._came_ns, 0) / 1e9
        if not self._data:
            return "no data came" if final or quiet_s > _SILENT_S else ""
        usual_s = (self._came_ns - self._began_ns) / 1e9 / max(self._data - 1, 1)
        if self._away or quiet_s > max(_SILENT_S, _SILENT_INTERVALS * usual_s):
            return f"no data for {quiet_s:.1f} s"
        return ""

    def live(self, written: int) -> LaneStatus:
        """What the panel shows."""
        now = self._clock.now_ns()
        with self._lock:
            window = [(at, wait) for at, wait in self._window if now - at < _WINDOW_S * 1e9]
            waited_ns = now - self._queue[0][0] if self._queue else 0
            queue = max(self._queued / self._room, min(waited_ns / self._longest_ns, 1.0))
        times = sorted(at for at, _ in window)
        intervals = [(b - a) / 1e6 for a, b in itertools.pairwise(times)]
        span = (times[-1] - times[0]) / 1e9 if times else 0.0
        return LaneStatus(
            counts=self.status(written, now),
            rate_hz=(len(times) - 1) / span if span > 0 else 0.0,
            jitter_ms=statistics.pstdev(intervals) if intervals else 0.0,
            latency_ms=max((wait for _, wait in window), default=0) / 1e6,
            queue=queue,
            doubts=self.doubts,
        )

    def _run(self) -> None:
        pause = RETRY_S
        while not self._stop.is_set():
            try:
                self._source.open()
                if self.opened.is_set():
                    self._restarts += 1
                else:
                    self._came_ns = self._clock.now_ns()
                self.opened.set()
                self._state = "recording"
                while self.leads and not (self._begun.wait(READ_S) or self._stop.is_set()):
                    pass
                while not self._stop.is_set():
                    samples = self._source.read(READ_S)
                    if samples:
                        pause, self._state, self._away = RETRY_S, "recording", False
                        told = [words for sample in samples for words in self._check.look(sample)]
                        self._put([*samples, *self._doubted(told)])
            except SourceEndedError:
                self._state = "ended"
                break
            except Exception as error:  # noqa: BLE001 - a source may be code of another package, whose defects must not end the take
                self._error = str(error) or type(error).__name__
                if self.leads or not self.opened.is_set():
                    self._state = "failed"
                    self.failure = error if isinstance(error, CabinposeError) else RecordingError(f"{self.name}: {error!r}")
                    break
                self._state, self._away = "retrying", True
            finally:
                self._close()
            self._clock.wait(self._stop, pause)
            pause = min(2 * pause, MOST_RETRY_S)
        if doubted := self._doubted(self._check.judged()):
            self._put(doubted)
        if self._stop.is_set():
            self._state = "stopped"
        self.opened.set()
        self._wake.set()

    def _close(self) -> None:
        try:
            self._source.close()
        except Exception as error:  # noqa: BLE001 - as above
            self._error = str(error) or type(error).__name__

    def _doubted(self, told: Sequence[str]) -> list[Sample]:
        """Facts for the take of what is doubted of the source, if anything is."""
        self.doubts += tuple(told)
        return [Sample(None, self._clock.now_ns(), None, b"", (Facts(DOUBTS, {"words": list(told)}),))] if told else []

    def _put(self, samples: Sequence[Sample]) -> None:
        now_ns = self._clock.now_ns()
        with self._lock:
            for sample in samples:
                if is_data(sample):
                    self._began_ns, self._came_ns = self._began_ns or now_ns, now_ns
                    self._first_ns, self._last_ns = self._first_ns or sample.host_ns, sample.host_ns
                    self._data += 1
                size = _OVERHEAD + len(sample.raw) + sample_bytes(sample.messages)
                self._given += 1
                late = bool(self._queue) and now_ns - self._queue[0][0] > self._longest_ns
                if late or (self._queue and self._queued + size > self._room):
                    self._dropped += 1
                    self._dropped_bytes += size
                else:
                    self._queue.append((now_ns, size, sample))
                    self._queued += size
        self._wake.set()


def is_data(sample: Sample) -> bool:
    """Whether it says what was measured: a device that is dead may still answer pings, and say what it is called."""
    return sample.sequence is not None or any(not isinstance(message, Facts) for message in sample.messages)
