"""RealSense cameras through a stand-in for `pyrealsense2`; where that is installed, through it and its software device."""

from __future__ import annotations

import json
import sys
import time
from collections import deque
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from camera_samples import check_reached_again, drained, frames

from cabinpose.core.camera import Camera
from cabinpose.core.errors import DependencyError, RecordingError
from cabinpose.record.sources.tof.realsense import RealsenseSettings, RealsenseSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample

SHAPE = (48, 64)
DEPTH = (np.arange(48 * 64, dtype=np.uint16) + 400).reshape(SHAPE)
INFRARED = (np.arange(48 * 64) % 251).astype(np.uint8).reshape(SHAPE)
DEFAULT = (64, 48, 30)
OFFERED = [(848, 480, 90), DEFAULT, (64, 48, 90), (64, 48, 6), (848, 480, 30)]

stream = Enum("stream", "depth infrared color")
format = Enum("format", "z16 y8 y16 rgb8")  # noqa: A001 - the SDK's name
option = Enum("option", "global_time_enabled emitter_enabled")
distortion = Enum("distortion", "none modified_brown_conrady inverse_brown_conrady brown_conrady kannala_brandt4")
timestamp_domain = Enum("timestamp_domain", "hardware_clock system_time global_time")
camera_info = Enum("camera_info", "name serial_number firmware_version usb_type_descriptor")


class intrinsics(SimpleNamespace):  # noqa: N801 - the SDK's names, here and below
    width, height, fx, fy, ppx, ppy = 64, 48, 60.0, 61.0, 31.5, 23.0
    model = distortion.brown_conrady
    coeffs = (-0.2, 0.05, 0.001, -0.001, 0.01)


class stream_profile:  # noqa: N801
    def __init__(self, kind: stream, index: int, shape: tuple[int, int, int], pixels: format, lens: Any = None) -> None:
        self._kind, self._index, self._shape, self._pixels, self._lens = kind, index, shape, pixels, lens

    def stream_type(self) -> stream:
        return self._kind

    def stream_index(self) -> int:
        return self._index

    def format(self) -> format:
        return self._pixels

    def fps(self) -> int:
        return self._shape[2]

    def is_default(self) -> bool:
        return self._shape == DEFAULT

    def as_video_stream_profile(self) -> video_stream_profile:
        return video_stream_profile(self._shape, self._lens)


class video_stream_profile:  # noqa: N801
    def __init__(self, shape: tuple[int, int, int], lens: Any) -> None:
        self._shape, self._lens = shape, lens

    def width(self) -> int:
        return self._shape[0]

    def height(self) -> int:
        return self._shape[1]

    def get_intrinsics(self) -> intrinsics:
        return self._lens


class depth_sensor:  # noqa: N801
    def __init__(self, device: device) -> None:
        self._device = device

    def supports(self, what: option) -> bool:
        return what in self._device.options

    def set_option(self, what: option, value: float) -> None:
        self._device.options[what] = value

    def get_depth_scale(self) -> float:
        return float(np.float32(0.001))

    def get_stream_profiles(self) -> list[stream_profile]:
        found = [stream_profile(stream.depth, 0, shape, format.z16) for shape in self._device.offered]
        for index in self._device.infrared:
            found += [stream_profile(stream.infrared, index, shape, format.y8) for shape in self._device.offered]
            found.append(stream_profile(stream.infrared, index, DEFAULT, format.y16))
        return [*found, stream_profile(stream.color, 0, DEFAULT, format.rgb8)]


class device:  # noqa: N801
    """A camera; the attributes say how it behaves."""

    def __init__(self, serial: str) -> None:
        self.serial = serial
        self.offered, self.infrared = list(OFFERED), [2, 1]
        self.options = {option.global_time_enabled: 1.0}
        self.lens: Any = intrinsics()
        self.sent: deque[Any] = deque()  # frame sets, None for a time-out, or what is raised
        self.refuses: Exception | None = None
        self.config: config | None = None
        self.running, self.plugged = False, True

    def get_info(self, what: camera_info) -> str:
        return {camera_info.name: "RealSense D435I", camera_info.serial_number: self.serial}[what]

    def supports(self, what: camera_info) -> bool:
        return what in (camera_info.name, camera_info.serial_number)

    def first_depth_sensor(self) -> depth_sensor:
        if not self.offered:
            raise RuntimeError("Could not find requested sensor type!")
        return depth_sensor(self)

    def is_connected(self) -> bool:
        return self.plugged


