"""Recordings as CSV tables: every number, read by the standard library, is that of its message."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import RecordingError
from cabinpose.signals.recorded import (
    Channels,
    Facts,
    JointAngles,
    Markers,
    Message,
    Sample,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    ToFFrame,
)
from cabinpose.store.convert.csv_ import write_csv
from cabinpose.store.convert.recordings import export_recording
from cabinpose.store.recording import RecordingWriter

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


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def number(cell: str) -> float:
    return float(cell) if cell else np.nan


def test_tables_hold_every_bit(tmp_path: Path) -> None:
    paths = write_csv(tmp_path / "out", samples())
    assert {p.name for p in paths} == {
        f"lab%2Fsuit.{name}.csv"
        for name in ("poses", "poses-2", "kinematics", "sensors", "joint_angles", "markers", "channels", "facts")
    }
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(p.name for p in paths)
    wide = {
        ("poses", "S01"): ("position_m", "orientation_wxyz"), ("poses-2", "S02"): ("position_m", "orientation_wxyz"),
        ("kinematics", "S01"): ("velocity", "acceleration"),
        ("sensors", "S01"): ("orientation_wxyz", "acceleration", "magnetic_field"), ("joint_angles", "S01"): ("angles",),
    }  # fmt: skip
    kinds = {"poses": SegmentPoses, "kinematics": SegmentKinematics, "sensors": SensorReadings, "joint_angles": JointAngles}
    for (name, subject), arrays in wide.items():
        kind = kinds[name.partition("-")[0]]
        true = [(s, m) for _, s in samples() for m in s.messages if isinstance(m, kind) and m.subject == subject]  # type: ignore[union-attr]
        found = table(tmp_path / "out" / f"lab%2Fsuit.{name}.csv")
        for row, (sample, message) in zip(found, true, strict=True):
            stamps = (sample.host_ns, sample.device_ns, sample.sequence)
            assert tuple(int(row[key]) if row[key] else None for key in ("host_ns", "device_ns", "sequence")) == stamps
            assert row["subject"] == subject
            columns = 0
            for array in arrays:
                axes = {"angles": "123", "orientation_wxyz": "wxyz"}.get(array, "xyz")
                for segment, values in zip(message.names, getattr(message, array), strict=True):
                    read = [number(row[f"{segment}.{array}_{axis}"]) for axis in axes]
                    np.testing.assert_array_equal(read, values)
                    columns += len(axes)
            assert len(row) == 4 + columns
    markers = [(m.subject, n, at, r) for _, s in samples() for m in s.messages if isinstance(m, Markers)
               for n, at, r in zip(m.names, m.position_m, m.residual_m, strict=True)]  # fmt: skip
    for row, (subject, name, at, residual) in zip(table(tmp_path / "out/lab%2Fsuit.markers.csv"), markers, strict=True):
        assert (row["subject"], row["marker"]) == (subject, name)
        np.testing.assert_array_equal([number(row[f"position_m_{axis}"]) for axis in "xyz"], at)
        np.testing.assert_array_equal(number(row["residual_m"]), residual)
    told = table(tmp_path / "out/lab%2Fsuit.facts.csv")
    assert [(row["about"], json.loads(row["values"])) for row in told] == [("weather", messages(np.random, 0)[-1].values)] * 5  # type: ignore[arg-type,union-attr]
    with pytest.raises(RecordingError, match="is not empty"):
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


def test_a_failed_export_leaves_nothing(tmp_path: Path) -> None:
    def breaks() -> Iterator[tuple[str, Sample]]:
        yield from samples()
        raise RecordingError("the recording is damaged")

    with pytest.raises(RecordingError, match="damaged"):
        write_csv(tmp_path / "new", breaks())
    assert list(tmp_path.iterdir()) == []
