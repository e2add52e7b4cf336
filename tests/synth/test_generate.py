"""Generation end to end: the same bytes however it is run, killed or not; refusals before any work; honest counts."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster
from synth_scenes import PART, fingerprint, small_config, start

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, DatasetError, SceneError
from cabinpose.core.pose import OCCUPANT_SLOTS, Visibility
from cabinpose.scene.cabin import build_cabin
from cabinpose.scene.labels import FIRST_BODY_ID, LAST_BODY_ID
from cabinpose.store import open_dataset
from cabinpose.synth.config import Limits, Output, SynthConfig, room_preset
from cabinpose.synth.generate import Progress, generate

FRAMES = 3 * PART


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset made in one go by one worker."""
    out = tmp_path_factory.mktemp("reference") / "dataset"
    report = generate(small_config(), FRAMES, out, seed=7, workers=1)
    assert report.frames == report.frames_total == FRAMES
    return out


def test_two_threads_write_the_same_bytes(reference: Path, tmp_path: Path) -> None:
    process = start(tmp_path / "run.py", tmp_path / "two", workers=2)
    assert process.wait(timeout=300) == 0
    assert fingerprint(tmp_path / "two") == fingerprint(reference)


def test_killed_and_resumed_writes_the_same_bytes(reference: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    process = start(tmp_path / "run.py", out, workers=1)
    assert process.stdout is not None
    while process.stdout.readline() != f"done {PART}\n":  # then the first part is on disk, the second has begun
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(timeout=60)
    done = sorted(p.name for p in out.glob("part-*.zarr"))
    assert 1 <= len(done) < FRAMES // PART
    with pytest.raises(DatasetError):
        generate(small_config(), FRAMES, out, seed=7, workers=1)
    report = generate(small_config(), FRAMES, out, seed=7, workers=1, existing="resume")
    assert report.frames == FRAMES - PART * len(done)
    assert fingerprint(out) == fingerprint(reference)


def test_a_dataset_grows_from_any_number_of_frames(reference: Path, tmp_path: Path) -> None:
    out = tmp_path / "grown"
    generate(small_config(), PART + 1, out, seed=7, workers=1)
    report = generate(small_config(), FRAMES, out, seed=7, workers=1, existing="resume")
    assert (report.frames, report.frames_total) == (FRAMES - PART, FRAMES)
    assert fingerprint(out) == fingerprint(reference)


def test_old_keywords_go_on_working_and_say_the_new_ones(reference: Path) -> None:
    with pytest.warns(DeprecationWarning, match='existing="resume"'):
        report = generate(small_config(), FRAMES, reference, seed=7, workers=1, resume=True)  # type: ignore[call-arg]
    assert (report.frames, report.frames_total) == (0, FRAMES)
    with pytest.warns(DeprecationWarning, match="existing"), pytest.raises(ConfigError, match="either resumed or overwritten"):
        generate(small_config(), FRAMES, reference, resume=True, overwrite=True)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="resumed"):
        generate(small_config(), FRAMES, reference, resumed=True)  # type: ignore[call-arg]