class config:  # noqa: N801
    def __init__(self) -> None:
        self.streams: list[tuple[Any, ...]] = []

    def enable_stream(
        self, kind: stream, index: int, width: int, height: int, pixels: format, fps: int
    ) -> None:  # as the SDK's longest overload
        self.streams.append((kind, index, width, height, pixels, fps))


class pipeline_profile:  # noqa: N801
    def __init__(self, device: device) -> None:
        self._device = device

    def get_stream(self, kind: stream) -> stream_profile:
        return stream_profile(kind, 0, DEFAULT, format.z16, self._device.lens)


class pipeline:  # noqa: N801
    def __init__(self, context: Any) -> None:
        del context

    def set_device(self, device: device) -> None:
        self._device = device

    def start(self, config: config) -> pipeline_profile:
        if self._device.refuses is not None:
            raise self._device.refuses
        self._device.config, self._device.running = config, True
        return pipeline_profile(self._device)

    def stop(self) -> None:
        if not self._device.plugged:
            raise RuntimeError("stop() cannot be called: No such device")
        self._device.running = False

    def try_wait_for_frames(self, timeout_ms: int) -> tuple[bool, Any]:
        assert type(timeout_ms) is int
        assert timeout_ms > 0
        found = self._device.sent.popleft() if self._device.sent else None
        if isinstance(found, Exception):
            raise found
        if found is None:
            time.sleep(timeout_ms / 1000)
        return found is not None, found


class video_frame:  # noqa: N801
    def __init__(self, number: int, data: np.ndarray | None) -> None:
        self._number, self._data = number, data
        self.stamp_ms, self.domain, self.units = 5000.0 + number * 33.333, timestamp_domain.hardware_clock, 0.001

    def __bool__(self) -> bool:
        return self._data is not None

    def get_frame_number(self) -> int:
        return self._number

    def get_timestamp(self) -> float:
        return self.stamp_ms

    def get_frame_timestamp_domain(self) -> timestamp_domain:
        return self.domain

    def get_data(self) -> np.ndarray:
        assert self._data is not None
        return self._data


class depth_frame(video_frame):  # noqa: N801
    def get_units(self) -> float:
        return float(np.float32(self.units))


class composite_frame:  # noqa: N801
    def __init__(self, depth: depth_frame, infrared: video_frame) -> None:
        self.depth, self._infrared = depth, infrared

    def get_depth_frame(self) -> depth_frame:
        return self.depth

    def get_infrared_frame(self, index: int) -> video_frame:
        assert index == 1
        return self._infrared


def rs2_deproject_pixel_to_point(lens: intrinsics, pixel: list[float], depth: float) -> list[float]:
    """The inverse model of Brown and Conrady: the polynomial takes distorted coordinates to ideal ones."""
    assert lens.model is distortion.inverse_brown_conrady
    x, y = (pixel[0] - lens.ppx) / lens.fx, (pixel[1] - lens.ppy) / lens.fy
    k1, k2, p1, p2, k3 = lens.coeffs
    r2 = x * x + y * y
    f = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    point = x * f + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * f + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
    return [depth * point[0], depth * point[1], depth]


class FakeSdk(ModuleType):
    """The module, and the cameras that are plugged in."""

    __version__ = "2.59.1"

    def __init__(self) -> None:
        super().__init__("pyrealsense2")
        self.devices = devices = [device("0123")]

        class context:  # noqa: N801
            def query_devices(self) -> list[device]:
                return list(devices)

        self.context = context
        for thing in (stream, format, option, distortion, timestamp_domain, camera_info, config, pipeline):
            setattr(self, thing.__name__, thing)
        self.rs2_deproject_pixel_to_point = rs2_deproject_pixel_to_point


