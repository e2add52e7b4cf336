"""The C interface of Bluetechnix's BltTofApi (BTA), version 3: structures and functions for ctypes.

Source: the vendor's headers `bta.h`, `bta_frame.h`, `bta_discovery.h` 3.0 to 3.3, which are public. Every field of
`BTA_Config` is aligned to 8 bytes; later versions append fields. Frames are reached through pointers, so that fields
appended to a channel do no harm.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DependencyError, RecordingError
from cabinpose.record.sources.tof.camera import MOST_PIXELS, MalformedFrameError
from cabinpose.record.sources.tof.setup import RefusedError

DISTANCE, AMPLITUDE, X, Y, Z, CONFIDENCE, FLAGS = 0x1, 0x2, 0x4, 0x8, 0x10, 0x20, 0x40
BALANCE, SIGMA = 0x10000, 0x20000
METRE, MILLIMETRE = 1, 3
MOST_CHANNELS = 64
FRAME_MODES: Mapping[str, int] = {
    "current": 0, "distance_amplitude": 1, "z_amplitude": 2, "distance_amplitude_flags": 3, "xyz": 4, "xyz_amplitude": 5,
    "xyz_amplitude_flags": 7, "distance_amplitude_balance": 11, "distance_amplitude_confidence": 21, "channel_selection": 255,
}  # fmt: skip
_DTYPES: Mapping[int, str] = {0x11: "<u1", 0x12: "<u2", 0x14: "<u4", 0x22: "<i2", 0x24: "<i4", 0x34: "<f4", 0x38: "<f8"}
_WHERE = "the BltTofApi comes with the camera, from Bluetechnix (becom Systems): name its library with `library`"

_U8, _U16, _U32, _F32 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_float
_IP, _PATH, _POINTER = ctypes.POINTER(_U8), ctypes.c_char_p, ctypes.c_void_p


class Channel(ctypes.Structure):
    """The beginning of a `BTA_Channel`."""

    _fields_ = (
        ("id", _U32), ("x_res", _U16), ("y_res", _U16), ("data_format", _U32), ("unit", _U32), ("integration_time_us", _U32),
        ("modulation_frequency_hz", _U32), ("data", _POINTER), ("data_len", _U32),
    )  # fmt: skip


class Frame(ctypes.Structure):
    """The beginning of a `BTA_Frame`."""

    _fields_ = (
        ("firmware_major", _U8), ("firmware_minor", _U8), ("firmware_non_functional", _U8), ("main_temperature", _F32),
        ("led_temperature", _F32), ("generic_temperature", _F32), ("frame_counter", _U32), ("time_stamp", _U32),
        ("channels", ctypes.POINTER(ctypes.POINTER(Channel))), ("channels_len", _U8),
    )  # fmt: skip


FrameArrived = ctypes.CFUNCTYPE(None, _POINTER, ctypes.POINTER(Frame))

_CONFIG_FIELDS: tuple[tuple[str, Any], ...] = (
    ("udp_data_ip", _IP), ("udp_data_ip_len", _U8), ("udp_data_port", _U16), ("udp_control_out_ip", _IP),
    ("udp_control_out_ip_len", _U8), ("udp_control_port", _U16), ("udp_control_in_ip", _IP), ("udp_control_in_ip_len", _U8),
    ("udp_control_callback_port", _U16), ("tcp_device_ip", _IP), ("tcp_device_ip_len", _U8), ("tcp_data_port", _U16),
    ("tcp_control_port", _U16), ("uart_port_name", _PATH), ("uart_baud_rate", _U32), ("uart_data_bits", _U8),
    ("uart_stop_bits", _U8), ("uart_parity", _U8), ("uart_transmitter", _U8), ("uart_receiver", _U8), ("device_type", _U32),
    ("product_order_number", _PATH), ("serial_number", _U32), ("calibration_file", _PATH), ("z_factors_file", _PATH),
    ("wiggling_file", _PATH), ("frame_mode", _U32), ("info_event", _POINTER), ("info_event_ex", _POINTER),
    ("info_event_ex2", _POINTER), ("verbosity", _U8), ("frame_arrived", _POINTER), ("frame_arrived_ex", FrameArrived),
    ("frame_arrived_ex2", _POINTER), ("user_argument", _POINTER), ("frame_queue_length", _U16), ("frame_queue_mode", _U32),
    ("average_window", _U16), ("bltstream_file", _PATH), ("info_event_file", _PATH), ("udp_data_auto_config", _U8),
    ("shared_memory", _U8),
)  # fmt: skip


def _aligned(fields: tuple[tuple[str, Any], ...]) -> tuple[tuple[str, Any], ...]:
    """Every field in 8 bytes of its own."""
    result: list[tuple[str, Any]] = []
    for name, kind in fields:
        result.append((name, kind))
        if rest := 8 - ctypes.sizeof(kind):
            result.append((f"_after_{name}", _U8 * rest))
    return tuple(result)


class Config(ctypes.Structure):
    """`BTA_Config` of version 3.3, with room for what later versions append."""

    _fields_ = (*_aligned(_CONFIG_FIELDS), ("_appended", _U8 * 512))


@dataclass(frozen=True, slots=True)
class BtaChannel:
    """The pixels of a channel (height, width), copied."""

    values: NDArray[Any]
    unit: int


@dataclass(frozen=True, slots=True)
class BtaFrame:
    """A frame, copied: channels by id, the device's counter and time, each exposure's integration (µs) and modulation (Hz)."""

    counter: int
    stamp_us: int
    channels: Mapping[int, BtaChannel]
    exposures: tuple[tuple[int, int], ...]


def load_library(path: str) -> Any:
    """The vendor's library; raises DependencyError where it is not there or no BltTofApi."""
    try:
        return declare(ctypes.CDLL(path))
    except (OSError, AttributeError) as error:
        message = f"a Bluetechnix camera needs the BltTofApi library, and {path} is none: {error}"
        raise DependencyError(message, hint=_WHERE) from error


