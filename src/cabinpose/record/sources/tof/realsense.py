"""RealSense depth cameras through their SDK's Python layer, `pyrealsense2`.

A frame set holds a depth image along the optical axis (Z16, in steps of the sensor's depth units) and the infrared image that is
aligned with it: the left one (number 1) of a stereo camera, the only one of an L515. 8 bits of infrared are asked for: the 16
bits (Y16) of a stereo camera are its images for calibration, which are not rectified.

Time stamps are milliseconds of the camera's clock, once the SDK is told not to map them to the host's (global_time_enabled).
Where the system passes no metadata on, they are the host's, and frames then have no time of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from cabinpose.core import Camera, RecordingError, fit_camera, optional_module
from cabinpose.record.sources.tof.camera import CameraSettings, MalformedFrameError
from cabinpose.record.sources.tof.polled import PolledFrame, PolledSource, Shape, chosen_serial, chosen_shape, shape_text
from cabinpose.signals import HostClock

_CONNECT = "connect it to a port of USB 3; on Linux install librealsense's udev rules"
_REFUSED = "is another program using it? On Linux, are librealsense's udev rules installed?"
_RAYS_ACROSS = 80  # of an image, of which a lens that is not OpenCV's is fitted


class RealsenseSettings(CameraSettings):
    """A RealSense depth camera."""

    serial: str | None = Field(None, description="serial number, where several are connected")
    width: int | None = Field(None, ge=1, description="width of the depth image, px; left out: the camera's own")
    height: int | None = Field(None, ge=1, description="height of the depth image, px; left out: the camera's own")
    fps: int | None = Field(None, ge=1, description="frames per second; left out: the camera's own, or the most")
    infrared: bool = Field(True, description="record the infrared image as amplitude")


class RealsenseSource(PolledSource[RealsenseSettings]):
    """A `FrameSource` of a RealSense depth camera."""

    Settings: ClassVar = RealsenseSettings

    def __init__(self, name: str, settings: RealsenseSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._rs: Any = None  # the SDK's module
        self._context: Any = None
        self._device: Any = None
        self._infrared: int | None = None  # its number
        self._serial = settings.serial

    def _missing(self) -> Sequence[str]:
        self._prepared()
        return []

    def _connect(self) -> None:
        pipeline, config, shape, facts = self._prepared()
        try:
            profile = pipeline.start(config)
        except self._errors as error:
            raise RecordingError(f"camera {self._serial}: {error}", hint=_REFUSED) from error
        self._pipeline = pipeline
        try:
            lens = self._read_lens(profile, shape)
        except self._errors as error:
            self._disconnect()
            raise RecordingError(
                f"camera {self._serial} has no intrinsics for {shape_text(shape)}: {error}", hint="state them with `lens`"
            ) from error
        self._begin()
        self._state("camera", **facts, **lens)

    def _prepared(self) -> tuple[Any, Any, Shape, dict[str, Any]]:
        """The pipeline and its configuration, the size of depth, and what the camera tells of itself. Raises RecordingError."""
        hint = "pip install 'cabinpose[realsense]'; on Linux it needs libusb-1.0 too"
        rs = self._rs = self._rs or optional_module("pyrealsense2", purpose="a RealSense camera", hint=hint)
        try:
            self._context = self._context or rs.context()
            devices = {device.get_info(rs.camera_info.serial_number): device for device in self._context.query_devices()}
            self._serial = chosen_serial("RealSense", list(devices), self._serial, _CONNECT)
            device = self._device = devices[self._serial]
            sensor = device.first_depth_sensor()
            if sensor.supports(rs.option.global_time_enabled):
                sensor.set_option(rs.option.global_time_enabled, 0.0)
            profiles = sensor.get_stream_profiles()
            depths = [p for p in profiles if p.stream_type() == rs.stream.depth and p.format() == rs.format.z16]
            own = next((_shape(p) for p in depths if p.is_default()), (0, 0, 0))
            wanted = (self.settings.width, self.settings.height, self.settings.fps)
            shape = chosen_shape(self._serial, [_shape(p) for p in depths], wanted, own)
            pipeline, config = rs.pipeline(self._context), rs.config()
            pipeline.set_device(device)
            config.enable_stream(rs.stream.depth, -1, *shape[:2], rs.format.z16, shape[2])
            self._infrared = self._infrared_number(profiles, shape) if self.settings.infrared else None
            if self._infrared is not None:
                config.enable_stream(rs.stream.infrared, self._infrared, *shape[:2], rs.format.y8, shape[2])
            facts = {
                "vendor": "RealSense", "model": self._told("name"), "serial": self._serial,
                "firmware": self._told("firmware_version"), "connection": self._told("usb_type_descriptor"),
                "sdk": rs.__version__, "profile": shape_text(shape), "profiles": sorted({shape_text(_shape(p)) for p in depths}),
                "unit_m": _shortest(sensor.get_depth_scale()),
                "amplitude": "none" if self._infrared is None else f"infrared {self._infrared}",
            }  # fmt: skip
        except self._errors as error:
            raise RecordingError(f"camera {self._serial or 'of RealSense'}: {error}", hint=_REFUSED) from error
        return pipeline, config, shape, facts

    def _told(self, name: str) -> str:
        """What the camera tells of itself under a name; nothing where it does not know it."""
        info = getattr(self._rs.camera_info, name)
        return str(self._device.get_info(info)) if self._device.supports(info) else ""

    def _infrared_number(self, profiles: Sequence[Any], shape: Shape) -> int:
        """Number of the infrared image of the depth's pixels."""
        rs = self._rs
        same = [
            p.stream_index()
            for p in profiles
            if p.stream_type() == rs.stream.infrared and p.format() == rs.format.y8 and _shape(p) == shape
        ]
        if not same:
            raise RecordingError(
                f"camera {self._serial} has no infrared image of {shape_text(shape)}", hint="record without it: infrared: false"
            )
        return min(same)

    def _read_lens(self, profile: Any, shape: Shape) -> dict[str, Any]:
        """Keep the intrinsics that the camera states; the facts on them. Raises RuntimeError where they are none."""
        rs, (width, height, _) = self._rs, shape
        lens = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()
        k1, k2, p1, p2, k3 = coefficients = [float(value) for value in lens.coeffs]  # in OpenCV's order
        stated = {"fx": lens.fx, "fy": lens.fy, "cx": lens.ppx, "cy": lens.ppy, "coefficients": coefficients}
        facts: dict[str, Any] = {"lens": {**stated, "model": lens.model.name}}
        if self.settings.lens is not None:
            return facts
        numbers = (lens.fx, lens.fy, lens.ppx, lens.ppy, *coefficients)
        if not np.isfinite(numbers).all() or min(lens.fx, lens.fy) <= 0 or (lens.width, lens.height) != (width, height):
            raise RuntimeError(f"they are of {lens.width}x{lens.height} px, with focal lengths {lens.fx} and {lens.fy}")
        if lens.model in (rs.distortion.none, rs.distortion.brown_conrady) or not any(coefficients):
            dist = (0.0,) * 5 if lens.model == rs.distortion.none else (k1, k2, p1, p2, k3)
            self._stated = Camera(width, height, lens.fx, lens.fy, lens.ppx, lens.ppy, dist)
            return facts
        rays = np.full((height, width, 2), np.nan)
        every = max(width // _RAYS_ACROSS, 1)
        for v in range(0, height, every):
            for u in range(0, width, every):
                rays[v, u] = rs.rs2_deproject_pixel_to_point(lens, [float(u), float(v)], 1.0)[:2]
        fit = fit_camera(rays)
        if fit is None:
            raise RuntimeError(f"no camera fits the lens of {lens.model.name}")
        self._stated = fit.camera
        return facts | {"fit_rms_px": fit.rms_px, "fit_max_px": fit.max_px}

    def _connected(self) -> bool:
        return bool(self._device.is_connected())

    def _fetch(self, timeout_s: float) -> Any | None:
        came, frames = self._pipeline.try_wait_for_frames(max(round(timeout_s * 1000), 1))
        return frames if came else None

    def _copied(self, frames: Any) -> PolledFrame:
        depth = frames.get_depth_frame()
        if not depth:
            raise MalformedFrameError("no depth")
        infrared = None if self._infrared is None else frames.get_infrared_frame(self._infrared)
        of_camera = depth.get_frame_timestamp_domain() == self._rs.timestamp_domain.hardware_clock
        return PolledFrame(
            int(depth.get_frame_number()),
            round(depth.get_timestamp() * 1000) if of_camera else None,
            _shortest(depth.get_units()),
            np.array(depth.get_data()),
            np.array(infrared.get_data()) if infrared else None,
        )


def _shape(profile: Any) -> Shape:
    video = profile.as_video_stream_profile()
    return video.width(), video.height(), profile.fps()


def _shortest(unit_m: float) -> float:
    """A number of 32 bits as it was meant: 0.001, not 0.0010000000475."""
    return float(str(np.float32(unit_m)))
