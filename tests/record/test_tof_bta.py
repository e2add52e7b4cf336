"""Bluetechnix cameras through functions with the C interface of the BltTofApi: real structures, pointers and callbacks."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, DependencyError, RecordingError
from cabinpose.record.sources.tof import bta_library as bta
from cabinpose.record.sources.tof.bta import BtaSettings, BtaSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample, ToFFrame

CAMERA = Camera(40, 30, 38.0, 39.0, 20.5, 14.0, (-0.15, 0.03, 0.0, 0.0, 0.0))
U8, U16, I16, F32 = 0x11, 0x12, 0x22, 0x34
FORMATS = {np.dtype(np.uint8): U8, np.dtype(np.uint16): U16, np.dtype(np.int16): I16, np.dtype(np.float32): F32}


class Library:
    """What the vendor's library does, with its C signatures; `send` is its thread that calls the callback."""

    def __init__(self, version: tuple[int, int, int] = (3, 3, 11)) -> None:
        self.version, self.connected, self.open_status = version, True, 0
        self.config: bta.Config | None = None
        self.opened, self.closed = [], 0
        u32 = ctypes.POINTER(ctypes.c_uint32)
        handle = ctypes.POINTER(ctypes.c_void_p)
        config = ctypes.POINTER(bta.Config)
        kind = ctypes.CFUNCTYPE
        pointer = ctypes.c_void_p
        self.BTAgetVersion = kind(ctypes.c_int32, u32, u32, u32, pointer, ctypes.c_uint32, pointer, pointer)(self._version)
        self.BTAinitConfig = kind(ctypes.c_int32, config)(self._init)
        self.BTAopen = kind(ctypes.c_int32, config, handle)(self._open)
        self.BTAclose = kind(ctypes.c_int32, handle)(self._close)
        self.BTAisConnected = kind(ctypes.c_uint8, pointer)(lambda _: int(self.connected))

    def _version(self, major: Any, minor: Any, patch: Any, *_: Any) -> int:
        major[0], minor[0], patch[0] = self.version
        return 0

    def _init(self, config: Any) -> int:
        config[0].udp_control_port = 10003
        config[0].frame_queue_length = 1
        return 0

    def _open(self, config: Any, handle: Any) -> int:
        if self.open_status < 0:
            return self.open_status
        given = config[0]
        address = bytes(given.tcp_device_ip[: given.tcp_device_ip_len]) if given.tcp_device_ip_len else b""
        self.opened.append(
            SimpleNamespace(
                address=address, port=given.tcp_control_port, mode=given.frame_mode, type=given.device_type,
                serial=given.serial_number, file=given.bltstream_file, udp=given.udp_control_port,
            )
        )  # fmt: skip
        # A copy of the pointer: the configuration is the caller's, who frees it.
        self.callback = bta.FrameArrived(ctypes.cast(given.frame_arrived_ex, ctypes.c_void_p).value)
        handle[0] = 0x1234
        return 0

    def _close(self, handle: Any) -> int:
        assert handle[0] == 0x1234
        handle[0] = None
        self.closed += 1
        return 0

    def send(self, counter: int, stamp_us: int, channels: Mapping[int, tuple[np.ndarray, int]], **wrong: int) -> None:
        """Call back with a frame in memory that is overwritten afterwards, as the library frees it."""
        buffers, parts = [], []
        for number, (values, unit) in channels.items():
            data = ctypes.create_string_buffer(values.tobytes(), values.nbytes)
            buffers.append(data)
            height, width = values.shape
            channel = bta.Channel(
                id=number, x_res=width, y_res=height, data_format=FORMATS[values.dtype], unit=unit,
                data=ctypes.addressof(data), data_len=values.nbytes,
            )  # fmt: skip
            for name, value in wrong.items():
                setattr(channel, name, value)
            parts.append(channel)
        pointers = (ctypes.POINTER(bta.Channel) * max(len(parts), 1))(*(ctypes.pointer(p) for p in parts))
        frame = bta.Frame(frame_counter=counter % 2**32, time_stamp=stamp_us % 2**32, channels=pointers, channels_len=len(parts))
        self.callback(0x1234, ctypes.pointer(frame))
        for data in buffers:
            ctypes.memset(data, 0xFF, len(data))


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Library:
    made = Library()
    monkeypatch.setattr(bta.ctypes, "CDLL", lambda _: made)
    return made


def make(**settings: Any) -> BtaSource:
    return BtaSource("tof", BtaSettings(library="libbta.so", **settings), HostClock())


