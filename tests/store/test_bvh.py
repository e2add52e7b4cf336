"""BVH: closed forms, an independent walk of the real file, damaged files, and poses that come back from a written one."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core import CMU_UNIT_M
from cabinpose.core.errors import MocapError, RecordingError
from cabinpose.signals.recorded import Facts, SegmentPoses
from cabinpose.store.convert.bvh import read_bvh, read_bvh_rows
from cabinpose.store.convert.bvh_write import write_bvh
from cabinpose.store.convert.clip import read_clip
from cabinpose.store.convert.mvnx import read_mvnx
from cabinpose.store.convert.rows import Row

SMALL = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Arm
  {
    OFFSET 1 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -2 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.01
0 10 0 0 0 0 0 0 0
0 10 5 90 0 0 0 90 0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "motion.bvh"
    path.write_text(text)
    return path


def test_closed_form(tmp_path: Path) -> None:
    clip = read_clip(written(tmp_path, SMALL), unit_m=0.01, up="y")
    assert clip.names == ("Hips", "Arm", "Arm_end")
    # File axes x left, y up, z forward; ours x forward, y left, z up.
    np.testing.assert_allclose(clip.positions[0], [[0, 0, 0.10], [0, 0.01, 0.10], [0, 0.01, 0.08]], atol=1e-12)
    # Root turned 90 degrees about file z: x -> y, so the arm sits above; then about its own x: -y -> -z, which stays -z.
    np.testing.assert_allclose(clip.positions[1], [[0.05, 0, 0.10], [0.05, 0, 0.11], [0.03, 0, 0.11]], atol=1e-12)
    np.testing.assert_allclose(clip.rest_positions, [[0, 0, 0], [0, 0.01, 0], [0, 0.01, -0.02]], atol=1e-12)


def test_z_up_keeps_lengths_and_handedness(tmp_path: Path) -> None:
    clip = read_clip(written(tmp_path, SMALL), unit_m=CMU_UNIT_M, up="z")
    np.testing.assert_allclose(np.linalg.det(clip.rotations), 1.0)
    np.testing.assert_allclose(clip.rest_positions[1], [0, CMU_UNIT_M, 0])  # +x is the left in both


def elementary(axis: str, degrees: float) -> np.ndarray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    m = np.eye(4)
    m[i, i] = m[j, j] = c
    m[j, i], m[i, j] = s, -s
    return m


def positions_by_matrices(text: str, frame: int, unit: float) -> dict[str, np.ndarray]:
    """An independent reading: one stack of 4x4 matrices pushed and popped while the text goes by."""
    head, tail = text.split("MOTION")
    values = [float(v) for v in tail.strip().splitlines()[2 + frame].split()]
    stack, result, offset, name = [np.eye(4)], {}, np.zeros(3), ""
    for line in (line.strip() for line in head.splitlines()):
        if match := re.match(r"(?:ROOT|JOINT) (\S+)", line):
            name = match[1]
        elif line == "End Site":
            name += "_end"
        elif line.startswith("OFFSET"):
            offset = np.array([float(v) for v in line.split()[1:]]) * unit
            m = np.eye(4)
            m[:3, 3] = offset
            stack.append(stack[-1] @ m)
            result[name] = stack[-1][:3, 3].copy()
        elif line.startswith("CHANNELS"):
            for channel in line.split()[2:]:
                value = values.pop(0)
                if channel.endswith("position"):
                    stack[-1]["XYZ".index(channel[0]), 3] += value * unit
                else:
                    stack[-1] = stack[-1] @ elementary(channel[0], value)
            result[name] = stack[-1][:3, 3].copy()
        elif line == "}":
            stack.pop()
    assert not values
    return result


def test_real_recording_against_an_independent_walk(real_data: Callable[[str], Path]) -> None:
    path = real_data("mocap/cmu_131_01.bvh")
    clip = read_clip(path, unit_m=CMU_UNIT_M, up="y")
    assert len(clip) == 994
    assert clip.frame_s == pytest.approx(1 / 120, rel=1e-3)
    text = path.read_text()
    for frame in (0, 397, 993):
        expected = positions_by_matrices(text, frame, CMU_UNIT_M)
        for j, name in enumerate(clip.names):
            x, y, z = expected[name]
            np.testing.assert_allclose(clip.positions[frame, j], [z, x, y], atol=1e-9, err_msg=name)
    feet = clip.positions[:, [clip.names.index("LeftToe"), clip.names.index("RightToe")], 2]
    assert -0.05 < feet.min() < 0.05  # the ground
    assert 1.35 < clip.positions[..., 2].max() < 1.75  # a grown person, so the unit is right


DAMAGE = {
    "no motion": (lambda t: t.split("MOTION")[0], "no MOTION"),
    "cut hierarchy": (lambda t: t.replace("}\n}\nMOTION", "MOTION"), "ends early"),
    "cut motion": (lambda t: t.rsplit("\n", 2)[0] + "\n", "states 2 frames and holds 1"),
    "short row": (lambda t: t.replace("90 0\n", "90\n"), "frame 1 has 8 values for 9"),
    "no number": (lambda t: t.replace("0 10 5", "0 ten 5"), "no number"),
    "not finite": (lambda t: t.replace("0 10 5", "0 nan 5"), "not finite"),
    "unknown channel": (lambda t: t.replace("Xrotation Yrotation", "Wrotation Yrotation"), "unknown channel 'Wrotation'"),
    "channel count": (lambda t: t.replace("CHANNELS 3", "CHANNELS 4"), "unknown channel 'End'"),
    "channel twice": (lambda t: t.replace("Zrotation Xrotation Yrotation", "Zrotation Zrotation Yrotation"), "a channel twice"),
    "same names": (lambda t: t.replace("JOINT Arm", "JOINT Hips"), "given twice: Hips"),
    "bad offset": (lambda t: t.replace("OFFSET 1 0 0", "OFFSET 1 0 x"), "three numbers"),
    "frame time": (lambda t: t.replace("Time: 0.01", "Time: 0"), "no positive number"),
    "no frames": (lambda t: re.sub(r"Frames: 2(\s.*\s)(.*\s)*", r"Frames: 0\1", t), "holds no frame"),
    "other file": (lambda t: "glTF", "no MOTION"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_files_are_refused(name: str, tmp_path: Path) -> None:
    damage, message = DAMAGE[name]
    text = damage(SMALL)
    assert text != SMALL
    with pytest.raises(MocapError, match=message) as caught:
        read_bvh(written(tmp_path, text))
    assert caught.value.hint


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="does not exist"):
        read_bvh(tmp_path / "none.bvh")
    (tmp_path / "binary.bvh").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(MocapError, match="as text"):
        read_bvh(tmp_path / "binary.bvh")


def test_a_file_of_endless_depth_is_refused(tmp_path: Path) -> None:
    joint = "JOINT j{} {{ OFFSET 0 0 0 CHANNELS 0 "
    deep = "HIERARCHY\nROOT r { OFFSET 0 0 0 CHANNELS 0 " + "".join(joint.format(i) for i in range(5000)) + "}" * 5001
    with pytest.raises(MocapError, match="201 joints deep"):
        read_bvh(written(tmp_path, deep + "\nMOTION\nFrames: 1\nFrame Time: 0.01\n\n"))


def poses(rows: list[Row]) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names, positions and rotation matrices."""
    found = [m for _, _, m in rows if isinstance(m, SegmentPoses)]
    quaternions = np.array([m.orientation_wxyz for m in found])
    matrices = Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True).as_matrix().reshape(*quaternions.shape[:2], 3, 3)
    return found[0].names, np.array([m.position_m for m in found]), matrices


