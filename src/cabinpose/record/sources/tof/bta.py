"""Bluetechnix (becom) cameras through the BltTofApi: Argos3D, Sentis3D, TIM-UP, and its recordings, `.bltstream`.

A frame holds the channels that its mode asks for. Where it holds X, Y and Z, the depth is Z and the intrinsics are fitted to
the points, unless the user states them; where it holds distances along the rays alone, the intrinsics have to be stated.
The time stamp counts 32 bits of microseconds and wraps after 71.6 minutes, which is undone.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cabinpose.core import Camera, ConfigError, RecordingError, unknown_name
from cabinpose.record.sources.counting import DeviceClock, FrameNumbers
from cabinpose.record.sources.tof import bta_library as bta
from cabinpose.record.sources.tof.camera import (
    CameraSettings,
    CameraSource,
    MalformedFrameError,
    depth_image,
    frame_of,
    rays_of_points,
)
from cabinpose.signals import HostClock, ToFFrame

_TURN = 2**32
_DEVICE_TYPES = {"any": 0, "ethernet": 1, "usb": 2, "uart": 3, "bltstream": 0xF}


class BtaSettings(CameraSettings):
    """A camera of Bluetechnix, or one of its recordings."""

    library: str = Field("libbta.so", description="file of the BltTofApi; `bta.dll` on Windows")
    device: Literal["any", "ethernet", "usb", "uart", "bltstream"] = Field("any", description="how the camera is connected")
    address: str | None = Field(
        None, pattern=r"^\d{1,3}(\.\d{1,3}){3}$", description="the camera's IPv4 address, for its TCP control"
    )
    port: int = Field(10001, ge=1, le=65535, description="port of its TCP control")
    serial: int | None = Field(None, ge=1, description="serial number, where several are connected")
    recording: Path | None = Field(None, description="a `.bltstream` file to play in place of a camera")
    frame_mode: str = Field("xyz_amplitude", description=f"what a frame holds: {', '.join(bta.FRAME_MODES)}")


class BtaSource(CameraSource[BtaSettings]):
    """A `FrameSource` of a camera of Bluetechnix."""

    Settings: ClassVar = BtaSettings

    def __init__(self, name: str, settings: BtaSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        if settings.frame_mode not in bta.FRAME_MODES:
            raise unknown_name("frame mode", settings.frame_mode, tuple(bta.FRAME_MODES))
        if settings.lens is None and settings.frame_mode not in {"current", "xyz", "xyz_amplitude", "xyz_amplitude_flags"}:
            raise ConfigError(
                f"frames of mode {settings.frame_mode} do not show the camera's intrinsics",
                hint="state them with `lens`, or ask for xyz_amplitude",
            )
        self._library: Any = None
        self._handle = ctypes.c_void_p()
        self._callback: Any = None
        self._numbers = FrameNumbers(self.counts, _TURN)
        self._device_clock = DeviceClock(1000, _TURN)
        self._exposures: tuple[tuple[int, int], ...] = ()

    def _missing(self) -> Sequence[str]:
        bta.version(bta.load_library(self.settings.library))
        recording = self.settings.recording
        if recording is not None and not recording.is_file():
            return [f"{recording} does not exist (check the path)"]
        return []

    def _connect(self) -> None:
        library = bta.load_library(self.settings.library)
        major, minor, patch = bta.version(library)
        config = bta.Config()
        bta.succeed(library.BTAinitConfig(ctypes.byref(config)), "BTAinitConfig")
        kept = self._fill(config)
        self._callback = bta.FrameArrived(self._arrived)
        config.frame_arrived_ex = self._callback
        handle = ctypes.c_void_p()
        bta.succeed(library.BTAopen(ctypes.byref(config), ctypes.byref(handle)), "BTAopen")
        del kept  # the library copies what the configuration points to
        self._library, self._handle = library, handle
        self._state("camera", vendor="Bluetechnix", library=f"{major}.{minor}.{patch}", frame_mode=self.settings.frame_mode)

    def _fill(self, config: bta.Config) -> list[Any]:
        """Put the settings into a configuration; gives what it points to."""
        settings = self.settings
        kept: list[Any] = []
        config.device_type = _DEVICE_TYPES["bltstream" if settings.recording is not None else settings.device]
        config.frame_mode = bta.FRAME_MODES[settings.frame_mode]
        config.serial_number = settings.serial or 0
        if settings.address is not None:
            numbers = [int(part) for part in settings.address.split(".")]
            if max(numbers) > 255:
                raise RecordingError(f"{settings.address} is no IPv4 address", hint="as in 192.168.0.10")
            kept.append((ctypes.c_uint8 * 4)(*numbers))
            config.tcp_device_ip = ctypes.cast(kept[-1], ctypes.POINTER(ctypes.c_uint8))
            config.tcp_device_ip_len = 4
            config.tcp_control_port = settings.port
        if settings.recording is not None:
            if not settings.recording.is_file():
                raise RecordingError(f"{settings.recording} does not exist", hint="check the path")
            config.bltstream_file = str(settings.recording).encode()
        return kept

    def _arrived(self, handle: int | None, frame: Any) -> None:
        """Called by the library's thread, which frees the frame when this returns."""
        del handle
        try:
            payload = bta.copied(frame.contents)
        except (MalformedFrameError, ValueError):  # ValueError: a null pointer
            self.counts.malformed += 1
            return
        self._deliver(payload)

    def _disconnect(self) -> None:
        library, self._library = self._library, None
        if library is not None:
            library.BTAclose(ctypes.byref(self._handle))
        self._callback = None

    def _alive(self) -> bool:
        return self._library is not None and bool(self._library.BTAisConnected(self._handle))

    def _number(self, payload: bta.BtaFrame, host_ns: int) -> tuple[int, int | None]:
        restarts = self.counts.restarts
        sequence = self._numbers.number(payload.counter)
        if self.counts.restarts > restarts:
            self._device_clock.restart()
        return sequence, self._device_clock.device_ns(payload.stamp_us, host_ns)

    def _reached_again(self) -> None:
        self._numbers.reached_again()
        self._device_clock.restart()

    def _decode(self, payload: bta.BtaFrame) -> ToFFrame:
        channels = payload.channels
        if payload.exposures != self._exposures:
            self._exposures = payload.exposures
            self._state(
                "exposure", integration_us=[t for t, _ in payload.exposures], modulation_hz=[f for _, f in payload.exposures]
            )
        sizes = {channel.values.shape for channel in channels.values()}
        if len(sizes) != 1:
            raise MalformedFrameError(f"channels of sizes {sorted(sizes)}")
        (height, width) = sizes.pop()
        camera = self._lens(width, height, lambda: _rays(channels))
        z_m = self._depth(channels, camera)
        unit = self.settings.depth_unit_m
        depth = depth_image(z_m, np.isfinite(z_m) & (z_m > 0), unit)
        kinds = (bta.AMPLITUDE, bta.CONFIDENCE, bta.BALANCE)
        amplitude, confidence, balance = (channels[c].values if c in channels else None for c in kinds)
        sigma = _metres(channels[bta.SIGMA]) if bta.SIGMA in channels else None
        return frame_of(camera, depth, unit, amplitude=amplitude, confidence=confidence, noise_m=sigma, balance=balance)

    def _depth(self, channels: Mapping[int, bta.BtaChannel], camera: Camera) -> NDArray[np.float64]:
        """Depth along the axis, m, NaN where the device marks a pixel as invalid."""
        if bta.Z in channels:
            return _metres(channels[bta.Z])
        if bta.DISTANCE not in channels:
            raise MalformedFrameError("neither Z nor distances")
        return camera.depth_from_range(_metres(channels[bta.DISTANCE]))


