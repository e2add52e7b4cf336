"""Infants in carriers, toddlers in harnesses, children without a seat: where they are, and only where they are asked for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from cabinpose.core import CABINPOSE
from cabinpose.core.errors import ConfigError
from cabinpose.scene.labels import LABEL_ID
from cabinpose.synth import SynthConfig, exact_config
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.scene import Scene, ScenePerson
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.subjects import Subjects

BABY = {"baby": {"years": 0.3, "gender": "female"}, "kid": {"years": 4}, "tot": {"years": 0.8}}


def config(**scene: Any) -> SynthConfig:
    scene = {"cars": ["suv"], "occupancy": {}, "right_hand_drive": 0.0, "clutter": 0.0} | scene
    return SynthConfig.parse({"scene": scene, "people": {"own": BABY}})


def drawn(seed: int = 0, **scene: Any) -> tuple[Scene, ScenePerson]:
    found = SceneSampler(config(**scene), seed).sample(0, rng=frame_rng(seed, 0))
    (somebody,) = found.people
    return found, somebody


def at(person: ScenePerson, name: str) -> np.ndarray:
    return np.asarray(person.posed.joints[CABINPOSE.index[name]])


@pytest.mark.parametrize("action", ["infant_asleep", "infant_awake"])
def test_an_infant_lies_in_a_carrier_and_looks_back(action: str) -> None:
    scene, infant = drawn(
        child_seats={"rear_left": "infant"},
        occupants={"rear_left": {"subject": "baby", "action": action}},
        objects={"rear_left": "blanket"},
    )
    assert infant.action == action
    spine = at(infant, "neck") - at(infant, "hip")
    assert 30.0 < math.degrees(math.asin(spine[2] / np.linalg.norm(spine))) < 55.0  # leans back by 40 deg
    assert spine[0] > 0.0  # the head to the front of the car, the feet to its rear
    across = at(infant, "lshoulder") - at(infant, "rshoulder")
    facing = np.cross(across, spine)
    assert facing[0] < 0.0 < facing[2]  # up and back
    carrier, blanket = scene.things
    low, high = carrier.thing.box + carrier.vehicle_from_thing[:3, 3]
    assert (infant.posed.joints > low - 0.05).all()
    assert (infant.posed.joints < high + 0.05).all()
    assert infant.belt == "harness"
    assert set(infant.surfaces[1].label) == {LABEL_ID["seat_belt"]}
    assert blanket.thing.kind == "blanket"
    cloth = blanket.surface(1).vertices
    knees = 0.5 * (at(infant, "lknee") + at(infant, "rknee"))
    assert np.abs(cloth - knees).sum(axis=1).min() < 0.15
    assert np.linalg.norm(cloth - infant.posed.eyes_m, axis=1).min() > 0.05  # the face is free


@pytest.mark.slow
def test_infants_are_drawn_for_their_share_of_carriers() -> None:
    sampler = SceneSampler(config(child_seats={"rear_left": "infant"}, occupancy={"driver": 1.0}, infants=0.5), 3)
    lying = [{p.slot: p for p in sampler.sample(i, rng=frame_rng(3, i)).people}.get("rear_left") for i in range(16)]
    infants = [person for person in lying if person is not None]
    assert 4 <= len(infants) <= 12  # 99.9 % of all seeds
    assert {person.action for person in infants} == {"infant_asleep", "infant_awake"}
    assert all(person.subject.startswith("I") and person.child for person in infants)


def test_nobody_lies_or_stands_unless_asked() -> None:
    sampler = SceneSampler(config(child_seats={"rear_left": "infant"}, occupancy={"driver": 1.0}, children=1.0), 0)
    assert [person.slot for person in sampler.sample(0, rng=frame_rng(0, 0)).people] == ["driver"]


def test_infants_and_toddlers_are_of_all_ages() -> None:
    subjects = Subjects(config(occupancy={"driver": 1.0}).people, 5)
    for kind, low, high in (("I", 0.0, 1.0), ("T", 0.75, 3.0)):
        years = [subjects.body(f"{kind}{number:02d}")[0].years for number in range(24)]
        assert low <= min(years) < low + 0.1
        assert high - 0.1 < max(years) <= high
        assert years == sorted(years)


def test_a_toddler_of_nine_months_sits_harnessed() -> None:
    scene, toddler = drawn(child_seats={"rear_right": "toddler"}, occupants={"rear_right": {"subject": "tot", "action": "sleep"}})
    assert toddler.belt == "harness"
    assert scene.things[0].thing.kind == "toddler_in_use"
    assert at(toddler, "neck")[2] > at(toddler, "hip")[2] + 0.15


@pytest.mark.parametrize(
    ("slot", "action"), [("rear_center", "child_stand"), ("rear_left", "child_lie"), ("rear_right", "child_footwell")]
)
def test_children_without_a_seat(slot: str, action: str) -> None:
    scene, child = drawn(occupants={slot: {"subject": "kid", "action": action}})
    assert scene.cabin is not None
    seat = scene.cabin.seats[slot]
    height = at(child, "head")[2] - at(child, "hip")[2]
    if action == "child_stand":
        assert height > 0.25
        assert at(child, "lankle")[2] < seat.floor_z + 0.12
        assert at(child, "hip")[2] > float(seat.design_h_point[2])
    elif action == "child_lie":
        assert abs(height) < 0.12
        assert abs(at(child, "head")[1] - at(child, "hip")[1]) > 0.25  # across the car
        assert at(child, "chest")[0] < float(seat.design_h_point[0]) + 0.3  # on the cushion
    else:
        assert at(child, "hip")[2] < seat.floor_z + 0.25
        assert min(at(child, "lknee")[2], at(child, "rknee")[2]) > at(child, "hip")[2]
    assert child.belt == "none"
    assert len(child.surfaces) == 1


@pytest.mark.slow
def test_loose_children_are_written_out_exactly() -> None:
    loose = config(loose_children={"rear_center": "any"}, occupancy={"driver": 1.0})
    scene = SceneSampler(loose, 2).sample(0, rng=frame_rng(2, 0))
    exact = exact_config(loose, 2, 0)
    again = SceneSampler(exact, 2).sample(0, rng=frame_rng(2, 0))
    assert np.array_equal(again.surface().vertices, scene.surface().vertices)
    assert exact.scene.tells_restraints


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"loose_children": {"driver": "child_stand"}}, "no child stands, lies or crouches before the driver seat"),
        ({"loose_children": {"rear_left": "sleep"}}, "unknown place of a child without a seat 'sleep'"),
        ({"loose_children": {"rear_left": {"child_lie": 0.7, "child_stand": 0.7}}}, "the probabilities are 1.4 together"),
        ({"loose_children": {"rear_left": "any"}, "child_seats": {"rear_left": "infant"}}, "the rear_left seat is taken"),
        ({"occupants": {"rear_left": {"subject": "S01", "action": "child_stand"}}}, "is for people of 0.72 to 1.15 m"),
        (
            {"child_seats": {"rear_left": "infant"}, "occupants": {"rear_left": {"subject": "baby", "action": "sleep"}}},
            "'sleep' makes no sense in a carrier",
        ),
        ({"occupants": {"rear_left": {"subject": "kid", "action": "infant_asleep"}}}, "makes no sense in the rear_left seat"),
        ({"occupants": {"rear_left": {"subject": "baby"}}}, "baby is a child of 0.3 years"),
    ],
)
def test_what_cannot_be_is_refused(scene: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        SceneSampler(config(**{"occupancy": {"driver": 1.0}} | scene), 0).sample(0, rng=frame_rng(0, 0))
    assert caught.value.hint