def test_rows_are_the_clip(tmp_path: Path) -> None:
    path = written(tmp_path, SMALL)
    clip = read_clip(path, unit_m=CMU_UNIT_M, up="y")
    rows = list(read_bvh_rows(path, unit_m=CMU_UNIT_M, subjects=["S01"], start_ns=7))
    names, positions, rotations = poses(rows)
    assert names == clip.names
    np.testing.assert_allclose(positions, clip.positions)
    np.testing.assert_allclose(rotations, clip.rotations, atol=1e-12)
    assert [(host, device) for host, device, _ in rows] == [(7, 0), (7, 0), (10_000_007, 10_000_000)]
    assert isinstance(rows[0][2], Facts)
    assert [s["parent"] for s in rows[0][2].values["segments"]] == [None, "Hips", "Arm"]


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    names = ("hand", "root", "arm")  # parents need not come first
    rows: list[Row] = [
        (0, None, Facts("subject S", {"segments": [{"name": "arm", "parent": "root"}, {"name": "hand", "parent": "arm"}]}))
    ]
    for i in range(30):
        turn = Rotation.from_rotvec(rng.normal(0, 1, (3, 3)))
        root = rng.normal(0, 1, 3)
        arm = root + turn[1].apply([0.1, 0.2, 0.3])
        hand = arm + turn[2].apply([0.0, 0.3, 0.0]) + (0.02 * np.sin(i), 0, 0)  # not rigid
        at = np.array([hand, root, arm])
        rows.append((i * 10**7, None, SegmentPoses("S", names, at, turn.as_quat(scalar_first=True))))
    path = write_bvh(tmp_path / "out.bvh", rows)
    text = path.read_text()
    assert text.count("CHANNELS 6") == 2  # the root, and the hand that moves in its parent's frame
    assert text.count("CHANNELS 3") == 1
    assert read_bvh(path, unit_m=0.01).frame_s == pytest.approx(0.01)
    back_names, positions, rotations = poses(list(read_bvh_rows(path, unit_m=0.01)))
    _, true_positions, true_rotations = poses(rows)
    for s, name in enumerate(names):
        there = back_names.index(name)
        np.testing.assert_allclose(positions[:, there], true_positions[:, s], atol=1e-6)
        np.testing.assert_allclose(rotations[:, there], true_rotations[:, s], atol=1e-6)
    with pytest.raises(RecordingError, match="exists"):
        write_bvh(path, rows)
    assert [p.name for p in tmp_path.iterdir()] == ["out.bvh"]


