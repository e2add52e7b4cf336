from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.app.lab.exercises import exercises
from cabinpose.app.lab.motion import KeyedMotion, Stage, named_person
from cabinpose.app.lab.rig import SuitErrors
from cabinpose.app.lab.suit import (
    PARENTS,
    SEGMENT,
    Segments,
    Wear,
    as_worn,
    forward,
    hand_offset,
    model_offsets,
    put_on,
    steel_of,
    true_segments,
)
from cabinpose.core.frames import apply, invert, transform
from cabinpose.core.skeleton import CABINPOSE, MVN_SEGMENTS
from cabinpose.scene.body import DOF_INDEX, DOFS

NONE = SuitErrors(**dict.fromkeys(SuitErrors.model_fields, 0.0))
HERE = transform()


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def only(name: str, value: float) -> SuitErrors:
    return NONE.model_copy(update={name: value})


def held(seconds: float, rate: float = 60.0, **degrees: float) -> tuple[KeyedMotion, np.ndarray]:
    """Somebody who holds a pose, T-pose where nothing is said, and the times at which a suit looks."""
    q = np.zeros((1, len(DOFS)))
    for name, value in {"lshoulder.abduction": 90.0, "rshoulder.abduction": 90.0, **degrees}.items():
        q[0, DOF_INDEX[name]] = np.radians(value)
    motion = KeyedMotion(named_person("S01"), np.zeros(1), np.full(1, seconds), q, np.eye(4)[None], np.zeros(1), ("hold",))
    return motion, np.arange(0.0, seconds, 1.0 / rate)


@pytest.fixture(scope="module")
def moving() -> tuple[KeyedMotion, Segments]:
    motion = exercises(named_person("S01"), heading=0.7, rng=generator(1))
    return motion, true_segments(motion, np.arange(2.5, 12.5, 1 / 60))


def wear(seed: int = 2) -> Wear:
    return put_on(rng=generator(seed))


def error_vectors(true: Segments, worn: Segments) -> np.ndarray:
    """(T, 23, 3) rad: turns of segments in their own frames."""
    relative = np.einsum("tsji,tsjk->tsik", true.rotation, worn.rotation)
    return Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec().reshape(*relative.shape[:2], 3)


def at_home(segments: Segments, worn: Wear) -> Segments:
    return segments.moved(invert(worn.suit_from_world))


def test_the_neutral_pose_is_the_identity_with_arms_to_the_sides() -> None:
    motion, _ = held(1.0)
    t = true_segments(motion, np.zeros(1))
    assert t.rotation[0] == pytest.approx(np.tile(np.eye(3), (23, 1, 1)), abs=1e-12)
    along = t.position_m[0, SEGMENT["LeftHand"]] - t.position_m[0, SEGMENT["LeftUpperArm"]]
    assert along / np.linalg.norm(along) == pytest.approx((0.0, 1.0, 0.0), abs=1e-6)
    toes = t.position_m[0, SEGMENT["RightToe"]] - t.position_m[0, SEGMENT["RightFoot"]]
    assert toes[0] > 0.1
    for name, s in SEGMENT.items():
        if name.startswith("Left"):
            mirrored = t.position_m[0, SEGMENT["Right" + name.removeprefix("Left")]] * (1, -1, 1)
            assert t.position_m[0, s] == pytest.approx(mirrored, abs=2e-3)


def test_segments_begin_at_our_joints_whatever_the_pose(driving: KeyedMotion) -> None:
    time = np.arange(0.0, 5.0, 0.31)
    segments, joints = true_segments(driving, time), driving.joints(time)
    for joint, theirs in CABINPOSE.maps["mvn"].items():
        assert segments.position_m[:, SEGMENT[theirs]] == pytest.approx(joints[:, CABINPOSE.index[joint]], abs=1e-12)
    for side, theirs in (("l", "LeftHand"), ("r", "RightHand")):
        at = np.einsum("tij,j->ti", segments.rotation[:, SEGMENT[theirs]], hand_offset(driving.person, side))
        assert segments.position_m[:, SEGMENT[theirs]] + at == pytest.approx(joints[:, CABINPOSE.index[side + "hand"]], abs=1e-12)


