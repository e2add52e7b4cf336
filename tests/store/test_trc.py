"""OpenSim's .trc and .sto: held against files written by hand after OpenSim's documentation; round trips."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import MocapError, RecordingError
from cabinpose.core.recorded import Channels, Facts, JointAngles, Markers, SegmentPoses
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.sto import read_sto, write_sto
from cabinpose.store.convert.trc import read_trc, write_trc

TRC = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "50.000000\t50.000000\t3\t2\tmm\t50.000000\t1\t3\n"
    "Frame#\tTime\tC7\t\t\tT10\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
    "\n"
    "1\t0.500000000\t1000.000000\t2000.000000\t3000.000000\t1.000000\t2.000000\t3.000000\n"
    "2\t0.520000000\t1001.000000\t2001.000000\t3001.000000\t\t\t\n"
    "3\t0.540000000\t1002.000000\t2002.000000\t3002.000000\t4.000000\t5.000000\t6.000000\n"
)


def of(rows: list, kind: type) -> list:
    return [(device_ns, message) for _, device_ns, message in rows if isinstance(message, kind)]


def test_trc_is_turned_upright(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(TRC)
    rows = list(read_trc(tmp_path / "a.trc", subject="S1", start_ns=7))
    assert rows[0][2] == Facts("points", {"rate_hz": 50.0, "units": ["mm"]})
    markers = of(rows, Markers)
    assert [time for time, _ in markers] == [500_000_000, 520_000_000, 540_000_000]
    assert [host_ns for host_ns, _, _ in rows[1:]] == [500_000_007, 520_000_007, 540_000_007]
    assert markers[0][1].names == ("C7", "T10")
    assert markers[0][1].subject == "S1"
    # OpenSim: x forward, y up, z right. Ours: x forward, y left, z up.
    np.testing.assert_allclose(markers[0][1].position_m, [(1.0, -3.0, 2.0), (0.001, -0.003, 0.002)])
    assert np.isnan(markers[1][1].position_m[1]).all()
    assert np.isnan(markers[0][1].residual_m).all()
    upright = of(list(read_trc(tmp_path / "a.trc", y_up=False)), Markers)
    np.testing.assert_allclose(upright[0][1].position_m[0], (1.0, 2.0, 3.0))


def test_trc_is_written_as_opensim_does(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(TRC)
    write_trc(tmp_path / "walk.trc", read_trc(tmp_path / "a.trc"))
    assert (tmp_path / "walk.trc").read_text() == TRC


@pytest.mark.real_data
def test_a_real_trial_goes_through_trc(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    rows = list(read_c3d(real_data("mocap/vicon_two_subjects.c3d")))
    again = of(list(read_trc(write_trc(tmp_path / "a.trc", rows, subject="Daphnee"), subject="Daphnee")), Markers)
    once = [(time, message) for time, message in of(rows, Markers) if message.subject == "Daphnee"]
    assert [time for time, _ in again] == [time for time, _ in once]
    for (_, a), (_, b) in zip(once, again, strict=True):
        assert a.names == b.names
        np.testing.assert_allclose(b.position_m, a.position_m, atol=1e-9)


def test_frames_that_are_missing_are_empty(tmp_path: Path) -> None:
    rows = [(0, 10**7 * k, Markers("S", ("a",), np.full((1, 3), k), np.zeros(1))) for k in (0, 1, 2, 5)]
    again = of(list(read_trc(write_trc(tmp_path / "a.trc", rows))), Markers)
    assert [bool(np.isnan(message.position_m).any()) for _, message in again] == [False, False, False, True, True, False]


def test_one_subject_is_written(tmp_path: Path) -> None:
    rows = [(0, 0, Markers(name, ("a",), np.ones((1, 3)), np.zeros(1))) for name in ("S1", "S2", "")]
    with pytest.raises(MocapError, match="S1, S2"):
        write_trc(tmp_path / "a.trc", rows)
    with pytest.raises(MocapError, match="no markers"):
        write_trc(tmp_path / "a.trc", [])
    write_trc(tmp_path / "a.trc", rows, subject="S2")
    with pytest.raises(RecordingError, match="exists"):
        write_trc(tmp_path / "a.trc", rows, subject="S2")


def test_times_that_lie_far_apart_are_an_error(tmp_path: Path) -> None:
    rows = [(0, time, Markers("S", ("a",), np.ones((1, 3)), np.zeros(1))) for time in (0, 10**7, 10**18)]
    with pytest.raises(MocapError, match="frames from the first"):
        write_trc(tmp_path / "a.trc", rows, rate_hz=100.0)


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ("PathFileType", "Path", "PathFileType"),
        ("\tmm\t", "\tyards\t", "yards"),
        ("\t3\t2\tmm", "\t3\t9\tmm", "9 markers"),
        ("1000.000000", "far", "line 7"),
        ("0.520000000", "inf", "line 8"),
    ],
)
def test_damaged_trc(tmp_path: Path, was: str, becomes: str, message: str) -> None:
    (tmp_path / "a.trc").write_text(TRC.replace(was, becomes, 1))
    with pytest.raises(MocapError, match=message) as raised:
        list(read_trc(tmp_path / "a.trc"))
    assert raised.value.hint


@pytest.mark.parametrize("name", ["a\tb", "a\nb", "a\r", ""])
def test_names_that_break_tabbed_text_are_refused(tmp_path: Path, name: str) -> None:
    markers = [(0, 0, Markers("S", ("x", name), np.ones((2, 3)), np.zeros(2)))]
    poses = [(0, 0, SegmentPoses("S", ("x", name), np.ones((2, 3)), np.ones((2, 4))))]
    for write, rows in ((write_trc, markers), (write_sto, poses)):
        with pytest.raises(MocapError, match="no name for tab-separated text") as raised:
            write(tmp_path / "out", rows)
        assert repr(name) in str(raised.value)
        assert raised.value.hint
    assert list(tmp_path.iterdir()) == []


STO = (
    "DataRate=100.000000\nDataType=Quaternion\nversion=3\nOpenSimVersion=4.5\nendheader\ntime\tpelvis_imu\ttorso_imu\n"
    "0.000000000\t1,0,0,0\t0.6,0.8,0,0\n0.010000000\t0,0,1,0\tnan,nan,nan,nan\n"
)


def test_sto_orientations_are_turned_upright(tmp_path: Path) -> None:
    (tmp_path / "a.sto").write_text(STO)
    rows = list(read_sto(tmp_path / "a.sto", subject="S"))
    poses = of(rows, SegmentPoses)
    assert [time for time, _ in poses] == [0, 10_000_000]
    assert poses[0][1].names == ("pelvis_imu", "torso_imu")
    # What points along OpenSim's y (up) points along our z.
    upright = Rotation.from_quat(poses[0][1].orientation_wxyz[0], scalar_first=True)
    np.testing.assert_allclose(upright.apply((0.0, 1.0, 0.0)), (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(upright.apply((1.0, 0.0, 0.0)), (1.0, 0.0, 0.0), atol=1e-12)
    assert np.isnan(poses[1][1].orientation_wxyz[1]).all()
    assert np.isnan(poses[0][1].position_m).all()


def test_sto_orientations_go_round(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rows: list = [(0, 0, Facts("stream", {"frame_rate_hz": 100.0}))]
    for k in range(5):
        orientation = Rotation.random(3, rng=rng).as_quat(scalar_first=True)
        orientation[k % 3] = np.nan
        rows.append((0, 10**7 * k + 10**9, SegmentPoses("S", ("a", "b", "c"), np.zeros((3, 3)), orientation)))
    path = write_sto(tmp_path / "a.sto", rows)
    assert path.read_text().splitlines()[:6] == [*STO.splitlines()[:5], "time\ta\tb\tc"]
    again = of(list(read_sto(path, subject="S")), SegmentPoses)
    for (time, a), (time_again, b) in zip(of(rows, SegmentPoses), again, strict=True):
        assert time == time_again
        same = np.abs((a.orientation_wxyz * b.orientation_wxyz).sum(axis=1))
        np.testing.assert_array_equal(np.isnan(a.orientation_wxyz), np.isnan(b.orientation_wxyz))
        np.testing.assert_allclose(same[np.isfinite(same)], 1.0, atol=1e-10)


def test_joint_angles_go_round_through_sto(tmp_path: Path) -> None:
    rows = [(0, 10**7 * k, JointAngles("S", ("knee", "hip"), np.arange(6.0).reshape(2, 3) * 0.1 + k)) for k in range(4)]
    path = write_sto(tmp_path / "a.sto", rows, angles=True)
    assert "inDegrees=no" in path.read_text()
    again = of(list(read_sto(path, subject="S")), JointAngles)
    for (time, a), (time_again, b) in zip(of(rows, JointAngles), again, strict=True):
        assert (time, a.names) == (time_again, b.names)
        np.testing.assert_allclose(b.angles, a.angles, rtol=1e-11)


def test_other_tables_are_channels(tmp_path: Path) -> None:
    (tmp_path / "a.mot").write_text("Coordinates\nversion=1\ninDegrees=yes\nendheader\ntime\tpelvis_tx\tknee\n0.5\t1.0\t90\n")
    ((time, channels),) = of(list(read_sto(tmp_path / "a.mot")), Channels)
    assert (time, channels.names, channels.values.tolist()) == (500_000_000, ("pelvis_tx", "knee"), [1.0, 90.0])


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ("endheader", "begin", "endheader"),
        ("time\t", "when\t", "time"),
        ("1,0,0,0", "1,0,0", "line 7"),
        ("0.6,0.8,0,0", "", "line 7"),
        ("\t0,0,1,0", "", "line 8"),
    ],
)
def test_damaged_sto(tmp_path: Path, was: str, becomes: str, message: str) -> None:
    (tmp_path / "a.sto").write_text(STO.replace(was, becomes, 1))
    with pytest.raises(MocapError, match=message):
        list(read_sto(tmp_path / "a.sto"))


def test_no_file(tmp_path: Path) -> None:
    for read in (read_trc, read_sto):
        with pytest.raises(MocapError):
            list(read(tmp_path / "nothing"))
        (tmp_path / "empty").write_text("")
        with pytest.raises(MocapError):
            list(read(tmp_path / "empty"))