@pytest.fixture
def sdk(monkeypatch: pytest.MonkeyPatch) -> FakeSdk:
    module = FakeSdk()
    monkeypatch.setitem(sys.modules, "pyrealsense2", module)
    return module


def frame_set(number: int, depth: np.ndarray | None = DEPTH, infrared: np.ndarray | None = INFRARED) -> composite_frame:
    return composite_frame(depth_frame(number, depth), video_frame(number, infrared))


def make(**settings: Any) -> RealsenseSource:
    return RealsenseSource("tof", RealsenseSettings(**settings), HostClock())


def test_a_frame(sdk: FakeSdk) -> None:
    """Depth in the sensor's unit, OpenCV's coefficients, infrared as amplitude, stamps of the camera's clock."""
    camera = sdk.devices[0]
    source = make()
    assert source.check() == []
    assert not camera.running
    source.open()
    assert camera.options[option.global_time_enabled] == 0.0
    assert camera.config is not None
    assert camera.config.streams == [
        (stream.depth, -1, 64, 48, format.z16, 30),
        (stream.infrared, 1, 64, 48, format.y8, 30),
    ]
    camera.sent.append(frame_set(3))
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    np.testing.assert_array_equal(frame.depth, DEPTH)
    np.testing.assert_array_equal(frame.amplitude, INFRARED)
    assert frame.depth_unit_m == 0.001
    np.testing.assert_array_equal(frame.camera_k, [[60.0, 0, 31.5], [0, 61.0, 23.0], [0, 0, 1]])
    np.testing.assert_array_equal(frame.camera_dist, intrinsics.coeffs)
    assert [s.device_ns for s in samples if s.sequence is not None] == [5_099_999_000]
    (facts,) = [m for s in samples for m in s.messages if isinstance(m, Facts)]
    assert json.loads(json.dumps(facts.values)) == facts.values
    assert facts.values["unit_m"] == 0.001
    assert facts.values["amplitude"] == "infrared 1"
    assert facts.values["lens"]["model"] == "brown_conrady"
    assert facts.values["firmware"] == ""  # it does not tell
    source.close()
    assert not camera.running


def test_another_lens_is_fitted(sdk: FakeSdk) -> None:
    """Pixels of the fitted camera lie where the SDK's model has them."""
    camera = sdk.devices[0]
    camera.lens = intrinsics(model=distortion.inverse_brown_conrady, coeffs=(0.1, 0.02, 1e-3, -1e-3, 0.0))
    source = make()
    source.open()
    camera.sent.append(frame_set(0))
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    k = frame.camera_k
    fitted = Camera(64, 48, k[0, 0], k[1, 1], k[0, 2], k[1, 2], tuple(frame.camera_dist))
    for pixel in ([2.0, 3.0], [60.0, 40.0], [31.0, 46.0]):
        ray = np.array(rs2_deproject_pixel_to_point(camera.lens, pixel, 1.0)[:2])
        seen = fitted.distort(ray) * (fitted.fx, fitted.fy) + (fitted.cx, fitted.cy)
        assert np.abs(seen - pixel).max() < 0.05
        assert np.abs(ray * (60.0, 61.0) + (31.5, 23.0) - pixel).max() > 0.2  # what is at stake
    (facts,) = [m for s in samples for m in s.messages if isinstance(m, Facts)]
    assert facts.values["fit_max_px"] < 0.05
    camera.lens = intrinsics(model=distortion.none)
    plain = make()
    plain.open()
    camera.sent.append(frame_set(0))
    assert not frames(list(plain.read(0.1)))[0].camera_dist.any()


@pytest.mark.parametrize(
    ("settings", "shape"),
    [
        ({}, DEFAULT),
        ({"fps": 90}, (64, 48, 90)),
        ({"width": 848}, (848, 480, 30)),
        ({"height": 480, "fps": 90}, (848, 480, 90)),
    ],
)
def test_the_size_that_is_asked_for(sdk: FakeSdk, settings: dict[str, Any], shape: tuple[int, int, int]) -> None:
    source = make(**settings, lens={"fx": 60.0, "fy": 60.0, "cx": 31.0, "cy": 23.0})
    source.open()
    chosen = sdk.devices[0].config
    assert chosen is not None
    assert {(*s[2:4], s[5]) for s in chosen.streams} == {shape}
    source.close()


