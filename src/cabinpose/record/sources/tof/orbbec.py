"""Orbbec's depth cameras (Femto Bolt, Femto Mega) through its SDK's Python layer, `pyorbbecsdk` of the package pyorbbecsdk2.

A frame set holds a depth and an infrared image of the same pixels. The depth is along the optical axis, in steps of
`get_depth_scale` mm; neither image is free of the lens' distortion. A Femto has the sensor, the depth modes and the rational
lens model of the Azure Kinect. Time stamps are microseconds of the device's clock; frames are counted by their index.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cabinpose.core import ConfigError, RationalLens, RecordingError, optional_module
from cabinpose.record.sources.tof.camera import CameraSettings, MalformedFrameError, shaped
from cabinpose.record.sources.tof.polled import (
    PolledFrame,
    PolledSource,
    Shape,
    chosen_serial,
    chosen_shape,
    shape_text,
    stated_camera,
)
from cabinpose.signals import HostClock, ToFFrame
from cabinpose.store.convert import DEPTH_MODES

_CONNECT = "connect it, and check its power; on Linux install the udev rules that come with pyorbbecsdk"
_REFUSED = "is another program using it? On Linux, are the udev rules of pyorbbecsdk installed?"
_DEPTH: Mapping[str, str] = {"Y16": "<u2", "Z16": "<u2"}  # pixel formats of the SDK, and what their bytes are
_INFRARED: Mapping[str, str] = {"Y16": "<u2", "Y8": "u1"}
_FIELDS = {(mode.width, mode.height): mode.field for mode in DEPTH_MODES.values()}


class OrbbecSettings(CameraSettings):
    """A camera of Orbbec."""

    serial: str | None = Field(None, description="serial number, where several are connected")
    mode: Literal["NFOV_2X2BINNED", "NFOV_UNBINNED", "WFOV_2X2BINNED", "WFOV_UNBINNED"] | None = Field(
        None, description="depth mode of a Femto, in place of width and height; left out: the camera's own"
    )
    width: int | None = Field(None, ge=1, description="width of the depth image, px")
    height: int | None = Field(None, ge=1, description="height of the depth image, px")
    fps: int | None = Field(None, ge=1, description="frames per second; left out: the camera's own, or the most")
    infrared: bool = Field(True, description="record the infrared image as amplitude")


class _Image(NamedTuple):
    """An image, copied: its bytes."""

    data_format: str
    width: int
    height: int
    data: NDArray[np.uint8]


class OrbbecSource(PolledSource[OrbbecSettings]):
    """A `FrameSource` of a camera of Orbbec."""

    Settings: ClassVar = OrbbecSettings

    def __init__(self, name: str, settings: OrbbecSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        if settings.mode is not None and (settings.width, settings.height) != (None, None):
            raise ConfigError(f"{name}: the mode {settings.mode} says the size", hint="leave out width and height, or the mode")
        self._ob: Any = None  # the SDK's module
        self._context: Any = None  # kept while the camera is away: a new one looks for cameras in the network, for 2 s
        self._serial = settings.serial
        self._uid = ""

    def _missing(self) -> Sequence[str]:
        self._prepared()
        return []

    def _connect(self) -> None:
        pipeline, config, facts = self._prepared()
        try:
            pipeline.start(config)
        except self._errors as error:
            raise RecordingError(f"camera {self._serial}: {error}", hint=_REFUSED) from error
        self._pipeline = pipeline
        self._begin()
        self._state("camera", **facts)

    def _prepared(self) -> tuple[Any, Any, dict[str, Any]]:
        """The SDK's pipeline and configuration, ready to start, and what the camera tells of itself. Raises RecordingError."""
        ob = self._ob = self._ob or _sdk()
        self._errors = (ob.OBError, RuntimeError)
        try:
            if self._context is None:
                self._context = ob.Context()
            device = self._device(self._context.query_devices())
            info, pipeline, config = device.get_device_info(), ob.Pipeline(device), ob.Config()
            offered = _profiles(pipeline, ob.OBSensorType.DEPTH_SENSOR, _DEPTH)
            depth = self._depth_profile(pipeline, ob, offered)
            config.enable_stream(depth)
            if self.settings.infrared:
                config.enable_stream(self._infrared_profile(pipeline, ob, depth))
                config.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
                pipeline.enable_frame_sync()
            facts = {
                "vendor": "Orbbec", "model": info.get_name(), "serial": self._serial, "firmware": info.get_firmware_version(),
                "connection": info.get_connection_type(), "sdk": ob.get_version(), "profile": _text(depth),
                "profiles": sorted({_text(profile) for profile in offered}),
                "temperatures_c": _temperatures(device, self._errors),
            }  # fmt: skip
            return pipeline, config, facts | self._read_lens(depth)
        except self._errors as error:
            raise RecordingError(f"camera {self._serial or 'of Orbbec'}: {error}", hint=_REFUSED) from error

    def _device(self, devices: Any) -> Any:
        """The camera that is meant; one that was lost is not replaced by another."""
        serials = [str(devices.get_device_serial_number_by_index(i)) for i in range(devices.get_count())]
        self._serial = chosen_serial("Orbbec", serials, self._serial, _CONNECT)
        index = serials.index(self._serial)
        self._uid = str(devices.get_device_uid_by_index(index))
        return devices.get_device_by_index(index)

    def _depth_profile(self, pipeline: Any, ob: Any, offered: Sequence[Any]) -> Any:
        """The profile that was asked for; what is left open is as the camera has it by default, else the fastest."""
        settings = self.settings
        mode = None if settings.mode is None else DEPTH_MODES[settings.mode]
        size = (settings.width, settings.height) if mode is None else (mode.width, mode.height)
        named = "" if settings.mode is None else f" ({settings.mode})"
        own = _shape(pipeline.get_stream_profile_list(ob.OBSensorType.DEPTH_SENSOR).get_default_video_stream_profile())
        shape = chosen_shape(str(self._serial), [_shape(p) for p in offered], (*size, settings.fps), own, named=named)
        return next(profile for profile in offered if _shape(profile) == shape)

    def _infrared_profile(self, pipeline: Any, ob: Any, depth: Any) -> Any:
        try:
            offered = _profiles(pipeline, ob.OBSensorType.IR_SENSOR, _INFRARED)
        except self._errors:  # a stereo camera has a left and a right one instead
            offered = []
        same = [profile for profile in offered if _shape(profile) == _shape(depth)]
        if not same:
            raise RecordingError(
                f"camera {self._serial} has no infrared image of {_text(depth)}", hint="record without it: infrared: false"
            )
        return max(same, key=lambda profile: profile.get_format().name == "Y16")

    def _read_lens(self, profile: Any) -> dict[str, Any]:
        """Keep the intrinsics that the camera states, refitted where five coefficients do not hold them; the facts on them."""
        width, height, _ = _shape(profile)
        k, d = profile.get_intrinsic(), profile.get_distortion()
        stated = {name: float(getattr(k, name)) for name in ("fx", "fy", "cx", "cy")}
        stated |= {name: float(getattr(d, name)) for name in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")}
        facts: dict[str, Any] = {"lens": stated}
        if self.settings.lens is not None:
            return facts
        field = _FIELDS.get((width, height))
        fx, fy, cx, cy, k1, k2, k3, k4, k5, k6, p1, p2 = stated.values()
        try:
            if (k.width, k.height) != (width, height):
                raise ValueError(f"they are of {k.width}x{k.height} px")
            lens = RationalLens(fx, fy, cx, cy, (k1, k2, k3, k4, k5, k6), p1, p2)
            self._stated, left = stated_camera(lens, width, height, field or np.inf)
        except ValueError as error:
            raise RecordingError(
                f"camera {self._serial} has no intrinsics for {_text(profile)}: {error}", hint="state them with `lens`"
            ) from error
        return facts | left | ({"fit_field": field} if left else {})

    def _connected(self) -> bool:
        """One that was unplugged and came back has another uid."""
        devices = self._context.query_devices()
        return self._uid in [str(devices.get_device_uid_by_index(i)) for i in range(devices.get_count())]

    def _fetch(self, timeout_s: float) -> Any | None:
        return self._pipeline.wait_for_frames(max(round(timeout_s * 1000), 1))

    def _copied(self, frames: Any) -> PolledFrame:
        depth, infrared = frames.get_depth_frame(), frames.get_ir_frame()
        if depth is None:
            raise MalformedFrameError("no depth")
        return PolledFrame(
            int(depth.get_index()),
            int(depth.get_timestamp_us()) or None,  # 0 where the system passes no metadata on
            float(depth.get_depth_scale()) / 1000,
            _image(depth),
            None if infrared is None else _image(infrared),
        )

    def _decode(self, payload: PolledFrame) -> ToFFrame:
        infrared = None if payload.infrared is None else _pixels(payload.infrared, _INFRARED)
        return super()._decode(replace(payload, depth=_pixels(payload.depth, _DEPTH).astype(np.uint16), infrared=infrared))


def _sdk() -> Any:
    """The SDK, kept from writing on stdout, where the lines of --json are, and from its folder of logs."""
    sys.stdout.flush()
    stdout = os.dup(1)
    os.dup2(2, 1)
    try:
        ob = optional_module("pyorbbecsdk", purpose="an Orbbec camera", hint="pip install 'cabinpose[orbbec]'")
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
    ob.Context.set_logger_level(ob.OBLogLevel.NONE)
    return ob


def _profiles(pipeline: Any, sensor: Any, formats: Mapping[str, str]) -> list[Any]:
    """The video profiles that a sensor offers in one of these formats."""
    listed = pipeline.get_stream_profile_list(sensor)
    profiles = [listed.get_stream_profile_by_index(i).as_video_stream_profile() for i in range(listed.get_count())]
    return [profile for profile in profiles if profile.get_format().name in formats]


def _shape(profile: Any) -> Shape:
    return profile.get_width(), profile.get_height(), profile.get_fps()


def _text(profile: Any) -> str:
    return shape_text(_shape(profile))


def _temperatures(device: Any, errors: tuple[type[Exception], ...]) -> dict[str, float]:
    """Temperatures (degrees Celsius) by part; the SDK gives 0 for a part without a thermometer, and fails for some cameras."""
    try:
        found = device.get_temperature()
    except errors:
        return {}
    values = {name: float(getattr(found, name)) for name in dir(found) if name.endswith("_temperature")}
    return {name.removesuffix("_temperature"): value for name, value in values.items() if value and np.isfinite(value)}


def _image(frame: Any) -> _Image:
    data = np.array(frame.get_data(), dtype=np.uint8)
    return _Image(str(frame.get_format().name), int(frame.get_width()), int(frame.get_height()), data)


def _pixels(image: _Image, formats: Mapping[str, str]) -> NDArray[Any]:
    """(height, width). Raises MalformedFrameError for another format, ValueError for half a pixel."""
    if image.data_format not in formats:
        raise MalformedFrameError(f"pixels of {image.data_format}")
    return shaped(image.data.view(formats[image.data_format]), image.width, image.height)
