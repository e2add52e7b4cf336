"""OAK cameras through a stand-in for `depthai`, which is held against the real package where that is installed."""

from __future__ import annotations

import json
import sys
import time
from collections import deque
from datetime import timedelta
from enum import Enum
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from camera_samples import check_quiet_without_a_camera, check_reached_again, drained, frames

from cabinpose.core.errors import ConfigError, DependencyError, RecordingError
from cabinpose.record.sources.tof.oak import OakSettings, OakSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample

SHAPE = (48, 64)
DEPTH = (np.arange(48 * 64, dtype=np.uint16) + 400).reshape(SHAPE)
LEFT = (np.arange(48 * 64) % 251).astype(np.uint8).reshape(SHAPE)
K = [[60.0, 0.0, 31.5], [0.0, 61.0, 23.0], [0.0, 0.0, 1.0]]

CameraSensorType = Enum("CameraSensorType", "COLOR MONO TOF")
CameraModel = Enum("CameraModel", "Perspective Fisheye")
DepthAlign = Enum("DepthAlign", "RECTIFIED_LEFT RECTIFIED_RIGHT")
LengthUnit = Enum("LengthUnit", "MILLIMETER METER")


class QueueException(Exception):  # noqa: N818 - depthai's name; no RuntimeError
    """What a queue raises that was closed."""


class ImgTransformation:
    def __init__(self, model: CameraModel, values: list[float], valid: bool) -> None:
        self._model, self._values, self._valid = model, values, valid

    def getIntrinsicMatrix(self) -> list[list[float]]:  # noqa: N802 - depthai's names, here and below
        return K

    def getDistortionModel(self) -> CameraModel:  # noqa: N802
        return self._model

    def getDistortionCoefficients(self) -> list[float]:  # noqa: N802
        return self._values

    def isValid(self) -> bool:  # noqa: N802
        return self._valid


class ImgFrame:
    def __init__(self, number: int, pixels: np.ndarray, seen: ImgTransformation) -> None:
        self._number, self._pixels, self._seen = number, pixels, seen
        self.stamp = timedelta(hours=2, microseconds=number * 33_333 + 7)

    def getSequenceNum(self) -> int:  # noqa: N802
        return self._number

    def getTimestampDevice(self) -> timedelta:  # noqa: N802
        return self.stamp

    def getFrame(self) -> np.ndarray:  # noqa: N802
        return self._pixels

    def getWidth(self) -> int:  # noqa: N802
        return self._pixels.shape[1]

    def getHeight(self) -> int:  # noqa: N802
        return self._pixels.shape[0]

    def getTransformation(self) -> ImgTransformation:  # noqa: N802
        return self._seen


class MessageQueue:
    def __init__(self, device: Device) -> None:
        self._device = device

    def get(self, timeout: timedelta) -> Any:
        assert timeout > timedelta()
        if self._device.sent:
            found = self._device.sent.popleft()
            if isinstance(found, Exception):
                raise found
            return found
        time.sleep(timeout.total_seconds())
        return None


class Output:
    def __init__(self, name: str, device: Device) -> None:
        self.name, self._device = name, device

    def link(self, other: str) -> None:
        self._device.links[other] = self.name

    def createOutputQueue(self, maxSize: int, blocking: bool) -> MessageQueue:  # noqa: N802
        assert maxSize == 8
        assert not blocking
        self._device.asked = self.name
        return MessageQueue(self._device)


class StereoDepthConfig:
    AlgorithmControl = SimpleNamespace(DepthAlign=DepthAlign)

    def __init__(self) -> None:
        self.postProcessing = SimpleNamespace(decimationFilter=SimpleNamespace(decimationFactor=2))

    def setDepthUnit(self, unit: LengthUnit) -> None:  # noqa: N802
        self.unit = unit


