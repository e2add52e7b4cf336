"""Resting hands: fingers one by one, how they lie, and how they vary."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from seated_posture import solve_posture

from cabinpose.core.frames import apply, invert
from cabinpose.scene import labels
from cabinpose.scene.body import DOF_INDEX, DOFS, SEGMENTS, SUBJECTS, BodyModel, Person, by_phalanx
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.cabin import build_cabin
from cabinpose.synth.posture.hands import BY_GRIP, lying
from cabinpose.synth.posture.places import PLACES

THIGH_RADIUS_M = 0.09


@pytest.fixture(scope="module")
def somebody() -> Person:
    return BodyModel.load().person(SUBJECTS["S01"].phenotype, SUBJECTS["S01"].outfit)


def posed(person: Person, grip: float, fingers: np.ndarray | None):
    q = np.zeros(len(DOFS))
    q[[DOF_INDEX["lhand.grip"], DOF_INDEX["rhand.grip"]]] = grip
    return person.pose(q, np.eye(4), fingers)


def drawn(place: str, count: int, rim: float | None = None) -> np.ndarray:
    noise = np.random.default_rng(4).standard_normal((count, 3)).tolist()
    return np.array([PLACES[place].fingers(tuple(n), rim) for n in noise])


def test_fingers_that_follow_the_grip_say_so(somebody: Person) -> None:
    """Curls that are the grip's, and knuckles that close up with it, are the pose by the grip."""
    same = np.array([[0.3] * 5 + [1.1 * 0.3]] * 2)
    by_grip = posed(somebody, 0.3, None).skin
    np.testing.assert_allclose(posed(somebody, 0.3, same).skin, by_grip, atol=1e-6)
    np.testing.assert_allclose(posed(somebody, 0.8, same).skin, by_grip, atol=1e-6)
    for free in (np.full((2, 5), np.nan), np.full((2, 6), np.nan)):
        np.testing.assert_allclose(posed(somebody, 0.3, free).skin, by_grip, atol=1e-6)


def test_fingers_close_up_side_by_side(somebody: Person) -> None:
    """The fingertips come together, and the other hand and the joints stay."""
    tips = [BONE_INDEX[f"lfinger{n}_3"] for n in (2, 3, 4, 5)]
    breadth = []
    for closed in (0.0, 0.5, 1.0):
        hand = posed(somebody, 0.2, np.array([[0.1] * 5 + [closed], [np.nan] * 6]))
        breadth.append(np.linalg.norm(np.diff(hand.bones[tips, :3, 3], axis=0), axis=1).sum())
        assert np.abs(hand.joints - posed(somebody, 0.2, None).joints).max() < 1e-9
        right = somebody.skin_segment == SEGMENTS.index("rhand")
        np.testing.assert_allclose(hand.skin[right], posed(somebody, 0.2, None).skin[right], atol=1e-6)
    assert breadth[0] - breadth[1] > 0.01
    assert breadth[1] - breadth[2] > 0.01


def test_each_phalanx_bends_by_itself(somebody: Person) -> None:
    """Told of each phalanx, fingers are as told of each finger; a last phalanx that bends alone turns its own skin only."""
    told = np.array([[0.1, 0.3, 0.2, 0.4, 0.5, 0.8], [np.nan] * 6])
    np.testing.assert_array_equal(posed(somebody, 0.2, by_phalanx(told)).skin, posed(somebody, 0.2, told).skin)
    one = by_phalanx(told).copy()
    one[0, 5] += 0.5  # the last one of the index finger, by 35 deg
    moved = np.linalg.norm(posed(somebody, 0.2, one).skin - posed(somebody, 0.2, told).skin, axis=1)
    last = somebody.leading_bone == BONE_INDEX["lfinger2_3"]
    assert moved[last].max() > 0.005
    assert moved[somebody.leading_bone == BONE_INDEX["lfinger2_1"]].max() < 1e-6
    assert moved[somebody.leading_bone == BONE_INDEX["lfinger3_3"]].max() < 1e-6


@pytest.mark.parametrize("name", ["S01", "S03", "S05"])
def test_a_hand_lies_on_heel_and_fingers(name: str) -> None:
    """On a cylinder as wide as a thigh: nothing of it is deeper than a little, and both its halves touch."""
    person = BodyModel.load().person(SUBJECTS[name].phenotype, SUBJECTS[name].outfit)
    hand = person.skin_segment == SEGMENTS.index("lhand")
    for fingers in drawn("thigh", 12):
        lies = lying(person, fingers)
        pose = posed(person, 0.5, np.stack((fingers, BY_GRIP)))
        x, y, z = apply(invert(pose.palms["l"]), pose.skin[hand].astype(np.float64)).T
        turned_x = np.cos(lies.pitch) * x + np.sin(lies.pitch) * z
        turned_z = np.cos(lies.pitch) * z - np.sin(lies.pitch) * x
        deep = turned_z - np.cos(lies.pitch) * y * y / (2 * THIGH_RADIUS_M) - lies.above
        assert deep.max() < 0.003
        assert deep[turned_x > 0.0].max() > -0.004
        if fingers[1:5].max() < 0.7:  # a fist tips forward
            assert deep[turned_x < 0.0].max() > -0.004


def test_resting_hands_differ() -> None:
    """Each follows from its noise; slack fingers are bent more towards the little finger; a wheel's hand is never tighter."""
    hands = drawn("thigh", 300)
    assert (drawn("thigh", 300) == hands).all()
    assert hands[:, :5].min() >= 0.0
    assert hands[:, :5].max() <= 1.0
    assert hands[:, 1:5].mean(axis=1).std() > 0.1
    slack = hands[(hands[:, 1:5].mean(axis=1) > 0.15) & (hands[:, 1:5].mean(axis=1) < 0.6)]
    assert len(slack) > 100
    assert (np.diff(slack[:, 1:5].mean(axis=0)) > 0.02).all()
    assert drawn("thigh", 300, rim=0.3)[:, 1:5].mean(axis=1).max() < 0.25  # there is little room under a wheel
    assert (drawn("wheel", 100, rim=0.3)[:, :5] <= 0.3).all()
    assert np.isnan(drawn("belt", 3)).all()


@pytest.mark.parametrize("name", ["S01", "S12", "S15"])
def test_a_hand_in_the_lap_lies_on_the_trousers(name: str) -> None:
    """Hardly any of it is below the cloth that is seen, and some of it is near."""
    person = BodyModel.load().person(SUBJECTS[name].phenotype, SUBJECTS[name].outfit)
    sedan = build_cabin("sedan")
    seat = sedan.seats["front_passenger"]
    found = solve_posture(person, seat, seat.default, sedan, hands="lap")
    pose = person.pose(found.q, found.vehicle_from_root)
    surface = pose.surface(1)
    worn = np.isin(
        surface.label, [labels.LABEL_ID[part + side] for part in ("thigh", "knee", "hip") for side in ("_left", "_right")]
    )
    cloth = np.unique(surface.faces[worn])
    for side in ("lhand", "rhand"):
        skin = pose.skin[person.skin_segment == SEGMENTS.index(side)]
        distance, near = cKDTree(surface.vertices[cloth]).query(skin, k=4)
        off = ((skin[:, None] - surface.vertices[cloth][near]) * surface.normals[cloth][near]).sum(axis=2).mean(axis=1)
        close = distance[:, 0] < 0.03
        assert (close & (off < -0.004)).mean() < 0.05
        assert off[close].min() < 0.010
