"""Bags of ROS 2 (a folder with metadata.yaml, or one .mcap or .db3 of it) with the images of a depth camera, by `rosbags`.

Depth is sensor_msgs/Image of 16UC1 (mm) or 32FC1 (m) as REP 118 has it, infrared of mono16; its camera_info is beside it, and
`image_rect` in a topic's name says that the image goes with the projection matrix of the camera_info and has no distortion
(image_pipeline's convention). The header's stamp is the device's time, the bag's the host's.

A lens of ROS's `plumb_bob` has OpenCV's five coefficients. To one of `rational_polynomial` (eight) a camera of five is fitted;
the facts say what is left, and keep the numbers.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import RationalLens, RecordingError, fit_lens, optional_module
from cabinpose.signals import Facts, ToFFrame
from cabinpose.store.convert.format import RecordingFormat
from cabinpose.store.convert.rows import Entry, Row

_IMAGE, _INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_ENCODINGS = {"16UC1": ("depth", "u2"), "32FC1": ("depth", "f4"), "mono16": ("infrared", "u2")}
_FLOAT_UNIT_M = 0.00025  # of depth in metres: up to 16.4 m
_FIELD = 1.74  # rays of a rational lens that are fitted: 60 degrees from the axis, as far as ToF cameras' light reaches
_MOST_WAITING = 32  # images without the other of their stamp
_COPY = "it may be cut short or still open: copy it again, or `ros2 bag reindex` it"


def read_rosbag2(path: Path, *, topics: tuple[str, ...] = ()) -> Iterator[Row]:
    """Facts on the camera, then its frames; depth and infrared of one stamp make one frame.

    topics: of depth, and of infrared where it is wanted; none: the only ones there are.

    Raises
    ------
    DependencyError
        Without `rosbags`.
    RecordingError
        Where the bag is damaged or of ROS 1, has no topic of depth or several, no camera_info, or an unknown lens or encoding.
    """
    hint = "pip install 'cabinpose[rosbag]'"
    highlevel = optional_module("rosbags.highlevel", purpose="a bag of ROS 2", hint=hint)
    stores = optional_module("rosbags.typesys", purpose="a bag of ROS 2", hint=hint)
    if path.suffix == ".bag":
        raise RecordingError(f"{path} is a bag of ROS 1", hint="make one of ROS 2 of it: rosbags-convert")
    try:
        # Bags of SQLite before Iron have no definitions; those of images have not changed since.
        humble = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
        with highlevel.AnyReader([path], default_typestore=humble) as bag:
            yield from _Bag(path, bag).rows(topics)
    except RecordingError:
        raise
    except Exception as error:
        raise RecordingError(f"cannot read {path} as a bag of ROS 2: {error}", hint=_COPY) from error


@dataclass(frozen=True, kw_only=True)
class Rosbag2Import:
    """How a bag of ROS 2 is read."""

    name: str = "tof"
    """Name of the source."""
    topic: tuple[str, ...] = ()
    """Topic of the depth images, and of infrared; default: the only ones there are."""


class Rosbag2Format(RecordingFormat):
    """Bags of ROS 2 with the images of a depth camera."""

    import_options = Rosbag2Import

    def read(self, path: Path, options: Rosbag2Import, _: Sequence[str]) -> Iterator[Entry]:
        """As `read_rosbag2`."""
        return ((options.name, *row) for row in read_rosbag2(path, topics=options.topic))


ROSBAG2 = Rosbag2Format()


class _Bag:
    """An open bag: its topics of a type, and their messages."""

    def __init__(self, path: Path, reader: Any) -> None:
        self.path, self._reader = path, reader

    def of(self, kind: str) -> list[str]:
        return sorted({c.topic for c in self._reader.connections if c.msgtype == kind and c.msgcount})

    def messages(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Topic, the bag's time and message, in the order of the bag."""
        chosen = [connection for connection in self._reader.connections if connection.topic in topics]
        for connection, time_ns, data in self._reader.messages(chosen):
            yield connection.topic, time_ns, self._reader.deserialize(data, connection.msgtype)

    def first(self, topic: str) -> Any:
        return next(self.messages(topic))[2]

    def rows(self, topics: tuple[str, ...]) -> Iterator[Row]:
        chosen = self._choose(topics)
        first = self.first(chosen["depth"])
        info_topic, info = self._info(chosen["depth"], first)
        rectified = "image_rect" in chosen["depth"].rpartition("/")[2]
        camera_k, camera_dist, lens = _camera(info, rectified, f"{self.path}: {info_topic}")
        unit_m = 0.001 if first.encoding == "16UC1" else _FLOAT_UNIT_M
        told = {"topics": chosen, "camera_info": info_topic, "frame_id": first.header.frame_id, "encoding": first.encoding}
        facts = Facts("camera", {"vendor": "ROS 2"} | told | lens)
        kinds = {topic: kind for kind, topic in chosen.items()}
        waiting: dict[int, dict[str, tuple[int, NDArray[Any]]]] = {}
        lost, begun = 0, False
        came: Counter[str] = Counter()
        for topic, bag_ns, image in self.messages(*kinds):
            came[topic] += 1
            stamp = image.header.stamp.sec * 1_000_000_000 + image.header.stamp.nanosec
            if not begun:
                yield bag_ns, stamp or None, facts
                begun = True
            if (image.width, image.height) != (first.width, first.height):
                wrong = f"{self.path}: {topic} has an image of {image.width}x{image.height} beside {first.width}x{first.height}"
                raise RecordingError(wrong, hint="name topics of one size with --topic")
            waiting.setdefault(stamp, {})[kinds[topic]] = (bag_ns, _pixels(image, f"{self.path}: {topic}"))
            whole = len(waiting[stamp]) == len(kinds)
            for ready in [stamp] if whole else sorted(waiting)[: max(len(waiting) - _MOST_WAITING, 0)]:
                images = waiting.pop(ready)
                lost += "depth" not in images
                yield from _frame(ready, images, unit_m, camera_k, camera_dist)
        for stamp in sorted(waiting):
            lost += "depth" not in waiting[stamp]
            yield from _frame(stamp, waiting[stamp], unit_m, camera_k, camera_dist)
        for topic in kinds:
            claimed = sum(c.msgcount for c in self._reader.connections if c.topic == topic)
            if came[topic] < claimed:
                lacking = f"{self.path} is damaged: it claims {claimed} images {topic} and gives {came[topic]}"
                warnings.warn(lacking, stacklevel=2)
        if lost:
            warnings.warn(f"{self.path}: {lost} infrared images have no depth of their stamp, and are left out", stacklevel=2)

    def _choose(self, topics: tuple[str, ...]) -> dict[str, str]:
        """The topics of depth and, if there is one, infrared."""
        there = self.of(_IMAGE)
        compressed = [topic for topic in topics or self.of(_COMPRESSED) if topic in self.of(_COMPRESSED)]
        unpack = "image_transport's `republish compressedDepth raw` makes images of them"
        for topic in topics:
            if topic in compressed:
                raise RecordingError(f"{self.path}: {topic} is compressed", hint=unpack)
            if topic not in there:
                raise RecordingError(f"{self.path} has no images {topic}", hint=f"it has: {', '.join(there) or 'none'}")
        encodings = {topic: str(self.first(topic).encoding) for topic in topics or there}
        unknown = [f"{topic} ({encoding})" for topic, encoding in encodings.items() if encoding not in _ENCODINGS]
        if topics and unknown:
            raise RecordingError(f"{self.path}: {unknown[0]} has another encoding", hint=f"known: {', '.join(_ENCODINGS)}")
        chosen: dict[str, str] = {}
        for kind in ("depth", "infrared"):
            able = [topic for topic, encoding in encodings.items() if _ENCODINGS.get(encoding, ("",))[0] == kind]
            if len(able) > 1:
                name = f"name one with --topic{' beside that of depth' if kind == 'infrared' else ''}, of: {', '.join(able)}"
                raise RecordingError(f"{self.path} has {len(able)} topics of {kind}", hint=name)
            if able:
                chosen[kind] = able[0]
        if "depth" not in chosen:
            what = f"compressed: {', '.join(compressed)}" if compressed else f"others: {', '.join(unknown) or 'none'}"
            hint = unpack if compressed else f"depth is sensor_msgs/Image of {' or '.join(list(_ENCODINGS)[:2])}"
            raise RecordingError(f"{self.path} has no depth images; {what}", hint=hint)
        return chosen

    def _info(self, topic: str, image: Any) -> tuple[str, Any]:
        """The camera_info of a topic: the one beside it, or the only one."""
        there = self.of(_INFO)
        name = f"{topic.rpartition('/')[0]}/camera_info"
        if name not in there and len(there) == 1:
            (name,) = there
        if name not in there:
            raise RecordingError(f"{self.path} has no {name}", hint="record the camera_info beside the images")
        info = self.first(name)
        if (info.width, info.height) != (image.width, image.height):
            wrong = f"{self.path}: {name} is of {info.width}x{info.height}, {topic} of {image.width}x{image.height}"
            raise RecordingError(wrong, hint="record the camera_info of these images")
        return name, info


