"""Orbbec's cameras through a stand-in for `pyorbbecsdk`, which is held against the real package where that is installed."""

from __future__ import annotations

import json
import re
import sys
import time
from collections import deque
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from camera_samples import check_quiet_without_a_camera, drained, frames

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, DependencyError, RecordingError
from cabinpose.record.config import parse_rig
from cabinpose.record.sources.tof.orbbec import OrbbecSettings, OrbbecSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample

SHAPE = (48, 64)
PERIOD_US = 33_333
STRAIGHT = {"fx": 60.0, "fy": 61.0, "cx": 31.5, "cy": 23.0, "k1": -0.2, "k2": 0.05, "k3": 0.01, "p1": 0.001, "p2": -0.001}
FEMTO = {
    "fx": 504.7, "fy": 504.8, "cx": 321.2, "cy": 329.0, "p1": 1.1e-3, "p2": -7.2e-4,
    "k1": 0.548, "k2": -0.021, "k3": -0.0027, "k4": 0.8897, "k5": 0.0861, "k6": -0.0139,
}  # fmt: skip
DEFAULT = (64, 48, 30)
OFFERED = [DEFAULT, (64, 48, 60), (64, 48, 5), (640, 576, 30), (640, 576, 15), (512, 512, 30), (1024, 1024, 15)]


class OBError(Exception):
    """What the SDK raises for its own errors; for others, pybind11 raises RuntimeError."""


OBFormat = Enum("OBFormat", "Y16 Z16 Y8 RLE MJPG")
OBSensorType = Enum("OBSensorType", "DEPTH_SENSOR IR_SENSOR")
OBFrameAggregateOutputMode = Enum("OBFrameAggregateOutputMode", "FULL_FRAME_REQUIRE ANY_SITUATION")
OBLogLevel = Enum("OBLogLevel", "NONE")


class OBCameraIntrinsic(SimpleNamespace):
    fx = fy = cx = cy = 0.0
    width = height = 0


class OBCameraDistortion(SimpleNamespace):
    k1 = k2 = k3 = k4 = k5 = k6 = p1 = p2 = 0.0


class OBDeviceTemperature(SimpleNamespace):
    cpu_temperature, ir_temperature, laser_temperature = 51.5, 40.25, 0.0


class VideoStreamProfile:
    def __init__(self, shape: tuple[int, int, int], lens: dict[str, float], image_format: OBFormat = OBFormat.Y16) -> None:
        self._shape, self._lens, self._format = shape, lens, image_format

    def as_video_stream_profile(self) -> VideoStreamProfile:
        return self

    def get_width(self) -> int:
        return self._shape[0]

    def get_height(self) -> int:
        return self._shape[1]

    def get_fps(self) -> int:
        return self._shape[2]

    def get_format(self) -> OBFormat:
        return self._format

    def get_intrinsic(self) -> OBCameraIntrinsic:
        values = {name: self._lens[name] for name in ("fx", "fy", "cx", "cy")}
        return OBCameraIntrinsic(width=self._shape[0], height=self._shape[1], **values)

    def get_distortion(self) -> OBCameraDistortion:
        return OBCameraDistortion(**{name: value for name, value in self._lens.items() if name[0] in "kp"})


class StreamProfileList:
    def __init__(self, profiles: list[VideoStreamProfile]) -> None:
        self._profiles = profiles

    def get_count(self) -> int:
        return len(self._profiles)

    def get_stream_profile_by_index(self, index: int) -> VideoStreamProfile:
        return self._profiles[index]

    def get_default_video_stream_profile(self) -> VideoStreamProfile:
        return next(p for p in self._profiles if (p.get_width(), p.get_height(), p.get_fps()) == DEFAULT)


class DeviceInfo:
    def get_name(self) -> str:
        return "Orbbec Femto Bolt"

    def get_firmware_version(self) -> str:
        return "1.1.2"

    def get_connection_type(self) -> str:
        return "USB3.2"


