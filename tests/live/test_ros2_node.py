"""The example of a ROS 2 node, on stand-ins of ROS's modules: what it reads of messages, and what it publishes."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

import cabinpose

FILE = Path(__file__).resolve().parents[2] / "examples/ros2/cabinpose_node.py"


class Message(SimpleNamespace):
    """A message of ROS, with the fields that the example's messages have; others are refused, as rclpy refuses them."""

    fields: tuple[str, ...] = ()
    nested: ClassVar = {"scale": "xyz", "color": "rgba", "lifetime": ("sec", "nanosec")}

    def __init__(self, **given: Any) -> None:
        assert set(given) <= set(self.fields), given
        empty: dict[str, Any] = {name: Message.__new__(Message) for name in self.nested if name in self.fields}
        if "pose" in self.fields:
            empty["pose"] = SimpleNamespace(orientation=SimpleNamespace(w=0.0))
        for name, inner in empty.items():
            vars(inner).update(dict.fromkeys(self.nested.get(name, ()), 0.0))
        super().__init__(**{"markers": []} | empty | given)


def message(name: str, *fields: str, **constants: int) -> type[Message]:
    """A kind of message."""
    return type(name, (Message,), {"fields": fields, **constants})


IMAGE = message("Image", "header", "height", "width", "encoding", "is_bigendian", "step", "data")
INFO = message("CameraInfo", "header", "k", "d")


class Publisher:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def publish(self, told: Any) -> None:
        self.sent.append(told)

    def get_subscription_count(self) -> int:
        return 1


class StandInNode:
    """What the example uses of rclpy's node."""

    def __init__(self, name: str) -> None:
        self.name, self.published, self.listens = name, dict[str, Publisher](), dict[str, Any]()
        self.logged: list[str] = []

    def declare_parameter(self, name: str, default: str) -> Any:
        return SimpleNamespace(value=default)

    def create_publisher(self, kind: Any, topic: str, depth: int) -> Publisher:
        return self.published.setdefault(topic, Publisher())

    def create_subscription(self, kind: Any, topic: str, call: Any, *_: Any) -> None:
        self.listens[topic] = call

    def get_logger(self) -> Any:
        return SimpleNamespace(
            warning=lambda words, **_: self.logged.append(words), error=lambda words, **_: self.logged.append(words)
        )


class Synchronizer:
    """Messages of one time from several topics."""

    def __init__(self, inputs: list[Any], **_: Any) -> None:
        self.topics = [each.topic for each in inputs]

    def registerCallback(self, call: Any) -> None:  # noqa: N802 - message_filters' name
        self.call = call


