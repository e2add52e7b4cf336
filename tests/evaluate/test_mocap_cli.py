"""`cabinpose evaluate-mocap` on recordings whose errors are known: numbers, pages, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import moving_body
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core.skeleton import MVN_SEGMENTS
from cabinpose.evaluate.mocap.sse import STEP_RAD
from cabinpose.signals.recorded import Channels

pytest.importorskip("mcap")

LATE_S = 0.040
FEW = ("--resamples", "20")


@pytest.fixture(scope="module")
def planes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Suit and optical system of one person: the suit late by 40 ms, its world turned, its left elbow off by 20 mm."""
    suit_s, optical_s = np.arange(0, 8, 1 / 30), np.arange(0, 8, 1 / 40)
    position, orientation = moving_body.moving(suit_s - LATE_S, amplitude=0.3)
    position[:, MVN_SEGMENTS.index("LeftForearm")] += (0, 0, 0.02)
    position, orientation = moving_body.turned(0.6, (1, 2, 0), position, orientation)
    streams = {
        "suit": moving_body.suit_stream(suit_s, position, orientation),
        "optical": moving_body.optical_stream(optical_s, *moving_body.moving(optical_s, amplitude=0.3)),
    }
    return moving_body.write_take(tmp_path_factory.mktemp("planes") / "planes.mcap", streams)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    time = np.arange(0, 12, 1 / 20)
    moving, after = (time > 2) & (time < 10), time >= 10
    position, orientation = moving_body.moving(np.zeros(len(time)))
    position[moving], orientation[moving] = moving_body.moving(time[moving], amplitude=0.8)
    position[after, MVN_SEGMENTS.index("Head")] += (0.003, 0.004, 0)
    return moving_body.write_take(
        tmp_path_factory.mktemp("drive") / "drive.mcap", {"suit": moving_body.suit_stream(time, position, orientation)}, "drive"
    )


