"""Bags of ROS 2 made by hand, with `rosbags`, which knows nothing of us."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

BEGAN = 1_700_000_000_000_000_000
W, H = 24, 18
K = (20.0, 0.0, 11.5, 0.0, 21.0, 8.5, 0.0, 0.0, 1.0)
P = (19.0, 0.0, 12.0, 0.0, 0.0, 19.5, 9.0, 0.0, 0.0, 0.0, 1.0, 0.0)
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
Message = tuple[str, int, Any]  # topic, the bag's time, message


def header(stamp_ns: int) -> Any:
    stamp = STORE.types["builtin_interfaces/msg/Time"](stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000)
    return STORE.types["std_msgs/msg/Header"](stamp, "tof_optical")


def image(pixels: np.ndarray, encoding: str, stamp_ns: int, *, pad: int = 0, big: bool = False) -> Any:
    """A sensor_msgs/Image, its rows filled up by `pad` bytes."""
    rows = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, pad)), constant_values=99)
    make = STORE.types["sensor_msgs/msg/Image"]
    return make(header(stamp_ns), *pixels.shape, encoding, int(big), rows.shape[1], rows.ravel())


def info(model: str = "plumb_bob", d: tuple[float, ...] = (0.1, -0.2, 0.001, 0.002, 0.03), **values: Any) -> Any:
    region = STORE.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    fields = {"height": H, "width": W, "k": K, "p": P} | values
    k, p = np.array(fields["k"]), np.array(fields["p"])
    make = STORE.types["sensor_msgs/msg/CameraInfo"]
    return make(header(0), fields["height"], fields["width"], model, np.array(d), k, np.eye(3).ravel(), p, 0, 0, region)


def bag(path: Path, messages: list[Message], plugin: str = "MCAP") -> Path:
    kinds: dict[str, Any] = {}
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[plugin]) as writer:
        for topic, time_ns, message in messages:
            kind = message.__msgtype__
            if topic not in kinds:
                kinds[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(kinds[topic], time_ns, STORE.serialize_cdr(message, kind))
    return path


def depth_mm(i: int) -> np.ndarray:
    image = (1000 + 10 * i + np.arange(W * H).reshape(H, W)).astype(np.uint16)
    image[0, :4] = 0
    return image


def take(infos: Mapping[str, Any] | None = None) -> list[Message]:
    """Three frames of depth and infrared of one stamp, 5 ms late in the bag; infrared precedes depth in the second."""
    found: list[Message] = [(topic, BEGAN, message) for topic, message in (infos or {"/tof/depth/camera_info": info()}).items()]
    for i in range(3):
        stamp = BEGAN + 40_000_000 * i
        pair = [
            ("/tof/depth/image_raw", stamp + 5_000_000, image(depth_mm(i), "16UC1", stamp, pad=2 * i)),
            ("/tof/ir/image_raw", stamp + 6_000_000, image(depth_mm(i) // 3, "mono16", stamp, big=i == 2)),
        ]
        found += pair[::-1] if i == 1 else pair
    return found
