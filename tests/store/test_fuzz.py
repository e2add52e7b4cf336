"""Readers of other tools' files bear damage: see `mutations`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from adtfdat_file import write_imu
from mutations import Read, mutated, survive
from mvnx_file import moving_person, write_mvnx
from xdf_file import XdfStream, write_xdf

from cabinpose.core.errors import RecordingError
from cabinpose.core.skeleton import MVN_JOINTS, MVN_SEGMENTS
from cabinpose.signals.recorded import Channels, Facts, JointAngles, Markers, Message, SegmentPoses, SensorReadings
from cabinpose.store.convert import FORMATS, RecordingFormat
from cabinpose.store.convert.bvh_write import write_bvh
from cabinpose.store.convert.c3d_write import write_c3d
from cabinpose.store.convert.recordings import read_entries

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="a crash is looked for in a process of its own")
FEW = {"azure-mkv": 40, "adtfdat": 60, "c3d": 60, "rosbag2": 60, "xdf": 60}  # those that read slowly
MANY = {"azure-mkv": 300, "adtfdat": 500, "c3d": 300, "rosbag2": 300, "xdf": 300}
NEEDS = {"adtfdat": "adtf_file", "xdf": "pyxdf", "c3d": "ezc3d", "azure-mkv": "av", "rosbag2": "rosbags"}
READ = [name for name, form in FORMATS.items() if isinstance(form, RecordingFormat) and form.can("read")]


def rows(*kinds: type, frames: int = 4) -> Iterator[tuple[int, int, Message]]:
    rng = np.random.default_rng(0)
    joints = tuple(name for name, _, _ in MVN_JOINTS)
    yield 0, 0, Facts("S01", {"frame_rate_hz": 100.0, "points": []})
    for i, pose in enumerate(moving_person(frames, 100.0)):
        poses = SegmentPoses("S01", MVN_SEGMENTS, *pose)
        sensors = SensorReadings(
            "S01", ("Pelvis",), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3)), np.ones((1, 3)), np.ones((1, 3))
        )
        angles = JointAngles("S01", joints, rng.normal(size=(len(joints), 3)))
        points = Markers("S01", ("LASI", "RASI", "C7"), rng.normal(0, 0.002, (3, 3)) + np.eye(3), np.full(3, 0.001))
        for message in (poses, sensors, angles, points, Channels(("fx", "fz"), rng.normal(size=2))):
            if isinstance(message, kinds):
                yield i * 10_000_000, i * 10_000_000, message


def ending(name: str) -> str:
    """Of a file's name."""
    return {"azure-mkv": ".mkv", "rosbag2": ".mcap"}.get(name, f".{name}")


def originals(name: str, folder: Path) -> dict[str, bytes]:
    """Sound files of a format, by what is in them."""
    path = folder / f"sound{ending(name)}"
    if name == "azure-mkv":
        from test_azure import make_mkv, picture

        images = [(track, 1000 * i, picture(i)) for i in range(2) for track in ("DEPTH", "IR")]
        return {"frames": make_mkv(path, [*images, ("IMU", 500, bytes(range(40)))]).read_bytes()}
    if name == "rosbag2":
        from rosbag_file import bag, take

        (file,) = bag(folder / "bag", take()).glob("*.mcap")
        return {"frames": file.read_bytes()}
    if name == "mvnx":
        write_mvnx(path, rows(SegmentPoses, SensorReadings, JointAngles))
    elif name == "c3d":
        write_c3d(path, rows(Markers, JointAngles, Channels))
    elif name == "bvh":
        write_bvh(path, rows(SegmentPoses))
    elif name == "adtfdat":
        write_imu(path, [(0.5, -1.5, k) for k in range(20)])
    elif name == "xdf":
        stamps = np.arange(30) / 100
        text = [[f"event {i}"] for i in range(30)]
        force = XdfStream("plate", "Force", 100.0, ("fx", "fz"), stamps, np.ones((30, 2)), np.array([[0.0, 1.0], [0.2, 1.0]]))
        write_xdf(path, [force, XdfStream("events", "Markers", 0.0, ("what",), stamps, text)])
    return {"file": path.read_bytes()}


def reader(name: str) -> Read:
    def read(path: Path) -> None:
        for _ in read_entries(path, name):
            pass

    return read


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] if name in FEW else []) for name in READ])
def test_damaged_files_are_read_or_refused(tmp_path: Path, name: str) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    for part, content in originals(name, tmp_path).items():
        sound = tmp_path / f"sound{ending(name)}"
        sound.write_bytes(content)
        reader(name)(sound)
        done = survive(reader(name), content, tmp_path / f"{part}-damaged", ending(name), count=FEW.get(name, 200))
        assert done.read > 0
        assert done.refused > 0 or name == "azure-mkv"  # nearly all of it is images


@pytest.mark.slow
@pytest.mark.parametrize("name", READ)
def test_many_damaged_files(tmp_path: Path, name: str) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    for part, content in originals(name, tmp_path).items():
        survive(reader(name), content, tmp_path / f"{part}-damaged", ending(name), count=MANY.get(name, 1000), seed=2)


@pytest.mark.slow
def test_what_is_not_borne_is_found(tmp_path: Path) -> None:
    def refuses(path: Path) -> None:
        raise RecordingError("no")

    def fails(path: Path) -> None:
        if path.stat().st_size < 90:
            raise KeyError("a defect")

    def crashes(_: Path) -> None:
        os.abort()

    def swells(path: Path) -> None:
        np.ones(1 << 27).sum()

    data = bytes(100)
    assert survive(refuses, data, tmp_path / "a", ".x", count=5).refused == 5
    for read, message in ((fails, "a defect"), (crashes, "a crash or a hang"), (swells, "MB more")):
        with pytest.raises(AssertionError, match=message):
            survive(read, data, tmp_path / read.__name__, ".x", count=50 if read is fails else 1)
    rng = np.random.default_rng(0)
    assert len({mutated(data, rng) for _ in range(100)}) > 80
