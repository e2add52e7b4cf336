"""What faces do in scenes: what is labelled is what is drawn, sleepers' eyes are closed, given faces are kept."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from synth_scenes import small_config

from cabinpose.core import ConfigError
from cabinpose.scene import MATERIAL_ID
from cabinpose.scene.body import BONE_INDEX, Face
from cabinpose.synth.exact import exact_scene
from cabinpose.synth.faces import DROWSY_OPENING, EXPRESSIONS, with_faces
from cabinpose.synth.gaze import gaze_labels
from cabinpose.synth.occupant import ExactFace
from cabinpose.synth.person_labels import doing_labels
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import frame_rng

SLOTS = ("driver", "front_passenger")
EYE = [MATERIAL_ID[name] for name in ("eye", "iris", "pupil")]


@pytest.fixture(scope="module")
def scene() -> Scene:
    awake, asleep = {"subject": "S01", "action": "drive"}, {"subject": "S02", "action": "sleep"}
    config = small_config(occupancy={}, occupants={"driver": awake, "front_passenger": asleep})
    return SceneSampler(config, 3).sample(0, rng=frame_rng(3, 0))


def test_the_gaze_is_that_of_the_eyes_that_are_seen(scene: Scene) -> None:
    driver, sleeper = scene.people
    labels = gaze_labels(scene, SLOTS, target=False)
    surface = driver.surfaces[0]
    ball, iris = (np.unique(surface.faces[np.isin(surface.material, kinds)]) for kinds in (EYE, [MATERIAL_ID["iris"]]))
    for points, own in zip(*(np.split(surface.vertices[rows].astype(np.float64), 2) for rows in (ball, iris)), strict=True):
        fit = np.linalg.lstsq(np.c_[2.0 * points, np.ones(len(points))], (points**2).sum(axis=1), rcond=None)[0]
        towards = own.mean(axis=0) - fit[:3]
        assert np.degrees(np.arccos(towards @ labels["gaze"][0] / np.linalg.norm(towards))) < 0.2
    assert np.isnan(labels["gaze"][1]).all()
    assert sleeper.face.lids == (0.0, 0.0)


def test_lids_and_expressions_are_labelled_as_they_are_drawn(scene: Scene) -> None:
    driver, sleeper = scene.people
    labels = doing_labels(scene, SLOTS)
    np.testing.assert_array_equal(labels["eyelid_opening"], np.array([driver.face.lids, (0.0, 0.0)], np.float32))
    assert labels["expression"] == [driver.face.expression, sleeper.face.expression]
    for opening, state in ((DROWSY_OPENING + 0.01, "awake"), (DROWSY_OPENING - 0.01, "drowsy")):
        tired = replace(driver, face=replace(driver.face, lids=(opening, opening)))
        told = doing_labels(replace(scene, people=(tired, sleeper)), SLOTS)
        assert told["alertness"] == [state, "asleep"]


def test_faces_have_a_stream_of_their_own_by_frame_and_seat(scene: Scene) -> None:
    def drawn(number: int, seed: int = 3) -> list[Face]:
        return [who.face for who in with_faces(scene.people, {}, scene.cabin, seed=seed, number=number)]

    assert drawn(0) == drawn(0) == [who.face for who in scene.people]
    assert drawn(0)[0] != drawn(1)[0] != drawn(1, seed=4)[0]
    assert drawn(0)[0].gaze == drawn(1)[0].gaze  # of the same head


def test_expressions_are_as_common_as_their_shares(scene: Scene) -> None:
    """Within four standard deviations of a count; hands are away from the mouth."""
    driver, count = scene.people[0], 1500
    assert min(np.linalg.norm(driver.posed.palms[s][:3, 3] - driver.posed.eyes_m) for s in "lr") > 0.3
    faces = [with_faces([driver], {}, scene.cabin, seed=1, number=n)[0].face for n in range(count)]
    met = Counter(face.expression for face in faces)
    assert sum(each.share for each in EXPRESSIONS.values()) == pytest.approx(1.0)
    for name, each in EXPRESSIONS.items():
        assert abs(met[name] - each.share * count) < 4.0 * np.sqrt(each.share * (1.0 - each.share) * count) + 1.0, name
    drowsy = sum(max(face.lids) < DROWSY_OPENING for face in faces)
    assert 0 < drowsy < 0.05 * count
    assert all(0.0 <= share <= 1.0 for face in faces for _, share in face.units)


def test_a_hand_at_the_mouth_has_a_still_face_behind_it(scene: Scene) -> None:
    driver = scene.people[0]
    driver.posed.palms["l"][:3, 3], kept = driver.posed.eyes_m + (0.1, 0.0, 0.0), driver.posed.palms["l"][:3, 3].copy()
    try:
        faces = [with_faces([driver], {}, scene.cabin, seed=1, number=n)[0].face for n in range(50)]
    finally:
        driver.posed.palms["l"][:3, 3] = kept
    assert {face.expression for face in faces} == {"neutral"}


def test_an_expression_fades_while_a_hand_comes_to_the_face(scene: Scene) -> None:
    """A hand at 1 m/s, 30 frames a second: no unit and no lid changes by more than a third of all it does; none at the mouth."""
    driver, way = scene.people[0], np.arange(0.55, 0.10, -1.0 / 30.0)
    drawn = (with_faces([driver], {}, scene.cabin, seed=1, number=n)[0].face for n in range(200))
    number = next(n for n, face in enumerate(drawn) if face.expression == "laughing")
    kept, faces = driver.posed.palms["l"][:3, 3].copy(), []
    try:
        for away_m in way:
            driver.posed.palms["l"][:3, 3] = driver.posed.eyes_m + (away_m, 0.0, 0.0)
            faces.append(with_faces([driver], {}, scene.cabin, seed=1, number=number)[0].face)
    finally:
        driver.posed.palms["l"][:3, 3] = kept
    shares = np.array([[*(dict(face.units).get(unit, 0.0) for unit, _ in faces[0].units), face.lids[0]] for face in faces])
    assert (np.abs(np.diff(shares, axis=0)).max(axis=0) <= np.ptp(shares, axis=0) / 3.0).all()
    assert (np.ptp(shares, axis=0) > 0.05).all()
    assert (np.diff(shares[:, :-1], axis=0) <= 0.0).all()
    assert not shares[-1, :-1].any()
    assert [face.expression for face in faces] == sorted((face.expression for face in faces), key=["laughing", "neutral"].index)
    assert {face.expression for face in faces} == {"laughing", "neutral"}


def test_eyes_turn_no_farther_than_they_can(scene: Scene) -> None:
    """A head that is about to turn to the back: the eyes wait at 55 deg."""
    driver = scene.people[0]
    turned = driver.posed.bones[BONE_INDEX["head"], :3, :3] @ np.diag((-1.0, -1.0, 1.0))
    (somebody,) = with_faces([replace(driver, coming_head=turned)], {}, scene.cabin, seed=1, number=0)
    assert abs(np.degrees(np.arctan2(somebody.face.gaze[1], somebody.face.gaze[0]))) == pytest.approx(55.0)
    assert np.linalg.norm(somebody.face.gaze) == pytest.approx(1.0)


def test_a_face_that_is_given_is_kept(scene: Scene) -> None:
    awake, asleep = {"subject": "S01", "action": "drive"}, {"subject": "S02", "action": "sleep"}
    config = small_config(occupancy={}, occupants={"driver": awake, "front_passenger": asleep})
    exact = exact_scene(config, scene)
    told = exact.scene.occupants["driver"].pose.face
    assert told is not None
    assert told.face == scene.people[0].face
    smiling = ExactFace(gaze=(1.0, 0.0, 0.0), lids=(0.4, 0.6), expression="smiling", units={"mouthSmileLeft": 0.5})
    (somebody,) = with_faces(scene.people[:1], {"driver": smiling.face}, scene.cabin, seed=1, number=0)
    assert somebody.face == Face(lids=(0.4, 0.6), expression="smiling", units=(("mouthSmileLeft", 0.5),))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("gaze", (1.0, 1.0, 0.0), "unit vector"),
        ("lids", (1.2, 1.0), "less than or equal to 1"),
        ("units", {"grin": 0.5}, "face unit"),
    ],
)
def test_what_no_face_does_is_refused(key: str, value: object, said: str) -> None:
    with pytest.raises((ConfigError, ValueError), match=said):
        ExactFace(**{"gaze": (1.0, 0.0, 0.0), "lids": (1.0, 1.0), key: value})


def test_lids_stay_closed_in_sequences_and_expressions_stay() -> None:
    occupants = {"driver": {"subject": "S01"}, "front_passenger": {"subject": "S02", "action": "sleep"}}
    scene = {
        "occupancy": {},
        "occupants": occupants,
        "sequence": {"frames": 4, "rate_hz": 10.0, "activities": ["steer", "sleep"]},
    }
    sampler = SceneSampler(small_config(**scene), 2)
    asleep, expressions = set(), set()
    for index in range(4):
        for person in sampler.sample(index, rng=frame_rng(2, index)).people:
            expressions.add((person.slot, person.action == "sleep", person.face.expression, person.face.units))
            if person.action == "sleep":
                asleep.add(person.slot)
            assert (person.face.lids == (0.0, 0.0)) == (person.action == "sleep")
    assert "front_passenger" in asleep
    assert len(expressions) == len({each[:2] for each in expressions})
