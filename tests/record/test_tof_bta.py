"""Bluetechnix cameras through functions with the C interface of the BltTofApi: real structures, pointers and callbacks."""

from __future__ import annotations

import ctypes
import itertools
import json
import threading
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cabinpose.app.cli import main
from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, DependencyError, RecordingError
from cabinpose.record.config import parse_rig
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
        # The device's values; those in `refused` are not taken, those in `kept` become another.
        self.values: dict[str, float] = {"IntegrationTime": 1000, "FrameRate": 25.0, "ModulationFrequency": 20_000_000}
        self.registers: dict[int, int] = {}
        self.refused: dict[str | int, int] = {}
        self.kept: dict[str | int, float] = {}
        self.put: list[tuple[str | int, float]] = []
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
        number = ctypes.c_uint32
        for what, of in (("IntegrationTime", number), ("FrameRate", ctypes.c_float), ("ModulationFrequency", number)):
            setter = kind(ctypes.c_int32, pointer, of)(partial(self._set, what))
            getter = kind(ctypes.c_int32, pointer, ctypes.POINTER(of))(partial(self._get, what))
            setattr(self, f"BTAset{what}", setter)
            setattr(self, f"BTAget{what}", getter)
        self.BTAwriteRegister = kind(ctypes.c_int32, pointer, number, u32, u32)(self._write)
        self.BTAreadRegister = kind(ctypes.c_int32, pointer, number, u32, u32)(self._read)

    def _set(self, what: str, handle: int, value: float) -> int:
        assert handle == 0x1234
        self.put.append((what, value))
        if what in self.refused:
            return self.refused[what]
        self.values[what] = self.kept.get(what, value)
        return 0

    def _get(self, what: str, _: int, value: Any) -> int:
        value[0] = self.values[what]
        return 0

    def _write(self, handle: int, address: int, data: Any, count: Any) -> int:
        assert handle == 0x1234
        assert not count  # one register
        self.put.append((address, data[0]))
        if address in self.refused:
            return self.refused[address]
        self.registers[address] = int(self.kept.get(address, data[0]))
        return 0

    def _read(self, _: int, address: int, data: Any, count: Any) -> int:
        if address not in self.registers:
            return -32768
        data[0] = self.registers[address]
        return 0

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


def setup(samples: list[Sample]) -> list[Mapping[str, Any]]:
    return [m.values for s in samples for m in s.messages if isinstance(m, Facts) and m.about == "setup"]


def test_values_are_sent_read_back_and_told(library: Library) -> None:
    """Exposure before rate; a value that the device changes is sent once more, told, and stated with the one that was asked."""
    library.kept = {"FrameRate": 29.98, 0x1E0: 0x7, "IntegrationTime": 480}
    source = make(integration_us=500, frame_rate_hz=30, registers={"0x1E0": 3, 0x1E1: "0x2"})
    with pytest.warns(UserWarning, match="tof: integration_us is not as asked: 480 \\(asked 500\\)") as told:
        source.open()
    assert {str(w.message).split(":")[1].split()[0] for w in told} == {"integration_us", "registers.0x1e0"}
    first = [("IntegrationTime", 500), ("FrameRate", 30), (0x1E0, 3), (0x1E1, 2)]
    assert library.put == [*first, ("IntegrationTime", 500), (0x1E0, 3)]
    library.send(1, 0, xyz(points_mm()))
    (values,) = setup(list(source.read(0.1)))
    assert values["modulation_hz"] == {"actual": 20_000_000}  # not asked for, and stated all the same
    assert values["integration_us"] == {"asked": 500, "actual": 480}
    assert values["frame_rate_hz"] == {"asked": 30, "actual": pytest.approx(29.98)}  # within a thousandth
    assert values["registers.0x1e0"] == {"asked": 3, "actual": 7}
    assert values["registers.0x1e1"] == {"asked": 2, "actual": 2}
    source.close()


def test_a_refused_value_ends_the_beginning_and_not_a_take_that_runs(library: Library) -> None:
    library.refused = {0x1E0: -32768, "ModulationFrequency": -32760}
    source = make(modulation_hz=1e6, registers={0x1E0: 3})
    with pytest.raises(
        RecordingError, match="refuses modulation_hz 1000000: not supported by this device or its firmware"
    ) as error:
        source.open()
    assert "registers.0x1e0 3: out of the valid range" in str(error.value)
    assert error.value.hint == "give another value, or leave modulation_hz and registers.0x1e0 out: the camera then keeps its own"
    assert library.closed == 1
    library.refused = {}
    source = make(modulation_hz=1e6, reconnect_s=1e-4)
    source.open()
    library.connected = False
    library.refused = {"ModulationFrequency": -32767}
    library.values["ModulationFrequency"] = 20_000_000  # the device was switched off and on
    library.connected = False
    with pytest.warns(UserWarning, match="modulation_hz is not as asked: 20000000 \\(asked 1000000, refused: not possible"):
        source.read(0.001)
    assert source.counts.restarts == 1
    library.connected = True
    library.send(0, 0, xyz(points_mm()))
    assert setup(list(source.read(0.1)))[-1]["modulation_hz"]["refused"].startswith("not possible")
    source.close()