class StereoDepth:
    def __init__(self, device: Device) -> None:
        self._device = device
        self.initialConfig = StereoDepthConfig()
        self.depth, self.rectifiedLeft = Output("stereo.depth", device), Output("stereo.left", device)

    def build(self, autoCreateCameras: bool, size: tuple[int, int], fps: float | None) -> StereoDepth:
        assert autoCreateCameras
        self._device.built = {"size": size, "fps": fps}
        return self

    def setDepthAlign(self, align: DepthAlign) -> None:  # noqa: N802
        self._device.aligned = align


class ToF:
    def __init__(self, device: Device) -> None:
        self._device = device
        self.depth, self.amplitude = Output("tof.depth", device), Output("tof.amplitude", device)

    def build(self, boardSocket: str, fps: float | None) -> ToF:
        self._device.built = {"socket": boardSocket, "fps": fps}
        return self


class Sync:
    def __init__(self, device: Device) -> None:
        self.inputs = {"depth": "depth", "infrared": "infrared"}
        self.out = Output("sync", device)


class DeviceInfo:
    def __init__(self, device: Device) -> None:
        self.device = device

    def getDeviceId(self) -> str:  # noqa: N802
        return self.device.serial


class Device:
    """A camera; the attributes say how it behaves."""

    def __init__(self, serial: str) -> None:
        self.serial = serial
        self.sensors = [("CAM_B", [CameraSensorType.MONO]), ("CAM_C", [CameraSensorType.MONO])]
        self.drivers: list[tuple[str, int, int]] = [("LM3644", 2, 0x63)]
        self.sent: deque[Any] = deque()  # messages, None for a time-out, or what is raised
        self.refuses: Exception | None = None
        self.links: dict[str, str] = {}
        self.lights: dict[str, float] = {}
        self.built: dict[str, Any] = {}
        self.nodes: list[Any] = []
        self.asked = ""
        self.aligned: DepthAlign | None = None
        self.running, self.closed = False, False

    def getConnectedCameraFeatures(self) -> list[SimpleNamespace]:  # noqa: N802
        return [SimpleNamespace(socket=socket, supportedTypes=types) for socket, types in self.sensors]

    def getIrDrivers(self) -> list[tuple[str, int, int]]:  # noqa: N802
        return self.drivers

    def getDeviceName(self) -> str:  # noqa: N802
        return "OAK-D-PRO"

    def getPlatformAsString(self) -> str:  # noqa: N802
        return "RVC2"

    def setIrFloodLightIntensity(self, value: float) -> bool:  # noqa: N802
        self.lights["flood"] = value
        return bool(self.drivers)

    def setIrLaserDotProjectorIntensity(self, value: float) -> bool:  # noqa: N802
        self.lights["dots"] = value
        return bool(self.drivers)

    def isClosed(self) -> bool:  # noqa: N802
        return self.closed

    def close(self) -> None:
        self.closed = True


class Pipeline:
    def __init__(self, device: Device) -> None:
        self._device = device

    def create(self, node: type) -> Any:
        self._device.nodes.append(node(self._device))
        return self._device.nodes[-1]

    def start(self) -> None:
        if self._device.refuses is not None:
            raise self._device.refuses
        self._device.running = True

    def isRunning(self) -> bool:  # noqa: N802
        return self._device.running

    def stop(self) -> None:
        self._device.running = False


class FakeSdk(ModuleType):
    """The module, and the cameras that are connected."""

    __version__ = "3.12.0"

    def __init__(self) -> None:
        super().__init__("depthai")
        self.devices = devices = [Device("14442C10")]

        class Opened:
            @staticmethod
            def getAllAvailableDevices() -> list[DeviceInfo]:  # noqa: N802
                return [DeviceInfo(device) for device in devices]

            def __new__(cls, info: DeviceInfo) -> Any:
                info.device.closed = False
                return info.device

        self.Device = Opened
        self.MessageQueue = SimpleNamespace(QueueException=QueueException)
        self.node = SimpleNamespace(StereoDepth=StereoDepth, ToF=ToF, Sync=Sync)
        for thing in (CameraSensorType, LengthUnit, Pipeline, StereoDepthConfig):
            setattr(self, thing.__name__, thing)