def declare(library: Any) -> Any:
    """State the arguments of the functions that are used; AttributeError where one is missing."""
    handle, count, config = ctypes.POINTER(_POINTER), ctypes.POINTER(_U32), ctypes.POINTER(Config)
    arguments: Mapping[str, tuple[Any, ...]] = {
        "BTAgetVersion": (count, count, count, _POINTER, _U32, _POINTER, _POINTER),
        "BTAinitConfig": (config,),
        "BTAopen": (config, handle),
        "BTAclose": (handle,),
        "BTAisConnected": (_POINTER,),
        "BTAsetIntegrationTime": (_POINTER, _U32),
        "BTAgetIntegrationTime": (_POINTER, count),
        "BTAsetFrameRate": (_POINTER, _F32),
        "BTAgetFrameRate": (_POINTER, ctypes.POINTER(_F32)),
        "BTAsetModulationFrequency": (_POINTER, _U32),
        "BTAgetModulationFrequency": (_POINTER, count),
        "BTAreadRegister": (_POINTER, _U32, count, count),
        "BTAwriteRegister": (_POINTER, _U32, count, count),
    }
    for name, kinds in arguments.items():
        function = getattr(library, name)
        function.argtypes = kinds
        function.restype = _U8 if name == "BTAisConnected" else ctypes.c_int32
    return library


def version(library: Any) -> tuple[int, int, int]:
    """The library's version; raises RecordingError for those before 3.0, whose structures differ."""
    numbers = [_U32() for _ in range(3)]
    succeed(library.BTAgetVersion(*(ctypes.byref(n) for n in numbers), None, 0, None, None), "BTAgetVersion")
    major, minor, patch = (n.value for n in numbers)
    if major < 3:
        raise RecordingError(f"BltTofApi {major}.{minor}.{patch} is too old", hint="3.0 or later is needed: ask becom Systems")
    return major, minor, patch