def points_mm() -> np.ndarray:
    u, v = np.meshgrid(np.arange(40), np.arange(30))
    return CAMERA.points(1.2 + 0.02 * u - 0.005 * v) * 1000


def xyz(points: np.ndarray, dtype: Any = np.float32) -> dict[int, tuple[np.ndarray, int]]:
    ids = (bta.X, bta.Y, bta.Z)
    return {c: (np.ascontiguousarray(points[..., i]).astype(dtype), bta.MILLIMETRE) for i, c in enumerate(ids)}


AMPLITUDE = np.arange(30 * 40, dtype=np.uint16).reshape(30, 40)


def frames(samples: list[Sample]) -> list[ToFFrame]:
    return [m for s in samples for m in s.messages if isinstance(m, ToFFrame)]


def numbered(samples: Any) -> list[Sample]:
    return [s for s in samples if s.sequence is not None]


def test_the_structures_lie_as_in_the_vendors_headers() -> None:
    """42 fields of 8 bytes (`CONFIG_STRUCT_ORG_LEN`), by their place in the header; frames as a C compiler lays them out."""
    places = {"tcp_device_ip": 9, "device_type": 20, "frame_mode": 26, "frame_arrived_ex": 32, "bltstream_file": 38}
    for name, place in places.items():
        assert getattr(bta.Config, name).offset == 8 * place, name
    assert bta.Config.shared_memory.offset == 8 * 41
    assert (bta.Frame.frame_counter.offset, bta.Frame.time_stamp.offset, bta.Frame.channels.offset) == (16, 20, 24)
    assert bta.Frame.channels_len.offset == 32
    assert (bta.Channel.data_format.offset, bta.Channel.data.offset, bta.Channel.data_len.offset) == (8, 24, 32)


@pytest.mark.parametrize("mirrored", [False, True])
def test_points_become_depth_and_intrinsics(library: Library, mirrored: bool) -> None:
    source = make(address="192.168.0.10", serial=42)
    assert source.check() == []
    source.open()
    (opened,) = library.opened
    assert (opened.address, opened.port, opened.mode, opened.serial) == (bytes([192, 168, 0, 10]), 10001, 5, 42)
    assert opened.udp == 10003  # what BTAinitConfig set is kept
    points = points_mm() * ((-1, 1, 1) if mirrored else (1, 1, 1))
    points[:3] = 0  # invalid
    library.send(7, 5_000, xyz(points) | {bta.AMPLITUDE: (AMPLITUDE, 0), bta.CONFIDENCE: (AMPLITUDE, 0)})
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    np.testing.assert_allclose(frame.depth[3:] * frame.depth_unit_m, points_mm()[3:, :, 2] / 1000, atol=1.3e-4)
    assert (frame.depth[:3] == 0).all()
    np.testing.assert_array_equal(frame.amplitude, AMPLITUDE)
    np.testing.assert_array_equal(frame.confidence, AMPLITUDE >> 8)
    np.testing.assert_allclose(frame.camera_k, CAMERA.k, atol=1e-3)
    np.testing.assert_allclose(frame.camera_dist, CAMERA.dist, atol=1e-3)
    assert numbered(samples)[0].device_ns == 5_000_000
    about = {m.about: m.values for s in samples for m in s.messages if isinstance(m, Facts)}
    assert about["intrinsics"]["max_px"] < 1e-3
    assert about["camera"]["library"] == "3.3.11"
    source.close()
    source.close()
    assert library.closed == 1


def test_settings_balance_and_sigma_are_recorded(library: Library) -> None:
    """Two integrations in one frame: the first one's images, and what both were."""
    source = make(frame_mode="current")
    source.open()
    sigma = np.full((30, 40), 0.0042, np.float32)
    channels = xyz(points_mm()) | {bta.BALANCE: (AMPLITUDE, 0), bta.SIGMA: (sigma, bta.METRE)}
    for counter in (1, 2):
        library.send(counter, 5_000 * counter, channels, integration_time_us=300, modulation_frequency_hz=20_000_000)
    samples = list(source.read(0.1))
    first, second = frames(samples)
    np.testing.assert_array_equal(first.balance, AMPLITUDE)
    np.testing.assert_array_equal(second.noise, np.full((30, 40), 4200))
    stated = [m.values for s in samples for m in s.messages if isinstance(m, Facts) and m.about == "exposure"]
    assert stated == [{"integration_us": [300], "modulation_hz": [20_000_000]}]
    source.close()


