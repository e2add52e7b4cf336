"""A session of the laboratory, calibrated and aligned: without errors nothing is left but the pixels' share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from cabinpose.align.calibration import rows
from cabinpose.align.dataset import align_takes
from cabinpose.align.project import align_take, correct_by_depth
from cabinpose.align.session import Calibrated, Session, calibrate
from cabinpose.app.cli import main
from cabinpose.app.cli.selection import opened
from cabinpose.app.lab.laboratory import load_rig, load_truth, record_session
from cabinpose.app.lab.plan import PAIR, RIG, SESSION, Plan, drive_take
from cabinpose.app.lab.rig import Tracker, VirtualRig
from cabinpose.app.lab.score import calibration_error, joint_error
from cabinpose.app.lab.takes import dress_up, write_action_take, write_head_take, write_pose_take
from cabinpose.app.label.labelling import Labelling
from cabinpose.app.studio.workspace import open_workspace
from cabinpose.core.errors import AlignmentError, ConfigError
from cabinpose.core.frames import invert
from cabinpose.core.pose import Visibility
from cabinpose.store import open_dataset
from cabinpose.store.recording import Recording, RecordingWriter
from cabinpose.store.source import import_source

pytestmark = pytest.mark.slow
PLAN = Plan(
    views=12, frames_per_view=1, pendulum_s=8, seconds=6.5, rate_hz=2, exercises=False, seed=4, subjects=("S01", "S02"),
    together=True,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("lab") / "session"
    record_session(made, VirtualRig().noise_free(), PLAN)
    return made


@pytest.fixture(scope="module")
def calibrated(folder: Path) -> Calibrated:
    return calibrate(Session.load(folder / SESSION))


def test_rendered_images_without_noise_give_the_calibration(folder: Path, calibrated: Calibrated) -> None:
    rig, truth = load_rig(folder / RIG), load_truth(folder, "S01")
    assert rig == VirtualRig().noise_free()
    error = calibration_error(calibrated.calibration, rig, truth, "S01")
    assert error.camera_mm < 1.0  # of 12 views; with 40, `bench lab` has 0.3
    assert error.camera_deg < 0.05
    assert abs(error.tof_delay_ms) < 0.5
    assert abs(error.focal_percent) < 0.2
    assert error.head_deg < 1e-3
    assert error.head_mm < 1e-3
    assert calibrated.by_corners.method == "corners"


def test_the_joints_follow(folder: Path, calibrated: Calibrated) -> None:
    rig, truth = load_rig(folder / RIG), load_truth(folder, "S01")
    with Recording(folder / drive_take("S01")) as recording:
        aligned = align_take(recording, calibrated.calibration, "S01")
    error = joint_error(aligned, rig, truth)
    assert aligned.kept.all()
    assert abs(error.suit_delay_ms) < 0.1
    assert error.mean_cm < 0.15
    assert error.error_m.max() < 0.003
    assert np.nanmax(error.error_px) < 1.0
    # the yardstick sees what is wrong
    off = truth.camera_from_world.copy()
    off[:3, 3] += 0.01
    wrong = aligned.joints + 0.01
    assert joint_error(type(aligned)(**{**vars(aligned), "joints": wrong}), rig, truth).mean_cm > 1.5
    assert np.linalg.norm((invert(off) - invert(truth.camera_from_world))[:3, 3]) > 0.01


def test_two_people_in_one_car_are_found_each_by_a_suit_of_their_own(folder: Path, calibrated: Calibrated) -> None:
    rig = load_rig(folder / RIG)
    errors = {}
    with Recording(folder / PAIR) as recording:
        assert [(each.code, each.seat) for each in recording.take.subjects] == [("S01", "driver"), ("S02", "front_passenger")]
        for code, suit in (("S01", "suit"), ("S02", "suit2")):
            aligned = align_take(recording, calibrated.calibration, code)
            errors[code] = joint_error(aligned, rig, load_truth(folder, code, together=True), suit=suit)
            assert aligned.kept.all()
        crossed = joint_error(aligned, rig, load_truth(folder, "S01", together=True))
    for error in errors.values():
        assert abs(error.suit_delay_ms) < 0.1
        assert error.error_m.max() < 0.003
    assert crossed.mean_cm > 40  # the passenger is not where the driver is
    true = [load_truth(folder, code, together=True).visibility for code in ("S01", "S02")]
    assert all((states == Visibility.VISIBLE).any() for states in true)


def test_a_tracker_gives_the_head_where_there_is_no_optical_system(folder: Path, tmp_path: Path) -> None:
    """On the road: the head take has both, the drive has the tracker alone; without errors the joints are as exact."""
    rig = VirtualRig(tracker=Tracker()).noise_free()
    actor = dress_up("sedan", "S01", rng=np.random.default_rng(1))
    head, both, drive = (tmp_path / name for name in ("head.mcap", "both.mcap", "drive.mcap"))
    write_head_take(head, rig, actor, rng=np.random.default_rng(2))
    truth = write_action_take(both, rig, actor, 8.0, rate_hz=2.0, rng=np.random.default_rng(4))
    with Recording(both) as recording, RecordingWriter(drive, recording.take) as writer:
        for source, sample in recording.samples(["suit", "tracker", "tof"]):
            writer.write(source, sample)
    session = Session.load(folder / SESSION)
    offset = tuple(truth.object_from_head[:3, 3].tolist())
    subject = session.subjects["S01"].model_copy(update={"take": head, "pose_take": None, "head_offset_m": offset})
    names = session.names.model_copy(update={"tracker": "tracker"})
    found = calibrate(session.model_copy(update={"names": names, "subjects": {"S01": subject}})).calibration
    with Recording(drive) as recording:
        error = joint_error(align_take(recording, found, "S01"), rig, truth)
    assert error.mean_cm < 0.15
    assert error.error_m.max() < 0.004
    place = found.heads["S01"].tracker
    assert place is not None
    assert place.tracker_to_optical.offset_s == pytest.approx(rig.optical.latency_s - Tracker().latency_s, abs=1e-4)


@pytest.mark.parametrize(("pose", "least"), [("n-pose", 2.0), ("optical", 5.0)])
def test_a_known_pose_corrects_what_the_suits_calibration_got_wrong(
    folder: Path, tmp_path: Path, pose: str, least: float
) -> None:
    rig = VirtualRig().only("calibration_offset_deg")
    actor = dress_up("sedan", "S01", rng=np.random.default_rng(1))
    write_head_take(tmp_path / "head.mcap", rig, actor, rng=np.random.default_rng(2))
    write_pose_take(tmp_path / "pose.mcap", rig, actor, rng=np.random.default_rng(3))
    truth = write_action_take(tmp_path / "drive.mcap", rig, actor, 8.0, rate_hz=2.0, rng=np.random.default_rng(4))
    session = Session.load(folder / SESSION)
    subject = session.subjects["S01"].model_copy(
        update={
            "take": tmp_path / "head.mcap",
            "head_offset_m": tuple(truth.object_from_head[:3, 3]),
            "pose_take": tmp_path / "pose.mcap",
            "pose_truth": pose,
        }
    )
    found = calibrate(session.model_copy(update={"subjects": {"S01": subject}})).calibration
    with Recording(tmp_path / "drive.mcap") as recording:
        wrong, mended = (
            joint_error(align_take(recording, found, "S01", correct_pose=correct), rig, truth).mean_cm
            for correct in (False, True)
        )
    assert wrong > 0.8
    assert mended < wrong / least


def test_depth_corrects_the_arms_of_people_whose_suits_err(folder: Path, calibrated: Calibrated, tmp_path: Path) -> None:
    """Two people with exact suits stay within the priors; the errors of a suit that sits askew shrink where the camera sees."""
    with Recording(folder / PAIR) as recording:
        pair = [align_take(recording, calibrated.calibration, code, correct_pose=False) for code in ("S01", "S02")]
        both = correct_by_depth(recording, pair, calibrated.calibration)
    for before, after in zip(pair, both, strict=True):
        assert after.joint_shift is not None
        assert np.allclose(after.joint_shift, np.linalg.norm(after.joints - before.joints, axis=2))
        assert 0 < after.joint_shift.max() < 0.05
    rig = VirtualRig().only("calibration_offset_deg")
    actor = dress_up("sedan", "S01", rng=np.random.default_rng(1))
    truth = write_action_take(tmp_path / "drive.mcap", rig, actor, 8.0, rate_hz=2.0, rng=np.random.default_rng(4))
    head = calibrated.calibration.head("S01").model_copy(update={"object_from_head": rows(truth.object_from_head)})
    found = calibrated.calibration.model_copy(update={"heads": {"S01": head}})
    with Recording(tmp_path / "drive.mcap") as recording:
        worn = align_take(recording, found, "S01", correct_pose=False)
        (fitted,) = correct_by_depth(recording, [worn], found)
    wrong, mended = (joint_error(each, rig, truth).by_joint() for each in (worn, fitted))
    arms = [side + joint for side in "lr" for joint in ("elbow", "wrist", "hand")]
    assert sum(mended[joint] for joint in arms) < 0.8 * sum(wrong[joint] for joint in arms)


def test_a_truth_of_another_take_is_refused(folder: Path, calibrated: Calibrated) -> None:
    rig, truth = load_rig(folder / RIG), load_truth(folder, "S01")
    with Recording(folder / drive_take("S01")) as recording:
        aligned = align_take(recording, calibrated.calibration, "S01")
    late = type(truth)(**{**vars(truth), "tof_ns": truth.tof_ns + 10**10})
    with pytest.raises(AlignmentError, match="not the one that the truth is of"):
        joint_error(aligned, rig, late)
    with pytest.raises(ConfigError, match=r"holds no drive-S03\.truth\.npz"):
        load_truth(folder, "S03")


def test_what_there_is_not_leaves_no_half_of_a_session(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="sedann"):
        record_session(tmp_path / "lab", VirtualRig(), PLAN.model_copy(update={"car": "sedann"}))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValidationError, match="a subject is named twice"):
        Plan(subjects=("S01", "S02", "S01"))


def test_the_commands_do_the_same(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibration, dataset = tmp_path / "calibration.yaml", tmp_path / "dataset"
    assert main(["calibrate", str(folder / SESSION), "--out", str(calibration)]) == 0
    assert "camera's place" in capsys.readouterr().out
    assert yaml.safe_load(calibration.read_text())["intrinsics"]["source"] == "checkerboard"
    take = str(folder / drive_take("S01"))
    assert main(["align", take, "--calibration", str(calibration), "--out", str(dataset)]) == 0
    out = capsys.readouterr().out
    assert "13 of 13 frames, S01" in out
    assert "initial pose" in out
    both = ["align", str(folder / PAIR), "--calibration", str(calibration), "--out", str(tmp_path / "both")]
    assert main([*both, "--no-pose-correction"]) == 0
    out = capsys.readouterr().out
    assert "13 of 13 frames, S01" in out
    assert "13 of 13 frames, S02" in out
    assert "initial pose" not in out
    there = open_dataset(tmp_path / "both")["subject"]
    assert (there.sel(person="driver") == "S01").all()
    assert (there.sel(person="front_passenger") == "S02").all()
    for again in (
        ["calibrate", str(folder / SESSION), "--out", str(calibration)],
        ["align", take, "--calibration", str(calibration), "--out", str(dataset)],
        ["align", take, "--calibration", str(folder / SESSION), "--out", str(tmp_path / "other")],
        ["align", str(folder / "board.mcap"), "--calibration", str(calibration), "--out", str(tmp_path / "other")],
        ["lab", "--out", str(folder)],
        ["lab", "--out", str(tmp_path / "lab"), "--only", "gravity"],
    ):
        assert main(again) == 2, again
        assert "hint: " in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_the_suits_wrists_and_hips_are_labelled(folder: Path, calibrated: Calibrated, tmp_path: Path) -> None:
    """An aligned take opens in the studio's labelling, and a corrected wrist is what `evaluate --labels` reads."""
    made = align_takes([folder / drive_take("S01")], calibrated.calibration)
    dataset = import_source(made.source, tmp_path / "dataset")
    workspace = open_workspace(dataset)
    labelling = Labelling(workspace.dataset, workspace.labels, workspace.role)
    labelling.joints = labelling.sets["wrists and hips"]
    shown = {each.joint: each.label for each in labelling.shown(3, "driver")}
    assert set(shown) == {"rwrist", "lwrist", "hip", "rpelvis", "lpelvis"}
    wrist = shown["lwrist"]
    assert wrist is not None
    placed = labelling.place(3, "driver", "lwrist", wrist.uv[0] + 2, wrist.uv[1])
    labelling.accept(3, "driver")
    assert labelling.done(3, "driver")
    workspace.close()
    corrected = opened(dataset, tmp_path / "dataset.labels.jsonl").isel(frame=3).sel(person="driver", joint="lwrist")
    np.testing.assert_allclose(corrected["joints_2d"].values, placed.uv, rtol=1e-6)
    np.testing.assert_allclose(corrected["joints_3d"].values, placed.xyz, rtol=1e-6)