def _rays(channels: Mapping[int, bta.BtaChannel]) -> NDArray[np.float64] | None:
    """The rays of a frame's points; None where it has none."""
    if not {bta.X, bta.Y, bta.Z} <= channels.keys():
        return None
    points = np.stack([_metres(channels[c]) for c in (bta.X, bta.Y, bta.Z)], axis=-1)
    return _image_axes(rays_of_points(points, np.isfinite(points).all(axis=-1) & (points[..., 2] > 0)))


def _metres(channel: bta.BtaChannel) -> NDArray[np.float64]:
    """Lengths of a channel; 0 is an invalid pixel. Raises MalformedFrameError for what is no length."""
    if channel.unit not in {bta.METRE, bta.MILLIMETRE}:
        raise MalformedFrameError(f"lengths of unit {channel.unit}")
    values = channel.values.astype(np.float64)
    return values / 1000 if channel.unit == bta.MILLIMETRE else values


def _image_axes(rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rays with x to the right of the image and y down, whichever way the device's axes point."""
    result = rays.copy()
    for axis, direction in ((0, 1), (1, 0)):  # x over columns, y over rows
        with np.errstate(invalid="ignore"):
            steps = np.diff(rays[..., axis], axis=direction)
        if np.nanmedian(steps) < 0 if np.isfinite(steps).any() else False:
            result[..., axis] *= -1
    return result
