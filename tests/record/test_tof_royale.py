"""pmd cameras through a stand-in for `roypy` that follows its documented classes, in both layouts of its frames."""

from __future__ import annotations

import sys
import time
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from camera_samples import frames
from pydantic import ValidationError

from cabinpose.core.camera import Camera
from cabinpose.core.errors import DependencyError, RecordingError
from cabinpose.record.sources.tof.royale import RoyaleSettings, RoyaleSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample

LENS = {"fx": 60.0, "fy": 61.0, "cx": 31.5, "cy": 23.0, "k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.001, "k3": 0.01}
CAMERA = Camera(64, 48, 60.0, 61.0, 31.5, 23.0, (-0.2, 0.05, 0.001, -0.001, 0.01))
PERIOD_US = 100_000


class Vector(list):
    """std::vector as SWIG wraps it: `len`, indices, and `size()`."""

    def size(self) -> int:
        return len(self)


class FakeCamera:
    """royale::ICameraDevice: calls raise RuntimeError where Royale's status is not SUCCESS."""

    def __init__(self) -> None:
        self.connected, self.capturing, self.listener, self.use_case = True, False, None, "MODE_9_10FPS_1000"
        self.rate, self.mode, self.exposure, self.level = 10, "automatic", 1000, 255
        self.parameters: dict[str, Any] = {"NoiseThreshold_Float": 0.07, "UseRemoveFlyingPixel_Bool": True}

    def setFrameRate(self, rate: int) -> int:  # noqa: N802
        if not 1 <= rate <= 10:
            raise RuntimeError("The framerate is not supported")
        self.rate = rate
        return 0

    def getExposureLimits(self) -> SimpleNamespace:  # noqa: N802
        return SimpleNamespace(first=8, second=1000)

    def setExposureMode(self, mode: str, stream: int) -> int:  # noqa: N802
        assert stream == 0
        self.mode = mode
        return 0

    def setExposureTime(self, time_us: int, stream: int) -> int:  # noqa: N802
        assert stream == 0
        if self.mode != "manual":
            raise RuntimeError("Exposure mode is not correct for this operation")
        self.exposure = time_us
        return 0

    def setFilterLevel(self, level: int, stream: int) -> int:  # noqa: N802
        assert stream == 0
        self.level = level
        return 0

    def getFilterLevel(self, stream: int) -> int:  # noqa: N802
        assert stream == 0
        return self.level

    def setProcessingParameters(self, values: dict[str, Any], stream: int) -> int:  # noqa: N802
        assert stream == 0
        assert all(type(value) is type(self.parameters[name]) for name, value in values.items())  # as Royale's variants
        self.parameters |= values
        return 0

    def getProcessingParameters(self, stream: int) -> dict[str, Any]:  # noqa: N802
        assert stream == 0
        return dict(self.parameters)

    def initialize(self) -> int:
        if not self.connected:
            raise RuntimeError("Device is not available")
        return 0

    def getUseCases(self) -> Vector:  # noqa: N802
        return Vector(["MODE_9_10FPS_1000", "MODE_5_45FPS_500"])

    def setUseCase(self, name: str) -> int:  # noqa: N802
        self.use_case = name
        return 0

    def getCurrentUseCase(self) -> str:  # noqa: N802
        return self.use_case

    def getFrameRate(self) -> int:  # noqa: N802
        return self.rate

    def getLensParameters(self) -> dict[str, float]:  # noqa: N802
        return dict(LENS)

    def registerDataListener(self, listener: Any) -> int:  # noqa: N802
        self.listener = listener
        return 0

    def unregisterDataListener(self) -> int:  # noqa: N802
        self.listener = None
        return 0

    def startCapture(self) -> int:  # noqa: N802
        self.capturing = True
        return 0

    def stopCapture(self) -> int:  # noqa: N802
        if not self.connected:
            raise RuntimeError("Device is not available")
        self.capturing = False
        return 0

    def isConnected(self) -> bool:  # noqa: N802
        return self.connected


class FakeRoypy(ModuleType):
    """The module, and the cameras that are plugged in."""

    def __init__(self) -> None:
        super().__init__("roypy")
        self.cameras: dict[str, FakeCamera] = {"0007-1": FakeCamera()}
        plugged = self.cameras

        class IDepthDataListener:
            def __init__(self) -> None:
                self.director = True

        class CameraManager:
            def getConnectedCameraList(self) -> Vector:  # noqa: N802
                return Vector(name for name, camera in plugged.items() if camera.connected)

            def createCamera(self, name: str) -> FakeCamera:  # noqa: N802
                return plugged[name]

        self.ExposureMode_MANUAL = "manual"
        self.FilterLevel_Off, self.FilterLevel_Full = 0, 255
        self.IDepthDataListener = IDepthDataListener
        self.CameraManager = CameraManager


@pytest.fixture
def roypy(monkeypatch: pytest.MonkeyPatch) -> FakeRoypy:
    module = FakeRoypy()
    monkeypatch.setitem(sys.modules, "roypy", module)
    return module


def scene(distorted: bool = True) -> np.ndarray:
    """(48, 64, 3) points on a slanted wall, of the sensor's pixels or of a straight grid."""
    camera = CAMERA if distorted else Camera(64, 48, 60.0, 61.0, 31.5, 23.0)
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    return camera.points(1.0 + 0.01 * u + 0.002 * v)


def new_layout(index: int, *, distorted: bool = True) -> SimpleNamespace:
    points = scene(distorted).astype(np.float32)
    confidence = np.ones((48, 64, 1), np.float32)
    confidence[:4] = 0
    coordinates = np.concatenate((points, confidence), axis=-1).reshape(-1, 4)
    amplitudes = np.arange(48 * 64, dtype=np.uint16)
    return SimpleNamespace(
        timeStamp=index * PERIOD_US + 10**15, width=64, height=48, streamId=1, coordinates=coordinates, amplitudes=amplitudes
    )


class OldLayout:
    """DepthData with `npoints()`: x y z noise grey confidence."""

    def __init__(self, index: int) -> None:
        self.timeStamp, self.width, self.height = index * PERIOD_US + 10**15, 64, 48
        self.exposureTimes = Vector([600, 600, 600, 600])

    def npoints(self) -> np.ndarray:
        grey = np.arange(48 * 64, dtype=np.float64).reshape(48, 64, 1)
        confidence = np.full((48, 64, 1), 255.0)
        confidence[:4] = 0
        return np.concatenate((scene(), np.full((48, 64, 1), 0.0031), grey, confidence), axis=-1)


class WithoutNumpy(OldLayout):
    """The same where `roypy` was built without numpy."""

    def npoints(self) -> np.ndarray:
        raise RuntimeError("Roypy was compiled without numpy support!")

    def points(self) -> list[SimpleNamespace]:
        names = ("x", "y", "z", "noise", "grayValue", "depthConfidence")
        return [SimpleNamespace(**dict(zip(names, row, strict=True))) for row in super().npoints().reshape(-1, 6)]


def make(**settings: Any) -> RoyaleSource:
    return RoyaleSource("tof", RoyaleSettings(**settings), HostClock())


def facts(samples: list[Sample], about: str) -> list[Facts]:
    return [m for s in samples for m in s.messages if isinstance(m, Facts) and m.about == about]


@pytest.mark.parametrize("layout", [new_layout, OldLayout, WithoutNumpy])
def test_a_frame_of_either_layout(roypy: FakeRoypy, layout: Any) -> None:
    source = make(use_case="MODE_5_45FPS_500")
    assert source.check() == []
    source.open()
    camera = roypy.cameras["0007-1"]
    assert camera.capturing
    assert camera.use_case == "MODE_5_45FPS_500"
    data = layout(3)
    camera.listener.onNewData(data)
    if hasattr(data, "coordinates"):
        data.coordinates[:] = np.nan  # Royale frees the frame when the listener returns
        data.amplitudes[:] = 0
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    truth = scene()[..., 2]
    assert (frame.depth[:4] == 0).all()  # no confidence
    np.testing.assert_allclose(frame.depth[4:] * frame.depth_unit_m, truth[4:], atol=frame.depth_unit_m / 2 + 1e-6)
    np.testing.assert_array_equal(frame.amplitude.ravel(), np.arange(48 * 64))
    assert frame.confidence.dtype == np.uint8
    assert set(np.unique(frame.confidence)) == {0, 255}
    np.testing.assert_array_equal(frame.camera_k, CAMERA.k)
    np.testing.assert_array_equal(frame.camera_dist, CAMERA.dist)
    np.testing.assert_array_equal(frame.amplitude_dist, CAMERA.dist)
    assert [s.device_ns for s in samples if s.sequence is not None] == [(10**15 + 3 * PERIOD_US) * 1000]
    (about,) = facts(samples, "camera")
    assert about.values["lens"] == LENS
    assert about.values["frame_rate_hz"] == 10
    if isinstance(data, OldLayout):
        np.testing.assert_array_equal(frame.noise, np.full((48, 64), 3100))
        assert [fact.values for fact in facts(samples, "exposure")] == [{"phases_us": [600] * 4}]
    source.close()
    assert not camera.capturing
    assert camera.listener is None


def test_the_points_of_a_frame_come_out_again(roypy: FakeRoypy) -> None:
    """Depth, K and distortion give the SDK's own points: the oracle for which distortion the depth image has."""
    source = make(depth_unit_m=0.0001)
    source.open()
    roypy.cameras["0007-1"].listener.onNewData(new_layout(0))
    (frame,) = frames(list(source.read(0.1)))
    k, dist = frame.camera_k, tuple(frame.camera_dist)
    camera = Camera(64, 48, k[0, 0], k[1, 1], k[0, 2], k[1, 2], dist)
    np.testing.assert_allclose(camera.points(frame.depth * frame.depth_unit_m)[4:], scene()[4:], atol=1e-4)
    source.close()


def test_a_straight_grid_is_seen_to_be_one(roypy: FakeRoypy) -> None:
    source = make()
    source.open()
    roypy.cameras["0007-1"].listener.onNewData(new_layout(0, distorted=False))
    samples = list(source.read(0.1))
    (frame,) = frames(samples)
    np.testing.assert_array_equal(frame.camera_dist, np.zeros(5))
    np.testing.assert_array_equal(frame.amplitude_dist, CAMERA.dist)  # the amplitude image is never undistorted
    (grid,) = facts(samples, "depth_grid")
    assert grid.values["distorted"] is False
    assert grid.values["error_px_if_undistorted"] < 1e-3 < grid.values["error_px"]
    source.close()


def test_losses_a_full_queue_and_damage_are_counted(roypy: FakeRoypy) -> None:
    source = make(queue_frames=3)
    source.open()
    listener = roypy.cameras["0007-1"].listener
    for index in (0, 1, 4):  # 2 and 3 never came
        listener.onNewData(new_layout(index))
    listener.onNewData(new_layout(5))  # the queue is full
    damaged = new_layout(6)
    damaged.amplitudes = damaged.amplitudes[:100]
    broken = new_layout(6)
    broken.coordinates = broken.coordinates[:-1]
    listener.onNewData(broken)
    samples = [s for s in source.read(0.1) if s.sequence is not None]
    assert [s.sequence for s in samples] == [0, 1, 4]
    listener.onNewData(damaged)
    (late,) = [s for s in source.read(0.1) if s.sequence is not None]
    assert late.sequence == 6
    assert late.messages == ()
    counts = source.counts
    assert (counts.received, counts.lost, counts.malformed) == (4, 3, 2)
    source.close()


def test_a_camera_that_is_pulled_out_is_reached_again(roypy: FakeRoypy) -> None:
    source = make(reconnect_s=0.01)
    source.open()
    camera = roypy.cameras["0007-1"]
    camera.listener.onNewData(new_layout(0))
    assert len(frames(list(source.read(0.1)))) == 1
    camera.connected = False
    for _ in range(3):
        assert frames(list(source.read(0.001))) == []
        time.sleep(0.02)
    assert source.counts.restarts == 0
    roypy.cameras["0007-1"] = camera = FakeCamera()
    for _ in range(100):
        source.read(0.001)
        if camera.capturing:
            break
        time.sleep(0.005)
    assert source.counts.restarts == 1
    camera.listener.onNewData(new_layout(1000))
    (sample,) = [s for s in source.read(0.1) if s.sequence is not None]
    assert sample.sequence == 1
    assert source.counts.lost == 0
    source.close()
    source.close()


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, roypy: FakeRoypy) -> None:
    with pytest.raises(RecordingError, match="no use case X") as error:
        make(use_case="X").open()
    assert error.value.hint == "known: MODE_9_10FPS_1000, MODE_5_45FPS_500"
    with pytest.raises(RecordingError, match="no pmd camera 9 is connected"):
        make(serial="9").open()
    roypy.cameras.clear()
    assert "no pmd camera is connected" in make().check()[0]
    monkeypatch.setitem(sys.modules, "roypy", None)
    with pytest.raises(DependencyError, match="roypy") as missing:
        make().open()
    assert "Royale SDK" in str(missing.value.hint)
    assert "roypy" in make().check()[0]


