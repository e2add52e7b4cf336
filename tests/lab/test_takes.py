from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.app.lab.optical import MODEL_SEGMENTS
from cabinpose.app.lab.rig import Device, VirtualRig
from cabinpose.app.lab.takes import Actor, Truth, truth_path, write_action_take, write_head_take, write_motion_take
from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import apply, invert
from cabinpose.core.skeleton import CABINPOSE, MVN_SEGMENTS
from cabinpose.scene.sensor import Sensor, sensor_by_name
from cabinpose.store.recording import Recording, SegmentSeries, segment_series, tof_frames

INDEX, MAPS = CABINPOSE.index, CABINPOSE.maps

SMALL: Sensor = sensor_by_name("evk75023").model_copy(update={"camera": Camera.from_fov(120, 96, np.radians(95.0))})


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"rig": None}, "it has no rig"),
        ({"hands": np.zeros((2, 4))}, r"hands is float64 \(2, 4\), which does not fit"),
        ({"tof_ns": np.zeros(5, np.int64)}, "joints_3d is .*, which does not fit"),
        ({"actions": np.zeros(2)}, "actions is float64"),
        ({"windows": np.array([{}], object)}, "windows.npy holds Python objects"),
        ({"suit_position": np.zeros((2, 23, 3), "S1")}, "suit_position is"),
    ],
)
def test_a_damaged_truth_is_told(changed: dict[str, np.ndarray | None], said: str, tmp_path: Path) -> None:
    path, eye = tmp_path / "take.truth.npz", np.eye(4)
    values = {
        "suit_ns": np.arange(2), "optical_ns": np.arange(3), "tof_ns": np.arange(2), "suit_position": np.zeros((2, 23, 3)),
        "suit_orientation_wxyz": np.zeros((2, 23, 4)), "world_from_object": np.zeros((3, 4, 4)),
        "object_seen": np.ones((3, 5), bool), "joints_3d": np.zeros((2, 20, 3)), "joints_2d": np.zeros((2, 20, 2)),
        "visibility": np.zeros((2, 20), np.uint8), "camera_from_world": eye, "world_from_scene": eye, "suit_from_world": eye,
        "object_from_head": eye, "hands": np.zeros((2, 3)), "windows": np.array([], np.str_),
        "window_ns": np.zeros((0, 2), np.int64), "actions": np.array(["a", "b"]), "rig": np.array("{}"),
    }  # fmt: skip
    np.savez(path, **values)
    assert Truth.load(path).rig == "{}"
    np.savez(path, **{name: value for name, value in (values | changed).items() if value is not None})
    with pytest.raises(ConfigError, match=said) as told:
        Truth.load(path)
    assert "cabinpose lab" in told.value.hint


def transforms(series: SegmentSeries, name: str) -> np.ndarray:
    position, orientation = series.segment(name)
    result = np.tile(np.eye(4), (len(position), 1, 1))
    result[:, :3, :3] = Rotation.from_quat(orientation, scalar_first=True).as_matrix()
    result[:, :3, 3] = position
    return result


def test_from_exact_observations_the_chain_gives_the_joints_in_the_camera(tmp_path: Path, actor: Actor) -> None:
    beat = Device(rate_hz=5.0)  # all devices at the same instants
    rig = VirtualRig.exact(tof=beat, optical=beat.model_copy(update={"offset_s": 7.0}), suit=beat)
    path = tmp_path / "take.mcap"
    truth = write_action_take(path, rig, actor, 2.0, sensor=SMALL, rng=generator(1))
    with Recording(path) as recording:
        suit, optical = segment_series(recording, "suit", "S01"), segment_series(recording, "optical", "head")
        frames = list(tof_frames(recording, "tof"))
        hosts = [sample.host_ns for _, sample in recording.samples()]
        take = recording.take
    assert len(frames) == len(truth.joints_3d) == 10
    assert hosts == sorted(hosts)
    assert take is not None
    assert (take.codes, take.action, take.car) == (("S01",), "drive", "sedan")
    # The thesis' chain: from the camera to the world, its object, the head, and there the suit.
    camera_from_head = truth.camera_from_world @ transforms(optical, "head") @ truth.object_from_head
    camera_from_suit = camera_from_head @ invert(transforms(suit, "Head"))
    for joint, theirs in MAPS["mvn"].items():
        position, _ = suit.segment(theirs)
        found = np.stack([apply(camera_from_suit[k], position[k]) for k in range(10)])
        assert found == pytest.approx(truth.joints_3d[:, INDEX[joint]], abs=1e-6), joint
    hands = camera_from_suit @ transforms(suit, "LeftHand")
    found = np.stack([apply(hands[k], truth.hands[0]) for k in range(10)])
    assert found == pytest.approx(truth.joints_3d[:, INDEX["lhand"]], abs=1e-6)
    assert truth.joints_2d[:, INDEX["head"]] == pytest.approx(SMALL.camera.project(truth.joints_3d[:, INDEX["head"]]), abs=1e-9)


