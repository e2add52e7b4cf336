"""SFE: a person who stands, drives and stands again, with known drift between; and lengths that should not change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import moving_body
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import AlignmentError
from cabinpose.core.skeleton import MVN_SEGMENTS
from cabinpose.evaluate.mocap.bones import bone_lengths, mvn_bones, rigid_pairs
from cabinpose.evaluate.mocap.sfe import ERROR, RATE, find_poses, sfe, sfe_run
from cabinpose.evaluate.mocap.stillness import Window
from cabinpose.signals.recorded import Markers, SegmentPoses
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.mvnx import read_mvnx

FIRST, LAST = Window("first", 0.0, 3.0), Window("last", 17.0, 20.0)


def drive() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """20 s at 30 Hz: still for 3 s, moving, and still again, elsewhere and turned by 2 rad."""
    time = np.arange(0, 20.001, 1 / 30)
    moving = (time > 3) & (time < 17)
    position, orientation = moving_body.moving(np.zeros(len(time)))
    position[moving], orientation[moving] = moving_body.moving(time[moving], amplitude=0.8)
    after = time >= 17
    position[after], orientation[after] = moving_body.turned(2.0, (4.0, -1.0, 0.3), position[after], orientation[after])
    return time, position, orientation


def test_where_and_how_the_person_stands_again_is_no_error() -> None:
    time, position, orientation = drive()
    run = sfe_run(time, position, orientation, MVN_SEGMENTS, (FIRST, LAST))
    assert run.error_m.max() < 1e-12
    assert run.drive_s == 14.0
    assert "Pelvis" not in run.names
    np.testing.assert_allclose(run.last_m, run.first_m, atol=1e-12)


def test_the_keywords_of_the_last_release_warn_and_work() -> None:
    time, position, orientation = drive()
    new = sfe_run(time, position, orientation, MVN_SEGMENTS, (FIRST, LAST))
    with pytest.warns(DeprecationWarning, match=r"poses=\(first, last\)"):
        old = sfe_run(time, position, orientation, MVN_SEGMENTS, first=FIRST, last=LAST, fit="pelvis", pelvis="Pelvis")
    np.testing.assert_array_equal(old.error_m, new.error_m)


def test_a_shift_of_one_joint_is_recovered_in_millimetres_and_by_second() -> None:
    time, position, orientation = drive()
    index = MVN_SEGMENTS.index("RightHand")
    position[time >= 17, index] += (0.012, 0.004, -0.003)  # 13 mm
    result = sfe([sfe_run(time, position, orientation, MVN_SEGMENTS, (FIRST, LAST))], rng=np.random.default_rng(0))
    assert result.summary(ERROR, name="RightHand").mean == pytest.approx(13.0)
    assert result.summary(ERROR, name="LeftHand").maximum < 1e-9
    assert result.summary(RATE, name="RightHand").mean == pytest.approx(13e3 / 14.0)
    assert result.summary(RATE).unit == "µm/s"


def test_a_drifted_pelvis_turns_the_whole_body_about_it() -> None:
    """A heading error of the pelvis of 2° moves a joint at the distance d from its axis by 2 d sin 1°."""
    time, position, orientation = drive()
    after = time >= 17
    off = Rotation.from_rotvec((0, 0, np.radians(2)))
    pelvis = MVN_SEGMENTS.index("Pelvis")
    turned = Rotation.from_quat(orientation[after, pelvis], scalar_first=True)
    orientation[after, pelvis] = (turned * off).as_quat(scalar_first=True)
    run = sfe_run(time, position, orientation, MVN_SEGMENTS, (FIRST, LAST))
    distance = np.hypot(*run.first_m[:, :2].T)
    np.testing.assert_allclose(run.error_m, np.broadcast_to(2 * distance * np.sin(np.radians(1)), run.error_m.shape), atol=1e-12)


def test_the_whole_body_is_fitted_where_there_is_no_pelvis() -> None:
    time, position, _ = drive()
    run = sfe_run(time, position, None, MVN_SEGMENTS, (FIRST, LAST), root=None)
    assert run.error_m.max() < 1e-12
    assert len(run.names) == 23


def test_poses_are_found_and_sitting_still_is_none() -> None:
    time, position, orientation = drive()
    seated = (time > 8) & (time < 12)
    position[seated], orientation[seated] = moving_body.moving(np.full(seated.sum(), 0.9), amplitude=1.0)
    rng = np.random.default_rng(0)
    position += rng.normal(0, 0.0005, position.shape)
    first, last = find_poses(time, position, MVN_SEGMENTS)
    assert (first.start_s, last.end_s) == pytest.approx((0, 20), abs=0.2)
    assert (first.end_s, last.start_s) == pytest.approx((3, 17), abs=0.3)
    assert find_poses(time[time < 13], position[time < 13], MVN_SEGMENTS, any_pose=True)[1].start_s == pytest.approx(8, abs=0.3)
    with pytest.raises(AlignmentError, match="stands still 2 times, 1 of them in an N-pose") as caught:
        find_poses(time[time < 13], position[time < 13], MVN_SEGMENTS)
    assert "give the times" in str(caught.value.hint)


def test_what_cannot_be_told_is_an_error() -> None:
    time, position, orientation = drive()
    with pytest.raises(AlignmentError, match="holds no frame"):
        sfe_run(time, position, orientation, MVN_SEGMENTS, (FIRST, Window("last", 30, 31)))
    with pytest.raises(AlignmentError, match="no pose of the segment 'Pelvis'"):
        sfe_run(time, position[:, 1:], orientation[:, 1:], MVN_SEGMENTS[1:], (FIRST, LAST))
    with pytest.raises(AlignmentError, match="not after the first"):
        sfe_run(time, position, orientation, MVN_SEGMENTS, (LAST, FIRST))
    with pytest.raises(AlignmentError, match="no N-pose can be told without"):
        find_poses(time, position[:, :5], MVN_SEGMENTS[:5])
    position[time >= 17, 2:] = np.nan
    with pytest.raises(AlignmentError, match="1 joints are known in both"):
        sfe_run(time, position, orientation, MVN_SEGMENTS, (FIRST, LAST))


def test_lengths_are_constant_until_one_is_not() -> None:
    time = np.arange(0, 5, 0.05)
    position, _ = moving_body.moving(time)
    bones = bone_lengths(position, MVN_SEGMENTS, mvn_bones(MVN_SEGMENTS))
    assert len(bones) == 22
    assert max(b.sd_m for b in bones) < 1e-12
    shin = next(b for b in bones if b.end == "LeftFoot")
    assert shin.mean_m == pytest.approx(np.linalg.norm(moving_body.OFFSETS["LeftFoot"]))
    position[:, MVN_SEGMENTS.index("Head")] += 0.01 * np.sin(time)[:, None] * (0, 0, 1)
    changed = [b.end for b in bone_lengths(position, MVN_SEGMENTS, mvn_bones(MVN_SEGMENTS)) if b.sd_m > 1e-9]
    assert changed == ["Head"]
    with pytest.raises(AlignmentError, match="there is no Tail"):
        bone_lengths(position, MVN_SEGMENTS, [("Pelvis", "Tail")])


def test_rigid_pairs_find_markers_that_sit_on_one_bone() -> None:
    time = np.arange(0, 5, 0.05)
    position, orientation = moving_body.moving(time, amplitude=0.8)
    names, points = [], []
    rng = np.random.default_rng(2)
    for segment in ("Head", "LeftForearm", "RightLowerLeg"):
        index = MVN_SEGMENTS.index(segment)
        turn = Rotation.from_quat(orientation[:, index], scalar_first=True)
        for k in range(3):
            names.append(f"{segment}{k}")
            points.append(position[:, index] + turn.apply(rng.uniform(-0.1, 0.1, 3)) + rng.normal(0, 1e-4, (len(time), 3)))
    order = rng.permutation(9)
    pairs = rigid_pairs(np.stack(points, axis=1)[:, order], [names[i] for i in order])
    assert len(pairs) == 8
    assert sum(a[:-1] == b[:-1] for a, b in pairs) == 6


@pytest.mark.real_data
def test_a_real_mvnx_recording_keeps_its_bones(real_data: Callable[[str], Path]) -> None:
    rows = [m for _, _, m in read_mvnx(real_data("mocap/xsens_upper_body.mvnx")) if isinstance(m, SegmentPoses)]
    position, names = np.stack([m.position_m for m in rows]), rows[0].names
    bones = bone_lengths(position, names, mvn_bones(names))
    assert len(bones) == 22
    assert max(b.range_m for b in bones) < 3e-4  # 0.2 mm, between T8 and the left shoulder
    time = np.arange(len(rows)) / 60
    turns = np.stack([m.orientation_wxyz for m in rows])
    run = sfe_run(time, position, turns, names, (Window("first", 0, 0.01), Window("last", time[-1], time[-1])))
    legs = [i for i, n in enumerate(run.names) if "Leg" in n or "Foot" in n]
    arms = [i for i, n in enumerate(run.names) if "Hand" in n]
    assert np.isfinite(run.error_m).all()
    assert run.error_m[:, arms].max() > run.error_m[:, legs].max()  # a recording of the upper body


@pytest.mark.real_data
def test_real_optical_markers_of_one_person_hold_together(real_data: Callable[[str], Path]) -> None:
    pytest.importorskip("ezc3d")
    rows = [m for _, _, m in read_c3d(real_data("mocap/vicon_two_subjects.c3d")) if isinstance(m, Markers) and m.subject]
    subject = rows[0].subject
    mine = [m for m in rows if m.subject == subject]
    position, names = np.stack([m.position_m for m in mine]), mine[0].names
    bones = bone_lengths(position, names, rigid_pairs(position, names))
    assert len(bones) == len(names) - 1
    assert np.median([b.sd_m for b in bones]) < 0.01
    time = np.arange(len(mine)) / 100
    ends = Window("first", 0, 0.5), Window("last", time[-1] - 0.5, time[-1])
    run = sfe_run(time, position, None, names, ends, root=None)
    assert np.nanmedian(run.error_m) < 0.5
