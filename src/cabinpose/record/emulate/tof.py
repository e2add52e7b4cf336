"""A ToF camera without hardware: frames of a dataset or of the generator at a camera's pace, with the faults of one.

ToF cameras have no network protocol in common, so nothing is served on a port: the emulator runs in the recorder's process,
hands frames over from a thread of its own as an SDK does, and keeps a log of what it did with each, to hold a recording
against.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.record.emulate.base import Emulator
from cabinpose.signals import HostClock

Frame = Mapping[str, Any]
Fate = Literal["sent", "lost", "stalled"]


class TofFaults(BaseModel):
    """What is wrong with an emulated camera and its clock; nothing, unless told."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    rate_hz: float = Field(15.0, gt=0, le=1000, description="frames a second")
    loss: float = Field(0.0, ge=0, le=1, description="share of frames that never arrive, though the camera counts them")
    jitter_s: float = Field(0.0, ge=0, description="standard deviation of the delay of a frame's arrival, s")
    latency_s: float = Field(0.0, ge=0, description="delay of every frame's arrival, s")
    stall_every_s: float = Field(0.0, ge=0, description="seconds between stalls; 0 = never")
    stall_s: float = Field(0.0, ge=0, description="how long a stall swallows frames, s")
    clock_offset_s: float = Field(0.0, description="the camera's clock before the host's, s")
    clock_drift_ppm: float = Field(0.0, ge=-10_000, le=10_000, description="how much faster the camera's clock runs, ppm")
    seed: int = Field(0, ge=0, description="of the faults")


class Sent(NamedTuple):
    """One line of the ground truth: the camera's count, its time stamp, when it was taken (host), and what became of it."""

    counter: int
    device_ns: int
    taken_ns: int
    fate: Fate


class EmulatedCamera(Emulator):
    """Takes a frame every period and hands it to `listener(counter, device_ns, frame)` on a thread of its own.

    The first frame is there before the camera's clock starts: `start` waits for it, however long it takes to make or to read.
    A source of frames that is slower than the camera slows it down; `late` counts the periods that it missed.
    """

    def __init__(
        self,
        frames: Callable[[], Iterable[Frame]],
        faults: TofFaults,
        clock: HostClock,
        listener: Callable[[int, int, Frame], None],
        loop: bool = True,
    ) -> None:
        super().__init__(clock)
        self.frames, self.faults, self.listener, self.loop = frames, faults, listener, loop
        self.log: list[Sent] = []
        self.late = 0
        self.ended = False
        self.error: Exception | None = None
        self._ready: Iterator[Frame] = iter(())

    def open(self) -> None:
        """Have the first frame ready; where that fails, `error` says so once the camera runs."""
        frames = self._endless()
        try:
            self._ready = chain([next(frames)], frames)
        except StopIteration:
            self._ready = iter(())
        except Exception as error:  # noqa: BLE001 - a source of frames may fail in any way; the reader is told
            self._ready = map(_fail, [error])

    def device_ns(self, taken_ns: int, origin_ns: int) -> int:
        """What the camera's clock says at a moment of the host's; it began to drift at `origin_ns`."""
        elapsed = taken_ns - origin_ns
        return origin_ns + elapsed + round(elapsed * self.faults.clock_drift_ppm * 1e-6 + self.faults.clock_offset_s * 1e9)

    def _run(self) -> None:
        try:
            self._take_frames()
        except Exception as error:  # noqa: BLE001 - a source of frames may fail in any way; the reader is told
            self.error = error
        self.ended = True

    def _take_frames(self) -> None:
        faults = self.faults
        rng = np.random.Generator(np.random.Philox(key=faults.seed))
        period_ns = round(1e9 / faults.rate_hz)
        origin_ns = started_ns = self._clock.now_ns()
        slack_ns = period_ns + round((faults.latency_s + 4 * faults.jitter_s) * 1e9)
        for counter, frame in enumerate(self._ready):
            taken_ns = started_ns + counter * period_ns
            now_ns = self._clock.now_ns()
            if now_ns > taken_ns + slack_ns:  # the frame was not there in time
                missed = (now_ns - taken_ns) // period_ns
                self.late += missed
                started_ns += missed * period_ns
                taken_ns = started_ns + counter * period_ns
            delay_s = faults.latency_s + max(rng.normal(0.0, faults.jitter_s), 0.0) if faults.jitter_s else faults.latency_s
            if self._clock.wait(self._stopping, (taken_ns - self._clock.now_ns()) / 1e9 + delay_s):
                return
            fate = self._fate(taken_ns - origin_ns, rng.random())
            device_ns = self.device_ns(taken_ns, origin_ns)
            self.log.append(Sent(counter, device_ns, taken_ns, fate))
            if fate == "sent":
                self.listener(counter, device_ns, frame)

    def _fate(self, elapsed_ns: int, drawn: float) -> Fate:
        faults = self.faults
        if faults.stall_every_s > 0 and (elapsed_ns / 1e9) % (faults.stall_every_s + faults.stall_s) >= faults.stall_every_s:
            return "stalled"
        return "lost" if drawn < faults.loss else "sent"

    def _endless(self) -> Iterator[Frame]:
        while True:
            empty = True
            for frame in self.frames():
                empty = False
                yield frame
                if self._stopping.is_set():
                    return
            if empty or not self.loop:
                return


def _fail(error: Exception) -> Frame:
    """In place of a frame, the error that there was."""
    raise error
