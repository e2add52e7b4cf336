"""Child seats and objects: closed, of the sizes stated, standing on their seats and in nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from thing_meshes import cabin_mesh, depth_in

from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import apply, axis_rotation, invert, transform
from cabinpose.scene import labels, materials
from cabinpose.scene.cabin import Cabin
from cabinpose.scene.contact import ContactField, PlacedField
from cabinpose.scene.things import CHILD_SEATS, OBJECTS, PlacedThing, make_thing
from cabinpose.scene.things.pieces import turned_body
from cabinpose.scene.things.placing import (
    LEANING,
    PRESSED_M,
    TOUCHING_M,
    Spot,
    cushion_frame,
    felt,
    in_the_way,
    stand_on_seat,
    stands_free,
)
from cabinpose.scene.things.thing import VARIANTS, Cloud
from cabinpose.synth.things import ON_LAPS, ON_SEATS

# Largest extents (m) that designs may have: UN R16 Annex 17's fixtures for child seats, common sense for the rest.
LARGEST = {
    "infant": (0.75, 0.44, 0.66), "toddler": (0.60, 0.44, 0.72), "booster": (0.60, 0.44, 0.72),
    "booster_cushion": (0.50, 0.46, 0.20), "toddler_in_use": (0.60, 0.44, 0.72), "infant_in_use": (0.75, 0.44, 0.66),
    "open_book": (0.30, 0.24, 0.07),
    "box": (0.36, 0.40, 0.28), "bag": (0.20, 0.38, 0.42), "backpack": (0.32, 0.34, 0.52), "bottle": (0.08, 0.08, 0.26),
    "cup": (0.10, 0.10, 0.17), "book": (0.16, 0.24, 0.04), "laptop": (0.40, 0.38, 0.27), "phone": (0.08, 0.17, 0.01),
    "sandwich": (0.07, 0.07, 0.21), "apple": (0.09, 0.09, 0.09),
}  # fmt: skip


@pytest.mark.parametrize("kind", [name for name, kind in {**CHILD_SEATS, **OBJECTS}.items() if kind.make])
def test_every_design_is_closed_and_of_its_size(kind: str) -> None:
    volumes = set()
    for variant in range(VARIANTS):
        thing = make_thing(kind, variant)
        for piece in thing.pieces:
            mesh = trimesh.Trimesh(piece.solid.vertices, piece.solid.faces, process=False)
            assert mesh.is_watertight
            assert mesh.is_winding_consistent
            assert mesh.volume > 0.0
            assert piece.material in materials.MATERIAL_ID
        extent = np.ptp(thing.surface.vertices, axis=0)
        assert (extent < LARGEST[kind]).all()
        assert (extent > 0.33 * np.array(LARGEST[kind])).all()
        assert set(thing.surface.label) == {labels.LABEL_ID[thing.label]}
        volumes.add(round(sum(piece.solid.volume() for piece in thing.pieces), 9))
    assert len(volumes) == VARIANTS  # designs differ


def test_a_turned_body_has_the_volume_of_frustums() -> None:
    body = turned_body([(0.03, 0.0), (0.04, 0.1), (0.02, 0.13)], sides=12)
    polygon = 0.5 * 12 * np.sin(2 * np.pi / 12)  # of 12 sides in the unit circle
    frustums = [h / 3 * (a * a + a * b + b * b) for a, b, h in ((0.03, 0.04, 0.1), (0.04, 0.02, 0.03))]
    assert body.volume() == pytest.approx(polygon * sum(frustums), rel=1e-9)


def test_a_distance_field_knows_how_deep_a_point_is() -> None:
    box = make_thing("box", 0)
    half = np.ptp(box.pieces[0].solid.vertices, axis=0)[0] / 2.0
    at = PlacedThing(box, transform(None, (1.0, 2.0, 3.0)), "rear_left", "seat")
    group = at.group()
    assert group[0].name == "rear_left box"
    inside = np.array([[1.0 + half - 0.03, 2.0, 3.06]])
    field = PlacedField((), np.empty((0, 3)), np.empty((0, 3))).with_groups([group])
    assert field.clearance(inside)[0] == pytest.approx(-0.03, abs=0.004)
    found = field.deepest(np.float32(inside), 0.0)
    assert found is not None
    assert found.part == "box carton"
    assert found.depth_m == pytest.approx(0.03, abs=1e-6)


@pytest.mark.parametrize(("kind", "pressed", "yields"), [("phone", 0.0, 0.003), ("booster", 0.012, 0.0), ("bag", np.inf, 0.004)])
def test_points_stand_free_as_trimesh_says(kind: str, pressed: float, yields: float) -> None:
    thing, rng = make_thing(kind, 0), np.random.default_rng(3)
    vehicle_from_thing = transform(axis_rotation("x", 0.7), (1.0, 2.0, 3.0))
    group = felt(thing.field, pressed, yields)
    pieces = [(trimesh.Trimesh(p.solid.vertices, p.solid.faces), min(p.give_m, pressed) + yields) for p in thing.pieces]
    low, high = thing.box
    free = []
    for _ in range(150):
        points = rng.uniform(low, high, (2, 3))
        deepest = max((trimesh.proximity.signed_distance(mesh, points) - allowed).max() for mesh, allowed in pieces)
        found = stands_free(group, Cloud.of(apply(vehicle_from_thing, points)), invert(vehicle_from_thing))
        assert found == (deepest <= 0.0) or abs(deepest) < 1e-6
        free.append(found)
    assert 20 < sum(free) < 130


@pytest.mark.parametrize("kind", ["infant", "toddler", "booster", "booster_cushion"])
@pytest.mark.parametrize("slot", ["rear_left", "front_passenger"])
def test_a_child_seat_rests_on_cushion_and_backrest(suv: tuple[Cabin, ContactField], slot: str, kind: str) -> None:
    cabin, contact = suv
    seat = cabin.seats[slot]
    at = stand_on_seat(make_thing(kind, 1), seat, seat.default, contact.at({}), LEANING, PRESSED_M)
    thing = PlacedThing(make_thing(kind, 1), at, slot, "seat")
    into = {name: depth_in(thing, cabin_mesh(cabin, f"{slot} {name}")) for name in ("cushion", "backrest", "headrest")}
    assert max(into.values()) < PRESSED_M + 0.004  # vertices lie between the points that were measured
    assert into["cushion"] > 0.005
    assert max(into["backrest"], into["headrest"]) > 0.0
    assert in_the_way(thing, contact.at({}), PRESSED_M) is None
    forward = at[:3, 0] @ seat.vehicle_from_seat(seat.default)[:3, 0]
    assert forward == pytest.approx(np.cos(seat.cushion_angle), abs=1e-9)


def test_a_seat_before_it_stops_a_child_seat(suv: tuple[Cabin, ContactField]) -> None:
    cabin, contact = suv
    seat = cabin.seats["rear_left"]
    at = stand_on_seat(make_thing("infant", 1), seat, seat.default, contact.at({}), LEANING, PRESSED_M)
    thing = PlacedThing(make_thing("infant", 1), at, "rear_left", "seat")
    driver = cabin.seats["driver"]
    for back in (0.0, 0.05, 0.10, 0.15):
        settings = {"driver": replace(driver.default, fore_aft_m=-back)}
        obstacle = in_the_way(thing, contact.at(settings), PRESSED_M)
        names = [p.name for p in cabin.parts if p.name.startswith("driver ") and "buckle" not in p.name]
        touching = max((depth_in(thing, cabin_mesh(cabin, name, settings)), name) for name in names)
        if obstacle is None:
            assert touching[0] < PRESSED_M + TOUCHING_M + 0.004
        else:
            assert obstacle.part.startswith("driver ")
            assert touching[0] > 0.0
    assert obstacle is not None


@pytest.mark.parametrize("kind", ON_SEATS)
def test_an_object_lies_on_the_cushion(suv: tuple[Cabin, ContactField], kind: str) -> None:
    cabin, contact = suv
    seat = cabin.seats["rear_right"]
    at = stand_on_seat(make_thing(kind, 2), seat, seat.default, contact.at({}), Spot(0.05), 0.004)
    thing = PlacedThing(make_thing(kind, 2), at, "rear_right", "seat")
    deep = depth_in(thing, cabin_mesh(cabin, "rear_right cushion"))
    assert -0.001 < deep < 0.008
    assert at[:3, 2] @ cushion_frame(seat, seat.default)[:3, 2] == pytest.approx(1.0)


def test_lap_objects_are_objects() -> None:
    assert set(ON_LAPS) < set(ON_SEATS)


def test_unknown_things_list_those_that_there_are() -> None:
    with pytest.raises(ConfigError, match="unknown thing 'sofa'") as caught:
        make_thing("sofa", 0)
    assert "toddler" in str(caught.value.hint)


def test_every_thing_has_a_class_that_ticam_knows() -> None:
    kinds = {**CHILD_SEATS, **OBJECTS}.values()
    assert {label.name for label in labels.THING_LABELS} == {kind.label for kind in kinds}
    classes = {label.name: labels.ticam_class(label) for label in labels.LABELS}
    assert classes["hand_left"] == classes["hair"] == 1
    assert classes["seat"] == classes["seat_belt"] == 0
    assert sorted(classes[label.name] for label in labels.THING_LABELS) == [2, 3, 4, 5, 6, 7, 8, 8, 9, 10, 13, 14, 15]
