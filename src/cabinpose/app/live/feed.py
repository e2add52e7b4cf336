"""Where live frames come from: a device, a recording, a dataset, a rig; one after another, or the newest one only."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core import FrameBatch, RecordingError, SourceEndedError
from cabinpose.evaluate import frame_batch
from cabinpose.record import Lane, Recorder, Rig, start_recorder
from cabinpose.signals import SETUP, Counts, Facts, FrameSource, HostClock, Sample, ToFFrame
from cabinpose.store import image_names, open_dataset

_WAIT_S = 0.1  # for a frame, before the caller is asked whether to go on


@dataclass(frozen=True)
class LiveFrame:
    """One frame as a detector gets it. number: of the dataset's frame, of a recording from 0 as `predict` counts, of a device its
    own count or, where it does not count, how many came before · host_ns: when it came · taken_ns: when it was taken, by the
    dataset or the device, or `host_ns` (of a recording, as recorded) where neither says it · sequence: the dataset's.
    """

    number: int
    host_ns: int
    batch: FrameBatch
    taken_ns: int
    sequence: int = 0


@dataclass(frozen=True)
class FeedStatus:
    """What is known of the source: its own counts, frames that newer ones replaced unseen, and what is wrong with it;
    setup: what a camera was set to, and what it has.
    """

    counts: Counts
    passed_over: int
    error: str
    silent: bool
    setup: Mapping[str, Any] = field(default_factory=dict)


class Feed(ABC):
    """Frames for detectors. `start` it, ask for `frames`, `stop` it."""

    name: str
    clock: HostClock  # of the frames' host_ns
    images: tuple[str, ...] = ("depth", "amplitude", "confidence", "noise", "cloud")
    """Those that its frames may hold, of `cabinpose.core.IMAGES`: a ToF camera's."""
    wanted: tuple[str, ...] = ()
    """Those that detectors ask for."""
    drive_side: str = ""
    """Where the wheel is, "left" or "right"; "" where nobody says it, or each frame does."""

    @abstractmethod
    def start(self) -> None:
        """Connect; raises RecordingError or DatasetError where that fails."""

    @abstractmethod
    def frames(self) -> Iterator[LiveFrame | None]:
        """The frames, until the source ends; None where none came for a tenth of a second, so that the caller may leave."""

    @abstractmethod
    def status(self) -> FeedStatus:
        """How the source does."""

    def stop(self) -> None:  # noqa: B027 - a dataset has nothing to let go of
        """Disconnect, and end what is being recorded."""


class DatasetFeed(Feed):
    """Every frame of a dataset, in order, as fast as it is asked for."""

    def __init__(self, folder: Path) -> None:
        self.name = folder.name
        self.dataset = open_dataset(folder)
        self.images = image_names(self.dataset)
        self.clock, self._counts = HostClock(), Counts()

    def start(self) -> None:
        """Nothing to connect to."""

    def frames(self) -> Iterator[LiveFrame | None]:
        """The frames as `evaluate` and `predict` read them."""
        facts = (self.dataset[name].values.tolist() for name in ("frame", "sync_ns", "sequence"))
        for row, (number, taken_ns, sequence) in enumerate(zip(*facts, strict=True)):
            batch = frame_batch(self.dataset, slice(row, row + 1), self.wanted)
            self._counts.received += 1
            yield LiveFrame(number, self.clock.now_ns(), batch, taken_ns, sequence)

    def status(self) -> FeedStatus:
        """Nothing is lost."""
        return FeedStatus(self._counts, 0, "", silent=False)


class EveryFrame(Feed):
    """Every frame of a source that waits to be asked, such as a recording that is replayed."""

    def __init__(self, source: FrameSource, clock: HostClock) -> None:
        self.name, self._source, self.clock = source.name, source, clock
        self._given = 0

    def start(self) -> None:
        """Open the source."""
        self._source.open()

    def frames(self) -> Iterator[LiveFrame | None]:
        """Its frames, none left out."""
        while True:
            try:
                samples = self._source.read(_WAIT_S)
            except SourceEndedError:
                return
            if not samples:
                yield None
            for sample in samples:
                if (frame := live_frame(sample, self._given, self.drive_side)) is not None:
                    self._given += 1
                    yield replace(frame, host_ns=self.clock.now_ns())  # of a file many are read at once: it comes now

    def status(self) -> FeedStatus:
        """The counts of the source."""
        return FeedStatus(self._source.counts, 0, "", silent=False)

    def stop(self) -> None:
        """Close the source."""
        self._source.close()


