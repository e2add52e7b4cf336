from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from cabinpose.app.lab.exercises import exercises, neutral_pose
from cabinpose.app.lab.motion import PASS_M, Key, KeyedMotion, Stage, _Course, _first, act, named_person
from cabinpose.app.lab.suit import SEGMENT, true_segments
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import transform
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOF_INDEX, DOFS
from cabinpose.scene.body.rig import LOWER, UPPER


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def two_keys() -> KeyedMotion:
    q = np.zeros((2, len(DOFS)))
    q[1, DOF_INDEX["lelbow.flexion"]] = 1.0
    root = np.stack((np.eye(4), transform(Rotation.from_rotvec((0.2, 0.9, -0.4)), (0.5, 0.0, 1.0))))
    return KeyedMotion(named_person("S01"), np.array((0.0, 2.0)), np.array((1.0, 3.0)), q, root, np.array((0.0, 0.3)), ("a", "b"))


def test_a_move_has_the_course_of_least_jerk_and_rests_at_its_ends() -> None:
    motion = two_keys()
    t = np.array((-1.0, 0.5, 1.0, 1.25, 1.5, 1.8, 2.0, 2.5, 9.0))
    q, root, wheel = motion.pose_at(t)
    x = np.clip(t - 1.0, 0.0, 1.0)
    share = 10 * x**3 - 15 * x**4 + 6 * x**5
    assert q[:, DOF_INDEX["lelbow.flexion"]] == pytest.approx(share, abs=1e-12)
    assert wheel == pytest.approx(0.3 * share, abs=1e-12)
    turned = Slerp((0.0, 1.0), Rotation.from_matrix(motion.root[:, :3, :3]))(share)
    assert root[:, :3, :3] == pytest.approx(turned.as_matrix(), abs=1e-9)
    assert root[:, :3, 3] == pytest.approx(share[:, None] * (0.5, 0.0, 1.0), abs=1e-12)
    edge = motion.pose_at(np.array((1.0, 1.001, 1.999, 2.0)))[0][:, DOF_INDEX["lelbow.flexion"]]
    assert np.abs(np.diff(edge)[[0, 2]]).max() < 1e-7  # neither speed nor acceleration


def test_joints_are_those_of_the_posed_body(driving: KeyedMotion) -> None:
    t = np.array((0.3, 1.7, 4.1))
    joints = driving.joints(t)
    for k, at in enumerate(t):
        assert joints[k] == pytest.approx(driving.body(float(at)).joints, abs=1e-12)


def test_fingers_hold_the_rim_as_the_generators_do_and_open_on_the_way_to_the_next_key(driving: KeyedMotion) -> None:
    fingers = driving.fingers
    assert driving.keys[0] == "drive"
    curl = fingers[0, :, 3:15].reshape(2, 4, 3)
    assert (np.ptp(curl, axis=2) > 0.1).any(axis=1).all()  # joint after joint around the rim, not by the grip
    held = driving.body(0.0)
    assert np.array_equal(held.skin, driving.person.pose(driving.q[0], driving.root[0], fingers[0]).skin)
    middle = 0.5 * (driving.leave_s[:-1] + driving.arrive_s[1:])
    assert driving.fingers_at(middle) == pytest.approx(0.5 * (fingers[:-1] + fingers[1:]), abs=1e-12)
    assert np.ptp(fingers, axis=0).max() > 0.3


def test_a_driver_moves_smoothly_within_the_limits_of_the_joints(driving: KeyedMotion) -> None:
    t = np.arange(0.0, driving.duration_s, 0.01)
    q = driving.pose_at(t)[0]
    assert (q >= LOWER - 1e-9).all()
    assert (q <= UPPER + 1e-9).all()
    speed = np.linalg.norm(np.diff(driving.joints(t), axis=0), axis=-1) / 0.01
    assert 0.3 < speed.max() < 4.0  # somebody moves, and nobody jumps
    assert np.abs(np.diff(speed, axis=0)).max() < 0.6
    yaw = true_segments(driving, t).rotation[:, SEGMENT["Head"], 1, 0]
    assert np.ptp(yaw) > 0.3


def test_keys_hold_by_the_generators_own_check_and_ways_by_the_stated_depth(stage: Stage, driving: KeyedMotion) -> None:
    course = _Course(stage)
    for k, name in enumerate(driving.keys):
        posed = stage.person.pose(driving.q[k], driving.root[k], driving.fingers[k])
        verdict = stage.validator.check([("driver", stage.person, posed)], stage.settings, float(driving.wheel_angle[k]))
        assert verdict.ok or name.startswith("look_"), verdict
    for t in np.arange(0.0, driving.duration_s, 0.25):
        q, root, wheel = driving.pose_at(t)
        at = Key(q[0], root[0], float(wheel[0]), driving.fingers_at(t)[0])
        assert course.depth(at) <= PASS_M + 0.005  # between the looks it may be a little more