class Device:
    """A camera; the attributes say how it behaves."""

    def __init__(self, serial: str, uid: str = "2-1-7") -> None:
        self.serial, self.uid = serial, uid
        self.lens: dict[str, float] = STRAIGHT
        self.offered = list(OFFERED)
        self.formats = {OBSensorType.DEPTH_SENSOR: OBFormat.Y16, OBSensorType.IR_SENSOR: OBFormat.Y16}
        self.sent: deque[Any] = deque()  # frame sets, None for a time-out, or what wait_for_frames raises
        self.refuses: Exception | None = None
        self.config: Config | None = None
        self.synchronised = self.running = False

    def get_device_info(self) -> DeviceInfo:
        return DeviceInfo()

    def get_temperature(self) -> OBDeviceTemperature:
        return OBDeviceTemperature()


class DeviceList:
    def __init__(self, devices: list[Device]) -> None:
        self._devices = devices

    def get_count(self) -> int:
        return len(self._devices)

    def get_device_serial_number_by_index(self, index: int) -> str:
        return self._devices[index].serial

    def get_device_uid_by_index(self, index: int) -> str:
        return self._devices[index].uid

    def get_device_by_index(self, index: int) -> Device:
        return self._devices[index]


class Config:
    def __init__(self) -> None:
        self.streams: list[VideoStreamProfile] = []
        self.mode: OBFrameAggregateOutputMode | None = None

    def enable_stream(self, profile: VideoStreamProfile) -> None:
        self.streams.append(profile)

    def set_frame_aggregate_output_mode(self, mode: OBFrameAggregateOutputMode) -> None:
        self.mode = mode


class Pipeline:
    def __init__(self, device: Device) -> None:
        self._device = device

    def get_stream_profile_list(self, sensor: OBSensorType) -> StreamProfileList:
        if sensor not in self._device.formats:
            raise OBError("No matched sensor found")
        kind = self._device.formats[sensor]
        return StreamProfileList([VideoStreamProfile(shape, self._device.lens, kind) for shape in self._device.offered])

    def enable_frame_sync(self) -> None:
        self._device.synchronised = True

    def start(self, config: Config) -> None:
        if self._device.refuses is not None:
            raise self._device.refuses
        self._device.config, self._device.running = config, True

    def stop(self) -> None:
        self._device.running = False

    def wait_for_frames(self, timeout_ms: int) -> Any:
        assert type(timeout_ms) is int
        assert timeout_ms > 0
        if not self._device.sent:
            time.sleep(timeout_ms / 1000)
            return None
        found = self._device.sent.popleft()
        if isinstance(found, Exception):
            raise found
        return found


class DepthFrame:
    def __init__(self, index: int, data: np.ndarray, image_format: OBFormat = OBFormat.Y16, scale: float = 1.0) -> None:
        self.index, self.stamp_us, self.scale = index, 5_000_000 + index * PERIOD_US, scale
        self._data, self._format = data, image_format

    def get_index(self) -> int:
        return self.index

    def get_timestamp_us(self) -> int:
        return self.stamp_us

    def get_depth_scale(self) -> float:
        return self.scale

    def get_format(self) -> OBFormat:
        return self._format

    def get_width(self) -> int:
        return self._data.shape[1]

    def get_height(self) -> int:
        return self._data.shape[0]

    def get_data(self) -> np.ndarray:
        return np.ascontiguousarray(self._data).view(np.uint8).ravel()


class FrameSet:
    def __init__(self, depth: DepthFrame | None, infrared: DepthFrame | None) -> None:
        self.depth, self.infrared = depth, infrared

    def get_depth_frame(self) -> DepthFrame | None:
        return self.depth

    def get_ir_frame(self) -> DepthFrame | None:
        return self.infrared


class FakeSdk(ModuleType):
    """The module, and the cameras that are plugged in."""

    def __init__(self) -> None:
        super().__init__("pyorbbecsdk")
        self.devices = devices = [Device("CL8F0001")]

        class Context:
            def query_devices(self) -> DeviceList:
                return DeviceList(list(devices))

            @staticmethod
            def set_logger_level(level: OBLogLevel) -> None:
                assert level is OBLogLevel.NONE

        self.Context = Context
        for thing in (OBError, OBSensorType, OBFrameAggregateOutputMode, OBLogLevel, Pipeline, Config):
            setattr(self, thing.__name__, thing)

    def get_version(self) -> str:
        return "2.7.6"


