"""What a session may say, and what `calibrate` and `align` refuse before they begin."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from cabinpose.align.dataset import align_takes
from cabinpose.align.session import Session
from cabinpose.core.errors import AlignmentError
from cabinpose.store.recording import RecordingWriter, Take

sys.path.insert(0, str(Path(__file__).parent))
from rig_takes import calibration

SUBJECT: dict[str, Any] = {
    "take": "head.mcap",
    "head_offset_m": [-0.07, 0.01, -0.09],
    "hands_m": [[0.0, 0.09, 0.0], [0.0, -0.09, 0.0]],
    "pose_take": "pose.mcap",
    "pose_truth": "n-pose",
    "arms_off_deg": 6.0,
}
WITHOUT_POSE = {key: value for key, value in SUBJECT.items() if key not in ("pose_take", "pose_truth", "arms_off_deg")}
CAR = [[1.0, 0.0, 0.0, 2.1], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.3], [0.0, 0.0, 0.0, 1.0]]


def session_of(path: Path, subject: dict[str, Any], **more: Any) -> Path:
    told = {"board_take": "board.mcap", "pendulum_take": "pendulum.mcap", "subjects": {"S01": subject}, **more}
    path.write_text(yaml.safe_dump(told))
    return path


def test_a_session_names_its_recordings(tmp_path: Path) -> None:
    session = Session.load(session_of(tmp_path / "session.yaml", SUBJECT, vehicle_from_world=CAR))
    assert [path.name for path in session.recordings] == ["board.mcap", "pendulum.mcap", "head.mcap", "pose.mcap"]
    assert {path.parent for path in session.recordings} == {tmp_path}
    assert len(Session.load(session_of(tmp_path / "session.yaml", WITHOUT_POSE)).recordings) == 3


@pytest.mark.parametrize(
    ("subject", "said"),
    [
        (SUBJECT | {"head_offset_m": [-74.0, 9.0, -92.0]}, r"head_offset_m of 118.41 m.*are they millimetres \(0.11841 m\)"),
        (SUBJECT | {"head_offset_m": [-7.4, 0.9, -9.2]}, "no cap has more than 0.5 m"),
        (SUBJECT | {"hands_m": [[0.0, 85.0, 0.0], [0.0, -85.0, 0.0]]}, r"hands_m of 85 m.*millimetres \(0.085 m\)"),
        (SUBJECT | {"hands_m": [[0.0, -0.09, 0.0], [0.0, 0.09, 0.0]]}, r"the left finger base lies at \+y"),
        (WITHOUT_POSE | {"pose_truth": "optical"}, "pose_truth says nothing without pose_take"),
        (WITHOUT_POSE | {"arms_off_deg": 6.0}, "arms_off_deg says nothing without pose_take"),
        (SUBJECT | {"pose_truth": "optical"}, "arms_off_deg is of the N-pose"),
    ],
    ids=["mm", "cm", "hands in mm", "hands exchanged", "truth of no pose", "arms of no pose", "arms of an optical pose"],
)
def test_what_no_person_has_and_what_says_nothing_is_refused(tmp_path: Path, subject: dict[str, Any], said: str) -> None:
    with pytest.raises(AlignmentError, match=rf"subjects.S01: .*{said}"):
        Session.load(session_of(tmp_path / "session.yaml", subject))


def test_a_car_that_stands_in_millimetres_is_refused(tmp_path: Path) -> None:
    car = [[*row[:3], 1000 * row[3]] for row in CAR[:3]] + CAR[3:]
    with pytest.raises(AlignmentError, match=r"vehicle_from_world of 2121.32 m.*millimetres \(2.12132 m\)"):
        Session.load(session_of(tmp_path / "session.yaml", SUBJECT, vehicle_from_world=car))


def test_no_output_replaces_what_is_read(tmp_path: Path, run: Callable[..., Any]) -> None:
    session = session_of(tmp_path / "session.yaml", SUBJECT)
    take, later, known = tmp_path / "head.mcap", tmp_path / "head-001.mcap", session.read_bytes()
    in_folder = tmp_path / "takes" / "head.mcap"
    in_folder.parent.mkdir()
    for file in (take, later, in_folder):
        file.write_bytes(b"a take")
    for words in (
        ("calibrate", session, "--out", session),
        ("calibrate", session, "--out", take),
        ("calibrate", session, "--out", later),
        ("align", take, "--calibration", session, "--out", tmp_path / "dataset", "--report", session),
        ("align", take, "--calibration", session, "--out", tmp_path / "dataset", "--report", take),
        ("align", take, "--calibration", session, "--out", tmp_path / "dataset", "--report", later),
        ("align", in_folder.parent, "--calibration", session, "--out", tmp_path / "dataset", "--report", in_folder),
    ):
        done = run(*words, "--overwrite")
        assert (done.code, "is what is read, and would be lost" in done.err) == (2, True), done.err
    assert (session.read_bytes(), *(file.read_bytes() for file in (take, later, in_folder))) == (known, *3 * (b"a take",))


def test_a_folder_that_is_not_there_is_told_before_the_work(tmp_path: Path, run: Callable[..., Any]) -> None:
    done = run("calibrate", session_of(tmp_path / "session.yaml", SUBJECT), "--out", tmp_path / "none" / "calibration.yaml")
    assert done.code == 2
    assert "there is no folder" in done.err  # and not: board.mcap does not exist


def test_a_take_that_is_named_twice_is_refused(tmp_path: Path) -> None:
    """`align take*.mcap` names the later files of a take, which its first file stands for."""
    first, second, other = (tmp_path / name for name in ("take.mcap", "take-001.mcap", "other.mcap"))
    for path, part in ((first, 0), (second, 1), (other, None)):
        RecordingWriter(path, Take(), started_ns=7, part=part).close()
    for paths, said in (
        ([first, other, first], "take.mcap is named twice"),
        ([second, first], "take-001.mcap and .*take.mcap both hold .*take-001.mcap"),
        ([first, tmp_path / "x" / ".." / "take.mcap"], "both hold"),
    ):
        (tmp_path / "x").mkdir(exist_ok=True)
        with pytest.raises(AlignmentError, match=said):
            align_takes(paths, calibration())
    with pytest.raises(AlignmentError, match="names no subject"):
        align_takes([first, other], calibration())