def test_an_elbow_bends_about_its_own_axis() -> None:
    motion, _ = held(1.0, **{"lelbow.flexion": 70.0})
    t = true_segments(motion, np.zeros(1))
    relative = t.rotation[0, SEGMENT["LeftUpperArm"]].T @ t.rotation[0, SEGMENT["LeftForearm"]]
    # Arm to the left, palm down: a flexed elbow brings the hand forward, a turn about -z.
    assert Rotation.from_matrix(relative).as_rotvec(degrees=True) == pytest.approx((0.0, 0.0, -70.0), abs=1e-6)


def test_without_errors_the_suit_says_the_truth_in_its_own_world(moving: tuple[KeyedMotion, Segments]) -> None:
    motion, true = moving
    on = wear()
    worn = as_worn(true, NONE, on, motion.person, np.zeros((1, 3)), rng=generator(3))
    assert worn.position_m == pytest.approx(apply(on.suit_from_world, true.position_m), abs=1e-9)
    home = at_home(worn, on)
    assert home.rotation == pytest.approx(true.rotation, abs=1e-12)
    assert on.suit_from_world[2] == pytest.approx((0, 0, 1, 0), abs=1e-12)  # upright
    turned = Rotation.from_quat(worn.orientation_wxyz[7], scalar_first=True).as_matrix()
    assert turned == pytest.approx(worn.rotation[7], abs=1e-12)


def test_forward_kinematics_against_the_two_link_closed_form() -> None:
    rotation = np.tile(np.eye(3), (1, 23, 1, 1))
    offsets = np.zeros((1, 23, 3))
    offsets[0, SEGMENT["LeftUpperArm"]] = (0.0, 0.2, 0.5)
    offsets[0, SEGMENT["LeftForearm"]] = (0.0, 0.3, 0.0)
    offsets[0, SEGMENT["LeftHand"]] = (0.0, 0.25, 0.0)
    a, b = 0.4, 1.3
    rotation[0, SEGMENT["LeftUpperArm"]] = Rotation.from_euler("z", a).as_matrix()
    rotation[0, SEGMENT["LeftForearm"]] = Rotation.from_euler("z", a + b).as_matrix()
    hand = forward(rotation, offsets)[0, SEGMENT["LeftHand"]]
    flat = (-0.3 * np.sin(a) - 0.25 * np.sin(a + b), 0.2 + 0.3 * np.cos(a) + 0.25 * np.cos(a + b), 0.5)
    assert hand == pytest.approx(flat, abs=1e-12)


def test_offsets_and_forward_undo_each_other(moving: tuple[KeyedMotion, Segments]) -> None:
    _, true = moving
    assert forward(true.rotation, true.offsets()) == pytest.approx(true.position_m, abs=1e-9)


def test_noise_has_its_size_and_half_of_it_a_memory() -> None:
    motion, time = held(40.0)
    true = true_segments(motion, time)
    on = wear()
    worn = at_home(as_worn(true, only("segment_noise_deg", 0.3), on, motion.person, rng=generator(5)), on)
    wrong = np.degrees(error_vectors(true, worn))
    assert wrong.std() == pytest.approx(0.3, rel=0.03)
    lagged = np.mean(wrong[1:] * wrong[:-1]) / wrong.var()
    assert lagged == pytest.approx(0.5 * np.exp(-1 / 60 / 0.3), abs=0.03)


