"""A take aligned: joints where the formulas say, frames left out for the reason that holds, a dataset of the standard."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.align.calibration import Calibration, Head, Intrinsics, KnownDelay, rows
from cabinpose.align.dataset import SuitCorrections, align_takes
from cabinpose.align.project import REASONS, align_take
from cabinpose.align.time import TISSUE_S, with_known
from cabinpose.app.report.heads import write_head_page
from cabinpose.core import transform
from cabinpose.core.errors import AlignmentError, RecordingError, UndeterminedError
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.store import open_dataset
from cabinpose.store.recording import Recording
from cabinpose.store.source import import_source

sys.path.insert(0, str(Path(__file__).parent))
import rig_takes
from rig_takes import Made, calibration, joints_in_camera


def aligned(path: Path, code: str = "S07"):
    with Recording(path) as recording:
        return align_take(recording, calibration(), code)


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    path = tmp_path_factory.mktemp("takes") / "take.mcap"
    return path, Made(jitter_s=0.0).write(path)


def test_joints_are_where_the_formulas_say_whatever_the_clocks(take) -> None:
    path, time = take
    found = aligned(path)
    inside = found.kept
    assert inside.sum() >= len(time) - 2  # ends of the other sources' takes
    error = np.linalg.norm(found.joints[inside] - joints_in_camera(time[inside]), axis=2)
    assert error.max() < 2e-4  # lines between samples of 60 Hz
    assert found.delay.offset_s == pytest.approx(rig_takes.LATENCY_S["optical"] - rig_takes.LATENCY_S["suit"], abs=1e-4)


def test_late_arrivals_cost_little(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    time = Made(jitter_s=0.004).write(path)
    found = aligned(path)
    error = np.linalg.norm(found.joints[found.kept] - joints_in_camera(time[found.kept]), axis=2)
    assert np.median(error) < 1e-3
    assert found.delay.offset_s == pytest.approx(-0.015, abs=1e-3)


def test_a_calibration_that_is_wrong_is_wrong_here_too(take) -> None:
    """The check above would see a transform or a delay that is off."""
    path, time = take
    turned = rig_takes.OBJECT_FROM_HEAD.copy()
    turned[:3, 3] += (0.0, 0.02, 0.0)
    for change in (
        {"heads": {"S07": Head(object_from_head=rows(turned))}},
        {"tof_to_optical": KnownDelay(offset_s=0.03)},
    ):
        with Recording(path) as recording:
            found = align_take(recording, calibration(**change), "S07")
        error = np.linalg.norm(found.joints[found.kept] - joints_in_camera(time[found.kept]), axis=2)
        assert error[:, CABINPOSE.index["head"]].max() > 2e-3


def test_frames_are_left_out_for_the_reason_that_holds(tmp_path: Path) -> None:
    path = tmp_path / "gaps.mcap"
    time = Made(jitter_s=0.0, optical_gap=(4.0, 5.0), suit_until_s=12.0).write(path)
    found = aligned(path)
    reason = np.array(found.reason)
    assert (reason[(time > 4.05) & (time < 4.95)] == REASONS[1]).all()
    assert (reason[time > 12.05] == REASONS[2]).all()
    assert not found.kept[(time > 4.01) & (time < 4.99)].any()
    assert found.kept[(time > 0.1) & (time < 3.95)].all()
    assert np.isnan(found.joints[reason == REASONS[1]]).all()
    assert sum(found.left_out.values()) + found.kept.sum() == len(time)


def test_what_cannot_be_aligned_is_refused(tmp_path: Path, take) -> None:
    def refused(made: Made, says: str, kind: type[Exception] = AlignmentError) -> None:
        path = tmp_path / f"{abs(hash(says))}.mcap"
        made.write(path)
        with pytest.raises(kind, match=says) as caught:
            align_takes([path], calibration())
        assert getattr(caught.value, "hint", "")

    refused(Made(seconds=6, sources=("tof", "optical")), "no source 'suit'", RecordingError)
    refused(Made(seconds=6, sources=("optical", "suit")), "no source 'tof'", RecordingError)
    refused(Made(seconds=6, codes=()), "names no subject")
    refused(Made(seconds=6, codes=("S07", "S08")), "knows no subject S08")
    refused(Made(seconds=6, codes=("S09",)), "knows no subject S09")
    refused(Made(seconds=6, suit_still=True), "constant|does not move|no motion|weak|still")
    refused(Made(seconds=6, optical_gap=(-1, 99)), "optical|b has|b is|not known|known samples")
    with pytest.raises(RecordingError, match="of 'S01'"), Recording(take[0]) as recording:
        align_take(recording, calibration(heads={"S01": Head(object_from_head=rows(np.eye(4)))}), "S01")


def test_a_known_delay_sharpens_a_wide_one_and_leaves_a_contradiction_alone(take) -> None:
    exact = aligned(take[0]).delay
    half = 0.004
    measured = replace(exact, interval_s=(exact.offset_s - half, exact.offset_s + half))
    same = KnownDelay(
        offset_s=measured.offset_s + 0.5 * half, interval_s=(measured.offset_s - 0.5 * half, measured.offset_s + 1.5 * half)
    )
    joined = with_known(measured, same)
    assert joined.offset_s == pytest.approx(measured.offset_s + 0.25 * half)
    assert joined.interval_s[1] - joined.interval_s[0] == pytest.approx(np.sqrt(2) * half)
    # without noise, what both takes have in common is left, and two takes do not halve it
    low, high = exact.interval_s
    assert 0.5 * (high - low) == pytest.approx(TISSUE_S, rel=0.05)
    shared = with_known(exact, KnownDelay(offset_s=exact.offset_s, interval_s=exact.interval_s)).interval_s
    assert 0.5 * (shared[1] - shared[0]) == pytest.approx(TISSUE_S, rel=0.05)
    other = KnownDelay(offset_s=measured.offset_s + 1.0, interval_s=(measured.offset_s + 0.999, measured.offset_s + 1.001))
    assert with_known(measured, other) is measured
    assert with_known(measured, None) is measured


def test_a_take_too_short_for_a_delay_of_its_own_takes_the_known_one(tmp_path: Path) -> None:
    path = tmp_path / "short.mcap"
    time = Made(seconds=3, jitter_s=0.0).write(path)
    with pytest.raises(UndeterminedError, match=r"short\.mcap: the head of S07 in the suit.*too short"):
        aligned(path)
    known = KnownDelay(offset_s=-0.015, interval_s=(-0.016, -0.014))
    head = Head(object_from_head=rows(rig_takes.OBJECT_FROM_HEAD), suit_to_optical=known)
    with Recording(path) as recording:
        found = align_take(recording, calibration(heads={"S07": head}), "S07")
    error = np.linalg.norm(found.joints[found.kept] - joints_in_camera(time[found.kept]), axis=2)
    assert error.max() < 2e-4
    assert found.delay.offset_s == -0.015


def test_takes_become_a_dataset_of_the_standard(tmp_path: Path, take) -> None:
    path, time = take
    other = tmp_path / "other.mcap"
    Made(seconds=6, seed=8, depth_m=0.5).write(other)
    takes = align_takes([path, other], calibration(vehicle_from_world=rows(np.eye(4))))
    seen: list[int] = []
    folder = import_source(takes.source, tmp_path / "dataset", report=seen.append)
    data = open_dataset(folder)
    first, second = takes.reports
    assert data.sizes["frame"] == first.kept + second.kept == seen[-1]
    assert np.unique(data["sequence"].values).tolist() == [0, 1]
    driver = list(data["person"].values).index("driver")
    there = data["subject"].values != ""
    assert there[:, driver].all()
    assert there.sum() == data.sizes["frame"]
    assert set(data["action"].values[:, driver]) == {"reach"}
    found = data["joints_3d"].values[: first.kept, driver]
    kept = aligned(path).kept
    assert np.linalg.norm(found - joints_in_camera(time[kept]), axis=2).max() < 2e-4
    uv = rig_takes.CAMERA.project(joints_in_camera(time[kept]))
    assert np.allclose(data["joints_2d"].values[: first.kept, driver], uv, atol=0.05)
    assert np.allclose(data["vehicle_from_camera"].values[0] @ rig_takes.CAMERA_FROM_WORLD, np.eye(4), atol=1e-9)
    assert np.diff(data["sync_ns"].values[: first.kept]).min() > 0
    # nothing was measured in the first take, a wall at 0.5 m hides everybody in the second
    states = data["visibility"].values[:, driver]
    assert set(np.unique(states[: first.kept])) <= {Visibility.OUTSIDE_IMAGE, Visibility.VISIBLE}
    assert (states[first.kept :, CABINPOSE.index["lwrist"]] == Visibility.OCCLUDED).any()
    assert first.joints_measured == 0
    assert np.isnan(first.floating)
    assert second.joints_measured > 0
    apart = data["head_residual"].values
    assert np.isfinite(apart[:, driver]).all()
    assert np.isnan(np.delete(apart, driver, axis=1)).all()
    assert first.head_deg[0] <= first.head_deg[1] == pytest.approx(np.degrees(apart[: first.kept, driver].max()), abs=1e-4)
    assert first.head_deg[1] < 0.2  # nothing is wrong with these heads
    people = [(each.sequence, each.recording, each.subject, each.person) for each in takes.reports]
    write_head_page(folder, people, tmp_path / "head.html")
    page = (tmp_path / "head.html").read_text("utf-8")
    assert page.count("<figure>") == 8  # of each take the two best frames and the two worst
    assert f"{path.name}, S07: worst, {first.head_deg[1]:.2f} deg" in page


def pair_calibration(suit: str) -> Calibration:
    """The true calibration of two people, the second in the suit of this source."""
    head = Head(object_from_head=rows(rig_takes.OBJECT_FROM_HEAD))
    return calibration(heads={"S07": head, "S08": head.model_copy(update={"suit": suit, "head_object": "head2"})})


@pytest.mark.parametrize("suit", ["suit", "suit2"])  # two characters of one streamer; two suits
def test_two_people_in_one_take_are_both_in_the_dataset(tmp_path: Path, suit: str) -> None:
    path = tmp_path / "pair.mcap"
    time = Made(jitter_s=0.0, codes=("S07", "S08"), second=suit).write(path)
    takes = align_takes([path], pair_calibration(suit))
    data = open_dataset(import_source(takes.source, tmp_path / "dataset"))
    frames = data.sizes["frame"]
    assert frames >= len(time) - 4
    true_s = (data["sync_ns"].values - rig_takes.START_NS) / 1e9 - rig_takes.LATENCY_S["tof"]
    for place, code, truth in (
        ("driver", "S07", joints_in_camera(true_s)),
        ("front_passenger", "S08", rig_takes.second_in_camera(true_s)),
    ):
        person = data.sel(person=place)
        assert set(person["subject"].values) == {code}
        assert np.linalg.norm(person["joints_3d"].values - truth, axis=2).max() < 3e-4
        assert np.degrees(person["head_residual"].values).max() < 0.2
    for report, source in zip(takes.reports, ("suit", suit), strict=True):
        late = rig_takes.LATENCY_S["optical"] - rig_takes.LATENCY_S[source]
        assert report.suit_delay_ms == pytest.approx(1000 * late, abs=0.2)
        assert (report.kept, report.sequence) == (frames, 0)
    pages = [(each.sequence, each.recording, each.subject, each.person) for each in takes.reports]
    write_head_page(tmp_path / "dataset", pages, tmp_path / "head.html")
    assert "1 take, " in (tmp_path / "head.html").read_text("utf-8")


def test_joints_of_whom_no_pixel_is_seen_stay(tmp_path: Path, take) -> None:
    path, _ = take
    takes = align_takes([path], calibration(), corrections=SuitCorrections(depth=True))
    data = open_dataset(import_source(takes.source, tmp_path / "dataset")).sel(person="driver")
    assert (data["joint_shift"].values == 0.0).all()
    true_s = (data["sync_ns"].values - rig_takes.START_NS) / 1e9 - rig_takes.LATENCY_S["tof"]
    assert np.linalg.norm(data["joints_3d"].values - joints_in_camera(true_s), axis=2).max() < 3e-4
    assert set(takes.reports[0].depth_corrected_cm.values()) == {0.0}


@pytest.mark.slow
def test_frames_in_which_one_of_two_people_has_no_pose_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "pair.mcap"
    Made(jitter_s=0.0, codes=("S07", "S08"), second="suit2", optical_gap=(4.0, 5.0)).write(path)
    first, second = align_takes([path], pair_calibration("suit2")).reports
    assert first.left_out["no head object"] == second.left_out["the pose of somebody else is not known"] >= 18
    assert first.kept == second.kept
    alone = align_takes([path], pair_calibration("suit2"), subject="S08").reports
    assert alone[0].kept == second.kept + second.left_out["the pose of somebody else is not known"]
    Made(codes=("S07", "S08"), second="suit2", car="", seat=None).write(tmp_path / "room.mcap")
    with pytest.raises(AlignmentError, match="S07 and S08 have one place"):
        align_takes([tmp_path / "room.mcap"], pair_calibration("suit2"))


def test_a_take_of_another_computer_or_network_is_told(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    facts = {"computer": "c0ffee", "network eth0": "MTU 9000, 1000 Mb/s", "kernel": "Linux 6.1"}
    Made(seconds=6, drive_side="left", host=facts).write(path)
    assert align_takes([path], calibration(host=facts)).warnings == []
    assert align_takes([path], calibration()).warnings == []  # a calibration of before this was recorded
    then = facts | {"network eth0": "MTU 1500, 1000 Mb/s", "network wlan0": "MTU 1500"}
    (warning,) = align_takes([path], calibration(host=then)).warnings
    assert warning.startswith("take.mcap: not recorded as the pendulum was")
    assert "network eth0: MTU 1500, 1000 Mb/s then, MTU 9000, 1000 Mb/s now" in warning
    assert "network wlan0: MTU 1500 then, none now" in warning
    assert "kernel" not in warning


def test_the_side_of_the_wheel_is_what_a_take_says_or_where_its_people_sit(tmp_path: Path) -> None:
    """The driver's pelvis decides, about a metre to the right of the car's middle or to its left."""

    def sides(made: Made, to_left_m: float | None, **options: Any) -> tuple[str, list[str]]:
        path = tmp_path / f"{made.seat} {made.drive_side}.mcap"
        if not path.exists():
            made.write(path)
        car = {} if to_left_m is None else {"vehicle_from_world": rows(transform(None, (0, to_left_m, 0)))}
        takes = align_takes([path], calibration(**car), **options)
        return next(takes.source.frames()).get("drive_side", "not there"), takes.warnings

    driver = Made(seconds=6)
    assert sides(driver, -1.0) == ("right", [])
    assert sides(driver, 1.0) == ("left", [])
    assert sides(replace(driver, seat="front_passenger"), -1.0) == ("left", [])
    assert sides(replace(driver, drive_side="right"), None) == ("right", [])
    assert sides(driver, None, drive_side="right") == ("right", [])
    said, (warning,) = sides(replace(driver, drive_side="left"), -1.0)
    assert said == "left"
    assert "said to have its wheel on the left, but as people sit in front it is on the right" in warning
    said, (warning,) = sides(driver, None)
    assert said == "not there"
    assert "--drive-side left or right, or `drive_side` in the rig's take" in warning
    assert sides(replace(driver, car="", seat=None), None) == ("not there", [])


def test_a_seat_that_is_not_named_and_another_cameras_size_are_refused(tmp_path: Path, take) -> None:
    path = tmp_path / "take.mcap"
    Made(seconds=6, seat=None).write(path)
    with pytest.raises(AlignmentError, match="does not say where S07 sits in the sedan"):
        align_takes([path], calibration())
    Made(seconds=6, seat=None, car="").write(tmp_path / "room.mcap")
    assert align_takes([tmp_path / "room.mcap"], calibration()).source.manifest.persons == ("standing",)
    lens = Intrinsics(width=32, height=24, fx=20, fy=20, cx=15.5, cy=11.5)
    takes = align_takes([take[0]], calibration(intrinsics=lens))
    with pytest.raises(AlignmentError, match="64x48 pixels, the calibration is of 32x24"):
        import_source(takes.source, tmp_path / "dataset")
    assert not (tmp_path / "dataset").exists()


@pytest.mark.parametrize("first", [True, False])
def test_takes_with_other_images_are_refused_before_one_is_aligned(
    first: bool, tmp_path: Path, take, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cabinpose.align.dataset.align_take", lambda *_, **__: pytest.fail("it was aligned"))
    Made(seconds=6, amplitude=False).write(tmp_path / "dark.mcap")
    paths = [take[0], tmp_path / "dark.mcap"]
    with pytest.raises(AlignmentError, match=r"other images.*take.mcap has depth, amplitude") as error:
        align_takes(paths if first else paths[::-1], calibration())
    assert "align them apart" in str(error.value.hint)


def test_the_file_of_a_calibration_comes_back_and_what_is_wrong_in_it_is_named(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    calibration().save(path)
    assert Calibration.load(path) == calibration()
    text = path.read_text()
    for wrong, says in (
        (text.replace("fx: 40.0", "fx: -40.0"), "intrinsics.fx"),
        (text.replace("version: 1", "version: 2"), "version"),
        (text + "focus: 3\n", "focus"),
        ("- 1\n", "no mapping"),
        ("a: [", "not YAML"),
    ):
        path.write_text(wrong)
        with pytest.raises(AlignmentError, match=says) as caught:
            Calibration.load(path)
        assert caught.value.hint
    mirrored = rig_takes.CAMERA_FROM_WORLD @ np.diag((-1.0, 1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="right-handed"):
        calibration(extrinsics={"camera_from_world": rows(mirrored)})
