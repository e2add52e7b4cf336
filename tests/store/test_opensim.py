"""OpenSim's .trc and .sto: held against files written by hand after OpenSim's documentation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from opensim_text import ZUP_FROM_YUP, read_sto, read_trc
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import MocapError, RecordingError
from cabinpose.signals.recorded import Facts, JointAngles, Markers, SegmentPoses
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.opensim import write_sto, write_trc

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


def test_trc_is_written_as_opensim_does(tmp_path: Path) -> None:
    # OpenSim: x forward, y up, z right. Ours: x forward, y left, z up.
    places = {0: [(1.0, -3.0, 2.0), (0.001, -0.003, 0.002)], 2: [(1.002, -3.002, 2.002), (0.004, -0.006, 0.005)]}
    places[1] = [(1.001, -3.001, 2.001), (np.nan,) * 3]
    rows = [(0, 0, Facts("points", {"rate_hz": 50.0}))]
    rows += [(0, 5 * 10**8 + k * 2 * 10**7, Markers("S", ("C7", "T10"), np.array(places[k]), np.zeros(2))) for k in range(3)]
    assert write_trc(tmp_path / "walk.trc", rows).read_text() == TRC


@pytest.mark.real_data
def test_a_real_trial_goes_through_trc(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    rows = list(read_c3d(real_data("mocap/vicon_two_subjects.c3d")))
    names, times, positions = read_trc(write_trc(tmp_path / "a.trc", rows, subject="Daphnee"))
    once = [(time, m) for _, time, m in rows if isinstance(m, Markers) and m.subject == "Daphnee"]
    np.testing.assert_allclose(times, [time / 1e9 for time, _ in once], atol=1e-9)
    for (_, message), position in zip(once, positions, strict=True):
        assert list(message.names) == names
        np.testing.assert_allclose(position, message.position_m, atol=1e-9)


def test_frames_that_are_missing_are_empty(tmp_path: Path) -> None:
    rows = [(0, 10**7 * k, Markers("S", ("a",), np.full((1, 3), k), np.zeros(1))) for k in (0, 1, 2, 5)]
    _, _, positions = read_trc(write_trc(tmp_path / "a.trc", rows))
    assert np.isnan(positions).any(axis=(1, 2)).tolist() == [False, False, False, True, True, False]


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


@pytest.mark.parametrize("name", ["a\tb", "a\nb", "a\r", ""])
def test_names_that_break_tabbed_text_are_refused(tmp_path: Path, name: str) -> None:
    markers = [(0, 0, Markers("S", ("x", name), np.ones((2, 3)), np.zeros(2)))]
    poses = [(0, 0, SegmentPoses("S", ("x", name), np.ones((2, 3)), np.full((2, 4), 0.5)))]
    for write, rows in ((write_trc, markers), (write_sto, poses)):
        with pytest.raises(MocapError, match="no name for tab-separated text") as raised:
            write(tmp_path / "out", rows)
        assert repr(name) in str(raised.value)
        assert raised.value.hint
    assert list(tmp_path.iterdir()) == []


STO = (
    "DataRate=100.000000\nDataType=Quaternion\nversion=3\nOpenSimVersion=4.5\nendheader\ntime\tpelvis_imu\ttorso_imu\n"
    "0.000000000\t0.5,0.5,0.5,0.5\tnan,nan,nan,nan\n"
)


def test_sto_is_written_as_opensense_reads_it(tmp_path: Path) -> None:
    """The segment's x, y and z point along OpenSim's y, z and x: our z, -y and x, which is a turn by the columns below."""
    turn = Rotation.from_matrix(np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]))
    orientation = np.stack((-turn.as_quat(scalar_first=True), np.full(4, np.nan)))
    rows = [
        (0, 0, Facts("stream", {"frame_rate_hz": 100.0})),
        (0, 0, SegmentPoses("S", ("pelvis_imu", "torso_imu"), np.zeros((2, 3)), orientation)),
    ]
    assert write_sto(tmp_path / "a.sto", rows).read_text() == STO


def test_orientations_are_turned_to_y_up(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rows: list = [(0, 0, Facts("stream", {"frame_rate_hz": 100.0}))]
    true = Rotation.random(15, rng=rng).as_quat(scalar_first=True).reshape(5, 3, 4)
    true[range(5), np.arange(5) % 3] = np.nan
    rows += [(0, 10**7 * k + 10**9, SegmentPoses("S", ("a", "b", "c"), np.zeros((3, 3)), true[k])) for k in range(5)]
    names, times, found = read_sto(write_sto(tmp_path / "a.sto", rows))
    assert names == ["a", "b", "c"]
    np.testing.assert_allclose(times, 1 + np.arange(5) / 100, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(true))
    seen = ~np.isnan(true[..., 0])
    ours, theirs = (Rotation.from_quat(q[seen], scalar_first=True).as_matrix() for q in (true, found))
    np.testing.assert_allclose(ZUP_FROM_YUP @ theirs, ours, atol=1e-10)


def test_joint_angles(tmp_path: Path) -> None:
    angles = np.arange(6.0).reshape(2, 3) * 0.1 + np.arange(4.0)[:, None, None]
    rows = [(0, 10**7 * k, JointAngles("S", ("knee", "hip"), angles[k])) for k in range(4)]
    path = write_sto(tmp_path / "a.sto", rows, angles=True)
    assert "inDegrees=no" in path.read_text()
    names, times, found = read_sto(path)
    assert names == ["knee_1", "knee_2", "knee_3", "hip_1", "hip_2", "hip_3"]
    np.testing.assert_allclose(times, np.arange(4) / 100, atol=1e-9)
    np.testing.assert_allclose(found, angles.reshape(4, 6), rtol=1e-11)
