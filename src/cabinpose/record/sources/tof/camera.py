"""What the ToF cameras share: the hand-over from the SDK's thread, counting, reaching a lost camera again."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core.camera import Camera
from cabinpose.core.clock import HostClock
from cabinpose.core.errors import CabinposeError, DependencyError, RecordingError
from cabinpose.core.ports import Counts, Sample
from cabinpose.core.recorded import Facts, Message, ToFFrame

MOST_PIXELS = 1 << 24  # of an image: no ToF sensor is near it, and a header may say anything


class MalformedFrameError(ValueError):
    """What a camera delivered is no frame: sizes that contradict each other, formats that are unknown."""


class Lens(BaseModel):
    """Intrinsics that the user knows better than the camera: px, OpenCV's distortion."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    fx: float = Field(gt=0, description="focal length, px")
    fy: float = Field(gt=0, description="focal length, px")
    cx: float = Field(description="principal point, px; an integer is a pixel's centre")
    cy: float = Field(description="principal point, px")
    dist: tuple[float, float, float, float, float] = Field((0.0, 0.0, 0.0, 0.0, 0.0), description="k1 k2 p1 p2 k3")

    def camera(self, width: int, height: int) -> Camera:
        """The camera of images of a size."""
        return Camera(width, height, self.fx, self.fy, self.cx, self.cy, self.dist)


class CameraSettings(BaseModel):
    """What every ToF camera may be told."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    queue_frames: int = Field(8, ge=1, le=1000, description="frames kept between the camera's thread and the recorder's")
    depth_unit_m: float = Field(0.00025, gt=0, le=0.01, description="step of the recorded depth where the camera states none, m")
    reconnect_s: float = Field(2.0, gt=0, description="seconds between attempts to reach a camera that went away")
    lens: Lens | None = Field(None, description="intrinsics in place of the camera's own")


@dataclass(frozen=True, slots=True)
class Arrival:
    """A frame as the SDK's thread hands it over: copied, and not decoded yet."""

    sequence: int
    host_ns: int
    device_ns: int | None
    payload: Any


