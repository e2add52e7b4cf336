"""Bags of ROS 2, written by `rosbags`, which knows nothing of us: what becomes of their images, stamps and lenses."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbag_file import BEGAN, STORE, H, K, Message, P, W, bag, depth_mm, header, image, info, take

from cabinpose.core.camera import Camera
from cabinpose.core.errors import RecordingError
from cabinpose.signals.recorded import Facts, ToFFrame
from cabinpose.store.convert.rosbag2 import read_rosbag2


def frames_of(path: Path, **options: Any) -> list[tuple[int, int | None, ToFFrame]]:
    return [(host, device, m) for host, device, m in read_rosbag2(path, **options) if isinstance(m, ToFFrame)]


def facts_of(path: Path) -> Mapping[str, Any]:
    return next(m.values for _, _, m in read_rosbag2(path) if isinstance(m, Facts))


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
def test_depth_and_infrared(tmp_path: Path, plugin: str) -> None:
    path = bag(tmp_path / "bag", take(), plugin)
    (file,) = (p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))
    for each in (path, file):  # the folder, and its file alone
        found = frames_of(each)
        assert [device for _, device, _ in found] == [BEGAN + 40_000_000 * i for i in range(3)]
        assert [host - device for host, device, _ in found] == [5_000_000] * 3  # type: ignore[operator]
        for i, (_, _, frame) in enumerate(found):
            assert (frame.depth == depth_mm(i)).all()
            assert (frame.amplitude == depth_mm(i) // 3).all()
            assert frame.depth_unit_m == 0.001
            np.testing.assert_array_equal(frame.camera_k.ravel(), K)
            np.testing.assert_array_equal(frame.camera_dist, (0.1, -0.2, 0.001, 0.002, 0.03))
            np.testing.assert_array_equal(frame.amplitude_dist, frame.camera_dist)
    facts = facts_of(path)
    assert facts["topics"] == {"depth": "/tof/depth/image_raw", "infrared": "/tof/ir/image_raw"}
    assert (facts["camera_info"], facts["frame_id"], facts["encoding"]) == ("/tof/depth/camera_info", "tof_optical", "16UC1")


def test_depth_in_metres(tmp_path: Path) -> None:
    metres = np.linspace(0.2, 3.0, W * H, dtype=np.float32).reshape(H, W)
    metres[0, :5] = (np.nan, np.inf, -1.0, 0.0, 17.0)  # the last is beyond 65535 steps
    path = bag(tmp_path / "bag", [("/camera_info", 5, info()), ("/depth", 7, image(metres, "32FC1", 0))])
    ((host, device, frame),) = frames_of(path)
    assert (host, device) == (7, None)  # no stamp
    assert np.isnan(frame.depth_m()[0, :5]).all()
    np.testing.assert_allclose(frame.depth_m()[1:], metres[1:], atol=0.000126)
    assert frame.amplitude.shape == (0, 0)


def test_images_without_the_other_of_their_stamp(tmp_path: Path) -> None:
    messages = [m for m in take() if m[:2] != ("/tof/depth/image_raw", BEGAN + 45_000_000)]
    del messages[-1]  # the infrared image of the third
    with pytest.warns(UserWarning, match="1 infrared images have no depth"):
        found = frames_of(bag(tmp_path / "bag", messages))
    assert [frame.amplitude.shape for _, _, frame in found] == [(H, W), (0, 0)]
    messages = take()
    late = [("/tof/ir/image_raw", BEGAN + 10**9 + i, messages[k][2]) for i, k in enumerate((2, 3, 6))]
    deep = [("/tof/depth/image_raw", BEGAN + 10**8 + i, image(depth_mm(i), "16UC1", BEGAN + 1 + i)) for i in range(25)]
    found = frames_of(bag(tmp_path / "late", [messages[0], messages[1], messages[4], messages[5], *deep, *late]))
    assert [stamp for _, stamp, frame in found if frame.amplitude.size] == [BEGAN + 40_000_000 * i for i in range(3)]
    many: list[Message] = [("/d/camera_info", 0, info())]
    many += [("/d/image", i, image(depth_mm(i), "16UC1", i + 1)) for i in range(40)]
    many += [("/d/ir", 50 + i, image(depth_mm(i), "mono16", 1000 + i)) for i in range(3)]
    with pytest.warns(UserWarning, match="3 infrared"):
        assert [device for _, device, _ in frames_of(bag(tmp_path / "many", many))] == list(range(1, 41))


def test_topics_are_named_where_there_are_several(tmp_path: Path) -> None:
    more = [("/other/depth", BEGAN + 9, image(depth_mm(7), "16UC1", 3)), ("/other/camera_info", BEGAN, info(d=()))]
    path = bag(tmp_path / "bag", take() + more)
    with pytest.raises(RecordingError, match="2 topics of depth") as error:
        frames_of(path)
    assert error.value.hint == "name one with --topic, of: /other/depth, /tof/depth/image_raw"
    ((_, _, frame),) = frames_of(path, topics=("/other/depth",))
    assert (frame.depth == depth_mm(7)).all()
    assert not frame.camera_dist.any()
    assert len(frames_of(path, topics=("/tof/depth/image_raw",))) == 3
    both = frames_of(path, topics=("/tof/ir/image_raw", "/tof/depth/image_raw"))
    assert (both[0][2].amplitude == depth_mm(0) // 3).all()


def test_rectified_images_go_with_the_projection_matrix(tmp_path: Path) -> None:
    messages = [("/d/camera_info", 0, info()), ("/d/image_rect_raw", 1, image(depth_mm(0), "16UC1", 2))]
    ((_, _, frame),) = frames_of(bag(tmp_path / "bag", messages))
    np.testing.assert_array_equal(frame.camera_k, np.array(P).reshape(3, 4)[:, :3])
    assert not frame.camera_dist.any()


def test_a_rational_lens_is_fitted(tmp_path: Path) -> None:
    """Against OpenCV's own projection by the eight coefficients (k1 k2 p1 p2 k3 k4 k5 k6, in ROS' order)."""
    k, size = np.array((252.0, 0, 160, 0, 252, 144, 0, 0, 1)), (320, 288)
    d = (0.45, 0.05, 0.0002, -0.0001, 0.003, 0.78, 0.12, 0.01)
    lens = info("rational_polynomial", d, k=k, width=size[0], height=size[1])
    pixels = np.full(size[::-1], 1500, np.uint16)
    path = bag(tmp_path / "bag", [("/d/camera_info", 0, lens), ("/d/image_raw", 1, image(pixels, "16UC1", 2))])
    ((_, _, frame),) = frames_of(path)
    points = np.array([(x, y, 1.0) for x in (-0.5, -0.1, 0.4) for y in (-0.4, 0.0, 0.45)])
    theirs = cv2.projectPoints(points, np.zeros(3), np.zeros(3), k.reshape(3, 3), np.array(d))[0][:, 0]
    fitted = frame.camera_k
    ours = Camera(*size, fitted[0, 0], fitted[1, 1], fitted[0, 2], fitted[1, 2], tuple(frame.camera_dist)).project(points)
    np.testing.assert_allclose(ours, theirs, atol=0.05)
    assert np.abs(points[:, :2] * 252 + (160, 144) - theirs).max() > 5  # it is distorted
    facts = facts_of(path)
    assert facts["fit_rms_px"] < 0.1
    assert facts["d"] == list(d)


def compressed(kind: str = "CompressedImage") -> Any:
    return STORE.types[f"sensor_msgs/msg/{kind}"](header(1), "16UC1; compressedDepth", np.zeros(20, np.uint8))


def short() -> Any:
    found = image(depth_mm(0), "16UC1", 1)
    found.data = found.data[:-1]
    return found


RGB = image(depth_mm(0), "bgr8", 1)
DEPTH, INFO = image(depth_mm(0), "16UC1", 1), info()


@pytest.mark.parametrize(
    ("messages", "topics", "message", "hint"),
    [
        ({"/d/image": DEPTH}, (), "has no /d/camera_info", "record the camera_info"),
        ({"/d/image": DEPTH, "/a/camera_info": INFO, "/b/camera_info": INFO}, (), "has no /d/camera_info", "record"),
        ({"/d/image": DEPTH, "/d/camera_info": info(width=48)}, (), "is of 48x18, /d/image of 24x18", "of these images"),
        ({"/d/image": DEPTH, "/d/camera_info": info(k=(0.0,) * 9)}, (), "without calibration", "camera_calibration"),
        ({"/d/image": DEPTH, "/d/camera_info": info("equidistant", (0.1,) * 4)}, (), "equidistant of 4", "plumb_bob of 5"),
        ({"/d/image": DEPTH, "/d/camera_info": info("plumb_bob", (0.1,) * 4)}, (), "plumb_bob of 4", "plumb_bob of 5"),
        ({"/c": RGB, "/d/camera_info": INFO}, (), r"no depth images; others: /c \(bgr8\)", "16UC1 or 32FC1"),
        ({"/c": RGB, "/d/image": DEPTH, "/d/camera_info": INFO}, ("/c",), r"/c \(bgr8\) has another encoding", "known: 16UC1"),
        ({"/d/compressedDepth": compressed()}, (), "no depth images; compressed: /d/compressedDepth", "republish"),
        ({"/d/compressedDepth": compressed()}, ("/d/compressedDepth",), "/d/compressedDepth is compressed", "republish"),
        ({"/d/image": DEPTH, "/d/camera_info": INFO}, ("/x",), "has no images /x", "it has: /d/image"),
        ({"/d/image": short(), "/d/camera_info": INFO}, (), "863 bytes for 18 rows of 48, 24 px each", "copy it again"),
        (
            {"/d/image": DEPTH, "/d/camera_info": INFO, "/i": image(depth_mm(0)[:9], "mono16", 1)}, (), "24x9 beside 24x18",
            "topics of one size",
        ),
        (
            {"/d/image": DEPTH, "/d/camera_info": INFO, "/i": image(depth_mm(0), "mono16", 1),
             "/j": image(depth_mm(0), "mono16", 1)}, (), "2 topics of infrared", "beside that of depth, of: /i, /j",
        ),
        ({"/d/camera_info": INFO}, (), "no depth images; others: none", "16UC1"),
    ],
)  # fmt: skip
def test_bags_of_something_else(
    tmp_path: Path, messages: Mapping[str, Any], topics: tuple[str, ...], message: str, hint: str
) -> None:
    path = bag(tmp_path / "bag", [(topic, i, each) for i, (topic, each) in enumerate(messages.items())])
    with pytest.raises(RecordingError, match=message) as error:
        frames_of(path, topics=topics)
    assert hint in str(error.value.hint)


@pytest.mark.parametrize(
    "harm",
    [
        lambda path: (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}"),
        lambda path: (path / "metadata.yaml").unlink(),
        lambda path: (path / "bag.mcap").unlink(),
        lambda path: (path / "bag.mcap").write_bytes((path / "bag.mcap").read_bytes()[:-900]),
        lambda path: (path / "bag.mcap").write_bytes(bytes(1000)),
    ],
)
def test_damaged(tmp_path: Path, harm: Callable[[Path], Any]) -> None:
    path = bag(tmp_path / "bag", take())
    harm(path)
    with pytest.raises(RecordingError, match=r"cannot read .* as a bag of ROS 2"):
        frames_of(path)


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    path = bag(tmp_path / "bag", take())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(frames_of(path)) == 3
    (path / "metadata.yaml").write_text((path / "metadata.yaml").read_text().replace("message_count: 3", "message_count: 5"))
    with pytest.warns(UserWarning, match="it claims 5 images /tof/depth/image_raw and gives 3"):
        frames_of(path)


def test_other_files(tmp_path: Path) -> None:
    for name, message in (("a.bag", "a bag of ROS 1"), ("a.txt", "cannot read .*a.txt as a bag of ROS 2")):
        (tmp_path / name).write_bytes(b"#ROSBAG V2.0\n")
        with pytest.raises(RecordingError, match=message):
            frames_of(tmp_path / name)