@pytest.mark.slow
def test_a_cluster_makes_the_same_bytes_though_a_worker_dies(reference: Path, tmp_path: Path) -> None:
    """One worker is a thread of this process; the other is a process of its own, which is killed at the first sign of life."""
    here = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "protocol": "tcp://", "host": "127.0.0.1"}
    with LocalCluster(**here, dashboard_address=None, silence_logs="ERROR") as cluster:
        command = [
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            cluster.scheduler_address,
            "--no-nanny",
            "--nthreads",
            "1",
        ]
        other = subprocess.Popen([*command, "--no-dashboard"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=tmp_path)
        ended_before = []

        def kill_it(_: Progress) -> None:
            ended_before.append(other.poll())
            other.kill()

        try:
            with Client(cluster) as client:
                client.wait_for_workers(2, timeout=120)
            out = tmp_path / "wounded"
            report = generate(small_config(), FRAMES, out, seed=7, workers=cluster.scheduler_address, progress=kill_it)
        finally:
            other.kill()
            other.wait(timeout=60)
    assert ended_before[0] is None  # it was at work until then
    assert report.frames == FRAMES
    assert fingerprint(out) == fingerprint(reference)


def test_another_seed_makes_other_frames(reference: Path, tmp_path: Path) -> None:
    generate(small_config(), PART, tmp_path / "other", seed=8, workers=1)
    ours, theirs = open_dataset(reference), open_dataset(tmp_path / "other")
    assert not np.array_equal(ours.depth[0].values, theirs.depth[0].values, equal_nan=True)


def test_frames_hold_together(reference: Path) -> None:
    dataset = open_dataset(reference)
    assert dataset.sizes["frame"] == FRAMES
    for index in range(FRAMES):
        frame = dataset.isel(frame=index)
        k = frame.camera_k.values
        camera = Camera(352, 287, k[0, 0], k[1, 1], k[0, 2], k[1, 2], tuple(frame.camera_dist.values))
        joints, pixels, state = (frame[name].values for name in ("joints_3d", "joints_2d", "visibility"))
        seated = np.flatnonzero(frame.subject.values != "")
        assert [OCCUPANT_SLOTS[i] for i in seated] == ["driver"]
        np.testing.assert_allclose(camera.project(joints[seated]), pixels[seated], rtol=1e-4, atol=0.02)
        assert np.isnan(joints[1:]).all()
        assert (state[1:] == Visibility.ABSENT).all()
        assert (state[0] != Visibility.ABSENT).all()
        labels, instance = frame.labels.values, frame.instance.values
        is_body = (labels >= FIRST_BODY_ID) & (labels <= LAST_BODY_ID)
        assert set(np.unique(instance)) == {0, 1}
        np.testing.assert_array_equal(instance > 0, is_body)
        assert is_body.mean() > 0.05
        clean, noisy = frame.depth_clean.values, frame.depth.values
        both = ~np.isnan(clean) & ~np.isnan(noisy) & is_body
        assert both.sum() > 0.5 * is_body.sum()
        assert np.median(np.abs(clean[both] - noisy[both])) < 0.02
        # A visible joint lies under the skin seen at its pixel: behind it, but not deeper than a body is thick.
        for u, v, z in np.c_[pixels[0], joints[0, :, 2]][state[0] == Visibility.VISIBLE]:
            assert -0.03 < z - clean[round(v), round(u)] < 0.30


def test_a_finished_dataset_is_neither_overwritten_nor_mixed(reference: Path) -> None:
    before = fingerprint(reference)
    for config, options in [(small_config(), {}), (small_config(belted=0.0), {"existing": "resume"})]:
        with pytest.raises(DatasetError) as caught:
            generate(config, FRAMES, reference, seed=7, workers=1, **options)
        assert caught.value.hint
    assert fingerprint(reference) == before


def test_a_scene_that_cannot_be_ends_with_its_cause(tmp_path: Path) -> None:
    # The upper arm goes down through the chest in every pose.
    axes = {
        "lshoulder.flexion": {"mean_deg": 0.0, "sigma_deg": 0.0},
        "lshoulder.abduction": {"mean_deg": -45.0, "sigma_deg": 0.0},
    }
    config = small_config(profile={"kind": "gaussian", "axes": axes})
    config = config.model_copy(update={"limits": Limits(poses_per_person=4, scenes_per_frame=2)})
    with pytest.raises(SceneError) as caught:
        generate(config, PART, tmp_path / "impossible", workers=1)
    assert re.match(r"frame \d: none of 8 poses", str(caught.value))
    assert "driver: lupper_arm in torso" in str(caught.value)
    assert "Tried: hatchback (S0" in str(caught.value)
    assert not (tmp_path / "impossible").exists()  # nothing is in the way of the next try


@pytest.mark.parametrize(
    ("frames", "options", "word"),
    [
        (0, {}, "0 frames"),
        (1, {"workers": 0}, "0 workers"),
        (1, {"seed": -1}, "seed"),
        pytest.param(1, {"workers": "tcp://127.0.0.1:9"}, "127.0.0.1:9", marks=pytest.mark.slow),  # tried for ten seconds
    ],
)
def test_bad_numbers(frames: int, options: dict[str, int], word: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=word):
        generate(small_config(), frames, tmp_path / "out", **options)


def test_a_camera_inside_a_seat_is_refused_before_work(tmp_path: Path) -> None:
    config = small_config()
    seat = build_cabin("hatchback", drive_side="left").seats["driver"]
    eye = seat.h_point(seat.default) + (0.1, 0.0, -0.11)  # in the cushion, below the thighs
    view = {"position_m": eye.tolist(), "look_at_m": (0.0, 0.0, 1.0)}
    config = SynthConfig.parse(config.model_dump(mode="json") | {"camera": {"views": {"mine": view}}})
    with pytest.raises(ConfigError, match="mine"):
        generate(config, 1, tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()


def test_impossible_combinations_are_left_out(tmp_path: Path) -> None:
    # The left upper arm swings from within the chest (impossible) out beside it.
    axes = {"lshoulder.flexion": {"min_deg": 0.0, "max_deg": 0.0, "step_deg": 1.0}}
    axes["lshoulder.abduction"] = {"min_deg": -45.0, "max_deg": 15.0, "step_deg": 30.0}
    config = small_config(profile={"kind": "incremental", "axes": axes}, motion={"driver": {"rest_lap": 1.0}})
    config = config.model_copy(update={"limits": Limits(poses_per_person=10, scenes_per_frame=4)})
    report = generate(config, 3, tmp_path / "grid", workers=1)
    dataset = open_dataset(tmp_path / "grid")
    assert dataset.frame.values.tolist() == [1, 2]
    assert (report.frames, dataset.attrs["skipped_frames"]) == (2, 1)
    assert report.rejections["self"] > 0
    resumed = generate(config, 3, tmp_path / "grid", workers=1, existing="resume")
    assert (resumed.frames, resumed.frames_total) == (0, 2)


def test_more_frames_than_combinations_are_refused(tmp_path: Path) -> None:
    profile = {"kind": "incremental", "axes": {"lelbow.flexion": {"min_deg": 20.0, "max_deg": 60.0, "step_deg": 20.0}}}
    with pytest.raises(ConfigError, match="all combinations are 3"):
        generate(small_config(profile=profile), 4, tmp_path / "out", workers=1)


def test_a_room_with_somebody_in_it(tmp_path: Path) -> None:
    config = room_preset().model_copy(update={"output": Output(frames_per_part=4)})
    started = time.perf_counter()
    report = generate(config, 4, tmp_path / "room", workers=1)
    elapsed = time.perf_counter() - started
    assert 0.5 * elapsed < report.seconds <= elapsed  # all of the work, measured by the same clock
    dataset = open_dataset(tmp_path / "room")
    assert dataset.sizes["person"] == 1
    itop = dataset.itop_joints_3d.values[:, 0]
    assert np.isfinite(itop).all()
    assert (np.abs(itop[:, 8] - (itop[:, 1] + (itop[:, 9] + itop[:, 10]) / 2) / 2) < 1e-3).all()  # the torso's definition
    assert ((itop[..., 2] > 1.2) & (itop[..., 2] < 5.0)).all()


def test_other_sets_of_joints_are_written_where_they_are_asked_for(tmp_path: Path) -> None:
    for name, output, expected in (("none", [], []), ("itop", ["itop", "rig", "itop"], ["itop_joints_3d", "rig_joints_3d"])):
        config = small_config()
        config = config.model_copy(update={"output": config.output.model_copy(update={"skeletons": tuple(output)})})
        generate(config, 1, tmp_path / name, workers=1)
        dataset = open_dataset(tmp_path / name)
        assert [v for v in dataset.data_vars if str(v).endswith("_joints_3d")] == expected
    there = dataset["subject"].values != ""
    shoulders = dataset["rig_joints_3d"].sel(rig_joint=["lshoulder", "rshoulder"]).values[there]
    assert np.array_equal(dataset["itop_joints_3d"].sel(itop_joint=["lshoulder", "rshoulder"]).values[there], shoulders)
    with pytest.raises(ConfigError, match=r"output\.skeletons\[0\]: must be one of itop"):
        SynthConfig.parse({"output": {"skeletons": ["cabinpose"]}})
