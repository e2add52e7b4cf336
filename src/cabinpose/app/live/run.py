"""Detectors at work on live frames: what they find, how long it takes, and what was missed meanwhile."""

from __future__ import annotations

import time
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cabinpose.app.live.feed import Feed, FeedStatus, LiveFrame
from cabinpose.app.models import seat_predictors
from cabinpose.core import CabinposeError, PoseBatch, Predictor, images_of, joined, require_images, skeleton_of, without_numbers
from cabinpose.estimate import Smoother, WheelOverTime, cameras_of
from cabinpose.store import Predictions, empty_batch

_MOST_CAUSES = 20  # of failures that are told apart
_WINDOW = 100  # frames over which the present rate and latency are taken


@dataclass(frozen=True)
class Found:
    """What one detector found in a frame: poses (one frame), or why it found nothing; ms that it took."""

    model: str
    poses: PoseBatch
    error: str
    ms: float


@dataclass(frozen=True)
class Latency:
    """Percentiles of a time, ms."""

    p50: float
    p95: float
    p99: float

    @classmethod
    def of(cls, ms: Sequence[float]) -> Latency | None:
        """Those of a number of times; None of none."""
        return cls(*np.percentile(ms, (50, 95, 99)).tolist()) if ms else None


@dataclass(frozen=True)
class LiveStatus:
    """How it goes. rate_hz: frames answered a second, of late · latency: from the frame's arrival to all joints, ms ·
    models: time in each detector, ms · failed: frames on which each detector gave no answer · causes: why, how often each ·
    unseen: frames in which nobody can be seen, by the reason that each detector gives · remarks: what else stood out to it.
    """

    frames: int
    rate_hz: float
    latency: Latency | None
    models: dict[str, Latency | None]
    failed: dict[str, int]
    causes: dict[str, dict[str, int]]
    unseen: dict[str, dict[str, int]]
    remarks: dict[str, list[str]]
    feed: FeedStatus


_Answered = tuple[LiveFrame, tuple[Found, ...]]


@dataclass
class _Answers:
    """One detector's answers so far."""

    numbers: list[int] = field(default_factory=list)
    batches: list[PoseBatch] = field(default_factory=list)
    ms: array[float] = field(default_factory=lambda: array("d"))
    failed: int = 0
    causes: _Counted = field(default_factory=dict)
    unseen: _Counted = field(default_factory=dict)
    remarks: dict[str, None] = field(default_factory=dict)

    def count(self, error: str) -> None:
        """Count a failure by its cause."""
        self.failed += 1
        _count(error, self.causes)

    def note(self, poses: PoseBatch) -> None:
        """Count what a detector says beside its answer to one frame."""
        if reason := poses.reason[0]:
            _count(reason, self.unseen)
        for remark in poses.remarks:
            if len(self.remarks) < _MOST_CAUSES:
                self.remarks[remark] = None


_Counted = dict[str, tuple[str, int]]  # the first message, how often; by it without its numbers


def _count(message: str, known: _Counted) -> None:
    """Count a message; those that differ in numbers alone are one."""
    key = without_numbers(message)
    if key not in known and len(known) >= _MOST_CAUSES:
        key = message = "other causes"
    first, times = known.get(key, (message, 0))
    known[key] = first, times + 1


