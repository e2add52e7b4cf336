"""What the ToF cameras share: the hand-over from the SDK's thread, counting, reaching a lost camera again."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import Camera, check_camera, fit_camera
from cabinpose.record.sources.base import DeviceSource
from cabinpose.signals import FRAME_IMAGES, Facts, HostClock, Message, Sample, ToFFrame

MOST_PIXELS = 1 << 24  # of an image: no ToF sensor is near it, and a header may say anything


class MalformedFrameError(ValueError):
    """What a camera delivered is no frame: sizes that contradict each other, formats that are unknown."""


class Lens(BaseModel):
    """Intrinsics that the user knows better than the camera: px, OpenCV's distortion."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    fx: float = Field(gt=0, description="focal length, px")
    fy: float = Field(gt=0, description="focal length, px")
    cx: float = Field(description="principal point, px; an integer is a pixel's centre")
    cy: float = Field(description="principal point, px")
    dist: tuple[float, float, float, float, float] = Field((0.0, 0.0, 0.0, 0.0, 0.0), description="k1 k2 p1 p2 k3")

    def camera(self, width: int, height: int) -> Camera:
        """The camera of images of a size."""
        return check_camera(Camera(width, height, self.fx, self.fy, self.cx, self.cy, self.dist), "lens")


class CameraSettings(BaseModel):
    """What every ToF camera may be told."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    queue_frames: int = Field(8, ge=1, le=1000, description="frames kept between the camera's thread and the recorder's")
    depth_unit_m: float = Field(0.00025, gt=0, le=0.01, description="step of the recorded depth where the camera states none, m")
    reconnect_s: float = Field(2.0, gt=0, description="seconds between attempts to reach a camera that went away")
    lens: Lens | None = Field(None, description="intrinsics in place of the camera's own")


CameraT = TypeVar("CameraT", bound=CameraSettings)


class Arrival(NamedTuple):
    """A frame as the SDK's thread hands it over: copied, and not decoded yet."""

    sequence: int
    host_ns: int
    device_ns: int | None
    payload: Any


class CameraSource(DeviceSource[CameraT]):
    """A `FrameSource` of a camera whose SDK delivers frames on a thread of its own, or when asked.

    A subclass connects, and calls `_deliver` for every frame with a copy of its arrays; decoding is done by the reader. Frames
    that find the queue full are lost.
    """

    is_camera = True

    def __init__(self, name: str, settings: CameraT, clock: HostClock | None = None) -> None:
        super().__init__(name, settings, clock)
        self._arrivals: deque[Arrival] = deque()
        self._lock = threading.Lock()  # of the arrivals and their numbers
        self._came = threading.Event()
        self._facts: list[Facts] = []
        self._fitted: Camera | None = None

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        """The frames since the last call, what was found out of the camera before them; tries to reach one that went away."""
        self._wait(timeout_s)
        with self._lock:
            self._came.clear()
            arrivals = list(self._arrivals)
            self._arrivals.clear()
        samples = [self._sample(arrival) for arrival in arrivals]
        if self._facts:
            samples.insert(0, Sample(None, self._clock.now_ns(), None, b"", tuple(self._facts)))
            self._facts.clear()
        if not arrivals and not self._alive() and self._attempt(self.settings.reconnect_s):
            self._disconnect()
            with self._lock:
                self._reached_again()
            self._reconnect()
        return samples

    @abstractmethod
    def _alive(self) -> bool:
        """Whether the camera is still there."""

    @abstractmethod
    def _number(self, payload: Any, host_ns: int) -> tuple[int, int | None]:
        """The sequence number and device time of a frame; counts what is missing before it."""

    @abstractmethod
    def _decode(self, payload: Any) -> ToFFrame:
        """The frame; raises MalformedFrameError."""

    def _reached_again(self) -> None:
        """Forget the clock and counter of the camera, which have restarted."""

    def _wait(self, timeout_s: float) -> None:
        """Wait for frames, unless there are facts; an SDK that wants to be asked is asked here instead."""
        if not self._facts:
            self._clock.wait(self._came, timeout_s)

    def _state(self, about: str, **values: object) -> None:
        """Say something of the camera in the next sample."""
        self._facts.append(Facts(about, values))

    def _deliver(self, payload: Any) -> None:
        """Hand a frame over, with nothing in it that the SDK will change or free; any thread."""
        host_ns = self._clock.now_ns()
        with self._lock:
            sequence, device_ns = self._number(payload, host_ns)
            if len(self._arrivals) >= self.settings.queue_frames:
                self.counts.lost += 1  # the reader is late: the gap in the sequence says where
                return
            self._arrivals.append(Arrival(sequence, host_ns, device_ns, payload))
            self._came.set()

    def _sample(self, arrival: Arrival) -> Sample:
        messages: tuple[Message, ...] = ()
        self.counts.received += 1
        try:
            with np.errstate(invalid="ignore", over="ignore"):  # a camera's infinities and NaN need no warning
                messages = (_fitting(self._decode(arrival.payload)),)
        except (ValueError, TypeError, OverflowError):  # MalformedFrameError, and numpy of what is no number
            self.counts.malformed += 1
        return Sample(arrival.sequence, arrival.host_ns, arrival.device_ns, b"", messages)

    def _lens(
        self, width: int, height: int, rays: Callable[[], NDArray[np.float64] | None], stated: Camera | None = None
    ) -> Camera:
        """Intrinsics as the user states them, as the camera does, or fitted to the rays of the first frame that shows enough."""
        if self.settings.lens is not None:
            return self.settings.lens.camera(width, height)
        if stated is not None:
            return replace(stated, width=width, height=height)
        if self._fitted is None or (self._fitted.width, self._fitted.height) != (width, height):
            found = rays()
            fit = None if found is None else fit_camera(found)
            if fit is None:
                raise MalformedFrameError("no intrinsics: state them with `lens`, or ask the camera for points")
            self._fitted = fit.camera
            self._state("intrinsics", fitted_to_points=True, rms_px=fit.rms_px, max_px=fit.max_px)
        return self._fitted