def test_stamps_are_those_of_the_rigs_clocks(tmp_path: Path, actor: Actor) -> None:
    rig = VirtualRig()
    path = tmp_path / "take.mcap"
    written = write_action_take(path, rig, actor, 1.0, rate_hz=3.0, sensor=SMALL, rng=generator(2))
    truth = Truth.load(truth_path(path))
    assert VirtualRig.model_validate_json(truth.rig) == rig
    assert np.array_equal(truth.world_from_object, written.world_from_object)
    with Recording(path) as recording:
        for source, rate, true_ns in (("suit", 60, truth.suit_ns), ("optical", 100, truth.optical_ns), ("tof", 3, truth.tof_ns)):
            samples = [sample for _, sample in recording.samples([source])]
            assert abs(len(samples) - rate) <= 1
            assert [s.sequence for s in samples] == list(range(len(samples)))
            clock = rig.clock(source)
            device = np.array([s.device_ns for s in samples])
            assert np.abs(device - clock.device_from_true(true_ns)).max() <= clock.settings.resolution_ns / 2 + 1
            late = (np.array([s.host_ns for s in samples]) - true_ns) / 1e9
            assert (late >= clock.settings.latency_s - 1e-9).all()
        suit = segment_series(recording, "suit", "S01")
    assert suit.names == MVN_SEGMENTS
    # The suit's own world is somewhere else, and its segments are off by what such suits are off by.
    home = apply(invert(truth.suit_from_world), suit.position_m)
    off = np.linalg.norm(home - truth.suit_position, axis=-1)
    assert 0.005 < off.mean() < 0.2
    assert np.linalg.norm(suit.position_m - truth.suit_position, axis=-1).min() > 0.2


def test_the_head_take_turns_the_head_and_names_its_windows(tmp_path: Path, actor: Actor) -> None:
    rig = VirtualRig.exact(optical=Device(rate_hz=10.0), suit=Device(rate_hz=10.0))
    path = tmp_path / "head.mcap"
    truth = write_head_take(path, rig, actor, rng=generator(3))
    assert truth.windows.tolist() == ["flexion", "lateral", "rotation"]
    assert truth.joints_3d.shape == (0, 20, 3)
    with Recording(path) as recording:
        assert set(recording.sources) == {"suit", "optical"}
        suit, optical = segment_series(recording, "suit", "S01"), segment_series(recording, "optical", "head")
    angles = []
    for series, name in ((suit, "Head"), (optical, "head")):
        turned = Rotation.from_quat(series.segment(name)[1], scalar_first=True)
        angles.append((turned * turned[0].inv()).magnitude())
    assert angles[0] == pytest.approx(angles[1], abs=1e-6)  # what time is aligned by
    assert np.degrees(angles[0].max()) > 25


def test_the_motion_take_has_suit_and_model_of_the_whole_body(tmp_path: Path, actor: Actor) -> None:
    rig = VirtualRig.exact(optical=Device(rate_hz=10.0), suit=Device(rate_hz=10.0))
    path = tmp_path / "motion.mcap"
    truth = write_motion_take(path, rig, actor, rng=generator(4))
    assert truth.windows.tolist() == ["neutral_first", "coronal", "sagittal", "transversal", "neutral_last"]
    with Recording(path) as recording:
        suit, model = segment_series(recording, "suit", "S01"), segment_series(recording, "optical", "S01")
        head = segment_series(recording, "optical", "head")
    assert set(model.names) == set(MODEL_SEGMENTS)
    assert np.isfinite(head.position_m).all()
    home = apply(invert(truth.suit_from_world), suit.position_m)
    for joint in ("lwrist", "rfoot", "head"):
        theirs = model.segment(MAPS["vicon_kinematic_fit"][joint])[0]
        assert home[:, MVN_SEGMENTS.index(MAPS["mvn"][joint])] == pytest.approx(theirs, abs=1e-6)
    first, last = (home[(truth.suit_ns >= start) & (truth.suit_ns < end)].mean(axis=0) for start, end in truth.window_ns[[0, -1]])
    assert last == pytest.approx(first, abs=2e-3)


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path, actor: Actor) -> None:
    def digest(name: str, seed: int) -> str:
        path = tmp_path / name
        write_action_take(path, VirtualRig(), actor, 0.5, rate_hz=4.0, sensor=SMALL, rng=generator(seed))
        return hashlib.sha256(path.read_bytes()).hexdigest()

    assert digest("a.mcap", 5) == digest("b.mcap", 5) != digest("c.mcap", 6)
