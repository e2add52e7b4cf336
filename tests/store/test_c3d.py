"""C3D: held against ezc3d itself on a real file and on files written by it; round trips."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import MocapError, RecordingError
from cabinpose.signals.recorded import Channels, Facts, JointAngles, Markers, Message, SegmentPoses
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.c3d_write import write_c3d

ezc3d = pytest.importorskip("ezc3d")

REAL = "mocap/vicon_two_subjects.c3d"


def of(rows: list, kind: type, subject: str | None = None) -> list[tuple[int, Message]]:
    found = [(device_ns, message) for _, device_ns, message in rows if isinstance(message, kind)]
    return [(time, message) for time, message in found if subject is None or message.subject == subject]


def plain_file(path: Path, **point: list) -> Path:
    """Four frames of three points at 50 Hz, written by ezc3d; the second point is occluded in frame 2."""
    file = ezc3d.c3d()
    points = np.ones((4, 3, 4))
    points[:3] = np.arange(36).reshape(3, 3, 4)
    residuals = np.full((1, 3, 4), 2.0)
    residuals[0, 1, 2] = -1
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = residuals
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, 3, 4), bool)
    file["parameters"]["POINT"]["RATE"]["value"] = [50.0]
    for name, value in {"LABELS": ["A:one", "A:two", "*7"], "UNITS": ["mm"], "Y_SCREEN": ["+Z"], **point}.items():
        file.add_parameter("POINT", name, value)
    file["data"]["analogs"] = np.arange(16.0).reshape(1, 2, 8)
    file["parameters"]["ANALOG"]["RATE"]["value"] = [100.0]
    file.add_parameter("ANALOG", "LABELS", ["emg", "force"])
    file.add_parameter("ANALOG", "UNITS", ["V", "N"])
    file.add_parameter("EVENT", "USED", [1])
    file.add_parameter("EVENT", "TIMES", np.array([[1.0], [0.04]]))
    file.add_parameter("EVENT", "LABELS", ["Foot Strike"])
    file.add_parameter("EVENT", "CONTEXTS", ["Left"])
    file.write(str(path))
    return path


@pytest.mark.real_data
def test_a_real_file_is_what_ezc3d_says(real_data: Callable[[str], Path]) -> None:
    path = real_data(REAL)
    rows = list(read_c3d(path))
    file = ezc3d.c3d(str(path))
    points, residuals = file["data"]["points"], file["data"]["meta_points"]["residuals"][0]
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    column = {label: i for i, label in enumerate(labels)}
    seen = 0
    for subject in ("boite", "Daphnee"):
        for k, (time, markers) in enumerate(of(rows, Markers, subject)):
            assert time == 10_000_000 * k
            columns = [column[f"{subject}:{name}"] for name in markers.names]
            expected = np.where(residuals[columns, k, None] < 0, np.nan, points[:3, columns, k].T / 1000)
            np.testing.assert_allclose(markers.position_m, expected, rtol=1e-12)
            np.testing.assert_array_equal(np.isnan(markers.residual_m), residuals[columns, k] < 0)
            seen += len(columns)
    assert seen == 51 * 580
    occluded = sum(int(np.isnan(markers.position_m[:, 0]).sum()) for _, markers in of(rows, Markers))
    assert occluded == 305
    analog = np.array([channels.values for _, channels in of(rows, Channels)])
    np.testing.assert_array_equal(analog, file["data"]["analogs"][0].T)
    assert np.diff([time for time, _ in of(rows, Channels)]).tolist() == [500_000] * 11_599
    facts = {message.about: message.values for _, message in of(rows, Facts)}
    assert (facts["points"]["rate_hz"], facts["points"]["frames"]) == (100.0, 580)
    assert facts["parameters"]["MANUFACTURER"]["SOFTWARE"] == ["Vicon Nexus"]
    assert facts["analog"]["labels"][14] == "Delt_med.EMG2"
    json.dumps([dict(values) for values in facts.values()], allow_nan=False)
    # A person's markers in the world, z up: a shoulder above a hip
    _, first = of(rows, Markers, "Daphnee")[0]
    height = dict(zip(first.names, first.position_m[:, 2].tolist(), strict=True))
    assert 0.3 < height["ACRO_tip"] - height["ASISr"] < 0.7


@pytest.mark.real_data
def test_a_real_file_goes_round(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    rows = list(read_c3d(real_data(REAL)))
    again = list(read_c3d(write_c3d(tmp_path / "again.c3d", rows)))
    assert_same(rows, again)


def assert_same(rows: list, again: list, step_m: float = 0.5e-5) -> None:
    for kind, name, tolerance in ((Markers, "position_m", 1e-7), (Markers, "residual_m", step_m), (Channels, "values", 1e-5)):
        one, two = of(rows, kind), of(again, kind)
        assert [(time, message.names) for time, message in one] == [(time, message.names) for time, message in two]
        for (_, a), (_, b) in zip(one, two, strict=True):
            np.testing.assert_allclose(getattr(b, name), getattr(a, name), rtol=1e-6, atol=tolerance)
    subjects = [[message.subject for _, message in of(side, Markers)] for side in (rows, again)]
    assert subjects[0] == subjects[1]


def test_units_occlusion_analogs_and_events(tmp_path: Path) -> None:
    rows = list(read_c3d(plain_file(tmp_path / "a.c3d"), start_ns=10**18))
    times = [time for time, _ in of(rows, Markers, "A")]
    assert times == [0, 20_000_000, 40_000_000, 60_000_000]
    assert all(host_ns == 10**18 + device_ns for host_ns, device_ns, _ in rows)
    assert [device_ns for _, device_ns, _ in rows] == sorted(device_ns for _, device_ns, _ in rows)
    _, markers = of(rows, Markers, "A")[2]
    assert markers.names == ("one", "two")
    np.testing.assert_allclose(markers.position_m[0], (0.002, 0.014, 0.026))
    assert np.isnan(markers.position_m[1]).all()
    assert markers.residual_m[0] == pytest.approx(0.002)
    assert np.isnan(markers.residual_m[1])
    assert of(rows, Markers, "")[0][1].names == ("7",)
    channels = of(rows, Channels)
    assert [time for time, _ in channels] == [10_000_000 * i for i in range(8)]
    assert channels[3][1].names == ("emg", "force")
    assert channels[3][1].values.tolist() == [3.0, 11.0]
    facts = {message.about: message.values for _, message in of(rows, Facts)}
    (event,) = facts["events"]["events"]
    assert event.pop("time_s") == pytest.approx(60.04)
    assert event == {"label": "Foot Strike", "context": "Left", "subject": "", "description": ""}


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("MM", 0.001), ("in", 0.0254)])
def test_units(tmp_path: Path, unit: str, metres: float) -> None:
    _, markers = of(list(read_c3d(plain_file(tmp_path / "a.c3d", UNITS=[unit]))), Markers, "A")[1]
    np.testing.assert_allclose(markers.position_m[0], np.array([1, 13, 25]) * metres)


@pytest.mark.parametrize("up", ["+X", "-X", "+Y", "-Y", "+Z", "-Z", "y"])
def test_the_vertical_axis_becomes_z(tmp_path: Path, up: str) -> None:
    rows = list(read_c3d(plain_file(tmp_path / "a.c3d", X_SCREEN=["+X"], Y_SCREEN=[up])))
    points = np.array([markers.position_m[0] for _, markers in of(rows, Markers, "A")]) * 1000
    x, y, z = np.arange(4.0), np.arange(12.0, 16.0), np.arange(24.0, 28.0)
    theirs = {"X": x, "Y": y, "Z": z}[up[-1].upper()]
    np.testing.assert_allclose(points[:, 2], -theirs if up[0] == "-" else theirs)
    # No mirror: the volume that three points span keeps its sign
    basis = [np.array(file_axis) for file_axis in np.eye(3)]
    assert np.linalg.det(world_of(tmp_path, up) @ np.array(basis)) == pytest.approx(1.0)


def world_of(folder: Path, up: str) -> np.ndarray:
    """The matrix that the reader applies, found by reading the three unit vectors."""
    file = ezc3d.c3d()
    points = np.ones((4, 3, 1))
    points[:3, :, 0] = np.eye(3)  # a millimetre long: too small for the markers to contradict the file
    file["data"]["points"] = points
    file["parameters"]["POINT"]["RATE"]["value"] = [50.0]
    for name, value in {"LABELS": ["a", "b", "c"], "UNITS": ["mm"], "Y_SCREEN": [up]}.items():
        file.add_parameter("POINT", name, value)
    file.write(str(folder / "axes.c3d"))
    ((_, markers),) = of(list(read_c3d(folder / "axes.c3d")), Markers)
    return markers.position_m.T * 1000


def test_what_models_add_is_no_marker(tmp_path: Path) -> None:
    path = plain_file(tmp_path / "a.c3d", ANGLES=["A:two"], POWERS=["*7"], ANGLE_UNITS=["deg"])
    rows = list(read_c3d(path))
    assert of(rows, Markers)[0][1].names == ("one",)
    _, angles = of(rows, JointAngles)[1]
    assert (angles.subject, angles.names) == ("A", ("two",))
    np.testing.assert_allclose(angles.angles, np.radians([[5.0, 17.0, 29.0]]))
    assert np.isnan(of(rows, JointAngles)[2][1].angles).all()
    powers = [message for _, message in of(rows, Channels) if message.names == ("7.x", "7.y", "7.z")]
    np.testing.assert_allclose(powers[1].values, (9, 21, 33))


def test_subjects_get_codes(tmp_path: Path) -> None:
    rows = list(read_c3d(plain_file(tmp_path / "a.c3d"), subjects=["S17"]))
    assert {message.subject for _, message in of(rows, Markers)} == {"S17", ""}


def recording(rate_hz: float = 100.0, frames: int = 6, residual: float = 0.0004) -> list:
    rng = np.random.default_rng(4)
    rows: list = [(0, 0, Facts("events", {"events": [{"label": "Start", "context": "General", "time_s": 61.5}]}))]
    for k in range(frames):
        time = round(k * 1e9 / rate_hz)
        position, residuals = rng.normal(size=(3, 3)), np.round(rng.uniform(0, residual, 3), 5)
        position[k % 3] = residuals[k % 3] = np.nan
        rows.append((time + 5, time, Markers("S1", ("a", "b", "c"), position, residuals)))
        rows.append((time + 5, time, Markers("", ("12",), rng.normal(size=(1, 3)), np.zeros(1))))
        rows.append((time + 5, time, SegmentPoses("S1", ("Root",), np.zeros((1, 3)), np.ones((1, 4)))))
        rows += [(time, time + round(i * 0.25e9 / rate_hz), Channels(("u", "v"), rng.normal(size=2))) for i in range(4)]
    return rows


def test_a_recording_goes_round_with_residuals(tmp_path: Path) -> None:
    rows = recording()
    path = write_c3d(tmp_path / "a.c3d", rows)
    again = list(read_c3d(path))
    assert_same(rows, again, step_m=1e-9)  # residuals of 0.01 mm steps are kept exactly
    facts = {message.about: message.values for _, message in of(again, Facts)}
    assert facts["events"]["events"][0]["time_s"] == pytest.approx(61.5)
    assert facts["points"]["rate_hz"] == 100.0
    with path.open("rb") as file:  # the header says what the parameters say
        file.seek(12)
        assert struct.unpack("<f", file.read(4))[0] == pytest.approx(-0.01)


def test_large_residuals_are_kept_to_a_255th(tmp_path: Path) -> None:
    rows = recording(residual=0.05)
    again = list(read_c3d(write_c3d(tmp_path / "a.c3d", rows)))
    assert_same(rows, again, step_m=0.05 / 255 / 2 * 1.01)


def test_missing_frames_are_occluded_and_the_first_frame_is_kept(tmp_path: Path) -> None:
    rows = [row for row in recording() if row[1] not in (20_000_000,)]
    late = [(host, device + 10**9, message) for host, device, message in rows if isinstance(message, Markers)]
    again = list(read_c3d(write_c3d(tmp_path / "a.c3d", late, rate_hz=100.0)))
    markers = of(again, Markers, "S1")
    assert [time for time, _ in markers] == [10**9 + 10_000_000 * k for k in range(6)]
    assert np.isnan(markers[2][1].position_m).all()
    np.testing.assert_allclose(markers[3][1].position_m, late[4][2].position_m, atol=1e-6)


def test_an_unknown_residual_becomes_zero(tmp_path: Path) -> None:
    rows = [(0, 10**7 * k, Markers("S", ("a",), np.ones((1, 3)), np.array([np.nan]))) for k in range(3)]
    again = of(list(read_c3d(write_c3d(tmp_path / "a.c3d", rows))), Markers)
    assert [markers.residual_m.tolist() for _, markers in again] == [[0.0]] * 3


def test_joint_angles_go_round(tmp_path: Path) -> None:
    rows = recording()
    rows += [(0, 10**7 * k, JointAngles("S1", ("LKnee",), np.array([[0.1 * k, 0.2, -0.3]]))) for k in range(6)]
    again = of(list(read_c3d(write_c3d(tmp_path / "a.c3d", rows))), JointAngles)
    assert [angles.names for _, angles in again] == [("LKnee",)] * 6
    np.testing.assert_allclose([a.angles[0] for _, a in again], [(0.1 * k, 0.2, -0.3) for k in range(6)], atol=1e-6)


def test_many_points_have_their_names(tmp_path: Path) -> None:
    names = tuple(f"m{i}" for i in range(600))
    rows = [(0, 10**7 * k, Markers("S", names, np.full((600, 3), k + 0.5), np.zeros(600))) for k in range(2)]
    again = of(list(read_c3d(write_c3d(tmp_path / "a.c3d", rows))), Markers)
    assert again[1][1].names == names


def test_slower_channels_are_held(tmp_path: Path) -> None:
    rows = [row for row in recording() if not isinstance(row[2], SegmentPoses)]
    rows += [(0, 10**7 * k, Channels(("slow",), np.array([float(k)]))) for k in range(6)]
    channels = of(list(read_c3d(write_c3d(tmp_path / "a.c3d", rows))), Channels)
    assert channels[0][1].names == ("u", "v", "slow")
    assert [message.values[2] for _, message in channels] == [float(i // 4) for i in range(24)]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "no markers"),
        (
            [(0, ns, Markers("S", ("a",), np.ones((1, 3)), np.zeros(1))) for ns in (0, 10**7, 2 * 10**7, 2 * 10**7 + 1)],
            "fall into the frame",
        ),
        ([(0, 0, Markers("S", ("a", "a"), np.ones((2, 3)), np.zeros(2)))], "one name"),
        ([(0, 10**9 * k, Markers("S", ("a",), np.ones((1, 3)), np.zeros(1))) for k in (0, 10**6)], "more than C3D counts"),
        ([*recording(), *[(0, k * 7_000_000, Channels(("x",), np.ones(1))) for k in range(9)]], "whole number"),
    ],
)
def test_what_cannot_be_written(tmp_path: Path, rows: list, message: str) -> None:
    with pytest.raises(MocapError, match=message) as raised:
        write_c3d(tmp_path / "a.c3d", rows, rate_hz=100.0)
    assert raised.value.hint
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = write_c3d(tmp_path / "a.c3d", recording())
    with pytest.raises(RecordingError):
        write_c3d(path, recording())
    write_c3d(path, recording(), overwrite=True)


@pytest.mark.parametrize("size", [0, 3, 100, 512, 600, 1500, -600, -300])
def test_a_file_that_is_cut_off_is_an_error(tmp_path: Path, size: int) -> None:
    path = plain_file(tmp_path / "a.c3d")
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(MocapError) as raised:
        list(read_c3d(path))
    assert raised.value.hint


@pytest.mark.parametrize(("point", "message"), [({"UNITS": ["parsec"]}, "parsec"), ({"Y_SCREEN": ["up"]}, "vertical")])
def test_what_cannot_be_understood(tmp_path: Path, point: dict, message: str) -> None:
    with pytest.raises(MocapError, match=message):
        list(read_c3d(plain_file(tmp_path / "a.c3d", **point)))


def test_frames_that_16_bits_do_not_count_are_not_left_out_in_silence(tmp_path: Path) -> None:
    def trial(start: list[int], end: list[int]) -> list:
        path = plain_file(tmp_path / "a.c3d")
        file = ezc3d.c3d(str(path))
        file["data"]["meta_points"]["residuals"] = np.zeros((1, 3, 4))
        file.add_parameter("TRIAL", "ACTUAL_START_FIELD", start)
        file.add_parameter("TRIAL", "ACTUAL_END_FIELD", end)
        file.write(str(path))
        return list(read_c3d(path))

    assert of(trial([1, 0], [4, 0]), Markers)
    with pytest.raises(MocapError, match="65540 frames, of which 4"):
        trial([1, 0], [4, 1])


def test_a_rate_of_zero_cannot_be_understood(tmp_path: Path) -> None:
    path = plain_file(tmp_path / "a.c3d")
    path.write_bytes(path.read_bytes().replace(struct.pack("<f", 50.0), struct.pack("<f", 0.0)))
    with pytest.raises(MocapError, match="rate"):
        list(read_c3d(path))


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(MocapError):
        read_c3d(tmp_path / "nothing.c3d")
    (tmp_path / "text.c3d").write_text("not C3D" * 200)
    with pytest.raises(MocapError, match="no C3D"):
        read_c3d(tmp_path / "text.c3d")


@pytest.mark.parametrize(
    ("name", "dimensions", "told"),
    [
        ("LABELS", bytes([255, 255]), "its parameter LABELS has 65025 bytes"),
        ("UNITS", bytes([200, 2]), "its parameter UNITS has 400"),
    ],
)
def test_a_count_is_held_against_its_place(tmp_path: Path, name: str, dimensions: bytes, told: str) -> None:
    """Before the library, which took 4.3 GB for a damaged file of 4.6 KB, sees it."""
    path = plain_file(tmp_path / "a.c3d")
    data = bytearray(path.read_bytes())
    at = data.index(name.encode(), data.index(b"ANALOG")) + len(name) + 4
    data[at : at + 2] = dimensions
    path.write_bytes(data)
    with pytest.raises(MocapError, match=told):
        list(read_c3d(path))


def test_counts_of_parameters_are_held_against_the_file(tmp_path: Path) -> None:
    path = plain_file(tmp_path / "a.c3d")
    data = bytearray(path.read_bytes())
    for name in (b"USED", b"FRAMES"):
        at = data.index(name, data.index(b"POINT")) + len(name) + 4
        data[at : at + 2] = b"\xff\xff"
    path.write_bytes(data)
    with pytest.raises(MocapError, match="claim 65535 frames of 65535 points"):
        list(read_c3d(path))
