"""Recorded motions of other files than BVH: the suit's and Plug-in Gait's bodies make the gesture that was recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import MocapError, RecordingError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOF_INDEX, SUBJECTS, BodyModel
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.signals.recorded import Markers, Sample, SegmentPoses
from cabinpose.store.convert.c3d_write import write_c3d
from cabinpose.store.convert.clip import Clip, read_clip
from cabinpose.store.convert.mvnx import read_mvnx
from cabinpose.store.convert.rows import Row
from cabinpose.store.recording import RecordingWriter
from cabinpose.synth.posture.retarget import retarget

MVNX = "mocap/xsens_upper_body.mvnx"
# Not the left forearm: the recorded shoulder turns 115 to 148 degrees inwards, ours 70.
LIMBS = (("Left", "UpperArm", "Forearm"), ("Right", "UpperArm", "Forearm"), ("Right", "Forearm", "Hand"))
OURS = {"UpperArm": "shoulder", "Forearm": "elbow", "Hand": "wrist"}


def clip_of(path: Path, subject: str | None = None) -> Clip:
    return read_clip(path, unit_m=1.0, up="y", subject=subject)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_a_suits_file_makes_the_recorded_gesture(real_data: Callable[[str], Path]) -> None:
    clip = clip_of(real_data(MVNX))
    assert len(clip) == 112
    assert clip.frame_s == pytest.approx(1 / 60, rel=0.02)
    at = clip.names.index
    np.testing.assert_allclose(clip.rest_positions[at("LeftHand")][1], 0.67, atol=0.1)  # stretched out at rest
    motion = retarget(clip)
    person = BodyModel.load().person(*SUBJECTS["S01"])
    errors, palms = [], []
    for f in range(0, len(clip), 10):
        root = np.eye(4)
        root[:3, :3] = motion.root[f]
        posed = person.pose(motion.q[f], root)
        for side, a, b in LIMBS:
            theirs = unit(clip.positions[f, at(side + b)] - clip.positions[f, at(side + a)])
            ours = unit(np.subtract(*(posed.joints[CABINPOSE.index[side[0].lower() + OURS[k]]] for k in (b, a))))
            errors.append(np.degrees(np.arccos(np.clip(ours @ theirs, -1, 1))))
        thumb = posed.bones[BONE_INDEX["rhand"]][:3, 0]  # the thumb's side of a hand is forward where arms are stretched out
        palms.append(thumb @ clip.rotations[f, at("RightHand"), :, 0])
    assert max(errors) < 1.0
    assert min(palms) > 0.85


def as_bones(clip: Clip) -> list[Row]:
    """The points that Plug-in Gait would give of a clip of MVN's segments, 100 mm beyond each origin."""
    pairs = {"Pelvis": "PEL", "T8": "TRX", "Head": "HED"} | {
        f"{side}{segment}": side[0] + bone
        for side in ("Left", "Right")
        for segment, bone in (
            ("Forearm", "HU"), ("Hand", "RA"), ("LowerLeg", "FE"), ("Foot", "TI"), ("Toe", "FO"), ("UpperArm", "CL"),
        )
    }  # a bone begins at its far joint  # fmt: skip
    turned_by = {"Forearm": "UpperArm", "Hand": "Forearm", "LowerLeg": "UpperLeg", "Foot": "LowerLeg", "Toe": "Foot"}
    points = {}
    for name, bone in pairs.items():
        side = next((s for s in ("Left", "Right") if name.startswith(s)), "")
        carrier = clip.names.index(side + turned_by.get(name.removeprefix(side), name.removeprefix(side)))
        origin, turn = clip.positions[:, clip.names.index(name)], clip.rotations[:, carrier].copy()
        if bone[1:] in ("HU", "RA"):  # the suit's arms are stretched out at rest, these hang
            c = 1.0 if side == "Left" else -1.0
            turn = turn @ np.array([[1, 0, 0], [0, 0, -c], [0, c, 0]])
        points |= {bone + "O": origin} | {bone + end: origin + 0.1 * turn[:, :, k] for k, end in enumerate("ALP")}
        if bone[1:] == "FE":
            points[bone + "P"] = clip.positions[:, clip.names.index(side + "UpperLeg")]
    for side in ("Left", "Right"):
        wrist, turn = clip.positions[:, clip.names.index(side + "Hand")], clip.rotations[:, clip.names.index(side + "Hand")]
        c = 1.0 if side == "Left" else -1.0
        turn = turn @ np.array([[1, 0, 0], [0, 0, -c], [0, c, 0]])
        points |= {f"{side[0]}HN{end}": wrist + (0.1 * turn[:, :, "ALP".index(end)] if end != "O" else 0) for end in "OALP"}
    names = tuple(points)
    at = np.stack(list(points.values()), axis=1)
    return [
        (round(i * clip.frame_s * 1e9), round(i * clip.frame_s * 1e9), Markers("S01", names, p, np.zeros(len(p))))
        for i, p in enumerate(at)
    ]


def test_bones_in_a_c3d_file_are_the_same_motion(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    suit = clip_of(real_data(MVNX))
    again = clip_of(write_c3d(tmp_path / "a.c3d", as_bones(suit), rate_hz=60))
    one, two = retarget(suit), retarget(again)
    trunk = [i for name, i in DOF_INDEX.items() if name.split(".")[0] in ("lumbar", "thorax", "neck", "head")]
    arms = [i for name, i in DOF_INDEX.items() if name[1:].startswith(("shoulder", "elbow", "wrist"))]
    for dofs in (trunk, arms):
        assert np.abs(one.q[: len(two.q), dofs] - two.q[:, dofs]).max() < np.radians(0.2)


def record(path: Path, rows: Sequence[Row]) -> None:
    with RecordingWriter(path) as writer:
        for i, (host_ns, device_ns, message) in enumerate(rows):
            writer.write("suit", Sample(i, host_ns, device_ns, b"", (message,)))


def test_a_suits_recording_is_the_same_motion(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    rows = list(read_mvnx(real_data(MVNX), subjects=("S01",)))
    path = tmp_path / "take.mcap"
    record(path, rows)
    one, two = clip_of(real_data(MVNX)), clip_of(path, "S01")
    np.testing.assert_allclose(one.positions, two.positions)
    with pytest.raises(RecordingError, match="no segments of a suit of 'S02'"):
        clip_of(path, "S02")
    others = [(host, device, replace(m, subject="S02")) for host, device, m in rows if isinstance(m, SegmentPoses)]
    record(tmp_path / "two.mcap", [*rows, *others])
    with pytest.raises(RecordingError, match="segments of a suit of several subjects") as error:
        clip_of(tmp_path / "two.mcap")
    assert error.value.hint == "choose the subject, of: 'S01', 'S02'"
    holes = [row for i, row in enumerate(rows) if not (isinstance(row[2], SegmentPoses) and 100 < i < 160)]
    record(tmp_path / "holes.mcap", holes)
    with pytest.raises(MocapError, match="a gap of 0"):
        clip_of(tmp_path / "holes.mcap")


def test_files_that_hold_no_motion(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="has no bones of Plug-in Gait"):
        clip_of(real_data("mocap/vicon_two_subjects.c3d"))
    with pytest.raises(RecordingError, match=r"a\.fbx is no motion"):
        clip_of(tmp_path / "a.fbx")
    with pytest.raises(RecordingError, match="does not exist"):
        clip_of(tmp_path / "none.mvnx")