def test_calibration_turns_each_segment_by_a_constant(moving: tuple[KeyedMotion, Segments]) -> None:
    motion, true = moving
    on = wear()
    worn = at_home(as_worn(true, only("calibration_offset_deg", 2.0), on, motion.person, rng=generator(5)), on)
    wrong = error_vectors(true, worn)
    assert wrong == pytest.approx(np.broadcast_to(np.radians(2.0) * on.offset, wrong.shape), abs=1e-9)
    lengths = np.linalg.norm(worn.offsets()[:, 1:], axis=-1)
    assert lengths == pytest.approx(np.linalg.norm(true.offsets()[:, 1:], axis=-1), abs=1e-9)


def test_soft_tissue_follows_the_angle_and_its_rate() -> None:
    error = only("soft_tissue_deg", 1.5)
    on = wear()
    still, time = held(1.0)
    true = true_segments(still, time)
    assert error_vectors(true, at_home(as_worn(true, error, on, still.person, rng=generator(1)), on)) == pytest.approx(
        0.0, abs=1e-9
    )
    bent, time = held(1.0, **{"lelbow.flexion": np.degrees(1.0)})
    true = true_segments(bent, time)
    wrong = error_vectors(true, at_home(as_worn(true, error, on, bent.person, rng=generator(1)), on))
    forearm = SEGMENT["LeftForearm"]
    assert wrong[30, forearm] == pytest.approx(np.radians(1.5) * on.tissue[0, forearm], abs=1e-6)
    others = [s for s in range(23) if s != forearm]
    assert wrong[:, others] == pytest.approx(0.0, abs=1e-7)
    # A turn at 3 rad/s from the T-pose on: rate alone counts at its start.
    time = np.arange(0.0, 0.5, 1e-3)
    rotation = np.tile(np.eye(3), (len(time), 23, 1, 1))
    rotation[:, SEGMENT["LeftHand"]] = Rotation.from_rotvec(np.outer(3.0 * time, (1.0, 0.0, 0.0))).as_matrix()
    swinging = Segments(time, forward(rotation, np.tile(model_offsets(still.person), (len(time), 1, 1))), rotation)
    wrong = error_vectors(swinging, at_home(as_worn(swinging, error, on, still.person, rng=generator(1)), on))
    hand = SEGMENT["LeftHand"]
    expected = np.radians(1.5) * (3.0 * time[100] * on.tissue[0, hand] + on.tissue[1, hand])
    assert wrong[100, hand] == pytest.approx(expected, abs=1e-6)


def test_heading_drifts_by_its_rate_and_drops_out_relative_to_the_head(moving: tuple[KeyedMotion, Segments]) -> None:
    motion, true = moving
    on = wear()
    worn = at_home(as_worn(true, only("heading_drift_deg_per_min", 5.0), on, motion.person, rng=generator(4)), on)
    since = np.einsum("tsij,tskj->tsik", worn.rotation, true.rotation)
    about = Rotation.from_matrix(since.reshape(-1, 3, 3)).as_rotvec().reshape(*since.shape[:2], 3)
    assert about[..., :2] == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(about[..., 2], axis=1).max() < 1e-9  # the whole body
    assert np.abs(about[-1, 0, 2]) > np.radians(0.05)
    for segments in (true, worn):
        assert segments.position_m[0, 0] == pytest.approx(true.position_m[0, 0], abs=1e-12)
    relative = [invert(s.pose("Head")) @ s.pose("LeftHand") for s in (true, worn)]
    assert relative[1] == pytest.approx(relative[0], abs=1e-9)
    minute, time = held(60.0 + 1e-6, rate=2.0)
    long = true_segments(minute, time)
    last = []
    for seed in range(150):
        drifted = at_home(as_worn(long, only("heading_drift_deg_per_min", 5.0), on, minute.person, rng=generator(seed)), on)
        last.append(np.degrees(np.arctan2(drifted.rotation[-1, 0, 1, 0], drifted.rotation[-1, 0, 0, 0])))
    assert np.std(last) == pytest.approx(5.0 * np.hypot(1.0, 0.3), rel=0.2)


