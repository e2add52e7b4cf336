"""Who sits where and how, as labels: each held against another way to it."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from cabinpose.core import OCCUPANT_SLOTS
from cabinpose.scene import merge
from cabinpose.scene.body import SEGMENTS, vertex_segments
from cabinpose.scene.contact import WHEEL_GROUP
from cabinpose.store import AXES
from cabinpose.synth import FrameMaker, Scene, SynthConfig
from cabinpose.synth.person_labels import clock_on_rim

ASKED = {
    "scene": {
        "cars": ["sedan"],
        "right_hand_drive": 0.0,
        "occupancy": {"rear_center": 0.0, "rear_left": 0.0},
        "occupants": {
            "driver": {"subject": "S01", "belt": "under_arm"},
            "front_passenger": {"subject": "S02", "action": "sleep"},
            "rear_right": {},
        },
        "children": 1.0,
        "child_seats": {"rear_right": "toddler", "rear_left": "infant"},
    },
    "camera": {"sensor": {"camera": {"width": 96, "height": 72, "fov_deg": 95}}, "views": {"front_row": 1.0}},
}


@pytest.fixture(scope="module")
def made() -> tuple[Mapping[str, Any], Scene]:
    return FrameMaker(SynthConfig.parse(ASKED), 0).make(0)


def test_states_are_those_of_the_scene(made: tuple[Mapping[str, Any], Scene]) -> None:
    frame, _ = made
    at = {slot: row for row, slot in enumerate(OCCUPANT_SLOTS)}
    assert {slot: frame["occupancy"][row] for slot, row in at.items()} == {
        "driver": "adult", "front_passenger": "adult", "rear_left": "child_seat_empty", "rear_center": "empty",
        "rear_right": "child_in_child_seat",
    }  # fmt: skip
    assert frame["belt"][at["driver"]] == "under_arm"
    assert frame["belt"][at["rear_right"]] == "harness"
    assert (frame["alertness"][at["driver"]], frame["alertness"][at["front_passenger"]]) == ("awake", "asleep")
    assert frame["child_seat_facing"][at["rear_left"]] == "rearward"
    assert (frame["eyelid_opening"][at["front_passenger"]] == 0).all()


def test_bodies_are_as_they_were_asked_for(made: tuple[Mapping[str, Any], Scene]) -> None:
    frame, scene = made
    for who in scene.people:
        row = OCCUPANT_SLOTS.index(who.slot)
        assert frame["stature"][row] == pytest.approx(who.person.stature_m, abs=1e-5)
        assert frame["mass"][row] == pytest.approx(who.person.mass_kg, abs=0.5)
        assert frame["sex"][row] in ("male", "female", "")
        assert np.isnan(frame["stature_percentile"][row]) or 0 <= frame["stature_percentile"][row] <= 100
        skin = np.array(frame["reflectance"])[row, AXES["worn"].index("skin")]
        assert 0.3 < skin < 0.8


@pytest.mark.parametrize(("hours", "off_mm"), [(12.0, 0), (3.0, 0), (9.0, 10), (10.5, -10), (1.0, 25)])
def test_the_clock_on_the_rim(hours: float, off_mm: float) -> None:
    """As seen by who sits behind a wheel that leans: 3 is at their right hand."""
    lean = np.radians(25.0)
    towards, up, left = (
        np.array([-np.cos(lean), 0, np.sin(lean)]),
        np.array([np.sin(lean), 0, np.cos(lean)]),
        np.array([0.0, 1, 0]),
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.column_stack((up, left, towards)), (1.2, 0.4, 0.7)
    wheel: Any = SimpleNamespace(vehicle_from_wheel=pose, rim_radius_m=0.18)
    angle = np.radians(hours * 30.0)
    palm = pose[:3, 3] + (0.18 + off_mm / 1000) * (np.cos(angle) * up - np.sin(angle) * left)
    assert clock_on_rim(wheel, palm) == pytest.approx(hours)
    assert np.isnan(clock_on_rim(wheel, palm + 0.05 * towards))


def test_boxes_hold_the_pixels_and_the_skin(made: tuple[Mapping[str, Any], Scene]) -> None:
    frame, scene = made
    for who in scene.people:
        row = OCCUPANT_SLOTS.index(who.slot)
        low, high = frame["box_3d"][row]
        assert (who.posed.skin >= low - 0.005).all()
        assert (who.posed.skin <= high + 0.005).all()
        v, u = np.nonzero((frame["instance"] == 1 + row) & (frame["labels"] < 64))
        if len(u):
            np.testing.assert_allclose(frame["box_2d"][row], [u.min(), v.min(), u.max(), v.max()])


def test_distances_are_those_of_each_point_from_each_triangle(made: tuple[Mapping[str, Any], Scene]) -> None:
    """Of the points that the page names: the 16 that are nearest to the part's box and 8 more, from every triangle of it."""
    frame, scene = made
    cabin, segments = scene.cabin, vertex_segments()
    parts = {part.name: part.surface for part in cabin.parts}
    board = parts["dashboard"]
    before_seat = np.abs(board.vertices[:, 1] - cabin.seats["front_passenger"].design_h_point[1]) <= 0.2
    at_wheel = cabin.group_transforms(scene.settings, wheel_angle=scene.wheel_angle)[WHEEL_GROUP]
    rim = merge([part.surface for part in cabin.parts if part.group == WHEEL_GROUP])
    hazards = {
        "wheel": (at_wheel, rim, rim.faces), "dashboard": (np.eye(4), board, board.faces),
        "airbag": (at_wheel, parts["airbag cover"], parts["airbag cover"].faces),
    }  # fmt: skip
    before = {"airbag": (np.eye(4), board, board.faces[before_seat[board.faces].all(axis=1)])}
    of_part = {"head": "head", "chest": "thorax", "left_foot": "lfoot", "right_foot": "rfoot"}
    for who in (each for each in scene.people if each.slot in ("driver", "front_passenger")):
        told = frame["distance"][OCCUPANT_SLOTS.index(who.slot)]
        expected = np.full_like(told, np.nan)
        for name, (at, surface, faces) in (hazards | (before if who.slot == "front_passenger" else {})).items():
            for row, part in enumerate(AXES["body_part"]):
                if "foot" in part and name != "dashboard":
                    continue
                skin = who.posed.skin[segments == SEGMENTS.index(of_part[part])].astype(float)
                skin = (skin[:: max(1, len(skin) // 400)] - at[:3, 3]) @ at[:3, :3]
                to_box = skin - np.clip(skin.mean(axis=0), surface.vertices.min(axis=0), surface.vertices.max(axis=0))
                chosen = np.union1d(np.argsort(np.linalg.norm(to_box, axis=1))[:16], np.arange(0, len(skin), len(skin) // 8))
                points, triangles = skin[chosen], surface.vertices[faces].astype(float)
                pairs = np.repeat(triangles, len(points), axis=0), np.tile(points, (len(triangles), 1))
                off = trimesh.triangles.closest_point(*pairs) - pairs[1]
                expected[row, AXES["hazard"].index(name)] = np.linalg.norm(off, axis=1).min()
        np.testing.assert_allclose(told, expected, atol=2e-5)  # of corners that are one within 0.01 mm


def test_distances_are_those_of_all_the_skin(made: tuple[Mapping[str, Any], Scene]) -> None:
    """From points 2 mm apart all over the wheel, by a tree of neighbours: at most 25 mm less than what a few points say."""
    frame, scene = made
    wheel = merge([part.surface for part in scene.cabin.parts if part.group == WHEEL_GROUP])
    points, _ = trimesh.sample.sample_surface(trimesh.Trimesh(wheel.vertices, wheel.faces, process=False), 60_000, seed=1)
    at = scene.cabin.group_transforms(scene.settings, wheel_angle=scene.wheel_angle)[WHEEL_GROUP]
    tree = KDTree(points @ at[:3, :3].T + at[:3, 3])
    (driver,) = (who for who in scene.people if who.slot == "driver")
    row = OCCUPANT_SLOTS.index("driver")
    for part, segment in (("head", "head"), ("chest", "thorax")):
        skin = driver.posed.skin[vertex_segments() == SEGMENTS.index(segment)]
        least = tree.query(skin)[0].min()
        told = frame["distance"][row, AXES["body_part"].index(part), AXES["hazard"].index("wheel")]
        assert least - 0.01 < told < least + 0.025
