"""Bluetechnix (becom) cameras through the BltTofApi: Argos3D, Sentis3D, TIM-UP, and its recordings, `.bltstream`.

A frame holds the channels that its mode asks for. Where it holds X, Y and Z, the depth is Z and the intrinsics are fitted to
the points, unless the user states them; where it holds distances along the rays alone, the intrinsics have to be stated.
The time stamp counts 32 bits of microseconds and wraps after 71.6 minutes, which is undone. What is set goes to the device
before the first frame counts; filters are bits of registers, whose addresses the device's manual has.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from cabinpose.core import Camera, ConfigError, RecordingError, unknown_name
from cabinpose.record.sources.counting import DeviceClock, FrameNumbers
from cabinpose.record.sources.tof import bta_library as bta
from cabinpose.record.sources.tof.camera import (
    MalformedFrameError,
    depth_image,
    frame_of,
    rays_of_points,
)
from cabinpose.record.sources.tof.setup import AdjustableSource, CameraSetup, Control, Positive, RefusedError
from cabinpose.signals import HostClock, ToFFrame

_TURN = 2**32
_WITH_POINTS = frozenset({"current", "xyz", "xyz_amplitude", "xyz_amplitude_flags", "channel_selection"})
_DEVICE_TYPES = {"any": 0, "ethernet": 1, "usb": 2, "uart": 3, "bltstream": 0xF}


def _number(value: Any) -> Any:
    """A number of a register as manuals write it, "0x1E0"; anything else as it is."""
    try:
        return int(value, 0) if isinstance(value, str) else value
    except ValueError:
        return value


Word = Annotated[int, BeforeValidator(_number), Field(ge=0, lt=2**32)]


class TwoIntegrations(BaseModel):
    """Two integration times in turn, of the evaluation kits EVK75023 and EVK75123: memory tables T1 and T2.

    A table holds times in periods of the modulation: INT = t f_mod, and IDLETIME = (1 / f_frame - phases (t + t_read)) f_mod,
    where t_read = 320/2 · 240 / (CPU clock / 2) is what it takes to read a phase.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    times_us: tuple[Positive, Positive] = Field(description="integration time of T1 and of T2, µs")
    registers: tuple[Word, Word] = Field(description="addresses of INT in T1 and in T2, from the kit's manual")
    idle_registers: tuple[Word, Word] | None = Field(None, description="addresses of IDLETIME; left out: it stays")
    phases: int = Field(4, ge=1, le=16, description="phases of a frame")
    cpu_clock_hz: Positive | None = Field(None, description="clock of the kit's processor, for IDLETIME")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.idle_registers is not None and self.cpu_clock_hz is None:
            raise ValueError("idle_registers need cpu_clock_hz")
        return self

    def periods(self, table: int, modulation_hz: float) -> int:
        """INT of a table (0: T1, 1: T2)."""
        return round(self.times_us[table] * 1e-6 * modulation_hz)

    def idle_periods(self, table: int, modulation_hz: float, frame_rate_hz: float) -> int:
        """IDLETIME of a table; below 0 where the phases take longer than a frame."""
        assert self.cpu_clock_hz is not None
        read_s = 320 / 2 * 240 / (self.cpu_clock_hz / 2)
        return round((1 / frame_rate_hz - self.phases * (self.times_us[table] * 1e-6 + read_s)) * modulation_hz)


