"""GenICam cameras through stand-ins for harvesters and genicam, with the names and behaviour of harvesters 1.4."""

from __future__ import annotations

import sys
from collections import deque
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from camera_samples import frames
from pydantic import ValidationError

from cabinpose.core.camera import Camera
from cabinpose.core.errors import DependencyError, RecordingError
from cabinpose.record.sources.tof.genicam import GenicamSettings, GenicamSource
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Facts, Sample

CAMERA = Camera(32, 24, 30.0, 30.0, 15.0, 12.5)


class GenericException(Exception):  # noqa: N818 - genicam's name
    pass


class Node:
    def __init__(self, value: Any) -> None:
        self.value = value


class Snapping(Node):
    """A feature that takes the nearest of its steps, has limits, and may have entries."""

    def __init__(self, value: Any, step: float = 1.0, most: float = 1e9, symbolics: tuple[str, ...] = ()) -> None:
        self._value, self._step, self._most, self.symbolics = value, step, most, symbolics

    @property
    def value(self) -> Any:
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        if self.symbolics:
            if value not in self.symbolics:
                raise GenericException(f"{value} is no entry")
            self._value = value
            return
        if value > self._most:
            raise GenericException(f"Value = {value} must be smaller than or equal Max = {self._most}")
        self._value = round(value / self._step) * self._step


class Coordinates:
    """Scan3dCoordinateScale and Offset, which depend on their selector."""

    def __init__(self, selector: Node, values: dict[str, float]) -> None:
        self._selector, self._values = selector, values

    @property
    def value(self) -> float:
        return self._values[self._selector.value]


class Nodes:
    """A node map: AttributeError for features that the camera does not have, as genicam's raises its own."""

    def __init__(self, **values: Any) -> None:
        for name, value in values.items():
            setattr(self, name, value if hasattr(value, "value") else Node(value))


def blaze(scale: float = 1.0) -> Nodes:
    selector = Node("CoordinateA")
    scales = dict.fromkeys(("CoordinateA", "CoordinateB", "CoordinateC"), scale)
    offsets = dict.fromkeys(scales, 0.0)
    return Nodes(
        DeviceVendorName="Basler", DeviceModelName="blaze-101", DeviceSerialNumber="2401", PixelFormat="Coord3D_C16",
        Scan3dDistanceUnit="Millimeter", Scan3dCoordinateSelector=selector, Scan3dCoordinateScale=Coordinates(selector, scales),
        Scan3dCoordinateOffset=Coordinates(selector, offsets), Scan3dInvalidDataFlag=True, Scan3dInvalidDataValue=0.0,
        Scan3dFocalLength=30.0, Scan3dPrincipalPointU=15.0, Scan3dPrincipalPointV=12.5,
    )  # fmt: skip


class Acquirer:
    def __init__(self, nodes: Nodes) -> None:
        self.remote_device = SimpleNamespace(node_map=nodes)
        self.filled: deque[Any] = deque()
        self.acquiring, self.out, self.broken = False, 0, False

    def start(self) -> None:
        self.acquiring = True

    def stop(self) -> None:
        self.acquiring = False

    def destroy(self) -> None:
        self.remote_device = None

    def is_acquiring(self) -> bool:
        return self.acquiring

    def try_fetch(self, *, timeout: float) -> Any:
        if self.broken:
            raise GenericException("Access to the device is lost")
        return self.filled.popleft() if self.filled else None

    def fill(self, frame_id: int, stamp_ns: int, *components: Any, incomplete: bool = False) -> None:
        acquirer = self

        class Buffer:
            is_incomplete = incomplete
            payload = SimpleNamespace(components=components)
            timestamp_ns = stamp_ns

            @property
            def frame_id(self) -> int:
                if frame_id < 0:
                    raise GenericException("not implemented by this producer")
                return frame_id

            def __enter__(self) -> Buffer:
                acquirer.out += 1
                return self

            def __exit__(self, *_: object) -> None:
                acquirer.out -= 1
                for component in components:  # the memory is given back
                    if component is not None and component.data is not None:
                        component.data[:] = 0

        self.filled.append(Buffer())