def test_distances_become_depth_by_stated_intrinsics(library: Library) -> None:
    lens = {"fx": 38.0, "fy": 39.0, "cx": 20.5, "cy": 14.0, "dist": CAMERA.dist}
    source = make(frame_mode="distance_amplitude", lens=lens)
    source.open()
    ranges = np.linalg.norm(points_mm(), axis=-1)
    library.send(1, 0, {bta.DISTANCE: (np.rint(ranges).astype(np.uint16), bta.MILLIMETRE), bta.AMPLITUDE: (AMPLITUDE, 0)})
    (frame,) = frames(list(source.read(0.1)))
    np.testing.assert_allclose(frame.depth * frame.depth_unit_m, points_mm()[..., 2] / 1000, atol=7e-4)
    source.close()
    with pytest.raises(ConfigError, match="do not show the camera's intrinsics"):
        make(frame_mode="distance_amplitude")
    with pytest.raises(ConfigError, match="unknown frame mode 'xy'"):
        make(frame_mode="xy")


def test_the_time_stamp_is_carried_over_its_wraps(library: Library) -> None:
    source = make(queue_frames=100)
    source.open()
    stamps = [2**32 - 70_000 + 33_333 * i for i in range(6)]
    for counter, stamp in enumerate(stamps, 2**32 - 3):  # the counter wraps too
        library.send(counter, stamp, xyz(points_mm()))
    samples = numbered(source.read(0.1))
    assert [s.device_ns for s in samples] == [stamp * 1000 for stamp in stamps]
    assert [b.sequence - a.sequence for a, b in itertools.pairwise(samples)] == [1] * 5
    library.send(2**32 + 50, 2**32 + 2_000_000, xyz(points_mm()))
    assert source.counts.lost == 47  # + 3 to + 49
    library.send(0, 10_000, xyz(points_mm()))  # switched off and on
    first, second = numbered(source.read(0.1))
    assert (second.sequence, second.device_ns) == (first.sequence + 1, 10_000_000)
    assert (source.counts.restarts, source.counts.lost) == (1, 47)
    source.close()


@pytest.mark.parametrize(
    "wrong",
    [
        {"data_len": 2**31},
        {"x_res": 65535},
        {"data": 0},
        {"data_format": 0x50},
        {"y_res": 0},
        {"unit": 9},
        {"x_res": 30, "y_res": 40},
    ],
    ids=str,
)
def test_what_contradicts_itself_is_counted(library: Library, wrong: dict[str, int]) -> None:
    source = make()
    source.open()
    library.send(0, 0, {bta.Z: xyz(points_mm())[bta.Z], bta.AMPLITUDE: (AMPLITUDE, 0)}, **wrong)
    library.send(1, 0, {})
    assert frames(list(source.read(0.01))) == []
    assert source.counts.malformed == 2
    library.send(2, 0, xyz(points_mm()))
    assert len(frames(list(source.read(0.1)))) == 1
    source.close()


def test_a_lost_camera_is_opened_again(library: Library) -> None:
    source = make(reconnect_s=1e-4)
    source.open()
    library.send(100, 10**6, xyz(points_mm()))
    assert len(numbered(source.read(0.1))) == 1
    library.connected, library.open_status = False, -32766
    assert numbered(source.read(0.001)) == []
    assert source.counts.restarts == 0
    library.open_status, library.connected = 0, True
    source.read(0.001)
    assert source.counts.restarts == 1
    library.send(0, 0, xyz(points_mm()))
    assert [s.sequence for s in numbered(source.read(0.1))] == [1]
    source.close()


def test_a_recording_is_played_and_what_is_missing_named(
    library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "take.bltstream"
    with pytest.raises(RecordingError, match="does not exist"):
        make(recording=file).open()
    assert "does not exist" in make(recording=file).check()[0]
    file.write_bytes(b"")
    make(recording=file).open()
    assert (library.opened[-1].type, library.opened[-1].file) == (0xF, str(file).encode())
    library.open_status = -32765
    with pytest.raises(RecordingError, match="BTAopen failed with status -32765"):
        make().open()
    library.version = (2, 1, 0)
    with pytest.raises(RecordingError, match=r"BltTofApi 2\.1\.0 is too old"):
        make().open()
    monkeypatch.undo()
    with pytest.raises(DependencyError, match="BltTofApi library") as error:
        BtaSource("tof", BtaSettings(library="nowhere.so"), HostClock()).open()
    assert "Bluetechnix" in str(error.value.hint)
    with pytest.raises(DependencyError):
        bta.load_library(None)  # type: ignore[arg-type]  # the C library itself: loads, and has no BTAopen