def test_lost_frames_are_interpolated(tmp_path: Path) -> None:
    turn = Rotation.from_euler("z", np.arange(10)[:, None] * 10, degrees=True).as_quat(scalar_first=True)
    rows: list[Row] = [
        (0, i * 10**7, SegmentPoses("S", ("Pelvis",), np.array([[0.1 * i, 0, 1]]), turn[i : i + 1]))
        for i in range(10)
        if i not in (4, 5)
    ]
    path = write_bvh(tmp_path / "out.bvh", rows)
    _, positions, rotations = poses(list(read_bvh_rows(path, unit_m=0.01)))
    np.testing.assert_allclose(positions[:, 0], [[0.1 * i, 0, 1] for i in range(10)], atol=1e-6)
    np.testing.assert_allclose(rotations[:, 0], Rotation.from_quat(turn, scalar_first=True).as_matrix(), atol=1e-6)


def test_what_bvh_cannot_say_is_refused(tmp_path: Path) -> None:
    def pose(names: tuple[str, ...], x: float = 0.0) -> list[Row]:
        quaternions = np.tile([1.0, 0, 0, 0], (len(names), 1))
        return [(0, 0, SegmentPoses("S", names, np.full((len(names), 3), x), quaternions))]

    def stated(**parents: str) -> list[Row]:
        return [(0, 0, Facts("subject S", {"segments": [{"name": n, "parent": p} for n, p in parents.items()]}))]

    out = tmp_path / "out.bvh"
    for rows, options, message in (
        ([], {}, "no poses to write"),
        (pose(("Pelvis",)), {"subject": "T"}, "no poses of T"),
        (pose(("Torso", "Arm")), {}, "hierarchy of these segments is not known"),
        (stated(a="c") + pose(("a", "b")), {}, "2 segments have no parent: a, b"),
        (stated(a="b", b="a") + pose(("a", "b", "c")), {}, "form a ring"),
        (pose(("Pelvis",), np.nan), {}, "1 of 1 frames have segments that were not seen"),
        (pose(("Pelvis",)) + pose(("Pelvis", "L5")), {}, "the segments of S change"),
    ):
        with pytest.raises(RecordingError, match=message):
            write_bvh(out, rows, **options)
    assert not out.exists()


def test_the_real_recording_comes_back(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    rows = list(read_bvh_rows(real_data("mocap/cmu_131_01.bvh")))
    path = write_bvh(tmp_path / "again.bvh", rows)
    names, positions, rotations = poses(list(read_bvh_rows(path, unit_m=0.01)))
    true_names, true_positions, true_rotations = poses(rows)
    order = [names.index(name) for name in true_names]
    np.testing.assert_allclose(positions[:, order], true_positions, atol=1e-5)
    np.testing.assert_allclose(rotations[:, order], true_rotations, atol=1e-5)
    text = path.read_text()
    expected = positions_by_matrices(text, 500, 0.01)
    for name, place in zip(true_names, true_positions[500], strict=True):
        np.testing.assert_allclose(np.array(expected[name])[[2, 0, 1]], place, atol=1e-5)


def test_a_suits_segments_have_their_hierarchy(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    rows = list(read_mvnx(real_data("mocap/xsens_upper_body.mvnx")))
    frames = [row for row in rows if isinstance(row[2], SegmentPoses)][3:]  # after the calibration poses
    path = write_bvh(tmp_path / "suit.bvh", frames)
    names, positions, _ = poses(list(read_bvh_rows(path, unit_m=0.01)))
    found = frames[-1][2]
    assert isinstance(found, SegmentPoses)
    np.testing.assert_allclose(positions[-1][[names.index(n) for n in found.names]], found.position_m, atol=1e-4)