@pytest.fixture
def sdk(monkeypatch: pytest.MonkeyPatch) -> FakeSdk:
    module = FakeSdk()
    monkeypatch.setitem(sys.modules, "depthai", module)
    monkeypatch.setenv("DEPTHAI_LEVEL", "off")  # the source sets it, for good
    return module


def images(
    number: int, depth: np.ndarray = DEPTH, *, model: CameraModel = CameraModel.Perspective, dist: Any = (), valid: bool = True
) -> dict[str, ImgFrame]:
    seen = ImgTransformation(model, list(dist), valid)
    return {"depth": ImgFrame(number, depth, seen), "infrared": ImgFrame(number, LEFT, seen)}


def make(**settings: Any) -> OakSource:
    return OakSource("tof", OakSettings(**settings), HostClock())


def facts(samples: list[Sample], about: str) -> dict[str, Any]:
    (found,) = [m for s in samples for m in s.messages if isinstance(m, Facts) and m.about == about]
    assert json.loads(json.dumps(found.values, allow_nan=False)) == found.values
    return dict(found.values)


def test_a_frame_of_a_stereo_camera(sdk: FakeSdk) -> None:
    """Depth in mm of the rectified left image's pixels, which is the amplitude; stamps of the camera's clock."""
    camera = sdk.devices[0]
    source = make(width=640, height=480, fps=20.0, flood_light=0.5, dot_projector=0.0)
    assert source.check() == []
    source.open()
    assert (camera.built, camera.aligned) == ({"size": (640, 480), "fps": 20.0}, DepthAlign.RECTIFIED_LEFT)
    assert camera.links == {"depth": "stereo.depth", "infrared": "stereo.left"}
    assert camera.asked == "sync"
    assert camera.lights == {"flood": 0.5, "dots": 0.0}
    config = camera.nodes[0].initialConfig
    assert config.unit is LengthUnit.MILLIMETER
    assert config.postProcessing.decimationFilter.decimationFactor == 1
    camera.sent.append(images(3))
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    np.testing.assert_array_equal(frame.depth, DEPTH)
    np.testing.assert_array_equal(frame.amplitude, LEFT)
    assert frame.depth_unit_m == 0.001
    np.testing.assert_array_equal(frame.camera_k, K)
    assert not frame.camera_dist.any()
    assert [s.device_ns for s in samples if s.sequence is not None] == [7_200_100_006_000]
    told = facts(samples, "camera")
    assert (told["model"], told["depth"], told["unit_m"]) == ("OAK-D-PRO", "stereo", 0.001)
    assert (told["amplitude"], told["infrared_lights"]) == ("rectified left image", True)
    source.close()
    assert camera.closed
    assert not camera.running


def test_a_tof_camera(sdk: FakeSdk) -> None:
    """Its amplitude; its lens' eight coefficients are fitted: points lie where OpenCV sees them through the eight."""
    camera = sdk.devices[0]
    camera.sensors.append(("CAM_A", [CameraSensorType.TOF]))
    eight = (0.3, -0.02, 1e-3, -7e-4, 0.002, 0.5, 0.03, -0.01)
    source = make()
    source.open()
    assert camera.built == {"socket": "CAM_A", "fps": None}
    assert camera.links == {"depth": "tof.depth", "infrared": "tof.amplitude"}
    camera.sent.append(images(0, dist=eight))
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    points = np.insert(np.random.default_rng(0).uniform(-0.35, 0.35, (100, 2)), 2, 1.0, axis=1)
    still = np.zeros(3)
    theirs = cv2.projectPoints(points, still, still, np.array(K), np.array(eight))[0]
    ours = cv2.projectPoints(points, still, still, frame.camera_k, frame.camera_dist)[0]
    straight = cv2.projectPoints(points, still, still, np.array(K), None)[0]
    assert np.abs(ours - theirs).max() < 0.02 < 0.2 < np.abs(straight - theirs).max()
    assert facts(samples, "camera")["amplitude"] == "amplitude"
    assert facts(samples, "intrinsics")["fit_max_px"] < 0.02
    with pytest.raises(RecordingError, match="is a ToF camera of one size") as error:
        make(width=640, height=480).open()
    assert error.value.hint == "leave out width and height"
    assert camera.closed