class BtaSettings(CameraSetup):
    """A camera of Bluetechnix, or one of its recordings."""

    cannot: ClassVar = {"filters": "its filters are bits of registers: set `registers`, by the addresses of the device's manual"}
    library: str = Field("libbta.so", description="file of the BltTofApi; `bta.dll` on Windows")
    device: Literal["any", "ethernet", "usb", "uart", "bltstream"] = Field("any", description="how the camera is connected")
    address: str | None = Field(
        None, pattern=r"^\d{1,3}(\.\d{1,3}){3}$", description="the camera's IPv4 address, for its TCP control"
    )
    port: int = Field(10001, ge=1, le=65535, description="port of its TCP control")
    serial: int | None = Field(None, ge=1, description="serial number, where several are connected")
    recording: Path | None = Field(None, description="a `.bltstream` file to play in place of a camera")
    frame_mode: str = Field("xyz_amplitude", description=f"what a frame holds: {', '.join(bta.FRAME_MODES)}")
    registers: dict[Word, Word] = Field(
        default_factory=dict, description="values by the registers' addresses (0x1E0), written in this order, such as filters"
    )
    two_integrations: TwoIntegrations | None = Field(None, description="integration times of the tables T1 and T2 of the kits")

    @model_validator(mode="after")
    def _sets_a_camera(self) -> Self:
        asked = (self.frame_rate_hz, self.integration_us, self.modulation_hz, self.registers, self.two_integrations)
        if self.recording is not None and any(asked):
            raise ValueError("a recording is played as it was taken: nothing can be set")
        return self


class BtaSource(AdjustableSource[BtaSettings]):
    """A `FrameSource` of a camera of Bluetechnix."""

    Settings: ClassVar = BtaSettings

    def __init__(self, name: str, settings: BtaSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        if settings.frame_mode not in bta.FRAME_MODES:
            raise unknown_name("frame mode", settings.frame_mode, tuple(bta.FRAME_MODES))
        if settings.lens is None and settings.frame_mode not in _WITH_POINTS:
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
        self._counts_frames = False  # those that come before the device is set up do not

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
        try:
            self._set_up()
        except RecordingError:
            self._disconnect()
            raise
        self._counts_frames = True
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

    def _controls(self) -> Iterator[Control]:
        """A longer exposure before a rate that has to fit it; registers last, since they may say anything."""
        settings = self.settings
        if settings.recording is not None:
            return
        put, get = partial(bta.put, self._library, self._handle), partial(bta.get, self._library, self._handle)
        values = {"ModulationFrequency": "modulation_hz", "IntegrationTime": "integration_us", "FrameRate": "frame_rate_hz"}
        for what, name in values.items():
            yield Control(name, getattr(settings, name), partial(put, what), partial(get, what))
        write = partial(bta.write_register, self._library, self._handle)
        read = partial(bta.read_register, self._library, self._handle)
        for address, value in settings.registers.items():
            yield Control(f"registers.{address:#x}", value, partial(write, address), partial(read, address))
        if (two := settings.two_integrations) is not None:
            yield from (self._table(two, table) for table in (0, 1))

    def _table(self, two: TwoIntegrations, table: int) -> Control:
        """The integration time of a memory table, in periods of the modulation that the device has now."""
        library, handle = self._library, self._handle

        def now(what: str) -> float:
            value = bta.get(library, handle, what)
            if not value:
                raise RefusedError(f"the device does not tell its {what}, which the table's times are in")
            return value

        def put(_: float) -> None:
            modulation = now("ModulationFrequency")
            words = {two.registers[table]: two.periods(table, modulation)}
            if two.idle_registers is not None:
                words[two.idle_registers[table]] = two.idle_periods(table, modulation, now("FrameRate"))
            if min(words.values()) < 0:
                raise RefusedError(f"{two.phases} phases of it take longer than a frame")
            for address, word in words.items():
                bta.write_register(library, handle, address, word)
                if bta.read_register(library, handle, address) not in (word, None):
                    raise RefusedError(f"register {address:#x} does not keep {word}")

        def get() -> float | None:
            word, modulation = (
                bta.read_register(library, handle, two.registers[table]),
                bta.get(library, handle, "ModulationFrequency"),
            )
            return None if word is None or not modulation else word / modulation * 1e6

        return Control(f"two_integrations.T{table + 1}_us", two.times_us[table], put, get)

    def _arrived(self, handle: int | None, frame: Any) -> None:
        """Called by the library's thread, which frees the frame when this returns."""
        del handle
        if not self._counts_frames:
            return
        try:
            payload = bta.copied(frame.contents)
        except (MalformedFrameError, ValueError):  # ValueError: a null pointer
            self.counts.malformed += 1
            return
        self._deliver(payload)

    def _disconnect(self) -> None:
        library, self._library = self._library, None
        self._counts_frames = False
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