def test_a_way_through_the_car_or_the_body_is_refused(stage: Stage) -> None:
    start = _first(stage, generator(5))
    course = _Course(stage)
    course.add(start, "drive", 0.0, 0.1)
    assert course.free(start, 1.0)
    into_the_wheel = start.root.copy()
    into_the_wheel[0, 3] += 0.25
    assert not course.free(start._replace(root=into_the_wheel), 1.0)
    crossed = start.q.copy()
    crossed[DOF_INDEX["lelbow.flexion"]], crossed[DOF_INDEX["lshoulder.flexion"]] = 2.6, 0.2
    crossed[DOF_INDEX["lshoulder.rotation"]] = 1.2
    assert not course.free(start._replace(q=crossed), 1.0)


def test_the_head_turns_about_each_axis_twice_on_a_still_trunk(nodding: KeyedMotion) -> None:
    t = np.arange(0.0, nodding.duration_s, 0.02)
    q, root, _ = nodding.pose_at(t)
    moving = [DOF_INDEX[f"{part}.{axis}"] for part in ("neck", "head") for axis in ("flexion", "lateral", "rotation")]
    still = np.setdiff1d(np.arange(len(DOFS)), moving)
    assert np.ptp(q[:, still], axis=0).max() == 0.0
    assert np.ptp(root, axis=0).max() < 1e-12
    assert [w.name for w in nodding.windows] == ["flexion", "lateral", "rotation"]
    for window in nodding.windows:
        within = (t >= window.start_s) & (t <= window.end_s)
        for axis in ("flexion", "lateral", "rotation"):
            turn = np.degrees(q[within, DOF_INDEX[f"neck.{axis}"]] + q[within, DOF_INDEX[f"head.{axis}"]])
            turn -= turn[0]
            if axis == window.name:
                assert 15.0 <= turn.max() <= 40.5
                assert -40.5 <= turn.min() <= -15.0
                assert np.count_nonzero(np.diff(np.sign(turn[np.abs(turn) > 5.0]))) == 3  # there, back, there, back
            else:
                assert np.abs(turn).max() < 1e-9


def test_exercises_keep_to_their_planes_and_end_as_they_began() -> None:
    person = named_person("S02")
    motion = exercises(person, heading=0.5, at_m=(1.0, 2.0), rng=generator(6))
    assert [w.name for w in motion.windows] == ["neutral_first", "coronal", "sagittal", "transversal", "neutral_last"]
    assert motion.windows[-1].end_s == motion.duration_s
    t = np.arange(0.0, motion.duration_s, 0.05)
    segments = true_segments(motion, t)
    body = Rotation.from_euler("z", 0.5)
    moved = {
        "coronal": (0, "LeftUpperArm", "T8", "RightUpperLeg"),
        "sagittal": (1, "LeftUpperArm", "T8", "RightUpperLeg"),
        "transversal": (2, "T8", "Head", "RightUpperLeg"),
    }
    for window in motion.windows[1:4]:
        within = (t > window.start_s) & (t < window.end_s)
        axis, *names = moved[window.name]
        for name in names:
            rotation = Rotation.from_matrix(segments.rotation[:, SEGMENT[name]])
            since = (body.inv() * (rotation[within] * rotation[0].inv()) * body).as_rotvec()
            peak = since[np.argmax(np.linalg.norm(since, axis=1))]
            assert np.linalg.norm(peak) > np.radians(18.0), (window, name)
            assert abs(peak[axis]) > 0.93 * np.linalg.norm(peak), (window, name)
    first, last = motion.joints([0.5, motion.duration_s - 0.5])
    assert last == pytest.approx(first, abs=1e-12)
    assert np.ptp(motion.joints(t)[:, CABINPOSE.index["hip"]], axis=0).max() < 1e-12
    low = motion.body(0.0).surface(1).vertices[:, 2].min()
    assert -0.01 < low < 0.02  # on the floor
    assert (neutral_pose() >= LOWER).all()


def test_the_same_seed_gives_the_same_motion(stage: Stage, driving: KeyedMotion) -> None:
    again = act(stage, 5.0, rng=generator(2))
    assert np.array_equal(again.q, driving.q)
    assert np.array_equal(again.arrive_s, driving.arrive_s)
    assert again.keys == driving.keys
    assert not np.array_equal(act(stage, 1.0, rng=generator(9)).q[0], driving.q[0])


def test_an_unknown_person_is_an_error() -> None:
    with pytest.raises(ConfigError, match="S99"):
        named_person("S99")