def test_frames_that_come_before_the_device_is_set_up_do_not_count(library: Library) -> None:
    source = make(integration_us=500)
    source.open()
    assert source.counts.received == 0
    source.close()

    def early(*_: Any) -> int:
        library.send(7, 0, xyz(points_mm()))
        return 0

    library.BTAsetIntegrationTime = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_uint32)(early)
    library.values["IntegrationTime"] = 500
    source = make(integration_us=500)
    source.open()
    library.send(8, 0, xyz(points_mm()))
    assert [s.sequence for s in numbered(source.read(0.1))] == [0]
    source.close()


def test_two_integrations_by_the_equation(library: Library) -> None:
    """INT = t f and IDLETIME = (1 / rate - 4 (t + t_read)) f, worked out here for 24 MHz, 20 Hz and a clock of 80 MHz."""
    two = {
        "times_us": [100, 1500], "registers": ["0x100", "0x200"], "idle_registers": ["0x101", "0x201"], "cpu_clock_hz": 80e6,
    }  # fmt: skip
    source = make(modulation_hz=24e6, frame_rate_hz=20, two_integrations=two)
    source.open()
    read_s = 0.00096  # 320 / 2 * 240 / 40e6
    assert library.registers == {
        0x100: 2400, 0x101: round((0.05 - 4 * (0.0001 + read_s)) * 24e6),
        0x200: 36000, 0x201: round((0.05 - 4 * (0.0015 + read_s)) * 24e6),
    }  # fmt: skip
    (values,) = setup(list(source.read(0.01)))
    assert values["two_integrations.T1_us"] == {"asked": 100, "actual": pytest.approx(100)}
    assert values["two_integrations.T2_us"] == {"asked": 1500, "actual": pytest.approx(1500)}
    source.close()
    with pytest.raises(RecordingError, match="4 phases of it take longer than a frame"):
        make(frame_rate_hz=200, two_integrations=two).open()
    library.kept = {0x201: 5}
    with pytest.raises(RecordingError, match="T2_us 1500: register 0x201 does not keep"):
        make(frame_rate_hz=20, two_integrations=two).open()


def test_balance_and_points_in_one_frame(library: Library) -> None:
    """The channels that registers choose: depth and intrinsics of the points, amplitude and balance of the same frame."""
    source = make(frame_mode="channel_selection", registers={0x250: 3})
    source.open()
    assert library.opened[-1].mode == 255
    library.send(1, 0, xyz(points_mm()) | {bta.AMPLITUDE: (AMPLITUDE, 0), bta.BALANCE: (AMPLITUDE + 5, 0)})
    (frame,) = frames(list(source.read(0.1)))
    np.testing.assert_allclose(frame.depth * frame.depth_unit_m, points_mm()[..., 2] / 1000, atol=1.3e-4)
    np.testing.assert_allclose(frame.camera_k, CAMERA.k, atol=1e-3)
    np.testing.assert_array_equal(frame.amplitude, AMPLITUDE)
    np.testing.assert_array_equal(frame.balance, AMPLITUDE + 5)
    source.close()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"filters": {"median": True}}, "bits of registers"),
        ({"recording": "a.bltstream", "frame_rate_hz": 5}, "nothing can be set"),
        ({"integration_us": 0}, "greater than 0"),
        ({"frame_rate_hz": float("nan")}, "finite"),
        ({"registers": {"0xZZ": 1}}, "a whole number"),
        ({"registers": {1: 2**32}}, "less than"),
        ({"two_integrations": {"times_us": [1, 2], "registers": [1, 2], "idle_registers": [3, 4]}}, "need cpu_clock_hz"),
    ],
    ids=str,
)
def test_what_cannot_be_set_is_named(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_rig({"sources": {"tof": {"kind": "bta", **settings}}})


def test_a_take_says_what_the_camera_was_set_to(library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the rig to `info`: what the device changed is warned of, what it refuses ends `record` with nothing left behind."""
    rig, take = tmp_path / "rig.yaml", tmp_path / "take.mcap"
    rig.write_text(
        "sources:\n  tof: {kind: bta, integration_us: 500, frame_rate_hz: 30, registers: {0x1E0: 3}}\n", encoding="utf-8"
    )
    record = ["record", "--config", str(rig), "--out", str(take), "--duration", "0.3"]
    library.refused = {0x1E0: -32768}
    assert main(record) == 2
    told = capsys.readouterr().err
    assert "error: tof: the camera refuses registers.0x1e0 3: out of the valid range\n" in told
    assert told.count("hint:") == 1
    assert not take.exists()
    library.refused, library.kept = {}, {"IntegrationTime": 480}
    timer = threading.Timer(0.1, lambda: library.send(1, 0, xyz(points_mm())))
    timer.start()
    assert main(record) == 0
    timer.join()
    assert "warning: tof: integration_us is not as asked: 480 (asked 500)" in capsys.readouterr().err
    assert main(["info", str(take)]) == 0
    words = capsys.readouterr().out
    assert "tof set-up" in words
    assert "modulation_hz 20000000, integration_us 480 (asked 500), frame_rate_hz 30, registers.0x1e0 3" in words
    assert main(["info", str(take), "--json"]) == 0
    (values,) = json.loads(capsys.readouterr().out)["sources"]["tof"]["setups"]
    assert values["integration_us"] == {"asked": 500, "actual": 480}