@pytest.fixture
def sdk(monkeypatch: pytest.MonkeyPatch) -> FakeSdk:
    module = FakeSdk()
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", module)
    return module


DEPTH = (np.arange(48 * 64, dtype=np.uint16) + 400).reshape(SHAPE)
INFRARED = (np.arange(48 * 64, dtype=np.uint16)[::-1] * 3).reshape(SHAPE)


def frame_set(index: int, *, scale: float = 1.0, **formats: OBFormat) -> FrameSet:
    depth = DepthFrame(index, DEPTH, formats.get("depth", OBFormat.Y16), scale)
    return FrameSet(depth, DepthFrame(index, INFRARED, formats.get("infrared", OBFormat.Y16)))


def make(**settings: Any) -> OrbbecSource:
    return OrbbecSource("tof", OrbbecSettings(**settings), HostClock())


def camera_facts(samples: list[Sample]) -> dict[str, Any]:
    (facts,) = [m for s in samples for m in s.messages if isinstance(m, Facts)]
    assert facts.about == "camera"
    assert json.loads(json.dumps(facts.values, allow_nan=False)) == facts.values
    return dict(facts.values)


def numbered(source: OrbbecSource, device: Device) -> list[Sample]:
    return [s for s in drained(source, device) if s.sequence is not None]


def test_a_frame(sdk: FakeSdk) -> None:
    device = sdk.devices[0]
    source = make()
    assert source.check() == []
    assert not device.running
    source.open()
    assert device.running
    assert device.synchronised
    assert device.config is not None
    assert device.config.mode is OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE
    device.sent.append(frame_set(3, scale=0.5))
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    np.testing.assert_array_equal(frame.depth, DEPTH)
    assert frame.depth.dtype == np.uint16
    assert frame.depth_unit_m == 0.0005
    np.testing.assert_array_equal(frame.amplitude, INFRARED)
    assert frame.confidence.size == 0
    k1, k2, k3, p1, p2 = (STRAIGHT[name] for name in ("k1", "k2", "k3", "p1", "p2"))
    np.testing.assert_array_equal(frame.camera_k, [[60.0, 0, 31.5], [0, 61.0, 23.0], [0, 0, 1]])
    np.testing.assert_array_equal(frame.camera_dist, [k1, k2, p1, p2, k3])  # OpenCV's order
    np.testing.assert_array_equal(frame.amplitude_dist, frame.camera_dist)
    facts = camera_facts(samples)
    assert facts["serial"] == "CL8F0001"
    assert facts["firmware"] == "1.1.2"
    assert facts["profile"] == "64x48@30"
    assert facts["temperatures_c"] == {"cpu": 51.5, "ir": 40.25}
    source.close()
    assert not device.running


