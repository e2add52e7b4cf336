"""The laboratory's calibration takes: their truth, and that their recordings say it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.board import Board
from cabinpose.app.lab.calibration import (
    BoardTake,
    PendulumTake,
    board_take,
    pendulum_take,
    write_board_take,
    write_pendulum_take,
)
from cabinpose.app.lab.markers import observed, spells
from cabinpose.app.lab.pendulum import GRAVITY, swing
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.core.errors import RecordingError, SceneError
from cabinpose.core.frames import apply, is_rigid, look_at
from cabinpose.store.recording import Recording
from cabinpose.store.recording.series import marker_series, tof_frames


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=(seed, 0)))


def true_times(rig: VirtualRig, source: str, device_ns: np.ndarray) -> np.ndarray:
    return rig.clock(source).device_from_true.inverse()(device_ns)


@pytest.fixture(scope="module")
def board() -> BoardTake:
    return board_take(VirtualRig(), views=18, rng=rng(3))


def test_the_board_is_shown_all_over_the_image_and_at_all_distances(board: BoardTake) -> None:
    rig = VirtualRig()
    sensor = rig.tof_sensor
    poses = rig.camera_from_world @ board.world_from_board
    uv = sensor.camera.project([apply(pose, np.concatenate((board.board.corners, board.board.marker_centres))) for pose in poses])
    assert sensor.camera.contains(uv).all()
    assert np.hypot(uv[..., 0] - sensor.camera.cx, uv[..., 1] - sensor.camera.cy).max() < sensor.field_radius_px
    centres = uv.mean(axis=1)
    assert (np.ptp(centres, axis=0) > 60).all()
    assert np.linalg.norm(uv - (sensor.camera.cx, sensor.camera.cy), axis=-1).max() > 140, "corners at the border of the lens"
    distances = [apply(pose, board.board.corners.mean(axis=0))[2] for pose in poses]
    assert 0.55 < min(distances) < 0.7
    assert 1.4 < max(distances) < 1.7
    tilt = np.degrees(np.arccos(poses[:, 2, 2]))
    assert tilt.max() > 25
    assert tilt.max() <= 38.001


def test_the_board_is_still_while_it_is_held_and_does_not_jump(board: BoardTake) -> None:
    held = board.poses(board.held_ns.ravel()).reshape(-1, 2, 4, 4)
    assert np.abs(held - board.world_from_board[:, None]).max() < 1e-9
    times = np.arange(board.held_ns[0, 0] - 200_000_000, board.held_ns[4, 0], 10_000_000)
    poses = board.poses(times)
    assert all(is_rigid(pose) for pose in poses[::7])
    markers = np.array([apply(pose, board.board.marker_centres) for pose in poses])
    speed = np.linalg.norm(np.diff(markers, axis=0), axis=-1).max(axis=-1) / 0.01
    assert speed.max() < 10
    assert np.abs(np.diff(speed)).max() < 2, "it starts and stops smoothly"
    assert (speed[: int(0.2 / 0.01)] == 0).all()


def test_a_camera_that_cannot_see_the_board_is_told() -> None:
    upwards = np.linalg.inv(look_at((0, 0, 1.0), (1.0, 0, 1.0)))
    with pytest.raises(SceneError, match="does not fit"):
        board_take(
            VirtualRig(sensor="kinect_v1", extrinsics=upwards, tof={"rate_hz": 30}), views=1, board=Board(square_m=0.3), rng=rng()
        )


def test_a_board_recording_says_what_was_true(tmp_path: Path) -> None:
    rig = VirtualRig.exact()
    truth = board_take(rig, views=2, hold_s=0.3, start_s=40.0, rng=rng(1))
    path = tmp_path / "board.mcap"
    write_board_take(path, rig, truth, frames_per_view=2, rng=rng(2))
    with Recording(path) as recording:
        assert recording.take.action == "board"
        seen = marker_series(recording, "optical", "board")
        frames = list(tof_frames(recording, "tof"))
    times = true_times(rig, "optical", seen.device_ns)
    assert seen.names == ("board1", "board2", "board3", "board4")
    assert len(times) == pytest.approx((truth.end_s - truth.start_s) * 100, abs=1.1)
    expected = np.array([apply(pose, truth.board.marker_centres) for pose in truth.poses(times)])
    assert np.abs(seen.position_m - expected).max() < 1e-8
    assert (seen.host_ns - times == 9_000_000).mean() > 0.5
    assert np.abs(seen.host_ns - times - 9_000_000).max() <= 2
    shown = true_times(rig, "tof", np.array([sample.device_ns for sample, _ in frames]))
    assert len(shown) == 4
    assert ((shown.reshape(2, 2) > truth.held_ns[:, :1]) & (shown.reshape(2, 2) < truth.held_ns[:, 1:])).all()
    # what frame and markers say together: the markers are where the camera sees something bright
    for at, (_, frame) in zip(shown, frames, strict=True):
        p_world = seen.position_m[np.abs(times - at).argmin()]
        u, v = np.rint(rig.tof_sensor.camera.project(apply(rig.camera_from_world, p_world))).astype(int).T
        assert (frame.amplitude[v, u] > 2 * np.percentile(frame.amplitude, 95)).all()


def test_the_optical_system_errs_as_the_rig_says() -> None:
    rig = VirtualRig(optical_noise_m=0.0002)
    times = rig.start_ns + np.arange(6000) * 100_000_000
    true = np.zeros((6000, 4, 3)) + np.arange(4)[:, None]
    said = observed(rig.only("optical_noise"), times, true, rng=rng())
    assert np.std(said - true) == pytest.approx(0.0002, rel=0.02)
    assert np.abs(np.mean(said - true)) < 5e-6
    lost = np.isnan(observed(rig.only("optical_occlusion"), times, true, rng=rng()))
    assert (lost.all(axis=-1) == lost.any(axis=-1)).all()
    assert 0.001 < lost.mean() < 0.05
    assert lost.any(axis=(0, 2)).sum() >= 2
    swapped = observed(VirtualRig(optical_swaps=True).only("optical_swaps"), times, true, rng=rng())
    wrong = (swapped != true).any(axis=-1)
    assert set(np.unique(wrong.sum(axis=1))) == {0, 2}
    assert (np.sort(swapped, axis=1) == true).all()
    assert (observed(VirtualRig.exact(), times, true, rng=rng()) == true).all()


def test_spells_last_as_long_as_they_should() -> None:
    time = np.arange(0, 2000, 0.01)
    inside = spells(time, 0.02, (0.5, 1.5), rng=rng())
    assert inside.mean() == pytest.approx(0.02, rel=0.35)
    lengths = np.diff(np.flatnonzero(np.diff(np.concatenate(([0], inside, [0])))))[::2] * 0.01
    assert lengths.min() >= 0.49
    assert np.median(lengths) == pytest.approx(1.0, abs=0.25)


def test_a_small_swing_has_the_period_of_the_textbook() -> None:
    motion = swing(25.0, length_m=0.65, amplitude_deg=4.0, by_hand_s=1.5, damping_per_s=0.0, rng=rng())
    time = np.arange(motion.release_s, 25, 0.001)
    p = motion(time)
    assert np.abs(np.linalg.norm(p, axis=-1) - 0.65).max() < 1e-8
    axis = np.array((1.0, 0.0, 0.0))  # the direction of release
    x = p @ axis
    rising = time[1:][(x[1:] >= 0) & (x[:-1] < 0)]
    # the series' next term for an ellipse of half axes a, b (rad): T = T0 (1 + (a^2 + b^2) / 16)
    other = np.abs(p[:, 1]).max() / 0.65
    expected = 2 * np.pi * np.sqrt(0.65 / GRAVITY) * (1 + (np.radians(4.0) ** 2 + other**2) / 16)
    assert np.mean(np.diff(rising)) == pytest.approx(expected, rel=3e-4)


def test_air_takes_energy_at_the_rate_of_the_damping() -> None:
    motion = swing(40.0, damping_per_s=0.06, rng=rng(5))
    time = np.arange(motion.release_s, 40, 0.002)
    p = motion(time)
    speed2 = (np.gradient(p, 0.002, axis=0) ** 2).sum(axis=-1)
    energy = speed2 / 2 + GRAVITY * (p[:, 2] + 0.65)
    # dE/dt = -c v^2
    lost = 0.06 * np.cumsum(speed2) * 0.002
    assert np.abs(energy[5:-5] + lost[5:-5] - energy[5]).max() < 0.005 * energy[5]


def test_the_pendulum_goes_from_the_hand_to_the_string_without_a_jump() -> None:
    motion = swing(12.0, rng=rng(2))
    p = motion(np.arange(0, 12, 0.002))
    assert np.abs(np.linalg.norm(p, axis=-1) - 0.65).max() < 1e-8
    assert np.linalg.norm(np.diff(p, axis=0), axis=-1).max() / 0.002 < 4.0
    assert (motion([-1.0]) == motion([0.0])).all()
    at_release = motion([motion.release_s - 1e-9, motion.release_s])
    assert np.abs(np.diff(at_release, axis=0)).max() < 1e-6


@pytest.fixture(scope="module")
def pendulum() -> PendulumTake:
    return pendulum_take(VirtualRig(), rng=rng(1))


def test_the_pendulum_stays_in_view_and_looks_like_itself_at_no_other_time(pendulum: PendulumTake) -> None:
    rig = VirtualRig()
    times = pendulum.start_ns + np.arange(0, 25_000_000_000, 20_000_000)
    camera = rig.tof_sensor.camera
    uv = camera.project(apply(rig.camera_from_world, pendulum.marker(times)))
    assert (camera.contains(uv)).all()
    assert (np.ptp(uv, axis=0) > (70, 15)).all()
    for lag in range(25, len(uv) // 2):
        a, b = uv[:-lag] - uv[:-lag].mean(axis=0), uv[lag:] - uv[lag:].mean(axis=0)
        assert (a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()) < 0.93, lag


def test_a_pendulum_recording_says_what_was_true(tmp_path: Path) -> None:
    rig = VirtualRig.exact()
    truth = pendulum_take(rig, duration_s=1.6, start_s=7.0, rng=rng(1))
    path = tmp_path / "pendulum.mcap"
    write_pendulum_take(path, rig, truth, rng=rng(2))
    with Recording(path) as recording:
        seen = marker_series(recording, "optical", "pendulum")
        frames = list(tof_frames(recording, "tof"))
    times = true_times(rig, "optical", seen.device_ns)
    assert np.abs(seen.marker("pendulum") - truth.marker(times)).max() < 1e-8
    shown = true_times(rig, "tof", np.array([sample.device_ns for sample, _ in frames]))
    assert len(frames) == pytest.approx(40, abs=1)
    assert [sample.sequence for sample, _ in frames] == list(range(len(frames)))
    camera = rig.tof_sensor.camera
    found = np.array([_blob(frame.amplitude) for _, frame in frames])
    off = [
        np.abs(found - camera.project(apply(rig.camera_from_world, truth.marker(shown + late_ns)))).max()
        for late_ns in (0, 10_000_000)
    ]
    assert off[0] < 0.1
    assert off[1] > 0.5


def _blob(amplitude: np.ndarray) -> tuple[float, float]:
    v, u = np.unravel_index(np.argmax(amplitude), amplitude.shape)
    window = amplitude[v - 5 : v + 6, u - 5 : u + 6].astype(np.float64)
    window = np.maximum(window - 0.2 * window.max(), 0)
    rows, columns = np.mgrid[v - 5 : v + 6, u - 5 : u + 6]
    return (window * columns).sum() / window.sum(), (window * rows).sum() / window.sum()


def test_the_same_seed_makes_the_same_file_and_another_does_not(tmp_path: Path) -> None:
    rig = VirtualRig()
    made = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        generator = rng(seed)
        write_pendulum_take(tmp_path / name, rig, pendulum_take(rig, duration_s=0.4, rng=generator), rng=generator)
        made.append((tmp_path / name).read_bytes())
    assert made[0] == made[1]
    assert made[0] != made[2]
    with pytest.raises(RecordingError, match="exists"):
        write_pendulum_take(tmp_path / "a", rig, pendulum_take(rig, duration_s=0.4, rng=rng()), rng=rng())


def test_a_hold_too_short_for_the_frames_is_told(tmp_path: Path) -> None:
    rig = VirtualRig()
    truth = board_take(rig, views=1, hold_s=0.05, rng=rng())
    with pytest.raises(SceneError, match="while the board is held"):
        write_board_take(tmp_path / "short.mcap", rig, truth, frames_per_view=3, rng=rng())


def test_poses_turn_by_the_shorter_way(board: BoardTake) -> None:
    turns = Rotation.from_matrix(board.world_from_board[:, :3, :3])
    between = (board.held_ns[:-1, 1] + board.held_ns[1:, 0]) // 2
    halfway = Rotation.from_matrix(board.poses(between)[:, :3, :3])
    apart = (turns[:-1].inv() * turns[1:]).magnitude()
    assert np.allclose((turns[:-1].inv() * halfway).magnitude(), apart / 2, atol=1e-6)
