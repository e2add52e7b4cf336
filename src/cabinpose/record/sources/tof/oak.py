"""Luxonis' OAK cameras through their SDK, `depthai` 3: stereo (OAK-D) and ToF.

A stereo camera's depth is that of the rectified left image, which is recorded as amplitude: infrared where the camera has a flood
light that is on (OAK-D Pro), otherwise whatever light there is. A ToF camera's own amplitude is recorded. Depth is along the
optical axis, in mm. Each frame tells the intrinsics of its pixels; frames are numbered, and stamped by the camera's clock.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from datetime import timedelta
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from cabinpose.core import ConfigError, RationalLens, RecordingError, optional_module
from cabinpose.record.sources.tof.camera import CameraSettings, MalformedFrameError
from cabinpose.record.sources.tof.polled import PolledFrame, PolledSource, chosen_serial, stated_camera
from cabinpose.signals import HostClock

_CONNECT = "connect it by USB 3 or to the network; on Linux install Luxonis' udev rules"
_REFUSED = "is another program using it? On Linux, are Luxonis' udev rules installed?"
_SIZE = (640, 400)  # of stereo depth, px: the SDK's own
_UNIT_M = 0.001  # of depth, which is asked of a stereo camera, and which a ToF camera has
_MICROSECOND = timedelta(microseconds=1)


class OakSettings(CameraSettings):
    """A camera of Luxonis' OAK series."""

    serial: str | None = Field(None, description="device id, where several are connected")
    width: int | None = Field(None, ge=1, description="width of stereo depth, px; left out: 640")
    height: int | None = Field(None, ge=1, description="height of stereo depth, px; left out: 400")
    fps: float | None = Field(None, gt=0, allow_inf_nan=False, description="frames per second; left out: the SDK's own")
    infrared: bool = Field(True, description="record the left image, or a ToF camera's amplitude, as amplitude")
    flood_light: float | None = Field(None, ge=0, le=1, description="infrared flood light of an OAK-D Pro, 0 to 1")
    dot_projector: float | None = Field(None, ge=0, le=1, description="infrared dots of an OAK-D Pro, 0 to 1")