def component(data_format: str, image: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(data_format=data_format, width=image.shape[1], height=image.shape[0], data=image.copy().ravel())


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> SimpleNamespace:
    producer = tmp_path / "vendor.cti"
    producer.write_bytes(b"")
    state = SimpleNamespace(nodes=blaze(), producer=producer, acquirer=None, resets=0, serials=["2401"], keys=[])

    class Harvester:
        def add_file(self, path: str) -> None:
            assert path == str(producer)

        def update(self) -> None:
            self.device_info_list = [SimpleNamespace(serial_number=s) for s in state.serials]

        def create(self, key: Any = None) -> Acquirer:
            state.keys.append(key)
            state.acquirer = Acquirer(state.nodes)
            return state.acquirer

        def reset(self) -> None:
            state.resets += 1

    core, gentl = ModuleType("harvesters.core"), ModuleType("genicam.gentl")
    core.Harvester, gentl.GenericException = Harvester, GenericException  # type: ignore[attr-defined]
    for name, module in {
        "harvesters": ModuleType("harvesters"), "harvesters.core": core, "genicam": ModuleType("genicam"), "genicam.gentl": gentl,
    }.items():  # fmt: skip
        monkeypatch.setitem(sys.modules, name, module)
    return state


def make(rig: SimpleNamespace, **settings: Any) -> GenicamSource:
    return GenicamSource("tof", GenicamSettings(producer=rig.producer, **settings), HostClock())


def numbered(samples: Any) -> list[Sample]:
    return [s for s in samples if s.sequence is not None]


DEPTH = (np.arange(24 * 32, dtype=np.uint16) * 5).reshape(24, 32)
INTENSITY = DEPTH + 7
CONFIDENCE = DEPTH * 13


def test_a_depth_map_keeps_the_cameras_own_steps(rig: SimpleNamespace) -> None:
    rig.nodes = blaze(scale=0.25)
    source = make(rig, features={"PixelFormat": "Coord3D_C16"}, serial="2401")
    assert source.check() == []
    source.open()
    assert rig.keys == [{"serial_number": "2401"}]
    rig.acquirer.fill(
        1, 5_000, component("Coord3D_C16", DEPTH), component("Mono16", INTENSITY), component("Confidence16", CONFIDENCE), None
    )
    samples = source.read(0.1)
    (frame,) = frames(samples)
    np.testing.assert_array_equal(frame.depth, DEPTH)
    assert frame.depth_unit_m == pytest.approx(0.00025)
    np.testing.assert_array_equal(frame.amplitude, INTENSITY)
    np.testing.assert_array_equal(frame.confidence, CONFIDENCE >> 8)
    np.testing.assert_array_equal(frame.camera_k, CAMERA.k)
    assert numbered(samples)[0].device_ns == 5_000
    assert rig.acquirer.out == 0  # every buffer was given back
    source.close()
    assert rig.resets == 2  # the check, and the close


def test_points_in_floats_and_a_second_mono_image(rig: SimpleNamespace) -> None:
    del rig.nodes.Scan3dFocalLength  # this camera does not tell: the intrinsics come from the points
    source = make(rig)
    source.open()
    u, v = np.meshgrid(np.arange(32), np.arange(24))
    points = (CAMERA.points(1.0 + 0.01 * u + 0.03 * v) * 1000).astype(np.float32)
    points[0] = 0
    points[1] = np.nan
    image = SimpleNamespace(data_format="Coord3D_ABC32f", width=32, height=24, data=points.copy().ravel())
    rig.acquirer.fill(1, 0, image, component("Mono16", INTENSITY), component("Mono16", CONFIDENCE))
    samples = source.read(0.1)
    (frame,) = frames(samples)
    np.testing.assert_allclose(frame.depth[2:] * frame.depth_unit_m, points[2:, :, 2] / 1000, atol=1.3e-4)
    assert (frame.depth[:2] == 0).all()
    np.testing.assert_array_equal(frame.confidence, CONFIDENCE >> 8)
    np.testing.assert_allclose(frame.camera_k, CAMERA.k, atol=1e-3)
    assert any(isinstance(m, Facts) and m.about == "intrinsics" for s in samples for m in s.messages)
    source.close()


def test_lucids_format_and_intrinsics(rig: SimpleNamespace) -> None:
    selector, k = Node("Value0"), (-0.2, 0.1, 0.001, 0.002, -0.01)
    scan = Node("CoordinateA")
    scales = {"CoordinateA": 0.25, "CoordinateB": 0.25, "CoordinateC": 0.25}
    rig.nodes = Nodes(
        CalibFocalLengthX=30.0, CalibFocalLengthY=31.0, CalibOpticalCenterX=15.0, CalibOpticalCenterY=12.0,
        CalibLensDistortionValueSelector=selector,
        CalibLensDistortionValue=Coordinates(selector, {f"Value{i}": value for i, value in enumerate(k)}),
        Scan3dCoordinateSelector=scan, Scan3dCoordinateScale=Coordinates(scan, scales),
        Scan3dCoordinateOffset=Coordinates(scan, {"CoordinateA": -8192.0, "CoordinateB": -8192.0, "CoordinateC": 0.0}),
        Scan3dInvalidDataValue=65535.0,
    )  # fmt: skip
    source = make(rig)
    source.open()
    values = np.zeros((24, 32, 4), np.uint16)
    values[..., 2], values[..., 3] = DEPTH, INTENSITY
    values[5, 5, 2] = 65535
    rig.acquirer.fill(1, 0, SimpleNamespace(data_format="Coord3D_ABCY16", width=32, height=24, data=values.ravel()))
    (frame,) = frames(source.read(0.1))
    assert frame.depth[5, 5] == 0
    np.testing.assert_array_equal(np.delete(frame.depth.ravel(), 5 * 32 + 5), np.delete(DEPTH.ravel(), 5 * 32 + 5))
    np.testing.assert_array_equal(frame.amplitude, INTENSITY)
    np.testing.assert_array_equal(frame.camera_dist, k)
    assert frame.camera_k[1, 1] == 31.0
    source.close()


def test_an_offset_is_no_lossless_step(rig: SimpleNamespace) -> None:
    scan = Node("CoordinateA")
    rig.nodes.Scan3dCoordinateSelector = scan
    rig.nodes.Scan3dCoordinateOffset = Coordinates(scan, {"CoordinateA": 0.0, "CoordinateB": 0.0, "CoordinateC": 100.0})
    rig.nodes.Scan3dCoordinateScale = Coordinates(scan, dict.fromkeys(("CoordinateA", "CoordinateB", "CoordinateC"), 1.0))
    source = make(rig)
    source.open()
    rig.acquirer.fill(1, 0, component("Coord3D_C16", DEPTH))
    (frame,) = frames(source.read(0.1))
    expected = np.where(DEPTH > 0, (DEPTH + 100.0) / 1000, 0)
    np.testing.assert_allclose(frame.depth * frame.depth_unit_m, expected, atol=1.3e-4)
    assert frame.amplitude.shape == frame.confidence.shape == (0, 0)
    source.close()


def test_lost_incomplete_and_foreign_buffers_are_counted(rig: SimpleNamespace) -> None:
    source = make(rig, queue_frames=20)
    source.open()
    for frame_id in (65533, 65534, 65535, 1, 2, 5):  # GigE Vision's block ids jump over 0; 3 and 4 are lost
        rig.acquirer.fill(frame_id, 0, component("Coord3D_C16", DEPTH))
    rig.acquirer.fill(6, 0, component("Coord3D_C16", DEPTH), incomplete=True)
    rig.acquirer.fill(7, 0, component("Mono16", INTENSITY))
    wrong = component("Coord3D_C16", DEPTH)
    wrong.width = 31
    rig.acquirer.fill(8, 0, wrong)
    samples = numbered(source.read(0.1))
    assert [s.sequence for s in samples] == [0, 1, 2, 3, 4, 7, 8, 9, 10]
    assert [len(s.messages) for s in samples] == [1] * 6 + [0] * 3
    assert (source.counts.lost, source.counts.malformed, source.counts.received, source.counts.restarts) == (2, 3, 9, 0)
    assert rig.acquirer.out == 0
    source.close()


def test_a_producer_without_frame_ids_and_a_lost_camera(rig: SimpleNamespace) -> None:
    source = make(rig, reconnect_s=1e-4)
    source.open()
    first = rig.acquirer
    first.fill(-1, 10, component("Coord3D_C16", DEPTH))
    assert [s.sequence for s in numbered(source.read(0.01))] == [0]
    first.broken = True
    assert numbered(source.read(0.01)) == []
    assert rig.acquirer is not first  # destroyed, and opened anew
    assert first.remote_device is None
    assert source.counts.restarts == 1
    rig.acquirer.fill(-1, 20, component("Coord3D_C16", DEPTH))
    assert [s.sequence for s in numbered(source.read(0.01))] == [1]
    source.close()


def test_what_is_missing_is_named(rig: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RecordingError, match=r"refuses features\.Nonsense 1") as error:
        make(rig, features={"Nonsense": 1}).open()
    assert error.value.hint == "check the names and values in `features`: features.Nonsense"
    assert rig.acquirer.remote_device is None
    rig.serials = []
    with pytest.raises(RecordingError, match="no GenICam camera is connected"):
        make(rig).open()
    assert "no GenICam camera" in make(rig).check()[0]
    rig.producer.unlink()
    with pytest.raises(RecordingError, match="does not exist"):
        make(rig).open()
    monkeypatch.setitem(sys.modules, "harvesters", None)
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(DependencyError, match="harvesters"):
        make(rig).open()


def told(samples: Any) -> list[Any]:
    return [m.values for s in samples for m in s.messages if isinstance(m, Facts) and m.about == "setup"]


def test_values_are_set_before_the_frames_and_read_back(rig: SimpleNamespace) -> None:
    rig.nodes.ExposureAuto, rig.nodes.ExposureTime = Node("Continuous"), Snapping(1000.0, step=60.0)
    rig.nodes.AcquisitionFrameRateEnable, rig.nodes.AcquisitionFrameRate = Node(False), Snapping(30.0, step=0.001, most=30)
    rig.nodes.SpatialFilter, rig.nodes.OperatingMode = Node(False), Node("LongRange")
    source = make(
        rig, integration_us=500, frame_rate_hz=12.5, filters={"SpatialFilter": True}, features={"OperatingMode": "ShortRange"}
    )
    with pytest.warns(UserWarning, match=r"tof: integration_us is not as asked: 480 \(asked 500\)"):
        source.open()
    nodes = rig.nodes
    assert (nodes.ExposureAuto.value, nodes.AcquisitionFrameRateEnable.value, nodes.SpatialFilter.value) == ("Off", True, True)
    rig.acquirer.fill(1, 0, component("Coord3D_C16", DEPTH))
    (values,) = told(source.read(0.1))
    assert values == {
        "features.OperatingMode": {"asked": "ShortRange", "actual": "ShortRange"},
        "filters.SpatialFilter": {"asked": True, "actual": True},
        "integration_us": {"asked": 500, "actual": 480},
        "frame_rate_hz": {"asked": 12.5, "actual": pytest.approx(12.5)},
    }
    source.close()


def test_exposures_of_which_there_are_few(rig: SimpleNamespace) -> None:
    entries = ("Exp62_5Us", "Exp250Us", "Exp1000Us")
    rig.nodes.ExposureTimeSelector = Snapping("Exp1000Us", symbolics=entries)
    source = make(rig, integration_us=62.5)
    source.open()
    assert rig.nodes.ExposureTimeSelector.value == "Exp62_5Us"
    source.close()
    with pytest.raises(RecordingError, match=r"integration_us 500: the camera has 62\.5, 250, 1000"):
        make(rig, integration_us=500).open()


def test_a_rate_that_is_refused_and_keys_that_the_standard_lacks(rig: SimpleNamespace) -> None:
    rig.nodes.AcquisitionFrameRate = Snapping(30.0, most=30)
    with pytest.raises(RecordingError, match="frame_rate_hz 60: Value = 60") as error:
        make(rig, frame_rate_hz=60).open()
    assert error.value.hint == "give another value, or leave frame_rate_hz out: the camera then keeps its own"
    assert rig.acquirer.remote_device is None
    assert not rig.acquirer.acquiring
    with pytest.raises(ValidationError, match="no feature for it"):
        make(rig, modulation_hz=60e6)
