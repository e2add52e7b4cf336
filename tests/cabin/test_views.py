"""Camera places see their people and stand clear of the cabin; people fit where the dimensions say."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cars import DIMENSIONS

from cabinpose.core.camera import Camera
from cabinpose.core.frames import apply, invert, look_at
from cabinpose.scene.cabin import PRESET_DIMENSIONS, PRESETS, PRODUCT_VIEWS, Cabin, build_cabin
from cabinpose.scene.cabin.layout import Layout, pedal_plane_angle
from cabinpose.scene.labels import LABEL_ID as LABEL

MONSTAR = Camera.from_fov(352, 287, np.deg2rad(100), np.deg2rad(85))
SEEN = {
    "driver": ("driver",),
    "front_row": ("driver", "front_passenger"),
    "rear": ("rear_left", "rear_right"),
}


def trunk_points(cabin: Cabin, slot: str) -> np.ndarray:
    """(6, 3) vehicle: H-point, both hips, both shoulders, head of a 1.75 m person in this seat."""
    seat = cabin.seats[slot]
    back = apply(
        seat.vehicle_from_back(seat.default),
        [(0.02, 0, 0.0), (0, 0.10, 0), (0, -0.10, 0), (0.03, 0.17, 0.46), (0.03, -0.17, 0.46)],
    )
    head = seat.vehicle_from_seat(seat.default) @ np.array([-0.16, 0, 0.68, 1])
    return np.concatenate((back, head[None, :3]))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", DIMENSIONS)
def test_each_view_is_clear_and_sees_its_people(name: str, side: str) -> None:
    cabin = build_cabin(DIMENSIONS[name], drive_side=side)  # type: ignore[arg-type]
    surface = cabin.surface({})
    mesh = trimesh.Trimesh(surface.vertices.astype(float), surface.faces, process=False)
    soft = np.isin(surface.label, [LABEL["seat"], LABEL["headrest"]])
    for view, slots in SEEN.items():
        anchor = cabin.view(view)
        clearance = trimesh.proximity.closest_point(mesh, anchor.eye[None])[1][0]
        assert clearance > 0.03, view
        camera_from_vehicle = invert(look_at(anchor.eye, anchor.target))
        for slot in slots:
            points = trunk_points(cabin, slot)
            assert MONSTAR.contains(MONSTAR.project(apply(camera_from_vehicle, points))).all(), (view, slot)
            rays = points - anchor.eye
            reach = np.linalg.norm(rays, axis=1)
            places, index, triangle = mesh.ray.intersects_location(
                np.tile(anchor.eye, (len(points), 1)), rays, multiple_hits=False
            )
            near = np.linalg.norm(places - anchor.eye, axis=1) < reach[index] - 0.12  # 0.12: the body is thicker than its joints
            blocked = near & ~soft[triangle]
            assert blocked.sum() <= 1, (view, slot)  # a hip may be behind the wheel's rim or the console


@pytest.mark.parametrize("name", [name for name in DIMENSIONS if DIMENSIONS[name].layout != "facing"])
def test_places_of_products_are_clear_and_look_at_the_driver(name: str) -> None:
    """12 mm to the nearest part; the head of a 1.75 m driver in front of each, and for the wide ones in their image."""
    cabin = build_cabin(DIMENSIONS[name])
    surface = cabin.surface({})
    mesh = trimesh.Trimesh(surface.vertices.astype(float), surface.faces, process=False)
    head = trunk_points(cabin, "driver")[-1:]
    for view in PRODUCT_VIEWS:
        anchor = cabin.view(view)
        assert trimesh.proximity.closest_point(mesh, anchor.eye[None])[1][0] > 0.012, view
        seen = apply(invert(look_at(anchor.eye, anchor.target)), head)
        assert MONSTAR.contains(MONSTAR.project(seen)).all(), view


@pytest.mark.parametrize("name", PRESETS)
def test_seats_stay_below_roof_and_glass(name: str) -> None:
    cabin = build_cabin(DIMENSIONS[name])
    layout = Layout(DIMENSIONS[name])
    transforms = cabin.group_transforms({})
    for part in cabin.parts:
        if part.group.startswith("seat:"):
            v = apply(transforms[part.group], part.surface.vertices)
            assert (v[:, 2] < layout.roof(v[:, 0], v[:, 1]) - 0.005).all(), part.name
            slot = part.group.removeprefix("seat:").split("/")[0]
            lowest = cabin.seats[slot].ranges[0].height_m
            assert (v[:, 2] + lowest > -0.001).all(), part.name
            assert (np.abs(v[:, 1]) < layout.half_width(v[:, 0], v[:, 2])).all(), part.name
            below = v[v[:, 0] < layout.roof_end_x]
            assert (below[:, 0] > layout.backlight_x(below[:, 2])).all(), part.name


@pytest.mark.parametrize("name", DIMENSIONS)
def test_head_room_is_h61(name: str) -> None:
    """A ray 8 degrees rearward from each front H-point meets the headlining at H61 - 102 mm."""
    d = DIMENSIONS[name]
    cabin = build_cabin(DIMENSIONS[name])
    roof = next(p for p in cabin.parts if p.name == "headlining").surface
    mesh = trimesh.Trimesh(roof.vertices.astype(float), roof.faces, process=False)
    seat = cabin.seats["driver"]
    up = np.array([-np.sin(np.deg2rad(8)) * np.cos(seat.facing_yaw), 0, np.cos(np.deg2rad(8))])
    origin = seat.design_h_point * (1, 0, 1)
    hit = mesh.ray.intersects_location(origin[None], up[None], multiple_hits=False)[0]
    assert abs(np.linalg.norm(hit[0] - origin) + 0.102 - d.h61_mm / 1000) < 0.012


@pytest.mark.parametrize("name", [n for n in PRESETS if n != "shuttle"])
def test_driver_fits_wheel_and_pedals(name: str) -> None:
    d = DIMENSIONS[name]
    cabin = build_cabin(DIMENSIONS[name])
    wheel, seat = cabin.steering_wheel, cabin.seats["driver"]
    assert wheel is not None
    assert np.allclose(wheel.vehicle_from_wheel[:3, 3], (-d.l11_mm / 1000, d.w20_mm / 1000, d.h17_mm / 1000))
    assert np.isclose(2 * (wheel.rim_radius_m + wheel.rim_section_m), d.w9_mm / 1000)
    lowest = wheel.grip_point(np.pi)
    thigh = seat.design_h_point[2] + (lowest[0] - seat.design_h_point[0]) * np.tan(seat.cushion_angle + np.deg2rad(3)) + 0.075
    assert lowest[2] - wheel.rim_section_m - thigh > 0.015
    pad = cabin.pedals["accelerator"]
    heel = np.array([0.0, pad[1, 3], 0.0])
    assert np.isclose(np.linalg.norm(pad[:3, 3] - heel), 0.200)
    assert abs(pad[:3, 2] @ (pad[:3, 3] - heel)) < 1e-9  # the sole from heel to ball lies in the pad's plane
    assert np.isclose(np.arctan2(pad[2, 0], pad[0, 0]), pedal_plane_angle(d.h30_mm / 1000))


@pytest.mark.parametrize("name", DIMENSIONS)
def test_walls_are_solid_outwards(name: str) -> None:
    """What reaches 20 and 38 mm into doors, floor, roof and glass is found inside of them."""
    cabin = build_cabin(DIMENSIONS[name])
    for part in cabin.parts:
        if part.name not in (
            "front door trim",
            "rear door trim",
            "floor",
            "headlining",
            "windscreen",
            "front side glass",
            "tail panel",
        ):
            continue
        s = part.surface
        mesh = trimesh.Trimesh(s.vertices.astype(float), s.faces, process=True)
        centre = np.array([cabin.bounds[:, 0].mean(), 0.0, 0.6])
        middles = mesh.triangles_center
        inward = np.einsum("ij,ij->i", mesh.face_normals, centre - middles) > 0
        large = mesh.area_faces > np.quantile(mesh.area_faces, 0.6)
        chosen = np.flatnonzero(inward & large)[::7]
        for depth in (0.020, 0.038):
            assert mesh.contains(middles[chosen] - depth * mesh.face_normals[chosen]).mean() > 0.9, (part.name, depth)


def test_presets_differ() -> None:
    """No two presets share their dimensions, and no two have the same combination of styles."""
    numbers = [tuple(v for v in d.model_dump().values() if isinstance(v, float)) for d in PRESET_DIMENSIONS.values()]
    styles = [(d.layout, d.seat_style, d.dash_style, d.console_style, d.door_style) for d in PRESET_DIMENSIONS.values()]
    assert len(set(numbers)) == len(set(styles)) == len(PRESETS) == 7
    h_points = np.array([build_cabin(n).seats["driver"].design_h_point for n in PRESETS])
    spread = np.linalg.norm(h_points[:, None] - h_points[None], axis=-1) + np.eye(len(PRESETS))
    assert spread.min() > 0.01
