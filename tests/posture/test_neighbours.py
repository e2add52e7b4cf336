"""People side by side: what neighbours mean, who sits where, and full cars that hold."""

from __future__ import annotations

import gc
import math
from dataclasses import replace
from weakref import ref

import numpy as np
import pytest

from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.body import SUBJECTS, BodyModel, Person
from cabinpose.scene.cabin import build_cabin
from cabinpose.synth import casting
from cabinpose.synth.casting import slimmest_in_the_middle
from cabinpose.synth.config import CabinScene, SynthConfig
from cabinpose.synth.posing import rows_of
from cabinpose.synth.posture import random_action
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.neighbours import NOBODY, half_breadth, is_opposite, neighbours_of, tunnel_m
from cabinpose.synth.posture.seat_fit import fit_seat
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng


@pytest.fixture(scope="module")
def model() -> BodyModel:
    return BodyModel.load()


@pytest.fixture(scope="module")
def people(model: BodyModel) -> dict[str, Person]:
    return {name: model.person(*SUBJECTS[name]) for name in ("S01", "S04", "S05", "S11")}


def test_what_neighbours_mean(people: dict[str, Person]) -> None:
    shuttle, sedan = build_cabin("shuttle"), build_cabin("sedan")
    others = {"rear_left": people["S04"], "rear_right": people["S05"]}
    between = neighbours_of(people["S01"], "rear_center", shuttle, others, rng=np.random.default_rng(0))
    assert between.close == (True, True)
    assert between.aside == 0.0
    beside = neighbours_of(people["S11"], "rear_left", sedan, {"rear_center": people["S04"]}, rng=np.random.default_rng(0))
    assert beside.close == (False, True)
    assert 0.0 < beside.aside <= 0.04  # to the left, away from the neighbour
    assert beside.lean == 0.0  # who sits in the middle leans
    assert beside.feet[0] == math.inf
    assert beside.feet[1] < 0.12  # the one in the middle has feet on both sides of the tunnel
    assert neighbours_of(people["S01"], "rear_center", sedan, {}, rng=np.random.default_rng(0)) is NOBODY


def test_nobody_does_by_chance_what_neighbours_leave_no_room_for() -> None:
    sedan, rng = build_cabin("sedan"), np.random.default_rng(0)
    seat = sedan.seats["rear_center"]
    for close, left_out in (
        ((False, False), set()),
        ((True, False), {"lean_side", "phone_ear"}),
        ((True, True), {"lean_side", "phone_ear", "phone_ear_outer"}),
    ):
        beside = NOBODY._replace(close=close)
        drawn = {random_action(seat, sedan, rng=rng, neighbours=beside) for _ in range(1000)}
        assert {"lean_side", "phone_ear", "phone_ear_outer"} - drawn == left_out


def test_the_slimmest_sits_between(people: dict[str, Person]) -> None:
    cabin = build_cabin("sedan")
    sat = dict(zip(OCCUPANT_SLOTS, ("S01", "S11", "S05", "S04", "S11"), strict=True))
    changed = slimmest_in_the_middle(sat, cabin, people.__getitem__)
    assert changed == sat | {"rear_center": "S05", "rear_left": "S04"}
    assert half_breadth(people["S05"]) == min(half_breadth(p) for p in people.values())
    assert rows_of(OCCUPANT_SLOTS, cabin) == [["driver", "front_passenger"], ["rear_left", "rear_center", "rear_right"]]


def test_benches_that_face_each_other_and_tunnels() -> None:
    shuttle, sedan = build_cabin("shuttle"), build_cabin("sedan")
    assert is_opposite(shuttle.seats["driver"], shuttle.seats["rear_left"])
    assert not is_opposite(sedan.seats["driver"], sedan.seats["rear_left"])
    assert tunnel_m(sedan) > 0.08
    assert tunnel_m(shuttle) < 0.04


@pytest.mark.slow
def test_full_cars_are_found_soon() -> None:
    full = CabinScene(cars=("van",), occupancy=dict.fromkeys(OCCUPANT_SLOTS, 1.0))
    sampler = SceneSampler(SynthConfig(scene=full), 1)
    scenes = [sampler.sample(i, rng=frame_rng(1, i)) for i in range(4)]
    assert all([p.slot for p in scene.people] == list(OCCUPANT_SLOTS) for scene in scenes)
    assert sum(scene.proposals for scene in scenes) < 4 * 40
    for scene in scenes:  # side by side: heads of the rear row far enough apart
        heads = np.stack([p.posed.joints[0] for p in scene.people if p.slot.startswith("rear")])
        gaps = [math.dist(heads[a], heads[b]) for a, b in ((0, 1), (1, 2))]
        assert min(gaps) > 0.2


def test_what_is_known_of_a_person_goes_with_the_person(model: BodyModel) -> None:
    calls = []

    @kept_with_person
    def known(person: Person, number: int) -> int:
        calls.append(number)
        return number + 1

    person = model.person(*SUBJECTS["S02"])
    gone = ref(person)
    assert [known(person, 1), known(person, 1), known(person, 2)] == [2, 2, 3]
    assert calls == [1, 2]
    fit_seat(person, build_cabin("sedan").seats["driver"], 0.4)
    del person
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize(("yaw", "moved"), [(0.0, True), (np.pi, False)])
def test_a_front_seat_makes_room_for_a_childs_legs_that_come_to_its_back(yaw: float, moved: bool) -> None:
    """A child who looks backwards has no knees behind the front seat."""
    cabin = build_cabin("suv")
    turned = replace(cabin, seats={**cabin.seats, "rear_right": replace(cabin.seats["rear_right"], facing_yaw=yaw)})
    settings = {slot: seat.default for slot, seat in turned.seats.items()}
    assert bool(casting._moved_forwards(turned, "rear_right", settings)) == moved