def test_values_are_set_within_the_use_case_and_read_back(roypy: FakeRoypy) -> None:
    """The exposure is told by frames alone; a rate is a whole number, and one that is not is told."""
    filters = {"FilterLevel": False, "NoiseThreshold_Float": 1, "UseRemoveFlyingPixel_Bool": False}  # YAML reads Off as false
    source = make(integration_us=600, frame_rate_hz=7.4, filters=filters)
    with pytest.warns(UserWarning, match=r"tof: frame_rate_hz is not as asked: 7 \(asked 7\.4\)"):
        source.open()
    camera = roypy.cameras["0007-1"]
    assert (camera.mode, camera.exposure, camera.rate, camera.level) == ("manual", 600, 7, 0)
    assert camera.parameters == {"NoiseThreshold_Float": 1.0, "UseRemoveFlyingPixel_Bool": False}
    camera.listener.onNewData(OldLayout(0))
    first, second = facts(list(source.read(0.1)), "setup")
    assert first.values["integration_us"] == {"asked": 600}  # before a frame has come
    assert first.values["frame_rate_hz"] == {"asked": 7.4, "actual": 7}
    assert first.values["filters.FilterLevel"] == {"asked": "Off", "actual": "Off"}
    assert first.values["filters.NoiseThreshold_Float"] == {"asked": 1, "actual": 1.0}
    assert second.values["integration_us"] == {"asked": 600, "actual": 600}
    other = OldLayout(1)
    other.exposureTimes = Vector([200, 450, 450, 450])
    camera.listener.onNewData(other)
    with pytest.warns(UserWarning, match=r"integration_us is not as asked: 450 \(asked 600\)"):
        source.read(0.1)
    source.close()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"integration_us": 2000}, "integration_us 2000: the use case takes 8 to 1000"),
        ({"frame_rate_hz": 15}, "frame_rate_hz 15: The framerate is not supported"),
        ({"filters": {"FilterLevel": "Best"}}, "this version of Royale knows Full, Off"),
        ({"filters": {"Sharpness": 1}}, "the camera's parameters are NoiseThreshold_Float, UseRemoveFlyingPixel_Bool"),
    ],
    ids=str,
)
def test_what_the_use_case_does_not_take_is_refused(roypy: FakeRoypy, settings: dict[str, Any], words: str) -> None:
    source = make(**settings)
    with pytest.raises(RecordingError, match=words):
        source.open()
    assert not roypy.cameras["0007-1"].capturing
    with pytest.raises(ValidationError, match="choose one with `use_case`"):
        make(modulation_hz=60e6)


def test_an_older_version_has_less(roypy: FakeRoypy, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("setFrameRate", "getExposureLimits", "setFilterLevel", "getFilterLevel"):
        monkeypatch.delattr(FakeCamera, name)
    with pytest.raises(RecordingError, match="this version of Royale has no setFrameRate"):
        make(frame_rate_hz=5).open()
    source = make(integration_us=5000)
    source.open()
    assert roypy.cameras["0007-1"].exposure == 5000
    source.close()
