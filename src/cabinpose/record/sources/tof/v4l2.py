"""Any depth camera that Linux shows as a video device (V4L2) of 16-bit pixels, Z16 or Y16, through FFmpeg in PyAV.

V4L2 says nothing of the unit of the depth nor of the lens: both are required. It has no infrared image of the same pixels: there
is no amplitude. Stamps are the driver's, in µs; frames that are missing are told by them, since FFmpeg keeps no frame numbers.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from cabinpose.core import ConfigError, RecordingError, optional_module
from cabinpose.record.sources.counting import FrameNumbers, FramePeriod
from cabinpose.record.sources.tof.camera import CameraSettings, CameraSource, Lens, frame_of, shaped
from cabinpose.signals import HostClock, ToFFrame

_FORMAT = "v4l2"  # of FFmpeg
_PIXELS = "gray16le"  # FFmpeg's name of Z16 and Y16
_STOP_S = 2.0  # until a thread that waits for a frame is left alone; it ends with the next one
_LISTED = "`v4l2-ctl --list-devices` lists them; one camera has several"


class V4l2Settings(CameraSettings):
    """A depth camera that Linux shows as a video device."""

    device: Path = Field(description="the device, such as /dev/video0, or one of /dev/v4l/by-id, which keeps its name")
    depth_unit_m: float = Field(gt=0, le=0.01, description="step of the depth, m: 0.001 where the camera gives mm")
    lens: Lens = Field(description="intrinsics, which V4L2 does not tell")
    width: int | None = Field(None, ge=1, description="width, px; left out, as height: the camera's own")
    height: int | None = Field(None, ge=1, description="height, px")
    fps: int | None = Field(None, ge=1, description="frames per second; left out: the camera's own")


class _Frame(NamedTuple):
    """A frame, copied: the bytes of its pixels."""

    stamp_ns: int
    pixels: bytes


class V4l2Source(CameraSource[V4l2Settings]):
    """A `FrameSource` of a V4L2 device, which a thread reads: reading waits for the camera, however long."""

    Settings: ClassVar = V4l2Settings

    def __init__(self, name: str, settings: V4l2Settings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        if (settings.width is None) != (settings.height is None):
            raise ConfigError(f"{name}: the depth has a width and a height", hint="give both, or leave both out")
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._size = (0, 0)
        self._numbers = FrameNumbers(self.counts)
        self._period = FramePeriod()

    def _missing(self) -> Sequence[str]:
        self._opened_device().close()
        return []

    def _opened_device(self) -> Any:
        """FFmpeg's container of the device. Raises DependencyError or RecordingError."""
        av = optional_module("av", purpose="a V4L2 camera", hint="pip install 'cabinpose[record]'")
        settings, path = self.settings, self.settings.device
        options = {"pixel_format": _PIXELS}
        if settings.width is not None:
            options["video_size"] = f"{settings.width}x{settings.height}"
        if settings.fps is not None:
            options["framerate"] = str(settings.fps)
        try:
            container = av.open(str(path), format=_FORMAT, options=options)
        except FileNotFoundError as error:
            raise RecordingError(f"there is no {path}", hint=f"connect the camera; {_LISTED}") from error
        except PermissionError as error:
            raise RecordingError(f"{path} may not be read", hint="add yourself to the group video") from error
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise RecordingError(f"{path} gives no video: {why}", hint=f"is it in use, or not the depth? {_LISTED}") from error
        stream = container.streams.video[0].codec_context
        width, height = int(stream.width), int(stream.height)
        as_asked = settings.width in (None, width) and settings.height in (None, height)
        if stream.pix_fmt != _PIXELS or not as_asked:
            container.close()
            remedy = f"depth has 16 bits: is it the colour? {_LISTED}" if as_asked else "leave out width and height"
            raise RecordingError(f"{path} gives {stream.pix_fmt} of {width}x{height}", hint=remedy)
        self._size = width, height
        return container

    def _connect(self) -> None:
        container = self._opened_device()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, args=(container, self._stop), name=f"{self.name}-v4l2", daemon=True)
        self._thread.start()
        width, height = self._size
        told = {"model": self.settings.device.name, "profile": f"{width}x{height}", "unit_m": self.settings.depth_unit_m}
        self._state("camera", **told, amplitude="none")

    def _listen(self, container: Any, stop: threading.Event) -> None:
        """Hand over what the device sends, until it is gone or `stop` is set."""
        try:
            for packet in container.demux(video=0):
                if stop.is_set():
                    return
                if packet.pts is None:  # of the packet behind the last
                    continue
                self._deliver(_Frame(round(packet.pts * packet.time_base * 10**9), bytes(packet)))
        except OSError:  # the device is gone
            return
        finally:
            container.close()

    def _disconnect(self) -> None:
        thread, self._thread = self._thread, None
        self._stop.set()
        if thread is not None:
            self._clock.join(thread, _STOP_S)

    def _alive(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _number(self, payload: _Frame, host_ns: int) -> tuple[int, int | None]:
        del host_ns
        lost = self._period.lost_before(payload.stamp_ns)
        if lost is None:
            self.counts.restarts += 1
        return self._numbers.forward(lost or 0), payload.stamp_ns

    def _reached_again(self) -> None:
        self._period = FramePeriod()

    def _decode(self, payload: _Frame) -> ToFFrame:
        width, height = self._size
        depth = shaped(np.frombuffer(payload.pixels, "<u2"), width, height).astype(np.uint16)
        return frame_of(self.settings.lens.camera(width, height), depth, self.settings.depth_unit_m)
