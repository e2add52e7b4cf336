"""What `bench detect` times: our detectors from frame to joints, and networks of others alone; run by run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from benchmarks.opening import opened
from cabinpose.core.errors import ConfigError
from cabinpose.core.ports import FrameBatch
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.onnx_model import BATCH, OnnxModel, cameras_of, open_session

WARM = 5  # frames before each run that are not counted
_BATCHES = 2  # in a run
_NOISE_SEED = 1

Frame = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]


class Subject:
    """Something that is timed. stages: names of the stages of a frame · about: what the report says of it beside the times."""

    def __init__(self, session: onnxruntime.InferenceSession, stages: tuple[str, ...], about: Mapping[str, Any]) -> None:
        self.session, self.stages, self.about = session, stages, about

    def frame(self, number: int) -> tuple[float, ...]:
        """Seconds of each stage of one frame."""
        raise NotImplementedError

    def batch(self) -> float | None:
        """Seconds per frame in a batch; None where batches are not timed."""
        return None

    def opened(self, folder: Path, threads: int) -> dict[str, float]:
        """How long it takes to open and what memory, see `opening.opened`; folder: for what the other process reads."""
        raise NotImplementedError


class OurDetector(Subject):
    """A detector of this package: the view of the camera's arrays, the network, decoding to joints in 3D, and checks."""

    def __init__(
        self, predictor: JointPredictor, frames: Sequence[Frame], answers: Sequence[Arrays] | None = None, **about: Any
    ) -> None:
        """frames: of the dataset standard, taken in turn · answers: for each frame the outputs that are decoded in place of the
        network's own.
        """
        self._predictor, self._model = predictor, cast(OnnxModel, predictor.model)
        super().__init__(self._model.session, ("input", "network", "decode", "checks"), about)
        self._frames = [frame_batch([frame]) for frame in frames]
        self._answers = answers or [{} for _ in frames]
        turns = [i % len(frames) for i in range(BATCH)]
        self._batch = frame_batch([frames[i] for i in turns])
        self._batch_answers = {n: np.concatenate([self._answers[i][n] for i in turns]) for n in self._answers[0]}

    def frame(self, number: int) -> tuple[float, ...]:
        """Seconds of the stages of one frame."""
        i = number % len(self._frames)
        return self._time(self._frames[i], self._answers[i])

    def batch(self) -> float:
        """Seconds per frame in a batch of `BATCH`."""
        return sum(self._time(self._batch, self._batch_answers)) / BATCH

    def opened(self, folder: Path, threads: int) -> dict[str, float]:
        """By itself, on the first of its frames."""
        shown = folder / "frames.npz"
        np.savez(shown, **cast("dict[str, Any]", self._frames[0]))
        return opened("ours", self._model.path, threads=threads, frames=shown)

    def _time(self, frames: FrameBatch, answers: Arrays) -> tuple[float, ...]:
        """The steps of `JointPredictor.predict` on one batch."""
        every = slice(0, BATCH)
        start = time.perf_counter()
        cameras = cameras_of(frames, every)
        seen = self._predictor.seen(frames, every, cameras)
        prepared = time.perf_counter()
        outputs = self._model.outputs(seen)
        answered = time.perf_counter()
        found = self._model.method.decode(answers or outputs, self._model.config, seen)
        poses = self._predictor.poses(found, cameras)
        decoded = time.perf_counter()
        self._predictor.believed(poses, frames, every, seen, cameras)
        return prepared - start, answered - prepared, decoded - answered, time.perf_counter() - decoded


class PeerNetwork(Subject):
    """A network alone, on noise of its input's shape."""

    def __init__(self, path: Path, *, threads: int, **about: Any) -> None:
        """Raises ConfigError for a network of several inputs, or of images of any size."""
        super().__init__(open_session(path, threads=threads), ("network",), about)
        self._path, inputs = path, self.session.get_inputs()
        shapes = [each.shape for each in inputs]
        if len(inputs) != 1 or not all(isinstance(length, int) for length in shapes[0][1:]):
            raise ConfigError(f"{path} takes inputs of shapes {shapes}", hint="export it for one image of a fixed size")
        self.about = {"input": shapes[0][:1:-1], **about}  # width and height
        rng = np.random.Generator(np.random.Philox(key=_NOISE_SEED))
        self._given = {inputs[0].name: rng.standard_normal((1, *shapes[0][1:]), dtype=np.float32)}

    def frame(self, number: int) -> tuple[float, ...]:  # noqa: ARG002 - every image takes as long
        """Seconds of the network."""
        start = time.perf_counter()
        self.session.run(None, self._given)
        return (time.perf_counter() - start,)

    def opened(self, folder: Path, threads: int) -> dict[str, float]:  # noqa: ARG002 - it needs no frames
        """By itself."""
        return opened("peer", self._path, threads=threads)


class Run(NamedTuple):
    """One run. seconds: (N, stages) of single frames · batch_s: seconds per frame in batches, or None."""

    seconds: NDArray[np.float64]
    batch_s: float | None


def timed_run(subject: Subject, frames: int) -> Run:
    """A few frames that are not counted, then `frames` one at a time, then batches."""
    for number in range(WARM):
        subject.frame(number)
    seconds = np.array([subject.frame(number) for number in range(frames)])
    batches = [batch for _ in range(_BATCHES) if (batch := subject.batch()) is not None]
    return Run(seconds, statistics.median(batches) if batches else None)


def figures(subject: Subject, runs: Sequence[Run]) -> dict[str, Any]:
    """Medians over runs. p50_ms, p95_ms: of whole frames · frames_per_s: frames of a run over the time of all of them · runs:
    that of each · stages_ms: medians within a run · frames_per_s_batch: where batches were timed.
    """
    totals = [run.seconds.sum(axis=1) for run in runs]
    rates = [1 / float(np.mean(total)) for total in totals]
    p50, p95 = (statistics.median(1e3 * float(np.percentile(total, percent)) for total in totals) for percent in (50, 95))
    stages = np.median([1e3 * np.median(run.seconds, axis=0) for run in runs], axis=0)
    result = {
        "frames_per_s": statistics.median(rates), "p50_ms": p50, "p95_ms": p95,
        "stages_ms": dict(zip(subject.stages, stages.tolist(), strict=True)), "runs": rates,
    }  # fmt: skip
    batches = [1 / run.batch_s for run in runs if run.batch_s is not None]
    return result | ({"frames_per_s_batch": statistics.median(batches)} if batches else {})


def frame_batch(frames: Sequence[Frame]) -> FrameBatch:
    """Frames of the dataset standard as a detector gets them from one camera."""
    return {
        "depth": np.stack([np.asarray(frame["depth"], dtype=np.float32) for frame in frames]),
        "amplitude": np.stack([frame["amplitude"] for frame in frames]),
        "camera_k": frames[0]["camera_k"],
        "camera_dist": frames[0]["camera_dist"],
    }
