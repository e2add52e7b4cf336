"""People side by side: what neighbours leave, the order of boarding, and full cars that hold."""

from __future__ import annotations

import gc
import math
from weakref import ref

import numpy as np
import pytest

from cabinpose._native import pose as native
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.body import DOF_INDEX, SUBJECTS, BodyModel, Person
from cabinpose.scene.cabin import build_cabin
from cabinpose.synth.boarding import boarding_order, slimmest_in_the_middle
from cabinpose.synth.config import CabinScene, SynthConfig, frame_rng
from cabinpose.synth.posture.company import company_of, half_breadth, within
from cabinpose.synth.posture.feet import is_opposite, tunnel_m
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.room import CELL_M, no_sides, room_for, sides_corner
from cabinpose.synth.posture.seat_fit import fit_seat
from cabinpose.synth.sample import SceneSampler


@pytest.fixture(scope="module")
def model() -> BodyModel:
    return BodyModel.load()


@pytest.fixture(scope="module")
def people(model: BodyModel) -> dict[str, Person]:
    return {name: model.person(*SUBJECTS[name]) for name in ("S01", "S04", "S05", "S11")}


def test_the_nearest_skin_bounds_the_room(people: dict[str, Person]) -> None:
    """Against the vertices themselves: none of the neighbour's skin is nearer than the field says, and some is as near."""
    cabin = build_cabin("suv")
    seat, beside = cabin.seats["rear_left"], cabin.seats["rear_center"]
    neighbour = people["S11"]
    fit = fit_seat(neighbour, beside, beside.default.torso_angle)
    q = fit.q.copy()
    for side in "lr":
        q[DOF_INDEX[side + "shoulder.abduction"]] = 0.1  # not across the own middle plane
    skin = neighbour.pose(q, beside.vehicle_from_seat(beside.default) @ fit.seat_from_root).skin
    others = {"rear_center": neighbour}
    company = company_of(people["S01"], "rear_left", cabin, others, {"rear_center": skin}, rng=np.random.default_rng(0))
    assert company is not None
    assert company.close == (False, True)
    assert np.isinf(company.people[0]).all()  # nobody on the left
    cells = np.rint((skin[:, [0, 2]] - sides_corner(seat)) / CELL_M).astype(int)
    away = seat.design_h_point[1] - skin[:, 1]
    shape = company.people[1].shape
    held = ((cells >= 0) & (cells < shape)).all(axis=1)
    nearest = np.full(shape, np.inf)
    np.minimum.at(nearest, tuple(cells[held].T), away[held])
    both = np.isfinite(nearest) & np.isfinite(company.people[1])
    assert both.sum() > 500
    assert np.median(np.abs(nearest[both] - company.people[1][both])) < 0.006


def test_neighbours_bring_the_sides_nearer(people: dict[str, Person]) -> None:
    cabin = build_cabin("suv")
    seat = cabin.seats["rear_left"]
    room = room_for(people["S01"], cabin, seat, seat.default)
    field = no_sides()
    assert within(room, field) is room
    field[1] = 0.3
    crowded = within(room, field)
    right, left = (seat.design_h_point + (0.2, y, 0.2) for y in (-0.28, 0.28))
    assert native.beside(crowded, right, 0.05) == pytest.approx((0.03, 1.0))
    assert native.beside(room, right, 0.05)[0] < 0.0
    assert native.beside(crowded, left, 0.05) == native.beside(room, left, 0.05)


def test_who_comes_first_keeps_to_a_fair_border(people: dict[str, Person]) -> None:
    cabin = build_cabin("shuttle")
    others = {"rear_left": people["S04"], "rear_right": people["S05"]}
    company = company_of(people["S01"], "rear_center", cabin, others, {}, rng=np.random.default_rng(0))
    assert company is not None
    assert company.close == (True, True)
    assert company.borders[0].max() < company.borders[1].max()  # the wide one at the left gets more
    assert np.isinf(company.people).all()
    alone = company_of(people["S01"], "rear_center", build_cabin("sedan"), {}, {}, rng=np.random.default_rng(0))
    assert alone is None


def test_the_slimmest_sits_between_and_boards_first(people: dict[str, Person]) -> None:
    cabin = build_cabin("sedan")
    sat = dict(zip(OCCUPANT_SLOTS, ("S01", "S11", "S05", "S04", "S11"), strict=True))
    changed = slimmest_in_the_middle(sat, cabin, people.__getitem__)
    assert changed == sat | {"rear_center": "S05", "rear_left": "S04"}
    assert half_breadth(people["S05"]) == min(half_breadth(p) for p in people.values())
    assert boarding_order(OCCUPANT_SLOTS, cabin) == ["driver", "front_passenger", "rear_center", "rear_left", "rear_right"]


def test_benches_that_face_each_other_and_tunnels() -> None:
    shuttle, sedan = build_cabin("shuttle"), build_cabin("sedan")
    assert is_opposite(shuttle.seats["driver"], shuttle.seats["rear_left"])
    assert not is_opposite(sedan.seats["driver"], sedan.seats["rear_left"])
    assert tunnel_m(sedan) > 0.08
    assert tunnel_m(shuttle) < 0.04


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