def _camera(info: Any, rectified: bool, where: str) -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, Any]]:
    """Matrix and five coefficients of a camera_info, and what the facts say of its lens."""
    k = np.array(info.p, np.float64).reshape(3, 4)[:, :3] if rectified else np.array(info.k, np.float64).reshape(3, 3)
    d = np.zeros(0) if rectified else np.array(info.d, np.float64)
    told = {"distortion_model": info.distortion_model, "d": list(map(float, info.d)), "k": list(map(float, info.k))}
    if not (np.isfinite(k).all() and k[0, 0] > 0 and k[1, 1] > 0):
        raise RecordingError(f"{where} is of a camera without calibration", hint="calibrate it: ros2 run camera_calibration")
    if not d.any():
        return k, np.zeros(5), told
    if info.distortion_model == "plumb_bob" and len(d) == 5:
        return k, d, told
    if info.distortion_model != "rational_polynomial" or len(d) != 8:
        wrong = f"{where} has the lens {info.distortion_model or 'without a name'} of {len(d)} coefficients"
        raise RecordingError(wrong, hint="known: plumb_bob of 5, rational_polynomial of 8; or record rectified images")
    k1, k2, p1, p2, k3, k4, k5, k6 = map(float, d)
    lens = RationalLens(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), (k1, k2, k3, k4, k5, k6), p1, p2)
    try:
        fit = fit_lens(lens, info.width, info.height, _FIELD)
    except ValueError as error:
        raise RecordingError(f"{where}: {error}", hint="check its coefficients") from error
    return (
        fit.camera.k,
        np.array(fit.camera.dist),
        told | {"fit_rms_px": fit.rms_px, "fit_max_px": fit.max_px, "fit_field": _FIELD},
    )


