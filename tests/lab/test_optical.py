from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.app.lab.motion import KeyedMotion
from cabinpose.app.lab.optical import (
    LOOK_HZ,
    MODEL_SEGMENTS,
    Cap,
    Watch,
    cap_of,
    kept,
    measured_model,
    measured_object,
    seen_by,
    true_object,
)
from cabinpose.app.lab.suit import true_segments
from cabinpose.app.lab.takes import Actor
from cabinpose.core.frames import apply, invert, transform
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import SEGMENTS
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.materials import MATERIALS
from cabinpose.synth.posture.frames import frames


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def crosses(eye: np.ndarray, marker: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether a segment passes through a triangle (F, 3, 3): by signs of volumes of tetrahedra."""

    def volume(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.einsum("...i,...i->...", np.cross(b - a, c - a), d - a)

    end = marker + 0.004 * (eye - marker) / np.linalg.norm(eye - marker)
    a, b, c = triangles.transpose(1, 0, 2)
    sides = volume(a, b, c, eye) * volume(a, b, c, end) < 0
    turns = np.stack([volume(eye, end, p, q) for p, q in ((a, b), (b, c), (c, a))])
    return bool((sides & ((turns > 0).all(axis=0) | (turns < 0).all(axis=0))).any())


def test_sight_against_brute_force_among_random_triangles() -> None:
    rng = generator(1)
    hidden = 0
    for _ in range(6):
        triangles = rng.uniform(-1, 1, (60, 1, 3)) + 0.3 * rng.standard_normal((60, 3, 3))
        eyes, markers = rng.uniform(-2, 2, (5, 3)), 0.4 * rng.standard_normal((4, 3))
        eyes[0] = (0.05, 0.0, 0.1)  # among the markers: no pyramid holds them
        vertices, faces = triangles.reshape(-1, 3), np.arange(180, dtype=np.int32).reshape(-1, 3)
        expected = [[not crosses(eye, marker, triangles) for marker in markers] for eye in eyes]
        assert seen_by(eyes, markers, vertices, faces).tolist() == expected
        hidden += sum(not seen for row in expected for seen in row)
    assert 20 < hidden < 100


def test_sight_of_a_driver_against_brute_force_on_the_whole_car_and_body(driving: KeyedMotion, actor: Actor) -> None:
    watch = Watch(driving, actor.cap)
    panes = [m.id for m in MATERIALS if m.transmissive]
    for t in (0.4, 3.3):
        body = driving.body(t)
        car = driving.cabin.surface(driving.settings, wheel_angle=float(driving.pose_at(t)[2][0]))
        faces = car.faces[~np.isin(car.material, panes)]
        triangles = np.concatenate((car.vertices[faces], body.skin[driving.person.skin_faces])).astype(np.float64)
        world_from_object = body.bones[BONE_INDEX["head"]] @ invert(actor.cap.object_from_head)
        markers = apply(world_from_object, actor.cap.markers_m)
        seen = watch.at(t)
        expected = np.array([[not crosses(eye, marker, triangles) for marker in markers[:3]] for eye in watch.eyes])
        assert np.array_equal(seen[:, :3], expected)
        assert 0.1 < seen.mean() < 0.9


def test_the_cap_sits_on_the_head(actor: Actor) -> None:
    cap, person = cap_of(actor.person), actor.person
    head_from_object = invert(cap.object_from_head)
    at = apply(head_from_object, cap.markers_m)
    skin = person.rest_skin[person.skin_segment == SEGMENTS.index("head")] - person.rest.heads[BONE_INDEX["head"]]
    nearest = np.linalg.norm(at[:, None] - skin[None], axis=-1).min(axis=1)
    assert (nearest > 0.015).all()
    assert (nearest < 0.045).all()
    assert cap.markers_m.mean(axis=0) == pytest.approx(0.0, abs=1e-12)
    pairs = np.linalg.norm(cap.markers_m[:, None] - cap.markers_m, axis=-1)[np.triu_indices(5, 1)]
    assert np.diff(np.sort(pairs)).min() > 1e-3  # a body that looks like itself in one way only
    assert pairs.min() > 0.08


def test_without_noise_the_object_is_where_head_and_cap_say(driving: KeyedMotion, actor: Actor) -> None:
    time = np.arange(0.0, 4.0, 0.5)
    head = true_segments(driving, time).pose("Head")
    true = true_object(head, actor.cap)
    assert true @ actor.cap.object_from_head == pytest.approx(head, abs=1e-12)
    position, orientation = measured_object(true, actor.cap, None, 0.0, rng=generator(1))
    assert position == pytest.approx(true[:, :3, 3], abs=1e-9)
    assert Rotation.from_quat(orientation, scalar_first=True).as_matrix() == pytest.approx(true[:, :3, :3], abs=1e-9)


def test_noise_of_markers_makes_that_of_the_object() -> None:
    # Four corners of a square, side 2 a: var of a turn about its normal is s2 / (4 * 2 a2), about an axis in it s2 / (4 a2).
    a, sigma = 0.1, 1e-3
    cap = Cap(("a", "b", "c", "d"), a * np.array([(1, 1, 0), (1, -1, 0), (-1, -1, 0), (-1, 1, 0)], float), transform())
    still = np.tile(np.eye(4), (4000, 1, 1))
    position, orientation = measured_object(still, cap, None, sigma, rng=generator(2))
    turns = Rotation.from_quat(orientation, scalar_first=True).as_rotvec()
    assert position.std(axis=0) == pytest.approx(np.full(3, sigma / 2), rel=0.05)
    assert turns.std(axis=0) == pytest.approx(sigma / (2 * a) * np.array((1, 1, np.sqrt(0.5))), rel=0.05)


def test_fewer_than_three_markers_are_no_object() -> None:
    cap = Cap(tuple("abcd"), generator(3).standard_normal((4, 3)), transform())
    visible = np.array([(1, 1, 1, 1), (1, 0, 1, 1), (1, 0, 0, 1), (0, 0, 0, 0)], bool)
    place = np.tile(transform(Rotation.from_rotvec((0.3, 0.2, 0.1)), (1.0, 2.0, 3.0)), (4, 1, 1))
    position, orientation = measured_object(place, cap, visible, 0.0, rng=generator(3))
    assert np.isnan(position).all(axis=1).tolist() == [False, False, True, True]
    assert np.isnan(orientation).all(axis=1).tolist() == [False, False, True, True]
    assert position[1] == pytest.approx((1.0, 2.0, 3.0), abs=1e-9)
    all_seen, _ = measured_object(place, cap, None, 1e-3, rng=generator(4))
    some_seen, _ = measured_object(place, cap, visible, 1e-3, rng=generator(4))
    assert np.array_equal(all_seen[0], some_seen[0])  # the same noise whatever is hidden


def test_two_cameras_have_to_see_a_marker_and_a_look_lasts(driving: KeyedMotion, actor: Actor) -> None:
    head = driving.joints([0.0])[0, CABINPOSE.index["head"]]
    q, root, _ = driving.pose_at(np.zeros(1))
    ahead, left, _ = frames(q[0], driving.person.rest, root[0]).bone("head")[:3, :3].T
    above = head + np.array([0.7 * ahead + (0.0, 0.0, 0.1), 0.7 * ahead + 0.3 * left + (0.0, 0.0, 0.1)])
    time = np.arange(0.0, 1.0, 0.01)
    both = Watch(driving, actor.cap, above).over(time)
    assert both[:, 0].all()  # on the brow, before two cameras
    assert not Watch(driving, actor.cap, above[:1]).over(time).any()
    changes = np.flatnonzero((np.diff(both.astype(int), axis=0) != 0).any(axis=1)) + 1
    assert (changes % round(100 / LOOK_HZ) == 0).all()


def test_the_model_of_the_whole_body_is_ours_with_its_names(driving: KeyedMotion) -> None:
    time = np.array((0.5, 2.5))
    world = transform(Rotation.from_euler("z", 0.8), (1.0, -2.0, 0.3))
    position, orientation = measured_model(driving, time, world, 0.0, rng=generator(1))
    joints = apply(world, driving.joints(time))
    segments = true_segments(driving, time).moved(world)
    for joint, theirs in CABINPOSE.maps["vicon_kinematic_fit"].items():
        assert position[:, MODEL_SEGMENTS.index(theirs)] == pytest.approx(joints[:, CABINPOSE.index[joint]], abs=1e-12)
    turned = Rotation.from_quat(orientation[:, MODEL_SEGMENTS.index("Head")], scalar_first=True).as_matrix()
    assert turned == pytest.approx(segments.pose("Head")[:, :3, :3], abs=1e-9)
    # Against the suit's frames an arm's differ by a constant turn alone: angles since the first frame are the same.
    for theirs, suit in (("L_Humerus", "LeftUpperArm"), ("R_Tibia", "RightLowerLeg"), ("LowerBack", "L5")):
        ours = Rotation.from_quat(orientation[:, MODEL_SEGMENTS.index(theirs)], scalar_first=True)
        suits = Rotation.from_matrix(segments.pose(suit)[:, :3, :3])
        assert (ours[1] * ours[0].inv()).magnitude() == pytest.approx((suits[1] * suits[0].inv()).magnitude(), abs=1e-9)
    noisy, _ = measured_model(driving, np.linspace(0, 4, 300), world, 1e-4, rng=generator(1))
    exact, _ = measured_model(driving, np.linspace(0, 4, 300), world, 0.0, rng=generator(1))
    assert (noisy - exact).std() == pytest.approx(5e-4, rel=0.05)


def test_markers_are_lost_for_moments_alone_and_all_at_once() -> None:
    time = np.arange(0.0, 3000.0, 0.02)
    lost = ~kept(time, 3, rng=generator(5))
    # Of a chain with rates a (lost) and b (found) a share of a / (a + b) is lost.
    alone, together = 0.1 / (0.1 + 10.0), 0.05 / (0.05 + 5.0)
    assert lost.all(axis=1).mean() == pytest.approx(together, rel=0.3)
    assert lost.mean() == pytest.approx(1 - (1 - alone) * (1 - together), rel=0.15)
    starts = np.count_nonzero(lost[1:, 0] & ~lost[:-1, 0])
    assert lost[:, 0].sum() * 0.02 / starts == pytest.approx((0.1 * 0.1 + 0.05 * 0.2) / (0.1 + 0.05), rel=0.2)
    assert not lost[0].any()