def test_the_femtos_lens_is_fitted(sdk: FakeSdk) -> None:
    """Points seen through the SDK's eight coefficients, by OpenCV, lie where the camera of five sees them."""
    device = sdk.devices[0]
    device.lens = FEMTO
    source = make(mode="NFOV_UNBINNED")
    source.open()
    depth = DepthFrame(0, np.full((576, 640), 1000, np.uint16))
    device.sent.append(FrameSet(depth, None))
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    k, dist = frame.camera_k, tuple(frame.camera_dist)
    camera = Camera(640, 576, k[0, 0], k[1, 1], k[0, 2], k[1, 2], dist)
    xy = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 2))
    true_k = np.array([[FEMTO["fx"], 0, FEMTO["cx"]], [0, FEMTO["fy"], FEMTO["cy"]], [0, 0, 1]])
    eight = np.array([FEMTO[name] for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")])
    theirs = cv2.projectPoints(np.insert(xy, 2, 1.0, axis=1), np.zeros(3), np.zeros(3), true_k, eight)[0][:, 0]
    ours = camera.distort(xy) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    assert np.abs(ours - theirs).max() < 0.1
    straight = xy * (FEMTO["fx"], FEMTO["fy"]) + (FEMTO["cx"], FEMTO["cy"])
    assert np.abs(straight - theirs).max() > 10  # what is at stake
    facts = camera_facts(samples)
    assert facts["lens"] == FEMTO
    assert facts["fit_rms_px"] < 0.03
    assert facts["fit_field"] == 1.0
    source.close()


@pytest.mark.parametrize(
    ("settings", "shape"),
    [
        ({}, (64, 48, 30)),
        ({"fps": 5}, (64, 48, 5)),
        ({"fps": 30}, (64, 48, 30)),
        ({"mode": "NFOV_UNBINNED"}, (640, 576, 30)),
        ({"mode": "NFOV_UNBINNED", "fps": 15}, (640, 576, 15)),
        ({"mode": "WFOV_2X2BINNED"}, (512, 512, 30)),
        ({"mode": "WFOV_UNBINNED"}, (1024, 1024, 15)),
        ({"width": 512, "height": 512}, (512, 512, 30)),
    ],
)
def test_the_profile_that_is_asked_for(sdk: FakeSdk, settings: dict[str, Any], shape: tuple[int, int, int]) -> None:
    device = sdk.devices[0]
    for shuffled in (1, -1):
        device.offered = OFFERED[::shuffled]
        source = make(**settings)
        source.open()
        assert device.config is not None
        chosen = [(p.get_width(), p.get_height(), p.get_fps()) for p in device.config.streams]
        assert chosen == [shape, shape]  # depth and infrared
        source.close()


def test_a_mode_that_does_not_exist(sdk: FakeSdk) -> None:
    with pytest.raises(ConfigError, match=r"sources.tof.mode: .*NFOV_2X2BINNED, NFOV_UNBINNED, WFOV_2X2BINNED, "):
        parse_rig({"sources": {"tof": {"kind": "orbbec", "mode": "WIDE"}}})
    with pytest.raises(ConfigError, match="mode NFOV_UNBINNED says the size"):
        make(mode="NFOV_UNBINNED", width=640)
    with pytest.raises(RecordingError, match=r"CL8F0001 has no depth of 320x288@any \(NFOV_2X2BINNED\)") as missing:
        make(mode="NFOV_2X2BINNED").open()
    assert missing.value.hint == "it offers: 1024x1024@15, 512x512@30, 640x576@15, 640x576@30, 64x48@30, 64x48@5, 64x48@60"
    sdk.devices[0].formats[OBSensorType.DEPTH_SENSOR] = OBFormat.RLE
    (line,) = make().check()
    assert line == "camera CL8F0001 has no depth of anyxany@any (it offers: none of 16 bits)"


def test_which_camera(sdk: FakeSdk) -> None:
    with pytest.raises(RecordingError, match="no Orbbec camera 9 is connected") as error:
        make(serial="9").open()
    assert error.value.hint == "connected: CL8F0001"
    sdk.devices.append(Device("CL8F0002", "2-3-9"))
    (line,) = make().check()
    assert line == "2 Orbbec cameras are connected (name one with `serial`: CL8F0001, CL8F0002)"
    source = make(serial="CL8F0002")
    source.open()
    assert [device.running for device in sdk.devices] == [False, True]
    source.close()
    sdk.devices.clear()
    (line,) = make().check()
    assert line.startswith("no Orbbec camera is connected (connect it")


def test_a_camera_without_the_infrared_sensor(sdk: FakeSdk) -> None:
    device = sdk.devices[0]
    del device.formats[OBSensorType.IR_SENSOR]
    with pytest.raises(RecordingError, match="no infrared image of 64x48@30") as error:
        make().open()
    assert error.value.hint == "record without it: infrared: false"
    source = make(infrared=False)
    source.open()
    assert device.config is not None
    assert len(device.config.streams) == 1
    assert not device.synchronised
    device.sent.append(FrameSet(DepthFrame(0, DEPTH, OBFormat.Z16), None))
    (frame,) = frames(list(source.read(0.1)))
    np.testing.assert_array_equal(frame.depth, DEPTH)
    assert frame.amplitude.size == 0
    source.close()


def test_frames_that_are_none_are_counted(sdk: FakeSdk) -> None:
    device = sdk.devices[0]
    source = make()
    source.open()
    short = frame_set(3)
    assert short.depth is not None
    short.depth.get_height = lambda: 50  # type: ignore[method-assign]
    eight = FrameSet(DepthFrame(8, DEPTH), DepthFrame(8, (INFRARED >> 8).astype(np.uint8), OBFormat.Y8))
    device.sent += [
        frame_set(0),
        frame_set(1, depth=OBFormat.RLE),
        frame_set(2, infrared=OBFormat.MJPG),
        short,
        FrameSet(None, DepthFrame(4, INFRARED)),  # never becomes a sample
        frame_set(5, scale=0.0),
        frame_set(6, scale=float("nan")),
        FrameSet(DepthFrame(7, DEPTH), None),
        eight,
        FrameSet(DepthFrame(9, DEPTH), DepthFrame(9, INFRARED[:10])),
    ]
    samples = numbered(source, device)
    assert [s.sequence for s in samples] == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert [len(s.messages) for s in samples] == [1, 0, 0, 0, 0, 0, 1, 1, 0]
    first, without, bytes_ = frames(samples)
    assert first.amplitude.shape == SHAPE
    assert without.amplitude.size == 0
    np.testing.assert_array_equal(bytes_.amplitude, INFRARED >> 8)
    assert (source.counts.malformed, source.counts.lost) == (7, 1)
    source.close()


def test_losses_and_the_clock(sdk: FakeSdk) -> None:
    """The index tells what was lost; a time stamp that wraps after 2**32 µs goes on, and 0 is none."""
    device = sdk.devices[0]
    source = make()
    source.open()
    sent = [frame_set(index) for index in (10, 11, 14, 15)]
    for frame, stamp in zip(sent, (2**32 - 40_000, 2**32 - 6_667, 93_333, 0), strict=True):
        assert frame.depth is not None
        frame.depth.stamp_us = stamp
    device.sent += sent
    samples = numbered(source, device)
    assert [s.sequence for s in samples] == [0, 1, 4, 5]
    assert source.counts.lost == 2
    expected = [2**32 - 40_000, 2**32 - 6_667, 2**32 + 93_333]
    assert [s.device_ns for s in samples] == [*(stamp * 1000 for stamp in expected), None]
    late, restarted = frame_set(16), frame_set(0)  # the camera is set back: no loss, and no wrap
    assert late.depth is not None
    late.depth.stamp_us = 2_000_000_000
    device.sent += [late, restarted]
    stamps = [(s.sequence, s.device_ns) for s in numbered(source, device)]
    assert stamps == [(6, (2**32 + 2_000_000_000) * 1000), (7, 5_000_000_000)]
    assert source.counts.lost == 2
    assert source.counts.restarts == 1
    source.close()


@pytest.mark.parametrize("how", ["error", "pybind11's error", "gone", "came back meanwhile"])
def test_a_camera_that_is_pulled_out_is_reached_again(sdk: FakeSdk, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    monkeypatch.setattr("cabinpose.record.sources.tof.polled._QUIET_S", 0.02)
    source = make(reconnect_s=0.01)
    source.open()
    device = sdk.devices.pop()
    first = frame_set(7)
    assert first.depth is not None
    first.depth.stamp_us = 2**32 - 5
    device.sent.append(first)
    assert len(frames(list(source.read(0.01)))) == 1
    if "error" in how:
        device.sent.append(OBError("device disconnected") if how == "error" else RuntimeError("device disconnected"))
    sdk.devices.append(Device("CL8F0099", "2-9-1"))  # another one takes its place, and is not meant
    for _ in range(10 if how != "came back meanwhile" else 0):
        assert frames(list(source.read(0.01))) == []
    assert source.counts.restarts == 0
    again = Device("CL8F0001", "2-1-8")  # plugged in again, it has another address
    sdk.devices.append(again)
    for _ in range(100):
        source.read(0.01)
        if again.running:
            break
    assert source.counts.restarts == 1
    assert not device.running
    again.sent.append(frame_set(0))
    (sample,) = numbered(source, again)
    assert sample.sequence == 1
    assert sample.device_ns == 5_000_000_000
    assert source.counts.lost == 0
    source.close()
    source.close()


def test_a_camera_that_waits_for_a_trigger_is_not_restarted(sdk: FakeSdk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.record.sources.tof.polled._QUIET_S", 0.01)
    source = make(reconnect_s=0.001)
    source.open()
    for _ in range(10):
        source.read(0.01)
    assert source.counts.restarts == 0
    source.close()


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, sdk: FakeSdk) -> None:
    device = sdk.devices[0]
    for refusal in (OBError("open failed: access denied"), RuntimeError("Device is occupied")):
        device.refuses = refusal
        with pytest.raises(RecordingError, match=f"camera CL8F0001: {refusal}") as error:
            make().open()
        assert "udev" in str(error.value.hint)
    device.refuses = None
    for lens in (STRAIGHT | {"fx": 0.0}, FEMTO | {"k4": float("nan")}, FEMTO | {"k1": -1e9}):
        device.lens = lens
        with pytest.raises(RecordingError, match="no intrinsics for 64x48@30") as error:
            make().open()
        assert "`lens`" in str(error.value.hint)
    own = make(lens={"fx": 50.0, "fy": 50.0, "cx": 30.0, "cy": 20.0})
    own.open()
    device.sent.append(frame_set(0))
    (frame,) = frames(list(own.read(0.1)))
    assert frame.camera_k[0, 0] == 50.0
    own.close()
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    with pytest.raises(DependencyError, match="pyorbbecsdk") as missing:
        make().open()
    assert missing.value.hint == "pip install 'cabinpose[orbbec]'"
    assert "cabinpose[orbbec]" in make().check()[0]


# ------------------------------------------------------------------------------------------------ against the real package
STAND_INS = (
    VideoStreamProfile, StreamProfileList, DeviceInfo, Device, DeviceList, Config, Pipeline, DepthFrame, FrameSet,
    FakeSdk().Context,
)  # fmt: skip


def arguments(documentation: str, name: str) -> list[int]:
    """How many arguments each overload of a function of pybind11 takes, without self."""
    found = re.findall(rf"^(?:\d+\. )?{name}\((.*)\) -> ", documentation, re.MULTILINE)
    return [len(re.findall(r"(?:^|, )\w+: ", text)) - text.startswith("self: ") for text in found]


@pytest.mark.parametrize("stand_in", STAND_INS, ids=lambda c: c.__name__)
def test_the_stand_in_is_as_the_sdk(stand_in: type) -> None:
    real = getattr(pytest.importorskip("pyorbbecsdk"), stand_in.__name__)
    for name, method in vars(stand_in).items():
        if not name.startswith("_"):
            documented = getattr(real, name).__doc__
            taken = (method.__func__ if isinstance(method, staticmethod) else method).__code__.co_argcount
            wanted = taken - (not isinstance(method, staticmethod))
            assert any(wanted <= count for count in arguments(documented, name)), documented


def test_the_names_of_the_sdk() -> None:
    real = pytest.importorskip("pyorbbecsdk")
    assert issubclass(real.OBError, Exception)
    assert callable(real.get_version)
    for own in (OBFormat, OBSensorType, OBFrameAggregateOutputMode, OBLogLevel):
        assert {getattr(getattr(real, own.__name__), member.name).name for member in own} == {member.name for member in own}
    for own, names in ((OBCameraIntrinsic, "fx fy cx cy width height"), (OBCameraDistortion, "k1 k2 k3 k4 k5 k6 p1 p2")):
        values = getattr(real, own.__name__)()
        assert {getattr(values, name) for name in names.split()} == {0}
    assert hasattr(real.OBDeviceTemperature(), "ir_temperature")


def test_the_sdk_without_a_camera_says_so_and_keeps_quiet(tmp_path: Any) -> None:
    """Its import writes on stdout, its context makes a folder for logs."""
    pytest.importorskip("pyorbbecsdk")
    check_quiet_without_a_camera("orbbec", "Orbbec", "Orbbec", tmp_path)
    assert list(tmp_path.iterdir()) == []