def test_without_infrared(sdk: FakeSdk) -> None:
    """The depth alone, and the recording says that there is no amplitude."""
    camera = sdk.devices[0]
    source = make(infrared=False)
    source.open()
    assert (camera.asked, camera.links) == ("stereo.depth", {})
    camera.sent.append(images(0)["depth"])
    samples = list(source.read(0.1))
    assert frames(samples)[0].amplitude.size == 0
    assert facts(samples, "camera")["amplitude"] == "none"


def test_losses_and_what_is_no_frame(sdk: FakeSdk) -> None:
    camera = sdk.devices[0]
    source = make()
    source.open()
    fish, prism = images(2, model=CameraModel.Fisheye, dist=[0.1]), images(3, dist=[0.0] * 8 + [0.1])
    camera.sent += [images(1, valid=False), fish, prism, images(4), images(6, DEPTH[:10]), images(8, DEPTH.astype(float))]
    samples = [s for s in drained(source, camera) if s.sequence is not None]
    assert [s.sequence for s in samples] == [0, 2, 4]
    assert len(frames(samples)) == 1
    assert (source.counts.malformed, source.counts.lost) == (5, 2)
    own = make(lens={"fx": 50.0, "fy": 50.0, "cx": 30.0, "cy": 20.0})
    own.open()
    camera.sent.append(images(1, valid=False))
    assert frames(list(own.read(0.1)))[0].camera_k[0, 0] == 50.0


@pytest.mark.parametrize("how", ["error", "queue", "closed"])
def test_a_camera_that_is_pulled_out_is_reached_again(sdk: FakeSdk, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    monkeypatch.setattr("cabinpose.record.sources.tof.polled._QUIET_S", 0.02)
    source = make(reconnect_s=0.01)
    source.open()
    old = sdk.devices.pop()
    old.sent.append(images(7))
    assert len(frames(list(source.read(0.01)))) == 1
    if how == "closed":
        old.closed = True
    else:
        old.sent.append(
            RuntimeError("Couldn't read data from stream") if how == "error" else QueueException("MessageQueue was closed")
        )
    check_reached_again(source, sdk.devices, Device, "14442C10", images(0))


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, sdk: FakeSdk) -> None:
    camera = sdk.devices[0]
    camera.refuses = RuntimeError("X_LINK_DEVICE_ALREADY_IN_USE")
    with pytest.raises(RecordingError, match="camera 14442C10: X_LINK_DEVICE_ALREADY_IN_USE") as error:
        make().open()
    assert "udev" in str(error.value.hint)
    assert camera.closed
    camera.refuses, camera.drivers = None, []
    with pytest.raises(RecordingError, match="camera 14442C10 has no flood light") as error:
        make(flood_light=1.0).open()
    assert error.value.hint == "leave out flood_light"
    assert camera.closed
    with pytest.raises(ConfigError, match="a width and a height"):
        make(width=640)
    sdk.devices.append(Device("22"))
    assert make().check() == ["2 OAK cameras are connected (name one with `serial`: 14442C10, 22)"]
    assert make(serial="7").check() == ["no OAK camera 7 is connected (connected: 14442C10, 22)"]
    sdk.devices.clear()
    assert make().check()[0].startswith("no OAK camera is connected (connect it by USB 3")
    monkeypatch.setitem(sys.modules, "depthai", None)
    with pytest.raises(DependencyError, match="an OAK camera needs the Python package depthai") as missing:
        make().open()
    assert missing.value.hint == "pip install 'cabinpose[oak]'"