class Live:
    """Runs detectors on the frames of a feed, in the caller's thread."""

    def __init__(
        self, feed: Feed, models: Sequence[Predictor], *, skip_errors: bool = False, keep: bool = False,
        smoothers: Sequence[Smoother] = (),
    ) -> None:  # fmt: skip
        """skip_errors: a frame that a detector fails on is counted, and the run goes on; otherwise the error is raised ·
        keep: remember all answers, for `predictions` · smoothers: one for each model, of one lag, by which answers come later.
        Raises DatasetError for a model that reads an image which the feed lacks.
        """
        require_images(models, feed.images, feed.name)
        feed.wanted = tuple(dict.fromkeys(name for model in models for name in images_of(model)))
        self.feed, self.models = feed, tuple(models)
        self._skip_errors, self._keep = skip_errors, keep
        self._answers = {model.name: _Answers() for model in self.models}
        self._latency_ms, self._ended_s = array("d"), array("d")
        self._smoothers, self._waiting = tuple(smoothers), deque[_Answered]()
        self._before: tuple[int, int] | None = None  # sequence and time of the last frame
        self.frames = 0
        """Frames looked at so far."""

    def run(self, go_on: Callable[[], bool] = lambda: True) -> Iterator[tuple[LiveFrame, tuple[Found, ...]]]:
        """Each frame with what each detector found in it, until the feed ends or `go_on` says no.

        Where nothing says on which side the wheel is, detectors see it over the frames of a sequence, since it stays there.
        """
        try:
            yield from self._run(go_on)
        finally:
            for model in seat_predictors(self.models):
                model.wheel_over_time = None

    def _run(self, go_on: Callable[[], bool]) -> Iterator[_Answered]:
        for frame in self.feed.frames():
            if frame is not None:
                found = self._look(frame)
                if not self._smoothers:
                    yield self._ended(frame, found)
                else:
                    self._waiting.append((frame, found))
                    smooth = [
                        poses
                        for smoother, each in zip(self._smoothers, found, strict=True)
                        if (poses := smoother(each.poses, frame.taken_ns, frame.sequence)) is not None
                    ]
                    if smooth:
                        yield self._smoothed(smooth)
            if not go_on():
                break
        for last in zip(*(smoother.rest() for smoother in self._smoothers), strict=True):
            yield self._smoothed(last)

    def _smoothed(self, poses: Sequence[PoseBatch]) -> _Answered:
        """The frame that waits longest, with each detector's smoothed joints in it."""
        frame, found = self._waiting.popleft()
        return self._ended(frame, tuple(replace(each, poses=smooth) for each, smooth in zip(found, poses, strict=True)))

    def _ended(self, frame: LiveFrame, found: tuple[Found, ...]) -> _Answered:
        """The same, once the answers are there: kept, and their latency noted."""
        for each in found:
            answers = self._answers[each.model]
            if self._keep and not each.error:
                answers.numbers.append(frame.number)
                answers.batches.append(each.poses)
        self._latency_ms.append((self.feed.clock.now_ns() - frame.host_ns) / 1e6)
        self._ended_s.append(time.monotonic())
        return frame, found

    def _look(self, frame: LiveFrame) -> tuple[Found, ...]:
        """What each detector finds in a frame, counted."""
        batch = frame.batch
        if "cloud" in self.feed.wanted and "cloud" not in batch:
            batch["cloud"] = cameras_of(batch, slice(0, 1))[0].points(batch["depth"]).astype(np.float32)
        self.frames += 1
        follows = self._before is not None and self._before[0] == frame.sequence and self._before[1] < frame.taken_ns
        self._before = frame.sequence, frame.taken_ns
        if not follows:  # another car, as in frames of no sequence
            for model in seat_predictors(self.models):
                model.wheel_over_time = WheelOverTime()
        return tuple(self._ask(model, frame) for model in self.models)

    def _ask(self, model: Predictor, frame: LiveFrame) -> Found:
        answers = self._answers[model.name]
        began = time.perf_counter()
        error = ""
        try:
            poses = model.predict(frame.batch)
        except CabinposeError as problem:
            if not self._skip_errors:
                raise
            poses, error = empty_batch(1, len(model.persons), len(model.joints)), problem.in_one_line()
            answers.count(error)
        ms = 1e3 * (time.perf_counter() - began)
        if not error:
            answers.ms.append(ms)
            answers.note(poses)
        return Found(model.name, poses, error, ms)

    def status(self, *, whole: bool = False) -> LiveStatus:
        """Rates and latencies of late, or of the whole run."""
        since = 0 if whole else -_WINDOW
        ended = self._ended_s[since:]
        span = ended[-1] - ended[0] if ended else 0.0
        return LiveStatus(
            frames=self.frames,
            rate_hz=(len(ended) - 1) / span if span > 0 else 0.0,
            latency=Latency.of(self._latency_ms[since:]),
            models={name: Latency.of(answers.ms[since:]) for name, answers in self._answers.items()},
            failed={model.name: self._answers[model.name].failed + getattr(model, "failed", 0) for model in self.models},
            causes={name: dict(answers.causes.values()) for name, answers in self._answers.items()},
            unseen={name: dict(answers.unseen.values()) for name, answers in self._answers.items()},
            remarks={name: [*answers.remarks] for name, answers in self._answers.items()},
            feed=self.feed.status(),
        )

    def answered(self, model: Predictor) -> int:
        """How many answers of a detector are kept."""
        return len(self._answers[model.name].numbers)

    def predictions(self, model: Predictor) -> Predictions:
        """All answers of a detector, by the numbers of the frames; of a number that a camera gave twice the first."""
        answers = self._answers[model.name]
        name = self._smoothers[0].model_name(model.name) if self._smoothers else model.name
        found = joined([empty_batch(0, len(model.persons), len(model.joints)), *answers.batches])
        numbers, order = np.unique(np.array(answers.numbers, np.int64), return_index=True)
        return Predictions(
            **vars(found.map(lambda values: values[order])), frame=numbers,
            persons=model.persons, joints=model.joints, model=name,
            skeleton=skeleton_of(model).name, joint_definition=getattr(model, "joint_definition", ""),
        )  # fmt: skip


def found_record(frame: LiveFrame, found: Sequence[Found], models: Sequence[Predictor]) -> dict[str, Any]:
    """What was found in a frame as plain data: a line of `live --json`, and of what the studio records."""
    return {
        "frame": frame.number,
        "host_ns": frame.host_ns,
        "models": [
            {"model": f.model, "ms": round(f.ms, 3), "people": _people(f, model.persons, model.joints)}
            | ({"error": f.error} if f.error else {})
            | ({"reason": str(f.poses.reason[0])} if f.poses.reason[0] else {})
            | ({"remarks": [*f.poses.remarks]} if f.poses.remarks else {})
            for f, model in zip(found, models, strict=True)
        ],
    }


def _people(found: Found, persons: tuple[str, ...], joints: tuple[str, ...]) -> dict[str, Any]:
    """Joints by person and name; those without an answer are left out."""
    poses, expected = found.poses, found.poses.expected_error_m[0]
    there = np.isfinite(poses.joints_2d[0]).all(axis=-1) | np.isfinite(poses.joints_3d[0]).all(axis=-1)
    return {
        person: {
            joint: {
                "px": [round(float(x), 2) for x in poses.joints_2d[0, p, j]],
                "m": [round(float(x), 4) for x in poses.joints_3d[0, p, j]],
                "score": round(float(poses.score[0, p, j]), 4),
                "presence": round(float(poses.presence[0, p, j]), 4),
            }
            | ({"expected_error_m": round(float(expected[p, j]), 4)} if np.isfinite(expected[p, j]) else {})
            for j, joint in enumerate(joints)
            if there[p, j]
        }
        for p, person in enumerate(persons)
        if there[p].any()
    }