class LatestFrame(Feed):
    """The newest frame of a device, read on a thread of its own: what comes while a detector works replaces what waits.

    With `out`, all that the source says is recorded meanwhile, as `cabinpose record` does it.
    """

    def __init__(self, rig: Rig, out: Path | None = None) -> None:
        """rig: of one source; its take and storage are those of the recording."""
        (plan,) = rig.sources
        self.name = plan.name
        self.clock, self._wake = HostClock(), threading.Event()
        self._recorded = plan.kind == "replay"  # whose cameras may have counted from anywhere
        self._source = _Tap(plan.build(self.clock))
        self.drive_side = rig.take.drive_side or ""
        self._lane = Lane(self._source, plan.kind, self.clock, self._wake)
        self._recorder: Recorder | None = None
        self._rig, self._out = rig, out

    def start(self) -> None:
        """Open the source, and the recording where there is to be one."""
        if self._out is not None:
            self._recorder = start_recorder(self._rig, [self._lane], self._out, self.clock, self._wake)
            return
        self._lane.start()
        if not self._lane.opened.wait(30.0) or self._lane.failure is not None:
            self._lane.stop()
            raise self._lane.failure or RecordingError(
                f"{self.name} does not answer", hint="`cabinpose record --check` says what is missing"
            )

    def frames(self) -> Iterator[LiveFrame | None]:
        """The newest frame whenever one is asked for, each once."""
        while True:
            ended = self._lane.ended  # before the look: the last frame may come between the two
            newest = self._source.newest(_WAIT_S)
            frame = None
            if newest is not None:
                before, sample = newest
                number = before if self._recorded or sample.sequence is None else sample.sequence
                frame = live_frame(sample, number, self.drive_side)
            if self._recorder is None:
                self._lane.take(1 << 62)  # nobody else empties its queue
            if frame is None and ended:
                return
            yield frame

    def status(self) -> FeedStatus:
        """The counts of the source, and whether it still speaks."""
        counts = self._lane.status(self._source.counts.received, self.clock.now_ns())
        return FeedStatus(self._source.counts, self._source.passed_over, counts.error, counts.silent, self._source.setup)

    def stop(self) -> None:
        """Stop the source and end the recording; raises RecordingError where the disk refused it."""
        if self._recorder is not None:
            outcome = self._recorder.stop()
            if outcome.error is not None:
                raise outcome.error
        else:
            self._lane.stop()
            self._lane.join(5.0)


class _Tap:
    """A source that keeps its newest frame for somebody else to look at."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._newest: tuple[int, Sample] | None = None  # frames before it, and what has it
        self._frames = 0
        self._changed = threading.Condition()
        self.setup: Mapping[str, Any] = {}
        self.passed_over = 0  # frames that a newer one replaced before anybody looked

    @property
    def name(self) -> str:
        """The source's."""
        return self._source.name

    @property
    def counts(self) -> Counts:
        """The source's."""
        return self._source.counts

    def check(self) -> Sequence[str]:
        """As the source's."""
        return self._source.check()

    def open(self) -> None:
        """As the source's."""
        self._source.open()

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """As the source's."""
        samples = self._source.read(timeout_s)
        for message in (message for sample in samples for message in sample.messages):
            if isinstance(message, Facts) and message.about == SETUP:
                self.setup = message.values
        seen = [sample for sample in samples if tof_frame_of(sample) is not None]
        if seen:
            with self._changed:
                self.passed_over += len(seen) - (self._newest is None)
                self._frames += len(seen)
                self._newest = self._frames - 1, seen[-1]
                self._changed.notify_all()
        return samples

    def close(self) -> None:
        """As the source's."""
        self._source.close()

    def newest(self, timeout_s: float) -> tuple[int, Sample] | None:
        """What has the newest frame that nobody has taken yet, behind the number of frames that came before it."""
        with self._changed:
            if self._newest is None:
                self._changed.wait(timeout_s)
            newest, self._newest = self._newest, None
        return newest


def tof_frame_of(sample: Sample) -> ToFFrame | None:
    """The image of a sample, where it has one."""
    return next((message for message in sample.messages if isinstance(message, ToFFrame)), None)


def live_frame(sample: Sample, number: int, drive_side: str = "") -> LiveFrame | None:
    """The frame of a sample as number so and so, with the side of the wheel where that is known; None where it holds none."""
    image = tof_frame_of(sample)
    if image is None:
        return None
    taken_ns = sample.host_ns if sample.device_ns is None else sample.device_ns
    batch = batch_of(image)
    batch["frame"], batch["sync_ns"] = np.array([number]), np.array([taken_ns])
    if drive_side:
        batch["drive_side"] = np.array([drive_side])
    return LiveFrame(number, sample.host_ns, batch, taken_ns)


def batch_of(image: ToFFrame) -> FrameBatch:
    """A recorded frame as a batch of one, the same numbers as a dataset of it holds."""
    batch = FrameBatch(depth=image.depth_m()[None], camera_k=image.camera_k[None], camera_dist=image.camera_dist[None])
    if image.amplitude.size:
        batch["amplitude"] = image.amplitude[None]
    if image.confidence.size:
        batch["confidence"] = image.confidence[None]
    if image.noise.size:
        batch["noise"] = image.noise[None]
    return batch
