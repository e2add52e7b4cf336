"""What `cabinpose bench detect` times: our detectors from frame to joints, and the networks of others alone; run by run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from cabinpose.core.ports import FrameBatch
from cabinpose.estimate.onnx_model import BATCH, cameras_of, open_session
from cabinpose.estimate.predictor import OnnxPredictor

WARM = 5  # frames before each run that are not counted
_BATCHES = 2  # in a run
_NOISE_SEED = 1
_ALL = slice(0, BATCH)

Frame = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]


class Subject(Protocol):
    """Something that is timed."""

    session: onnxruntime.InferenceSession

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages of a frame."""

    def frame(self, number: int) -> tuple[float, ...]:
        """Seconds that each stage of frame `number` took, alone."""

    def batch(self) -> float | None:
        """Seconds a frame, of a whole batch; None where batches are not timed."""


class OurDetector:
    """A detector of ours: what the view sees of the camera's arrays, the network, and decoding to joints in 3D."""

    stages = ("input", "network", "decode")

    def __init__(self, predictor: OnnxPredictor, frames: Sequence[Frame], answers: Sequence[Arrays] | None = None) -> None:
        """frames: of the dataset standard, taken in turn · answers: for each of them the outputs that are decoded in place of
        the network's own.
        """
        self.session = predictor.session
        self._predictor = predictor
        self._frames = [frame_batch([frame]) for frame in frames]
        self._answers = answers
        turns = [i % len(frames) for i in range(BATCH)]
        self._batch = frame_batch([frames[i] for i in turns])
        self._batch_answers: Arrays | None = None
        if answers is not None:
            self._batch_answers = {name: np.concatenate([answers[i][name] for i in turns]) for name in answers[0]}

    def frame(self, number: int) -> tuple[float, ...]:
        """The three stages of one frame (s)."""
        i = number % len(self._frames)
        return self._through(self._frames[i], None if self._answers is None else self._answers[i])

    def batch(self) -> float:
        """Seconds a frame of a batch of `BATCH`."""
        return sum(self._through(self._batch, self._batch_answers)) / BATCH

    def _through(self, frames: FrameBatch, answers: Arrays | None) -> tuple[float, float, float]:
        """What `OnnxPredictor.predict` does with one batch."""
        start = time.perf_counter()
        cameras = cameras_of(frames, _ALL)
        seen = self._predictor.seen(frames, _ALL, cameras)
        prepared = time.perf_counter()
        outputs = self._predictor.outputs(seen)
        answered = time.perf_counter()
        self._predictor.poses(outputs if answers is None else answers, seen, cameras)
        return prepared - start, answered - prepared, time.perf_counter() - answered


class PeerNetwork:
    """A network alone, on noise of its input's size (width, height)."""

    stages = ("network",)

    def __init__(self, path: Path, size: tuple[int, int], *, threads: int) -> None:
        self.session = open_session(path, threads=threads)
        rng = np.random.Generator(np.random.Philox(key=_NOISE_SEED))
        self._image = rng.standard_normal((1, 3, *size[::-1]), dtype=np.float32)

    def frame(self, number: int) -> tuple[float, ...]:  # noqa: ARG002 - every image takes as long
        """The network's seconds."""
        start = time.perf_counter()
        self.session.run(None, {"image": self._image})
        return (time.perf_counter() - start,)

    def batch(self) -> None:
        """A peer's batches are not timed."""


class Run(NamedTuple):
    """One run. seconds: (N, stages) of single frames · batch_s: seconds a frame in batches, or None."""

    seconds: NDArray[np.float64]
    batch_s: float | None


def timed_run(subject: Subject, frames: int) -> Run:
    """A few frames that are not counted, then `frames` one at a time, then batches."""
    for number in range(WARM):
        subject.frame(number)
    seconds = np.array([subject.frame(number) for number in range(frames)])
    batches = [subject.batch() for _ in range(_BATCHES)]
    counted = [seconds_ for seconds_ in batches if seconds_ is not None]
    return Run(seconds, statistics.median(counted) if counted else None)


def figures(subject: Subject, runs: Sequence[Run]) -> dict[str, Any]:
    """Medians over runs. p50_ms, p95_ms: of whole frames · frames_per_s: frames of a run over the time of all of them · runs:
    that of each · stages_ms: medians within a run · frames_per_s_batch: where batches were timed.
    """
    rates = [1 / float(np.mean(run.seconds.sum(axis=1))) for run in runs]
    p50, p95 = (
        statistics.median(1e3 * float(np.percentile(run.seconds.sum(axis=1), percent)) for run in runs) for percent in (50, 95)
    )
    stages = np.median([1e3 * np.median(run.seconds, axis=0) for run in runs], axis=0)
    result: dict[str, Any] = {"frames_per_s": statistics.median(rates), "p50_ms": p50, "p95_ms": p95}
    result["stages_ms"] = dict(zip(subject.stages, stages.tolist(), strict=True))
    batches = [1 / run.batch_s for run in runs if run.batch_s is not None]
    if batches:
        result["frames_per_s_batch"] = statistics.median(batches)
    return result | {"runs": rates}


def frame_batch(frames: Sequence[Frame]) -> FrameBatch:
    """Frames of the dataset standard as a detector gets them from one camera."""
    return {
        "depth": np.stack([np.asarray(frame["depth"], dtype=np.float32) for frame in frames]),
        "amplitude": np.stack([frame["amplitude"] for frame in frames]),
        "camera_k": frames[0]["camera_k"],
        "camera_dist": frames[0]["camera_dist"],
    }