def frame_of(
    camera: Camera,
    depth: NDArray[np.uint16],
    unit_m: float,
    *,
    amplitude: ArrayLike | None = None,
    confidence: NDArray[Any] | None = None,
    noise_m: NDArray[Any] | None = None,
    balance: NDArray[Any] | None = None,
) -> ToFFrame:
    """A frame (H, W) of a camera, without the images that are None; depth and amplitude have the lens' distortion.

    amplitude, balance: any numbers · noise_m: metres · confidence: floats in 0..1 or unsigned integers, of which 8 bits are kept.
    """
    dist = np.array(camera.dist)
    grey, balanced = _word_image(amplitude), _word_image(balance)
    noise = _word_image(None if noise_m is None else np.rint(noise_m * 1e6))
    sure = np.zeros((0, 0), np.uint8) if confidence is None else _byte_image(confidence)
    return ToFFrame(depth, unit_m, grey, sure, camera.k, dist, dist, noise, balanced)


def _word_image(values: ArrayLike | None) -> NDArray[np.uint16]:
    """Numbers as 16 bits, those beyond as the nearest, NaN as 0; (0, 0) for none."""
    if values is None:
        return np.zeros((0, 0), np.uint16)
    return np.asarray(np.clip(np.nan_to_num(values), 0, 65535).astype(np.uint16))


def _byte_image(values: NDArray[Any]) -> NDArray[np.uint8]:
    """A confidence as 0..255: bytes as they are, wider integers by their high byte, floats as 0..1."""
    if values.dtype.kind == "f":
        return np.rint(np.clip(np.nan_to_num(values), 0, 1) * 255).astype(np.uint8)
    return (np.clip(values, 0, None).astype(np.uint64) >> (8 * (values.dtype.itemsize - 1))).astype(np.uint8)


def _fitting(frame: ToFFrame) -> ToFFrame:
    """The frame, whose images have one size. Raises MalformedFrameError."""
    shapes = {frame.depth.shape, *(getattr(frame, name).shape for name in FRAME_IMAGES)} - {(0, 0)}
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