def test_a_camera_without_infrared(sdk: FakeSdk) -> None:
    camera = sdk.devices[0]
    camera.infrared = []
    with pytest.raises(RecordingError, match="no infrared image of 64x48@30") as error:
        make().open()
    assert error.value.hint == "record without it: infrared: false"
    source = make(infrared=False)
    source.open()
    camera.sent.append(frame_set(0, infrared=None))
    samples = list(source.read(0.1))
    assert frames(samples)[0].amplitude.size == 0
    assert [m.values["amplitude"] for s in samples for m in s.messages if isinstance(m, Facts)] == ["none"]


def test_losses_stamps_and_what_is_no_frame(sdk: FakeSdk) -> None:
    """Gaps are counted, the 32 bits of the clock's µs unwrapped; stamps of the host's clock are none of the camera's."""
    camera = sdk.devices[0]
    source = make()
    source.open()
    sent = [frame_set(number) for number in (10, 11, 14, 15, 16)]
    for frames_, stamp_us in zip(sent, (2**32 - 40_000, 2**32 - 6_667, 93_333, 0, 0), strict=True):
        frames_.depth.stamp_ms = stamp_us / 1000
    sent[3].depth.domain = timestamp_domain.system_time
    sent[4].depth.domain = timestamp_domain.global_time
    wrong = frame_set(19)
    wrong.depth.units = 0.0
    camera.sent += [*sent, frame_set(17, None), frame_set(18, DEPTH.astype(np.float32)), wrong, frame_set(20, DEPTH[:10])]
    samples = [s for s in drained(source, camera) if s.sequence is not None]
    assert [s.sequence for s in samples] == [0, 1, 4, 5, 6, 8, 9, 10]
    assert [s.device_ns for s in samples][:5] == [
        *((2**32 + us) * 1000 for us in (-40_000, -6_667, 93_333)), None, None,
    ]  # fmt: skip
    assert len(frames(samples)) == 5
    assert (source.counts.malformed, source.counts.lost) == (4, 3)


@pytest.mark.parametrize("how", ["error", "gone"])
def test_a_camera_that_is_pulled_out_is_reached_again(sdk: FakeSdk, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    monkeypatch.setattr("cabinpose.record.sources.tof.polled._QUIET_S", 0.02)
    source = make(reconnect_s=0.01)
    source.open()
    old = sdk.devices.pop()
    old.sent.append(frame_set(7))
    assert len(frames(list(source.read(0.01)))) == 1
    old.plugged = False
    if how == "error":
        old.sent.append(RuntimeError("Device disconnected"))
    check_reached_again(source, sdk.devices, device, "0123", frame_set(0))


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, sdk: FakeSdk) -> None:
    camera = sdk.devices[0]
    with pytest.raises(RecordingError, match="camera 0123 has no depth of 320xany@any") as error:
        make(width=320).open()
    assert error.value.hint == "it offers: 64x48@30, 64x48@6, 64x48@90, 848x480@30, 848x480@90"
    for lens in (intrinsics(fx=0.0), intrinsics(ppx=float("nan")), intrinsics(width=32)):
        camera.lens = lens
        with pytest.raises(RecordingError, match="no intrinsics for 64x48@30") as error:
            make().open()
        assert error.value.hint == "state them with `lens`"
        assert not camera.running
    camera.refuses = RuntimeError("xioctl(VIDIOC_S_FMT) failed, errno=16")
    with pytest.raises(RecordingError, match="camera 0123: xioctl") as error:
        make().open()
    assert "udev" in str(error.value.hint)
    camera.offered = []
    assert make().check()[0].startswith("camera 0123: Could not find requested sensor type!")
    sdk.devices.append(device("0456"))
    assert make().check() == ["2 RealSense cameras are connected (name one with `serial`: 0123, 0456)"]
    assert make(serial="7").check() == ["no RealSense camera 7 is connected (connected: 0123, 0456)"]
    sdk.devices.clear()
    assert make().check()[0].startswith("no RealSense camera is connected (connect it to a port of USB 3")
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(DependencyError, match="a RealSense camera needs the Python package pyrealsense2") as missing:
        make().open()
    assert "cabinpose[realsense]" in str(missing.value.hint)