class OakSource(PolledSource[OakSettings]):
    """A `FrameSource` of an OAK camera."""

    Settings: ClassVar = OakSettings
    _turn: ClassVar[int] = 2**63  # microseconds of 64 bits, which do not wrap

    def __init__(self, name: str, settings: OakSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        if (settings.width is None) != (settings.height is None):
            raise ConfigError(f"{name}: the depth has a width and a height", hint="give both, or leave both out")
        self._dai: Any = None  # the SDK's module
        self._device: Any = None
        self._queue: Any = None
        self._serial = settings.serial

    def _missing(self) -> Sequence[str]:
        self._found()
        return []

    def _found(self) -> Any:
        """What the SDK knows of the camera that is meant, which is not started for it. Raises RecordingError."""
        # The SDK logs on stdout, where the lines of --json are.
        os.environ.setdefault("DEPTHAI_LEVEL", "off")
        hint = "pip install 'cabinpose[oak]'"
        dai = self._dai = self._dai or optional_module("depthai", purpose="an OAK camera", hint=hint)
        self._errors = (RuntimeError, IndexError, dai.MessageQueue.QueueException)
        devices = {info.getDeviceId(): info for info in dai.Device.getAllAvailableDevices()}
        self._serial = chosen_serial("OAK", list(devices), self._serial, _CONNECT)
        return devices[self._serial]

    def _connect(self) -> None:
        info, settings = self._found(), self.settings
        try:
            self._device = self._dai.Device(info)
            pipeline = self._pipeline = self._dai.Pipeline(self._device)
            kind, depth, infrared = self._images(pipeline)
            if settings.infrared:
                sync = pipeline.create(self._dai.node.Sync)
                depth.link(sync.inputs["depth"])
                infrared.link(sync.inputs["infrared"])
                depth = sync.out
            self._queue = depth.createOutputQueue(maxSize=settings.queue_frames, blocking=False)
            pipeline.start()
            self._light()
            lights = bool(self._device.getIrDrivers())
            model, platform = str(self._device.getDeviceName()), str(self._device.getPlatformAsString())
        except self._errors as error:
            self._disconnect()
            raise RecordingError(f"camera {self._serial}: {error}", hint=_REFUSED) from error
        except RecordingError:
            self._disconnect()
            raise
        self._begin()
        amplitude = {"tof": "amplitude", "stereo": "rectified left image"}[kind] if settings.infrared else "none"
        self._state(
            "camera", vendor="Luxonis", model=model, platform=platform, serial=self._serial, sdk=self._dai.__version__,
            depth=kind, unit_m=_UNIT_M, amplitude=amplitude, infrared_lights=lights,
        )  # fmt: skip

    def _images(self, pipeline: Any) -> tuple[str, Any, Any]:
        """How the camera measures, "tof" or "stereo", and the outputs of its depth and of the image of the same pixels."""
        dai, settings = self._dai, self.settings
        features = self._device.getConnectedCameraFeatures()
        tof = next((f.socket for f in features if dai.CameraSensorType.TOF in f.supportedTypes), None)
        if tof is not None:
            if settings.width is not None:
                raise RecordingError(f"camera {self._serial} is a ToF camera of one size", hint="leave out width and height")
            node = pipeline.create(dai.node.ToF).build(boardSocket=tof, fps=settings.fps)
            return "tof", node.depth, node.amplitude
        size = (settings.width or _SIZE[0], settings.height or _SIZE[1])
        node = pipeline.create(dai.node.StereoDepth).build(autoCreateCameras=True, size=size, fps=settings.fps)
        node.setDepthAlign(dai.StereoDepthConfig.AlgorithmControl.DepthAlign.RECTIFIED_LEFT)
        node.initialConfig.setDepthUnit(dai.LengthUnit.MILLIMETER)
        # A preset that makes depth smaller would leave it without an image of the same pixels.
        node.initialConfig.postProcessing.decimationFilter.decimationFactor = 1
        return "stereo", node.depth, node.rectifiedLeft

    def _light(self) -> None:
        """Switch the infrared lights that are asked for. Raises RecordingError where the camera has none."""
        for key, put in (
            ("flood_light", self._device.setIrFloodLightIntensity),
            ("dot_projector", self._device.setIrLaserDotProjectorIntensity),
        ):
            value = getattr(self.settings, key)
            if value is not None and not put(value):
                raise RecordingError(f"camera {self._serial} has no {key.replace('_', ' ')}", hint=f"leave out {key}")

    def _disconnect(self) -> None:
        super()._disconnect()
        device, self._device, self._queue = self._device, None, None
        if device is not None:
            with suppress(*self._errors):  # as above
                device.close()

    def _connected(self) -> bool:
        return bool(self._pipeline.isRunning()) and not self._device.isClosed()

    def _fetch(self, timeout_s: float) -> Any | None:
        return self._queue.get(timedelta(seconds=max(timeout_s, 1e-3)))

    def _copied(self, frames: Any) -> PolledFrame:
        depth, infrared = (frames["depth"], frames["infrared"]) if self.settings.infrared else (frames, None)
        if self._stated is None and self.settings.lens is None:
            self._read_lens(depth.getTransformation(), depth.getWidth(), depth.getHeight())
        return PolledFrame(
            int(depth.getSequenceNum()),
            depth.getTimestampDevice() // _MICROSECOND,
            _UNIT_M,
            np.array(depth.getFrame()),
            None if infrared is None else np.array(infrared.getFrame()),
        )

    def _read_lens(self, seen: Any, width: int, height: int) -> None:
        """Keep the intrinsics that a frame tells, and tell them. Raises MalformedFrameError where none are understood."""
        k, model = np.array(seen.getIntrinsicMatrix(), dtype=np.float64), seen.getDistortionModel().name
        values = [float(value) for value in seen.getDistortionCoefficients()]
        # OpenCV's fourteen: k1 k2 p1 p2 k3 k4 k5 k6, of a thin prism, of a tilted sensor
        k1, k2, p1, p2, k3, k4, k5, k6, *others = [*values, *[0.0] * 14][:14]
        if not seen.isValid() or any(others) or (model != "Perspective" and any(values)):
            raise MalformedFrameError(f"no intrinsics of {model} with {values}: state them with `lens`")
        lens = RationalLens(k[0, 0], k[1, 1], k[0, 2], k[1, 2], (k1, k2, k3, k4, k5, k6), p1, p2)
        self._stated, left = stated_camera(lens, width, height)
        self._state("intrinsics", model=model, coefficients=values, **left)