def test_steel_turns_the_heading_of_what_is_near() -> None:
    motion, time = held(1.0)
    true = true_segments(motion, time)
    on = wear()
    hand, other = SEGMENT["LeftHand"], SEGMENT["RightHand"]
    for distance in (0.0, 0.12, 0.36):
        steel = true.position_m[0, hand] + ((0.0, distance, 0.0),)
        error = only("magnetic_deg", 2.0)
        worn = at_home(as_worn(true, error, on, motion.person, steel, rng=generator(4)), on)
        wrong = error_vectors(true, worn)  # in the T-pose about the vertical is about a segment's z
        expected = np.radians(2.0) * on.magnetic[hand] * np.exp(-distance / 0.12)
        assert wrong[:, hand] == pytest.approx(np.tile((0.0, 0.0, expected), (len(time), 1)), abs=1e-9)
        assert abs(wrong[0, other, 2]) < 1e-3 * abs(expected)
    free = as_worn(true, only("magnetic_deg", 2.0), on, motion.person, None, rng=generator(4))
    assert at_home(free, on).rotation == pytest.approx(true.rotation, abs=1e-12)


def test_the_cars_steel_is_behind_doors_and_roof_and_under_the_seat(stage: Stage) -> None:
    steel = steel_of(stage.cabin, stage.settings)
    head = stage.cabin.seats["driver"].h_point(stage.settings["driver"]) + (0.0, 0.0, 0.7)
    nearest = np.linalg.norm(steel - head, axis=1).min()
    assert 0.05 < nearest < 0.5
    low, high = stage.cabin.bounds
    assert (steel > low - 1e-3).all()
    assert (steel < high + 1e-3).all()


def test_lengths_are_wrong_by_their_share_and_constant(moving: tuple[KeyedMotion, Segments]) -> None:
    motion, true = moving
    on = wear()
    worn = as_worn(true, only("length_error", 0.02), on, motion.person, rng=generator(4))
    assert at_home(worn, on).rotation == pytest.approx(true.rotation, abs=1e-12)
    lengths = np.linalg.norm(worn.position_m - worn.position_m[:, PARENTS], axis=-1)[:, 1:]
    assert np.ptp(lengths, axis=0).max() < 1e-9
    model = np.linalg.norm(model_offsets(motion.person), axis=1)[1:]
    assert lengths[0] / model == pytest.approx(1.0 + 0.02 * on.length[1:], abs=1e-9)
    exact = np.linalg.norm(true.offsets()[:, 1:], axis=-1)
    bends = [MVN_SEGMENTS[1:].index(name) for name in ("L3", "Head")]  # above what our spine bends within
    rigid = [k for k in range(22) if k not in bends]
    assert exact[:, rigid] == pytest.approx(np.tile(model[rigid], (len(exact), 1)), abs=1e-9)
    assert np.abs(exact[:, bends] - model[bends]).max() < 0.006


def test_dead_reckoning_moves_the_whole_body_and_nothing_else(moving: tuple[KeyedMotion, Segments]) -> None:
    motion, true = moving
    on = wear()
    worn = at_home(as_worn(true, only("root_drift_m_per_min", 0.5), on, motion.person, rng=generator(4)), on)
    assert worn.rotation == pytest.approx(true.rotation, abs=1e-12)
    off = worn.position_m - true.position_m
    assert np.ptp(off, axis=1).max() < 1e-9
    assert off[0] == pytest.approx(0.0, abs=1e-9)
    assert 0.005 < np.linalg.norm(off[-1, 0]) < 0.5


def test_one_error_draws_the_same_numbers_whatever_else_is_on(moving: tuple[KeyedMotion, Segments]) -> None:
    motion, true = moving
    on = wear()
    rngs = generator(8), generator(8)
    as_worn(true, NONE, on, motion.person, rng=rngs[0])
    as_worn(true, SuitErrors(), on, motion.person, np.zeros((1, 3)), rng=rngs[1])
    assert rngs[0].random() == rngs[1].random()
