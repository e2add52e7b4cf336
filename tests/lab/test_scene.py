from __future__ import annotations

import numpy as np
import pytest

from cabinpose.app.lab.exercises import exercises
from cabinpose.app.lab.motion import KeyedMotion
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.scene import DEPTH_UNIT_M, SceneCamera, message_of, world_from_room, world_from_vehicle
from cabinpose.core.camera import Camera
from cabinpose.core.frames import apply, invert, is_rigid
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.labels import LABEL_ID
from cabinpose.scene.room import furnish_room
from cabinpose.scene.sensor import Sensor, sensor_by_name

SMALL: Sensor = sensor_by_name("evk75023").model_copy(update={"camera": Camera.from_fov(120, 96, np.radians(95.0))})


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def test_the_car_stands_upright_with_the_rigs_camera_at_its_view(driving: KeyedMotion) -> None:
    rig = VirtualRig()
    world = world_from_vehicle(rig, driving)
    assert is_rigid(world)
    assert world[:3, 2] == pytest.approx((0, 0, 1), abs=1e-12)
    vehicle_from_camera = invert(rig.camera_from_world @ world)
    anchor = driving.cabin.view("driver")
    assert vehicle_from_camera[:3, 3] == pytest.approx(np.asarray(anchor.eye), abs=1e-12)
    axis, wanted = vehicle_from_camera[:2, 2], (np.asarray(anchor.target) - anchor.eye)[:2]
    assert axis[0] * wanted[1] - axis[1] * wanted[0] == pytest.approx(0.0, abs=1e-12)
    assert axis @ wanted > 0
    room = invert(rig.camera_from_world @ world_from_room(rig))
    assert room[:3, 3] == pytest.approx((0.0, 0.0, 1.4), abs=1e-12)
    assert room[1, 2] == pytest.approx(0.0, abs=1e-12)


def test_frames_show_the_person_where_the_truth_says(driving: KeyedMotion) -> None:
    rig = VirtualRig.exact()
    world = world_from_vehicle(rig, driving)
    hand = SceneCamera(rig, [driving], world, sensor=SMALL)
    frames = [hand.frame(t, rng=generator(0)) for t in (0.2, 4.0)]
    for t, frame in zip((0.2, 4.0), frames, strict=True):
        frame |= {name: frame[name][0] for name in ("joints_3d", "joints_2d", "visibility")}
        joints = apply(rig.camera_from_world @ world, driving.joints([t])[0])
        assert frame["joints_3d"] == pytest.approx(joints, abs=1e-9)
        assert frame["joints_2d"] == pytest.approx(SMALL.camera.project(joints), abs=1e-9, nan_ok=True)
        seen = np.flatnonzero(frame["visibility"] == Visibility.VISIBLE)
        assert CABINPOSE.index["head"] in seen
        assert len(seen) >= 5
        for j in seen:
            u, v = np.rint(frame["joints_2d"][j]).astype(int)
            depth = frame["depth"][v, u]
            if np.isfinite(depth):
                assert joints[j, 2] - 0.42 < depth < joints[j, 2] + 0.03  # skin lies before its joint
            around = frame["instance"][v - 1 : v + 2, u - 1 : u + 2]  # the person's edge may pass through the pixel
            belted = frame["labels"][v, u] == LABEL_ID["seat_belt"]  # which hides no joint
            assert (around == 1).any() or belted or not np.isfinite(depth)
    assert np.nanmax(np.abs(frames[0]["depth"] - frames[1]["depth"])) > 0.05  # somebody moved


def test_noise_is_switched_by_the_rig(driving: KeyedMotion) -> None:
    exact, real = VirtualRig.exact(), VirtualRig()
    world = world_from_vehicle(real, driving)

    def depth(rig: VirtualRig, seed: int) -> np.ndarray:
        return SceneCamera(rig, [driving], world, sensor=SMALL).frame(1.0, rng=generator(seed))["depth"]

    clean = depth(exact, 1)
    assert np.array_equal(clean, depth(exact, 2), equal_nan=True)
    noisy = depth(real, 1)
    assert np.array_equal(noisy, depth(real, 1), equal_nan=True)
    assert 1e-4 < np.nanmedian(np.abs(noisy - depth(real, 2))) < 0.1
    assert exact.noise.wiggling == 0.0
    assert not exact.noise.shot_noise
    assert real.only("sensor_systematic").noise.ambient > 0


def test_somebody_standing_in_a_room_is_seen_too(driving: KeyedMotion) -> None:
    rig = VirtualRig.exact()
    motion = exercises(driving.person, at_m=(2.2, 0.0), heading=np.pi, rng=generator(1))
    hand = SceneCamera(rig, [motion], world_from_room(rig), furnish_room(rng=generator(2)), sensor=SMALL)
    frame = hand.frame(1.0, rng=generator(3))
    assert (frame["visibility"] >= Visibility.SELF_OCCLUDED).sum() >= 16
    with pytest.raises(ValueError, match="room"):
        SceneCamera(rig, [motion], world_from_room(rig), sensor=SMALL).frame(1.0, rng=generator(3))
    with pytest.raises(ValueError, match="vehicle"):
        world_from_vehicle(rig, motion)


def test_the_message_holds_the_frame_in_the_cameras_steps(driving: KeyedMotion) -> None:
    rig = VirtualRig()
    frame = SceneCamera(rig, [driving], world_from_vehicle(rig, driving), sensor=SMALL).frame(0.0, rng=generator(4))
    message = message_of(frame)
    depth = np.where(message.depth > 0, message.depth * DEPTH_UNIT_M, np.nan)
    assert depth == pytest.approx(frame["depth"], abs=0.51 * DEPTH_UNIT_M, nan_ok=True)
    assert np.array_equal(message.amplitude, frame["amplitude"])
    assert message.camera_k == pytest.approx(SMALL.camera.k)