# ------------------------------------------------------------------------------------------------ against the real package
def real_sdk() -> Any:
    return pytest.importorskip("pyrealsense2", exc_type=ImportError)  # it is there, and libusb is not


@pytest.mark.parametrize(
    "stand_in",
    [
        stream_profile,
        video_stream_profile,
        depth_sensor,
        device,
        config,
        pipeline,
        pipeline_profile,
        depth_frame,
        composite_frame,
    ],
    ids=lambda c: c.__name__,
)
def test_the_stand_in_is_as_the_sdk(stand_in: type) -> None:
    real = getattr(real_sdk(), stand_in.__name__)
    assert [name for name in vars(stand_in) if not name.startswith("_") and not hasattr(real, name)] == []


def test_the_names_of_the_sdk() -> None:
    real = real_sdk()
    for own in (stream, format, option, distortion, timestamp_domain, camera_info):
        assert {member.name for member in own} <= set(getattr(real, own.__name__).__members__)


@pytest.mark.parametrize("model", ["brown_conrady", "inverse_brown_conrady", "kannala_brandt4"])
def test_a_software_device_of_the_sdk(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    """Frames through the SDK's own pipeline; its points lie where OpenCV has them through the camera that is recorded."""
    rs = real_sdk()
    camera = rs.software_device()
    for info, text in ((rs.camera_info.serial_number, "0123"), (rs.camera_info.name, "RealSense D435I")):
        camera.register_info(info, text)
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = 64, 48, 60.0, 61.0, 31.5, 23.0
    lens.model, lens.coeffs = getattr(rs.distortion, model), [-0.1, 0.02, 1e-3, -1e-3, 0.0]
    sensor = camera.add_sensor("Stereo Module")
    images = ((rs.stream.depth, 0, rs.format.z16, DEPTH), (rs.stream.infrared, 1, rs.format.y8, INFRARED))
    profiles = []
    for uid, (kind, index, pixels, image) in enumerate(images):
        video = rs.video_stream()
        video.type, video.index, video.uid, video.fmt, video.bpp = kind, index, uid, pixels, image.itemsize
        video.width, video.height, video.fps, video.intrinsics = 64, 48, 30, lens
        profiles.append(sensor.add_video_stream(video, True).as_video_stream_profile())
    sensor.add_read_only_option(rs.option.depth_units, 0.001)
    camera.create_matcher(rs.matchers.default)
    monkeypatch.setattr(rs.context, "query_devices", lambda self: [camera])
    source = make()
    source.open()
    samples: list[Sample] = []
    for number in (4, 5):
        for profile, (*_, image) in zip(profiles, images, strict=True):
            sent = rs.software_video_frame()
            sent.pixels, sent.stride, sent.bpp, sent.profile = image, 64 * image.itemsize, image.itemsize, profile
            sent.timestamp, sent.domain, sent.frame_number = 100.0 * number, rs.timestamp_domain.hardware_clock, number
            if image is DEPTH:
                sent.depth_units = 0.001
            sensor.on_video_frame(sent)
        samples += source.read(2.0)
    assert [(s.sequence, s.device_ns) for s in samples if s.sequence is not None] == [(0, 400_000_000), (1, 500_000_000)]
    for frame in frames(samples):
        np.testing.assert_array_equal(frame.depth, DEPTH)
        np.testing.assert_array_equal(frame.amplitude, INFRARED)
        assert frame.depth_unit_m == 0.001
        for pixel in ([3.0, 4.0], [60.0, 40.0], [31.0, 24.0]):
            point = np.array(rs.rs2_deproject_pixel_to_point(lens, pixel, 1.0))
            seen = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), frame.camera_k, frame.camera_dist)[0][0, 0]
            assert np.abs(seen - pixel).max() < 0.05
    source.close()