@pytest.fixture(scope="module")
def example() -> Iterator[ModuleType]:
    """The example's module, with stand-ins in ROS's place."""
    point = message("Point", "x", "y", "z")
    marker = message(
        "Marker", "header", "ns", "id", "type", "action", "points", "scale", "color", "lifetime", "pose",
        SPHERE_LIST=7, LINE_LIST=5, ADD=0, DELETE=2,
    )  # fmt: skip
    modules = {
        "rclpy": {}, "rclpy.node": {"Node": StandInNode}, "rclpy.qos": {"qos_profile_sensor_data": object()},
        "message_filters": {
            "Subscriber": lambda node, kind, topic, **_: SimpleNamespace(topic=topic),
            "ApproximateTimeSynchronizer": Synchronizer,
        },
        "geometry_msgs": {}, "geometry_msgs.msg": {"Point": point},
        "sensor_msgs": {}, "sensor_msgs.msg": {"Image": IMAGE, "CameraInfo": INFO},
        "visualization_msgs": {}, "visualization_msgs.msg": {"Marker": marker, "MarkerArray": message("MarkerArray")},
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        for name, content in modules.items():
            stand_in = ModuleType(name)
            vars(stand_in).update(content)
            patch.setitem(sys.modules, name, stand_in)
        spec = importlib.util.spec_from_file_location("cabinpose_node", FILE)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        yield module


@pytest.fixture(scope="module")
def node(example: ModuleType) -> Any:
    return example.CabinposeNode()


def image(values: np.ndarray[Any, Any], encoding: str, *, big: bool = False, pad: int = 0) -> Any:
    """A message of an image, with rows longer than their pixels."""
    kind = values.dtype.newbyteorder(">" if big else "<")
    rows = values.astype(kind).view(np.uint8).reshape(len(values), -1)
    data = np.pad(rows, ((0, 0), (0, pad)), constant_values=255)
    height, width = values.shape
    return IMAGE(
        header="camera",
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(big),
        step=data.shape[1],
        data=data.tobytes(),
    )


def frame() -> tuple[Any, Any, Any]:
    """Depth in mm, infrared and the intrinsics of a frame of the sample, and what the model says of the frame."""
    ds = cabinpose.sample().isel(frame=0)
    depth = np.nan_to_num(ds.depth.values * 1000).round().astype(np.uint16)
    info = INFO(header="camera", k=ds.camera_k.values.ravel().tolist(), d=ds.camera_dist.values.tolist())
    return image(depth, "16UC1", pad=6), image(ds.amplitude.values, "mono16"), info


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    ("encoding", "dtype"), [("16UC1", np.uint16), ("mono16", np.uint16), ("32FC1", np.float32), ("mono8", np.uint8)]
)
def test_pixels_are_read_in_their_order_and_without_what_pads_rows(
    example: ModuleType, encoding: str, dtype: Any, big: bool
) -> None:
    values = (np.arange(12).reshape(3, 4) * 17).astype(dtype)
    np.testing.assert_array_equal(example.pixels(image(values, encoding, big=big, pad=5)), values)


def test_depths_become_metres(example: ModuleType) -> None:
    np.testing.assert_allclose(example.metres(image(np.array([[1500, 0]], np.uint16), "16UC1")), [[1.5, np.nan]])
    told = example.metres(image(np.array([[1.5, np.inf, np.nan]], np.float32), "32FC1"))
    np.testing.assert_allclose(told, [[1.5, np.nan, np.nan]])


def test_a_frame_becomes_people_and_a_picture(node: Any) -> None:
    depth, ir, info = frame()
    assert node.frames.topics == ["depth", "ir"]
    node.frames.call(depth, ir)
    assert node.logged == ["no camera_info yet"]
    node.listens["camera_info"](info)
    node.frames.call(depth, ir)
    (told,) = node.published["~/people"].sent
    ds = cabinpose.sample().isel(frame=0)
    rounded = np.where(np.isfinite(ds.depth.values), (ds.depth.values * 1000).round() / 1000, np.nan)
    expected = node.model(rounded, ds.camera_k.values, ds.amplitude.values, camera_dist=ds.camera_dist.values)
    for person, name in enumerate(expected.persons):
        spheres, lines = (marker for marker in told.markers if marker.ns == name)
        there = expected.presence[person] >= 0.5
        points = [(point.x, point.y, point.z) for point in spheres.points]
        np.testing.assert_allclose(points, expected.joints_3d[person][there], atol=1e-5)
        assert (spheres.type, lines.type, spheres.action, spheres.header) == (7, 5, 0, "camera")
        assert len(lines.points) % 2 == 0 < len(lines.points)
    (picture,) = node.published["~/image"].sent
    assert (picture.encoding, picture.width, picture.step, len(picture.data)) == (
        "rgb8",
        704,
        3 * 704,
        picture.step * picture.height,
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda depth, info: vars(depth).update(encoding="rgb8"), "an image of rgb8, and 16UC1"),
        (lambda depth, info: vars(info).update(d=[0.0] * 8), "distortion of 8 coefficients"),
        (lambda depth, info: vars(info).update(k=[1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]), "camera_k"),
    ],
    ids=["encoding", "lens", "camera"],
)
def test_what_cannot_be_is_logged_and_the_node_lives_on(node: Any, change: Callable[[Any, Any], None], words: str) -> None:
    depth, ir, info = frame()
    change(depth, info)
    before = len(node.published["~/people"].sent)
    node.listens["camera_info"](info)
    node.frames.call(depth, ir)
    assert words in node.logged[-1]
    assert len(node.published["~/people"].sent) == before