# ------------------------------------------------------------------------------------------------ against the real package
def test_the_stand_in_is_as_the_sdk() -> None:
    dai = pytest.importorskip("depthai")
    reals = {"StereoDepth": dai.node.StereoDepth, "ToF": dai.node.ToF, "Sync": dai.node.Sync, "Output": dai.Node.Output}
    for own in (
        ImgTransformation, ImgFrame, MessageQueue, Output, StereoDepthConfig, StereoDepth, ToF, Sync, DeviceInfo, Device,
        Pipeline,
    ):  # fmt: skip
        real = reals.get(own.__name__) or getattr(dai, own.__name__)
        assert [name for name in vars(own) if not name.startswith("_") and not hasattr(real, name)] == []
    for output in ("depth", "rectifiedLeft", "initialConfig", "amplitude", "inputs", "out"):
        assert any(hasattr(getattr(dai.node, kind), output) for kind in ("StereoDepth", "ToF", "Sync"))
    for ours, theirs in (
        (CameraSensorType, dai.CameraSensorType), (CameraModel, dai.CameraModel), (LengthUnit, dai.LengthUnit),
        (DepthAlign, dai.StereoDepthConfig.AlgorithmControl.DepthAlign),
    ):  # fmt: skip
        assert {member.name for member in ours} <= set(theirs.__members__)
    config = dai.StereoDepthConfig()
    config.setDepthUnit(dai.LengthUnit.MILLIMETER)
    config.postProcessing.decimationFilter.decimationFactor = 1
    assert config.postProcessing.decimationFilter.decimationFactor == 1


def test_messages_of_the_sdk(monkeypatch: pytest.MonkeyPatch) -> None:
    """The SDK's own queue, group, frames and transformation, in a camera's place: two frames, then the queue is closed."""
    dai = pytest.importorskip("depthai")
    queue = dai.MessageQueue("frames", 8, False)
    source = make()
    source._dai, source._queue = dai, queue
    source._errors = (RuntimeError, IndexError, dai.MessageQueue.QueueException)
    monkeypatch.setattr(source, "_connect", source._begin)
    source.open()
    for number in (4, 5):
        group = dai.MessageGroup()
        for name, kind, pixels in (("depth", dai.ImgFrame.Type.RAW16, DEPTH), ("infrared", dai.ImgFrame.Type.GRAY8, LEFT)):
            frame = dai.ImgFrame()
            frame.setType(kind)
            frame.setWidth(64)
            frame.setHeight(48)
            frame.setStride(64 * pixels.itemsize)
            frame.setData(pixels.view(np.uint8).ravel())
            frame.setSequenceNum(number)
            frame.setTimestampDevice(timedelta(seconds=number, microseconds=17))
            frame.setTransformation(dai.ImgTransformation(64, 48, K))
            group[name] = frame
        queue.send(group)
    queue.send(dai.MessageGroup())
    samples = list(source.read(1.0))
    assert [(s.sequence, s.device_ns) for s in samples if s.sequence is not None] == [(0, 4_000_017_000), (1, 5_000_017_000)]
    for frame in frames(samples):
        np.testing.assert_array_equal(frame.depth, DEPTH)
        np.testing.assert_array_equal(frame.amplitude, LEFT)
        np.testing.assert_allclose(frame.camera_k, K, atol=1e-5)
    assert source.counts.malformed == 1  # a group without images
    queue.close()
    source._wait(0.01)
    assert not source._runs


def test_the_sdk_without_a_camera_says_so_and_keeps_quiet(tmp_path: Path) -> None:
    """It logs on stdout."""
    pytest.importorskip("depthai")
    check_quiet_without_a_camera("oak", "Oak", "OAK", tmp_path)