class CameraSource(ABC):
    """A `FrameSource` of a camera whose SDK delivers frames on a thread of its own, or when asked.

    A subclass connects, and calls `_deliver` for every frame with a copy of its arrays; decoding is done by the reader.
    """

    def __init__(self, name: str, settings: CameraSettings, clock: HostClock) -> None:
        self._name = name
        self._camera_settings = settings
        self._clock = clock
        self._counts = Counts()
        self._arrivals: deque[Arrival] = deque()
        self._changed = threading.Condition()
        self._facts: list[Facts] = []
        self._opened = False
        self._next_attempt_s = 0.0

    @property
    def name(self) -> str:
        """What the rig's configuration calls it."""
        return self._name

    @property
    def counts(self) -> Counts:
        """What became of the frames; one that found the queue full is lost."""
        return self._counts

    def check(self) -> Sequence[str]:
        """What keeps the camera from working; looks for the SDK and, where the SDK lists them, for the camera."""
        try:
            return self._missing()
        except CabinposeError as error:
            return [error.in_one_line()]

    def open(self) -> None:
        """Connect and let frames come."""
        if not self._opened:
            self._connect()
            self._opened = True

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """The frames since the last call; tries to reach a camera that went away."""
        if not self._opened:
            raise RecordingError(f"{self._name} is not open", hint="call open() first")
        self._wait(timeout_s)
        with self._changed:
            arrivals, facts = list(self._arrivals), list(self._facts)
            self._arrivals.clear()
            self._facts.clear()
        samples = [Sample(None, self._clock.now_ns(), None, b"", tuple(facts))] if facts else []
        samples += [self._sample(arrival) for arrival in arrivals]
        with self._changed:  # what decoding found out, of the frames just decoded
            facts = list(self._facts)
            self._facts.clear()
        if facts:
            samples.append(Sample(None, self._clock.now_ns(), None, b"", tuple(facts)))
        if not arrivals and not self._alive():
            self._reconnect()
        return samples

    def close(self) -> None:
        """Stop the frames and let the camera go."""
        if self._opened:
            self._opened = False
            self._disconnect()

    @abstractmethod
    def _missing(self) -> Sequence[str]:
        """As `check`; may raise DependencyError or RecordingError instead."""

    @abstractmethod
    def _connect(self) -> None:
        """Start the frames. Raises DependencyError or RecordingError, having let go of everything."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Stop the frames, as far as they run; raises nothing."""

    @abstractmethod
    def _alive(self) -> bool:
        """Whether the camera is still there."""

    @abstractmethod
    def _number(self, payload: Any, host_ns: int) -> tuple[int, int | None]:
        """The sequence number and device time of a frame; counts what is missing before it."""

    @abstractmethod
    def _decode(self, payload: Any) -> ToFFrame:
        """The frame; raises MalformedFrameError."""

    def _reached_again(self) -> None:  # noqa: B027 - a device without a clock or counter of its own has nothing to forget
        """Forget the clock and counter of the camera, which begin anew."""

    def _wait(self, timeout_s: float) -> None:
        """Wait for frames or facts; an SDK that wants to be asked is asked here instead."""
        with self._changed:
            if not self._arrivals and not self._facts:
                self._changed.wait(timeout_s)

    def _state(self, about: str, **values: object) -> None:
        """Say something of the camera in the next sample."""
        with self._changed:
            self._facts.append(Facts(about, values))
            self._changed.notify()

    def _deliver(self, payload: Any) -> None:
        """Hand a frame over, with nothing in it that the SDK will change or free; any thread."""
        host_ns = self._clock.now_ns()
        with self._changed:
            sequence, device_ns = self._number(payload, host_ns)
            if len(self._arrivals) >= self._camera_settings.queue_frames:
                self._counts.lost += 1  # the reader is late: the gap in the sequence says where
                return
            self._arrivals.append(Arrival(sequence, host_ns, device_ns, payload))
            self._changed.notify()

    def _sample(self, arrival: Arrival) -> Sample:
        messages: tuple[Message, ...] = ()
        self._counts.received += 1
        try:
            with np.errstate(invalid="ignore", over="ignore"):  # infinities of a camera are no fault of ours to warn of
                messages = (_fitting(self._decode(arrival.payload)),)
        except (ValueError, TypeError, OverflowError):  # MalformedFrameError, and what numpy says of values that are none
            self._counts.malformed += 1
        return Sample(arrival.sequence, arrival.host_ns, arrival.device_ns, b"", messages)

    def _reconnect(self) -> None:
        """Try to reach a camera that went away, not too often."""
        now = time.monotonic()
        if now < self._next_attempt_s:
            return
        self._next_attempt_s = now + self._camera_settings.reconnect_s
        self._disconnect()
        with self._changed:
            self._reached_again()
        try:
            self._connect()
        except DependencyError:
            raise
        except RecordingError:
            return
        self._counts.restarts += 1


def _fitting(frame: ToFFrame) -> ToFFrame:
    """The frame, whose images have one size. Raises MalformedFrameError."""
    shapes = {image.shape for image in (frame.depth, frame.amplitude, frame.confidence)} - {(0, 0)}
    if len(shapes) > 1:
        raise MalformedFrameError(f"images of sizes {sorted(shapes)}")
    return frame


def depth_image(z_m: ArrayLike, valid: ArrayLike, unit_m: float) -> NDArray[np.uint16]:
    """Depth in steps of `unit_m`, 0 where it is not valid, not finite, not positive or beyond what 16 bits hold."""
    z = np.asarray(z_m, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        steps = np.rint(z / unit_m)
        good = np.asarray(valid, dtype=bool) & np.isfinite(steps) & (steps >= 1) & (steps <= 65535)
    return np.where(good, steps, 0).astype(np.uint16)


def shaped(values: ArrayLike, width: int, height: int, channels: int = 1) -> NDArray[Any]:
    """Values of an image in rows: (height, width) or (height, width, channels). Raises MalformedFrameError."""
    array = np.asarray(values)
    if not (0 < width * height <= MOST_PIXELS) or array.size != width * height * channels:
        raise MalformedFrameError(f"{array.size} values for {width}x{height} pixels of {channels}")
    return array.reshape((height, width) if channels == 1 else (height, width, channels))


def rays_of_points(points: NDArray[np.floating], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(height, width, 2): x/z and y/z of points (height, width, 3), NaN where they are not valid."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rays = points[..., :2].astype(np.float64) / points[..., 2:3]
    rays[~(valid & np.isfinite(rays).all(axis=-1))] = np.nan
    return rays