def _pixels(image: Any, where: str) -> NDArray[Any]:
    """(H, W) of an image, whose rows may be filled up and whose bytes may be swapped."""
    if image.encoding not in _ENCODINGS:
        raise RecordingError(f"{where} changes its encoding to {image.encoding}", hint=_COPY)
    dtype = np.dtype(_ENCODINGS[image.encoding][1]).newbyteorder(">" if image.is_bigendian else "<")
    width, data = image.width * dtype.itemsize, np.asarray(image.data, np.uint8)
    if image.step < width or len(data) < image.step * image.height:
        wrong = f"{len(data)} bytes for {image.height} rows of {image.step}, {image.width} px each"
        raise RecordingError(f"{where} has an image of {wrong}", hint=_COPY)
    rows = data[: image.step * image.height].reshape(image.height, image.step)[:, :width]
    return np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="))


def _frame(
    stamp: int, images: Mapping[str, tuple[int, NDArray[Any]]], unit_m: float, k: NDArray[np.float64], dist: NDArray[np.float64]
) -> Iterator[Row]:
    """The frame of a stamp, if it has depth."""
    if "depth" not in images:
        return
    bag_ns, depth = images["depth"]
    if depth.dtype != np.uint16:
        with np.errstate(invalid="ignore"):
            steps = np.rint(depth / unit_m)
            depth = np.where((steps > 0) & (steps < 65536), steps, 0).astype(np.uint16)
    none = np.zeros((0, 0), np.uint16)
    amplitude = images["infrared"][1] if "infrared" in images else none
    yield bag_ns, stamp or None, ToFFrame(depth, unit_m, amplitude, np.zeros((0, 0), np.uint8), k, dist, dist)