def succeed(status: int, what: str) -> None:
    """Raise RecordingError for a status that is an error; warnings are above 0."""
    if status < 0:
        raise RecordingError(f"{what} failed with status {status}", hint="see bta_status.h; is the camera on and reachable?")


_STATUSES: Mapping[int, str] = {
    -32768: "out of the valid range", -32767: "not possible in the present configuration", -32766: "no answer in time",
    -32765: "the device cannot be reached", -32764: "the connection is down", -32762: "the device did not react as expected",
    -32760: "not supported by this device or its firmware",
}  # fmt: skip


def put(library: Any, handle: Any, what: str, value: float) -> None:
    """`BTAset...` a value: "IntegrationTime" (µs), "FrameRate" (Hz), "ModulationFrequency" (Hz). Raises RefusedError."""
    number = value if what == "FrameRate" else round(value)
    _taken(f"BTAset{what}", getattr(library, f"BTAset{what}")(handle, number))


def get(library: Any, handle: Any, what: str) -> float | None:
    """`BTAget...` a value; None where the device does not tell."""
    number: Any = _F32() if what == "FrameRate" else _U32()
    status = getattr(library, f"BTAget{what}")(handle, ctypes.byref(number))
    return None if status < 0 else float(number.value)


def write_register(library: Any, handle: Any, address: int, value: int) -> None:
    """Write one register of 32 bits. Raises RefusedError."""
    _taken("BTAwriteRegister", library.BTAwriteRegister(handle, address, ctypes.byref(_U32(value)), None))


def read_register(library: Any, handle: Any, address: int) -> int | None:
    """The value of a register; None where the device does not tell."""
    value = _U32()
    return None if library.BTAreadRegister(handle, address, ctypes.byref(value), None) < 0 else value.value


def _taken(what: str, status: int) -> None:
    if status < 0:
        raise RefusedError(_STATUSES.get(status, f"{what} gave status {status}"))


def copied(frame: Frame) -> BtaFrame:
    """A frame copied out of the library's memory. Raises MalformedFrameError for sizes that contradict each other."""
    if frame.channels_len > MOST_CHANNELS or (frame.channels_len and not frame.channels):
        raise MalformedFrameError(f"{frame.channels_len} channels")
    channels: dict[int, BtaChannel] = {}
    exposures: dict[tuple[int, int], None] = {}
    for i in range(frame.channels_len):
        if not frame.channels[i]:
            raise MalformedFrameError(f"channel {i} is not there")
        channel = frame.channels[i].contents
        if channel.integration_time_us:
            exposures[int(channel.integration_time_us), int(channel.modulation_frequency_hz)] = None
        if channel.id not in {DISTANCE, AMPLITUDE, X, Y, Z, CONFIDENCE, FLAGS, BALANCE, SIGMA} or channel.id in channels:
            continue  # colour, raw phases; a further exposure of the same scene
        channels[channel.id] = _copied_channel(channel)
    return BtaFrame(int(frame.frame_counter), int(frame.time_stamp), channels, tuple(exposures))


def _copied_channel(channel: Channel) -> BtaChannel:
    name = _DTYPES.get(channel.data_format)
    if name is None:
        raise MalformedFrameError(f"channel {channel.id:#x} has data of format {channel.data_format:#x}")
    dtype = np.dtype(name)
    width, height = int(channel.x_res), int(channel.y_res)
    size = width * height * dtype.itemsize
    if not channel.data or not 0 < width * height <= MOST_PIXELS or channel.data_len != size:
        raise MalformedFrameError(f"channel {channel.id:#x}: {channel.data_len} bytes for {width}x{height} of {dtype}")
    values = np.frombuffer(ctypes.string_at(channel.data, size), dtype).reshape(height, width)
    return BtaChannel(values, int(channel.unit))
