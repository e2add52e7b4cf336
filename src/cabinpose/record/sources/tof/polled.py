"""What cameras share whose SDK is asked for frames: which camera and size is meant, its lens, numbers, stamps, and presence."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from cabinpose.core import Camera, RationalLens, RecordingError, fit_lens
from cabinpose.record.sources.counting import DeviceClock, FrameNumbers
from cabinpose.record.sources.tof.camera import CameraSource, CameraT, MalformedFrameError, frame_of
from cabinpose.signals import HostClock, ToFFrame

Shape = tuple[int, int, int]  # width, height, frames per second

_QUIET_S = 1.0  # without a frame, until the SDK is asked whether the camera is still connected; the slowest mode has 5 Hz
_COARSEST_M = 0.01  # step of a depth, as of `CameraSettings.depth_unit_m`


@dataclass(frozen=True, slots=True)
class PolledFrame:
    """A frame, copied: depth (H, W) in steps of `unit_m`, infrared (H, W) where there is one, or what a subclass makes them of.

    counter: the camera's number of the frame · stamp_us: of the camera's clock, None where it gives none.
    """

    counter: int
    stamp_us: int | None
    unit_m: float
    depth: Any
    infrared: Any | None


class PolledSource(CameraSource[CameraT]):
    """A camera whose SDK is asked for frames. `_connect` of a subclass ends with `_begin`."""

    _turn: ClassVar[int] = 2**32  # of the camera's microseconds

    def __init__(self, name: str, settings: CameraT, clock: HostClock | None = None) -> None:
        super().__init__(name, settings, clock)
        self._errors: tuple[type[Exception], ...] = (RuntimeError,)  # of the SDK
        self._pipeline: Any = None  # of the SDK, while it runs
        self._stated: Camera | None = None
        self._numbers = FrameNumbers(self.counts)
        self._device_clock = DeviceClock(1000, self._turn)
        self._heard_s = 0.0
        self._runs = False

    @abstractmethod
    def _fetch(self, timeout_s: float) -> Any | None:
        """What the SDK has, None where nothing comes in time; raises one of `_errors` where the camera is lost."""

    @abstractmethod
    def _copied(self, frames: Any) -> PolledFrame:
        """A frame, copied. Raises MalformedFrameError, or as the SDK does, where it is none."""

    @abstractmethod
    def _connected(self) -> bool:
        """Whether the SDK says that the camera is connected."""

    def _begin(self) -> None:
        """Frames come from now on."""
        self._runs, self._heard_s = True, self._clock.now_s()

    def _disconnect(self) -> None:
        pipeline, self._pipeline, self._runs = self._pipeline, None, False
        if pipeline is not None:
            with suppress(*self._errors):  # a camera that was unplugged
                pipeline.stop()

    def _alive(self) -> bool:
        """Whether the camera sends, or else is connected."""
        if not self._runs:
            return False
        if self._clock.now_s() - self._heard_s < _QUIET_S:
            return True
        try:
            return self._connected()
        except self._errors:
            return False

    def _wait(self, timeout_s: float) -> None:
        """The SDK is asked: for the first frame within the time, then for what has come meanwhile."""
        wait_s = timeout_s
        malformed: tuple[type[Exception], ...] = (*self._errors, ValueError, TypeError)  # MalformedFrameError among them
        for _ in range(self.settings.queue_frames):
            if not self._runs:
                self._clock.sleep(wait_s)
                return
            try:
                frames = self._fetch(wait_s)
            except self._errors:
                self._runs = False
                return
            if frames is None:
                return
            self._heard_s, wait_s = self._clock.now_s(), 0.0
            try:
                payload = self._copied(frames)
            except malformed:
                self.counts.malformed += 1
            else:
                self._deliver(payload)

    def _number(self, payload: PolledFrame, host_ns: int) -> tuple[int, int | None]:
        restarts = self.counts.restarts
        sequence = self._numbers.number(payload.counter)
        if self.counts.restarts > restarts:
            self._device_clock.restart()
        return sequence, None if payload.stamp_us is None else self._device_clock.device_ns(payload.stamp_us, host_ns)

    def _reached_again(self) -> None:
        self._numbers.reached_again()
        self._device_clock.restart()

    def _decode(self, payload: PolledFrame) -> ToFFrame:
        depth = payload.depth
        if not 0 < payload.unit_m <= _COARSEST_M:
            raise MalformedFrameError(f"depth in steps of {payload.unit_m} m")
        if depth.dtype != np.uint16 or depth.ndim != 2:
            raise MalformedFrameError(f"depth as {depth.dtype} of shape {depth.shape}")
        camera = self._lens(depth.shape[1], depth.shape[0], lambda: None, self._stated)
        return frame_of(camera, depth, payload.unit_m, amplitude=payload.infrared)


def chosen_serial(vendor: str, serials: Sequence[str], wanted: str | None, remedy: str) -> str:
    """The camera that is meant among those that are connected. Raises RecordingError; `remedy` is for none at all."""
    if not serials:
        raise RecordingError(f"no {vendor} camera is connected", hint=remedy)
    connected = ", ".join(serials)
    if wanted is None and len(serials) > 1:
        raise RecordingError(f"{len(serials)} {vendor} cameras are connected", hint=f"name one with `serial`: {connected}")
    if wanted is not None and wanted not in serials:
        raise RecordingError(f"no {vendor} camera {wanted} is connected", hint=f"connected: {connected}")
    return wanted or serials[0]


def chosen_shape(
    camera: str, offered: Sequence[Shape], wanted: tuple[int | None, int | None, int | None], own: Shape, *, named: str = ""
) -> Shape:
    """The size and rate of depth that are asked for; what is left open is as the camera has it by default, else the fastest.

    Raises RecordingError, which names what is offered; `named` says how the user calls what was asked for.
    """
    fitting = [shape for shape in offered if all(value in (None, has) for value, has in zip(wanted, shape, strict=True))]
    if not fitting:
        asked = "{}x{}@{}".format(*("any" if value is None else value for value in wanted))
        known = ", ".join(sorted({shape_text(shape) for shape in offered})) or "none of 16 bits"
        raise RecordingError(f"camera {camera} has no depth of {asked}{named}", hint=f"it offers: {known}")
    return max(fitting, key=lambda shape: (shape[:2] == own[:2], shape[2] == own[2], shape[2]))


def shape_text(shape: Shape) -> str:
    """As users read it: 640x576@30."""
    return "{}x{}@{}".format(*shape)


def stated_camera(lens: RationalLens, width: int, height: int, field: float = np.inf) -> tuple[Camera, dict[str, float]]:
    """The camera of a lens that an SDK states, refitted where five coefficients do not hold it, and what the fit leaves.

    lens: px, of images of that size · field: as of `fit_lens`. Raises ValueError where no camera has this lens.
    """
    k1, k2, k3, k4, k5, k6 = lens.radial
    values = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.radial, lens.p1, lens.p2)
    if not np.isfinite(values).all() or min(lens.fx, lens.fy) <= 0:
        raise ValueError(f"focal lengths {lens.fx} and {lens.fy}, distortion {lens.radial}")
    if (k4, k5, k6) == (0.0, 0.0, 0.0):
        return Camera(width, height, lens.fx, lens.fy, lens.cx, lens.cy, (k1, k2, lens.p1, lens.p2, k3)), {}
    fit = fit_lens(lens, width, height, field)
    return fit.camera, {"fit_rms_px": fit.rms_px, "fit_max_px": fit.max_px}
