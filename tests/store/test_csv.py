"""Recordings as CSV tables and back; tables of others, against pandas' layout and the real gaitmap files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import RecordingError
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import (
    Channels,
    Facts,
    JointAngles,
    Markers,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    ToFFrame,
)
from cabinpose.store.convert.csv_ import read_csv, write_csv
from cabinpose.store.convert.recordings import export_recording, import_recording
from cabinpose.store.recording import Recording, RecordingWriter

NONE3, NONE4 = np.zeros((0, 3)), np.zeros((0, 4))


def messages(rng: np.random.Generator, index: int) -> tuple[Message, ...]:
    two = rng.normal(size=(2, 3))
    two[0, 0] = np.nan
    names = ("Pelvis", "Left.Hand, upper")  # points and commas in names
    markers = tuple(f"m{i}" for i in range(1 + index % 3))
    place = rng.normal(size=(len(markers), 3))
    return (
        SegmentPoses("S01", names, two, rng.normal(size=(2, 4))),
        SegmentPoses("S02", names[:1], two[:1], rng.normal(size=(1, 4))),
        SegmentKinematics("S01", names, two, two + 1, NONE3, NONE3),
        SensorReadings("S01", ("left", "right"), rng.normal(size=(2, 4)), two, NONE3, two * 2),
        JointAngles("S01", ("jKnee",), two[:1]),
        Markers("S01", markers, place, np.array([np.nan, *place[1:, 0]])),
        Markers("", ("7",), place[:1], place[:1, 0]),
        Channels(("force x", "y"), rng.normal(size=2)),
        Facts("weather", {"text": 'a "quoted", ü\n', "n": [1, 2.5, None]}),
    )


def samples() -> Iterator[tuple[str, Sample]]:
    rng = np.random.default_rng(0)
    for i in range(5):
        device = None if i == 3 else i * 10**7 - 5
        yield "lab/suit", Sample(i if i else None, 1_700_000_000_000_000_000 + i, device, b"raw", messages(rng, i))


def same(one: Message, other: Message) -> None:
    assert type(one) is type(other)
    for each in fields(one):
        a, b = getattr(one, each.name), getattr(other, each.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
            assert a.shape == b.shape
        else:
            assert a == b


def test_tables_come_back_bit_by_bit(tmp_path: Path) -> None:
    paths = write_csv(tmp_path / "out", samples())
    assert {p.name for p in paths} == {
        f"lab%2Fsuit.{name}.csv"
        for name in ("poses", "poses-2", "kinematics", "sensors", "joint_angles", "markers", "channels", "facts")
    }
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(p.name for p in paths)
    back = [row for path in paths for row in read_csv(path)]
    expected = [(s.host_ns, s.device_ns, s.sequence, m) for _, s in samples() for m in s.messages]
    assert len(back) == len(expected) == 45
    for host, device, sequence, message in expected:
        found = [
            m for h, d, q, m in back
            if (h, d, q) == (host, device, sequence) and type(m) is type(message)
            and getattr(m, "subject", "") == getattr(message, "subject", "")
        ]  # fmt: skip
        assert len(found) == 1
        same(found[0], message)
    with pytest.raises(RecordingError, match="exists"):
        write_csv(tmp_path / "out", samples())


def test_names_with_a_slash_stay_apart(tmp_path: Path) -> None:
    sources = ("a/b", "a_b", "a%2Fb", "../b")
    names = ("a/b", "a_b")
    message = Markers("S", names, np.arange(6.0).reshape(2, 3), np.zeros(2))
    given = [(source, Sample(i, i, None, b"", (message, Channels((source,), np.ones(1))))) for i, source in enumerate(sources)]
    folder = tmp_path / "tables"
    paths = write_csv(folder, given)
    assert len(set(paths)) == 8
    assert {path.parent for path in paths} == {folder}
    with RecordingWriter(tmp_path / "take.mcap") as writer:
        for source, sample in given:
            writer.write(source, sample)
    export_recording(tmp_path / "take.mcap", "csv", tmp_path / "again")
    assert {p.name for p in (tmp_path / "again").iterdir()} == {p.name for p in paths}
    import_recording(folder, "csv", tmp_path / "back.mcap")
    with Recording(tmp_path / "back.mcap") as back:
        read = [(source, sample.messages) for source, sample in back.samples()]
    assert [source for source, _ in read] == ["a-b", "a_b", "a-2fb", "b"]  # as a rig could name them
    for _, messages_of in read:
        same(message, next(m for m in messages_of if isinstance(m, Markers)))


def test_others_read_the_columns(tmp_path: Path) -> None:
    (path,) = write_csv(tmp_path, [("a", Sample(4, 10, 7, b"", (Channels(("u", "v"), np.array([0.1, 1e300])),)))])
    assert path.read_text() == "host_ns,device_ns,sequence,subject,u,v\n10,7,4,,0.1,1e+300\n"


def test_frames_leave_a_line_each(tmp_path: Path) -> None:
    depth = np.zeros((2, 4), np.uint16)
    depth[0] = 5
    k = np.array([[10.0, 0, 1], [0, 11, 2], [0, 0, 1]])
    frame = ToFFrame(depth, 1e-4, depth, np.zeros((0, 0), np.uint8), k, np.array([0.1, 0, 0, 0, 0.2]), np.zeros(5))
    (path,) = write_csv(tmp_path, [("tof", Sample(0, 1, 2, b"", (frame,)))])
    assert path.name == "tof.frames.csv"
    (row,) = csv.DictReader(path.open())
    assert (row["width"], row["height"], row["valid_share"], row["fy"], row["k3"]) == ("4", "2", "0.5", "11.0", "0.2")
    with pytest.raises(RecordingError, match="no table of messages"):
        list(read_csv(path))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda t: t.replace("host_ns", "time"), "columns are not those"),
        (lambda t: t.replace("0.5", "half"), "near line 3"),
        (lambda t: t.rstrip("\n") + ",1\n", "2 columns and 3 values"),
        (lambda t: t.replace("\n20,", "\nlate,"), "invalid literal"),
        (lambda t: "", "columns are not those"),
    ],
)
def test_damaged_tables_are_refused(tmp_path: Path, damage: Callable[[str], str], message: str) -> None:
    def two() -> list[tuple[str, Sample]]:
        return [("a", Sample(i, 10 * (i + 1), None, b"", (Channels(("u", "v"), np.array([0.5 * i, 1])),))) for i in range(2)]

    (path,) = write_csv(tmp_path, two())
    path.write_text(damage(path.read_text()))
    with pytest.raises(RecordingError, match=message):
        list(read_csv(path))
    with pytest.raises(RecordingError, match="cannot read"):
        list(read_csv(tmp_path / "b.poses.csv"))


def test_a_failed_export_leaves_nothing(tmp_path: Path) -> None:
    def breaks() -> Iterator[tuple[str, Sample]]:
        yield from samples()
        raise RecordingError("the recording is damaged")

    with pytest.raises(RecordingError, match="damaged"):
        write_csv(tmp_path, breaks())
    assert list(tmp_path.iterdir()) == []