@pytest.fixture(scope="module")
def yaw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine steps of 11.25°, the sensor 0.5° too far from the third on."""
    time = np.arange(0, 9 * 1.5 - 0.3, 1 / 30)
    number = np.floor(time / 1.5)
    angle = (number + np.clip((time - number * 1.5 - 1.2) / 0.3, 0, 1)) * STEP_RAD
    angle += np.radians(0.5) * (angle > 1.9 * STEP_RAD)
    q = Rotation.from_rotvec(angle[:, None] * (0, 0, 1.0)).as_quat(scalar_first=True)
    return moving_body.write_take(tmp_path_factory.mktemp("yaw") / "yaw.mcap", {"imu": moving_body.sensor_stream(time, q)})


def judged(run: Callable[..., Any], *words: object) -> dict[str, Any]:
    done = run("evaluate-mocap", *words, *FEW, "--json")
    assert done.code == 0, done.err
    return json.loads(done.out)


def median(record: dict[str, Any], measure: str, name: str = "All", condition: str = "All") -> float:
    (row,) = [s for s in record["summaries"] if (s["measure"], s["name"], s["condition"]) == (measure, name, condition)]
    return row["median"]


def test_dse_finds_the_delay_and_no_other_error(run: Callable[..., Any], planes: Path) -> None:
    record = judged(run, "dse", planes, "--windows", "coronal=0.1:4", "sagittal=4:7.9")
    assert record["notes"][0].startswith("planes.mcap: suit +40.")
    assert median(record, "angle between the turns") < 0.2  # interpolation, at 30 Hz
    assert {s["condition"] for s in record["summaries"]} == {"All", "coronal", "sagittal"}
    assert [h["heading_deg"] for h in record["headings"]] == pytest.approx([-np.degrees(0.6)] * 2, abs=0.1)


def test_a_wrong_delay_costs_what_the_motion_makes_of_it(run: Callable[..., Any], planes: Path) -> None:
    right = judged(run, "dse", planes, "--delay-ms", "40")
    wrong = judged(run, "dse", planes, "--delay-ms", "-60")
    assert median(right, "difference of the angles") < 0.1
    assert median(wrong, "difference of the angles") > 10 * median(right, "difference of the angles")


def test_dfe_recovers_the_elbow(run: Callable[..., Any], planes: Path, tmp_path: Path) -> None:
    record = judged(run, "dfe", f"reach={planes}", "--delay-ms", "40", "--rate", "10", "--out", tmp_path / "page")
    assert median(record, "position, pelvis", "lelbow") == pytest.approx(20, abs=0.5)
    assert median(record, "position, pelvis", "relbow") < 1
    assert median(record, "position, pelvis + ICP", "lelbow") == pytest.approx(18, abs=1.5)
    assert median(record, "position, raw") > 1000
    assert median(record, "displacement, pelvis", "lelbow") < 20
    page = (tmp_path / "page" / "index.html").read_text("utf-8")
    assert "<script" not in page
    assert "http" not in page
    assert all(words in page for words in ("Error by joint", "Both bodies", "pelvis + Kabsch", "worst frame"))
    assert json.loads((tmp_path / "page" / "report.json").read_text("utf-8")) == record


def test_sfe_finds_the_poses_and_the_heads_error(run: Callable[..., Any], drive: Path, tmp_path: Path) -> None:
    record = judged(run, "sfe", drive, "--out", tmp_path)
    assert median(record, "joint error", "Head") == pytest.approx(5.0, abs=1e-6)
    assert median(record, "joint error", "LeftHand") < 1e-6
    assert len(record["lengths"]["drive"]) == 22
    assert "Both poses" in (tmp_path / "index.html").read_text("utf-8")
    given = judged(run, "sfe", f"EV1={drive}", "--first", "0", "1", "--last", "11", "11.9", "--fit", "body")
    assert 0 < median(given, "joint error", "Head") < 5.0
    again = run("evaluate-mocap", "sfe", drive, "--out", tmp_path)
    assert (again.code, "--overwrite" in again.err) == (2, True)


def test_sse_tells_the_steps_error(run: Callable[..., Any], yaw: Path, tmp_path: Path) -> None:
    record = judged(run, "sse", f"yaw={yaw}", "--steps", "9", "--out", tmp_path)
    assert median(record, "error about the axis") == pytest.approx(0.5, abs=1e-6)
    (row,) = [s for s in record["summaries"] if s["measure"] == "error about the axis"]
    assert row["mean"] == pytest.approx(0.5 * 7 / 9, abs=0.02)
    assert "Error by angle" in (tmp_path / "index.html").read_text("utf-8")
    table = run("evaluate-mocap", "sse", f"yaw={yaw}", "--steps", "9", *FEW)
    assert "error about the axis  0.50 °" in table.out


def test_sse_counts_standstills_with_the_motors_angle_as_without(run: Callable[..., Any], tmp_path: Path) -> None:
    """Two adjacent standstills without a turn between them that one can see (the motor goes by 1 degree/s) are one."""
    time = np.arange(0, 9 * 1.5 - 0.3, 1 / 30)
    number = np.floor(time / 1.5)
    angle = (number + np.clip((time - number * 1.5 - 1.2) / 0.3, 0, 1)) * STEP_RAD
    waits = np.where(time < 6, 3 * STEP_RAD, angle - STEP_RAD + np.radians(1.0) * np.clip(time - 6, 0, 1))
    slow = np.where(time < 5.7, angle, waits)
    for name, turn in (("right", angle), ("merged", slow)):
        q = Rotation.from_rotvec(turn[:, None] * (0, 0, 1.0)).as_quat(scalar_first=True)
        motor = [(at, Channels(("deg",), np.array([x]))) for at, x in zip(time.tolist(), np.degrees(turn), strict=True)]
        moving_body.write_take(tmp_path / f"{name}.mcap", {"imu": moving_body.sensor_stream(time, q), "motor": motor})
    words = ("--steps", "9", "--motor", "motor/deg")
    record = judged(run, "sse", f"yaw={tmp_path / 'right.mcap'}", *words, "--samples", "20")
    assert record["notes"] == ["yaw: 9 steps, 180 samples"]  # none of those while it turned
    assert median(record, "error about the axis") < 1e-9
    for motor in ((), ("--motor", "motor/deg")):
        done = run("evaluate-mocap", "sse", f"yaw={tmp_path / 'merged.mcap'}", "--steps", "9", *motor, *FEW)
        assert (done.code, "stands still 8 times; 9 steps were expected" in done.err) == (2, True), done.err


def test_a_sensor_that_two_people_wear_is_nobodys(run: Callable[..., Any], tmp_path: Path) -> None:
    time = np.arange(0, 1, 1 / 30)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
    streams = {
        source: [(at, replace(message, subject=code)) for at, message in moving_body.sensor_stream(time, still)]
        for source, code in (("suit", "S01"), ("suit2", "S02"))
    }
    take = moving_body.write_take(tmp_path / "two.mcap", streams)
    done = run("evaluate-mocap", "sse", f"yaw={take}")
    assert (done.code, "S01 and S02 have a sensor" in done.err) == (2, True), done.err
    assert "of two in one source, give a recording or an MVNX file of one alone" in done.err  # where --source does not help
    assert "stands still 1 times" in run("evaluate-mocap", "sse", f"yaw={take}", "--source", "suit2").err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sse", "{yaw}"], "is of no axis"),
        (["sse", "yaw={yaw}"], "stands still 9 times; 33 steps were expected"),
        (["sse", "yaw={yaw}", "--sensor", "left"], "no orientations of a sensor 'left'"),
        (["sse", "yaw={yaw}", "--motor", "motor"], "names no channel"),
        (["sse", "yaw={yaw}", "--motor", "imu/deg"], "gives no channel 'deg'"),
        (["sse", "yaw={yaw}", "--steps", "9", "--samples", "-5"], "-5 samples of a step are none"),
        (["sfe", "{drive}", "--seed", "-1"], "-1 is no seed"),
        (["dfe", "{planes}", "--rate", "1e9", "--delay-ms", "40"], "no system gives 1e+09 samples a second"),
        (["sfe"], "nothing to evaluate"),
        (["sfe", "{drive}", "--first", "0", "1"], "one of the two poses has no time"),
        (["sfe", "nowhere.bvh", "--first", "0", "1"], "one of the two poses has no time"),  # before a take is read
        (["sfe", "nowhere.bvh", "--first", "0", "1", "--last", "10", "11", "--any-pose"], "--any-pose looks for poses"),
        (["sfe", "nowhere.bvh", "--fit", "body", "--pelvis", "Hips"], "--pelvis is not heeded"),
        (["sfe", "{drive}", "--first", "0", "1", "--last", "10", "11", "--any-pose"], "--any-pose looks for poses"),
        (["sfe", "{drive}", "--fit", "body", "--pelvis", "Hips"], "--pelvis is not heeded"),
        (["sfe", "{drive}", "--subject", "S02"], "no SegmentPoses of 'S02'"),
        (["sfe", "{planes}"], "stands still 0 times"),
        (["sfe", "nowhere.bvh"], "nowhere.bvh does not exist"),
        (["dse", "{drive}"], "has no source 'optical'"),
        (["dse", "{planes}", "--windows", "coronal"], "is no window"),
        (["dse", "{planes}", "--windows", "late=90:100"], "holds no frame"),
        (["dse", "{planes}", "--pairs", "tail=Hips"], "unknown pair 'tail'"),
        (["dse", "{planes}", "--pairs", "lknee=L_Tibia"], "unknown pair 'lknee'"),  # a pair of positions
        (["dse", "{planes}", "--sensors"], "no orientations of sensors"),
        (["dfe", "{planes}", "--delay-ms", "60000"], "no time in common"),
        (["dfe", "{planes}", "--pairs", "hip=Hips", "--delay-ms", "40"], "the pelvis' frame needs hip"),
        (["dfe", "{planes}", "--pairs", "lelbow=R_Elbow", "relbow=L_Elbow", "--delay-ms", "40"], "swapped"),
    ],
)  # fmt: skip
def test_what_is_refused(run: Callable[..., Any], planes: Path, drive: Path, yaw: Path, words: list[str], said: str) -> None:
    done = run("evaluate-mocap", *(w.format(planes=planes, drive=drive, yaw=yaw) for w in words))
    assert done.code == 2
    assert said in done.err
    assert "hint:" in done.err


@pytest.mark.real_data
def test_real_files_of_both_systems(run: Callable[..., Any], real_data: Callable[[str], Path]) -> None:
    mvnx = judged(run, "sfe", real_data("mocap/xsens_upper_body.mvnx"), "--first", "0", "0.1", "--last", "1.7", "1.9")
    assert max(bone["range_m"] for bone in mvnx["lengths"]["xsens_upper_body"]) < 3e-4
    pytest.importorskip("ezc3d")
    c3d = real_data("mocap/vicon_two_subjects.c3d")
    done = run("evaluate-mocap", "sfe", c3d, "--first", "0", "1", "--last", "4", "5", "--fit", "body")
    assert done.code == 2
    assert "several subjects" in done.err
