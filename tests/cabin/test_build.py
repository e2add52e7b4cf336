"""Every preset, both sides, and random cars: closed parts, shared faces, settings, mirror images."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cars import DIMENSIONS, RANDOM
from scipy.interpolate import PchipInterpolator

from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import apply, is_rigid
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.cabin import (
    PRESETS,
    PRODUCT_VIEWS,
    SEATS_OF_ALL,
    VIEWS_OF_ALL,
    Cabin,
    CabinDimensions,
    SeatSetting,
    build_cabin,
)
from cabinpose.scene.cabin.layout import Layout, monotone_cubic
from cabinpose.scene.labels import LABELS, coarse_labels
from cabinpose.scene.surface import Surface

EVERY = [(name, side) for name in PRESETS for side in ("left", "right")]
EVERY += [(name, ("left", "right")[n % 2]) for n, name in enumerate(RANDOM)]


def closed_mesh(surface: Surface) -> trimesh.Trimesh:
    """The surface with its equal positions merged, which is how a part is closed."""
    return trimesh.Trimesh(surface.vertices.astype(np.float64), surface.faces, process=True)


@pytest.fixture(params=EVERY, ids=[f"{n}-{s}" for n, s in EVERY])
def cabin(request: pytest.FixtureRequest) -> Cabin:
    name, side = request.param
    return build_cabin(DIMENSIONS[name], drive_side=side)


def test_every_cabin_has_what_every_cabin_has(cabin: Cabin) -> None:
    assert set(SEATS_OF_ALL) <= set(cabin.seats)
    products = PRODUCT_VIEWS if cabin.steering_wheel is not None else ()
    assert tuple(cabin.views) == (*VIEWS_OF_ALL, *products)


def test_each_solid_is_closed_and_looks_outwards(cabin: Cabin) -> None:
    for part in cabin.parts:
        assert part.solid, part.name
        pieces = closed_mesh(part.surface).split(only_watertight=False)
        for piece in pieces:
            assert piece.is_watertight, part.name
            assert piece.is_winding_consistent, part.name
            assert piece.volume > 0, part.name


def test_normals_are_unit_and_agree_with_the_faces(cabin: Cabin) -> None:
    s = cabin.surface({})
    assert np.abs(np.linalg.norm(s.normals, axis=1) - 1).max() < 1e-5
    a, b, c = (s.vertices[s.faces[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    cosine = np.einsum("ij,ikj->ik", cross, s.normals[s.faces]) / np.maximum(np.linalg.norm(cross, axis=1), 1e-12)[:, None]
    assert np.mean(cosine > 0.6) > 0.995


def test_seats_settings_and_groups(cabin: Cabin) -> None:
    assert set(cabin.seats) <= set(OCCUPANT_SLOTS)
    assert {"driver", "front_passenger", "rear_left", "rear_right"} <= set(cabin.seats)
    assert ("rear_center" in cabin.seats) == (DIMENSIONS[cabin.name].rear_places == 3)
    transforms = cabin.group_transforms({})
    assert {p.group for p in cabin.parts} <= set(transforms)
    for slot, seat in cabin.seats.items():
        low, high = seat.ranges
        for setting in (seat.default, low, high):
            seat.check(setting)
            assert is_rigid(seat.vehicle_from_seat(setting))
            back = seat.vehicle_from_back(setting)
            assert np.isclose(back[2, 2], np.cos(setting.torso_angle))
        assert any(p.group == f"seat:{slot}/base" and p.give_m > 0.04 for p in cabin.parts)
        assert any(p.group == f"seat:{slot}/back" and p.give_m > 0.04 for p in cabin.parts)
        assert (seat.h_point(seat.default)[1] > 0) == ("left" in slot or (slot == "driver") == (cabin.drive_side == "left")) or (
            slot == "rear_center" or "rear" in slot
        )


def test_rear_left_is_left(cabin: Cabin) -> None:
    assert cabin.seats["rear_left"].design_h_point[1] > 0 > cabin.seats["rear_right"].design_h_point[1]


def test_surface_follows_settings(cabin: Cabin) -> None:
    seat = cabin.seats["driver"]
    setting = SeatSetting(seat.ranges[1].fore_aft_m, seat.ranges[0].height_m, seat.ranges[1].torso_angle)
    merged = cabin.surface({"driver": setting}, wheel_angle=0.4).vertices
    transforms = cabin.group_transforms({"driver": setting}, wheel_angle=0.4)
    expected = np.concatenate(
        [
            apply(transforms[p.group], p.surface.vertices)
            for group in ["body", *sorted({p.group for p in cabin.parts} - {"body"})]
            for p in cabin.parts
            if p.group == group
        ]
    )
    assert np.abs(merged - expected).max() < 1e-5


def test_right_hand_drive_is_the_mirror_image() -> None:
    for name in PRESETS:
        left, right = build_cabin(name), build_cabin(name, drive_side="right")
        if name == "shuttle":  # nothing in it would tell which side is the driver's
            assert right is left
            assert left.seats["driver"].design_h_point[1] > 0
            continue
        mirrored = left.surface({}).vertices * (1, -1, 1)
        pedal_free = [p for p in right.parts if "pedal" not in p.name]
        count = sum(len(p.surface.faces) for p in pedal_free)
        assert count == sum(len(p.surface.faces) for p in left.parts if "pedal" not in p.name)
        assert np.allclose(right.bounds, np.stack((mirrored.min(0), mirrored.max(0))), atol=1e-5)
        if right.pedals:
            assert right.pedals["accelerator"][1, 3] < right.pedals["brake"][1, 3]
            assert left.pedals["accelerator"][1, 3] < left.pedals["brake"][1, 3]


def test_wheel_frame_and_grip_points() -> None:
    wheel = build_cabin("sedan").steering_wheel
    assert wheel is not None
    assert is_rigid(wheel.vehicle_from_wheel)
    assert wheel.vehicle_from_wheel[0, 2] < -0.8  # the axis points at the driver
    top, nine, three = wheel.grip_point(0.0), wheel.grip_point(np.pi / 2), wheel.grip_point(-np.pi / 2)
    assert top[2] > nine[2]
    assert nine[1] > three[1]
    assert np.isclose(np.linalg.norm(nine - three), 2 * wheel.rim_radius_m)


def test_unknown_names_and_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="limousine") as error:
        build_cabin("limousine")
    assert "sedan" in str(error.value.hint)
    cabin = build_cabin("coupe")
    with pytest.raises(ConfigError, match="rear_center"):
        cabin.surface({"rear_center": SeatSetting()})
    with pytest.raises(ConfigError, match="bonnet"):
        cabin.view("bonnet")
    with pytest.raises(ConfigError, match="fore_aft"):
        cabin.seats["driver"].check(SeatSetting(1.0, 0.0, 0.4))
    with pytest.raises(ConfigError, match="drive side"):
        build_cabin("coupe", drive_side="middle")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"h30_mm": 900}, "h30_mm"),
        ({"a40_deg": float("nan")}, "a40_deg"),
        ({"seat_hight": 3}, "seat_hight: unknown key"),
        ({"w3_mm": 1200, "w20_mm": 450}, "do not fit"),
        ({"l53_mm": 600, "l11_mm": 400}, "wheel"),
        ({"layout": "facing", "l50_mm": 900}, "knee"),
        ({"h25_mm": 560, "h61_mm": 880}, "side glass"),
    ],
)
def test_impossible_dimensions_are_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        CabinDimensions(**values)
    assert error.value.hint


def test_dimensions_say_their_code_and_source() -> None:
    for name, field in CabinDimensions.model_fields.items():
        assert field.description
        if name.endswith(("_mm", "_deg")) and field.json_schema_extra:
            assert "J1100" in field.description


def test_monotone_cubics_are_scipys() -> None:
    """Coefficients to the last bit, of rising, falling, turning and level points."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        n = rng.integers(3, 7)
        x = np.sort(rng.uniform(0, 3, n))
        for y in (rng.normal(size=n), rng.normal(size=n).round(), np.sort(rng.normal(size=n))):
            np.testing.assert_array_equal(monotone_cubic(x, y), PchipInterpolator(x, y).c)


@pytest.mark.parametrize("name", PRESETS)
def test_the_roof_line_is_its_cubics(name: str) -> None:
    layout = Layout(DIMENSIONS[name])
    knots, _ = layout._roof_line
    at = np.linspace(knots[0], knots[-1], 101)
    heights = [float(layout.roof_line(x)) for x in knots]
    np.testing.assert_allclose(layout.roof_line(at), PchipInterpolator(knots, heights)(at), rtol=0, atol=1e-12)


def test_labels_of_before_are_the_coarse_ones(cabin: Cabin) -> None:
    """What is fine is in one class of before, and a car with a dashboard has every fine class."""
    labels = cabin.surface().label
    names = {label.id: label.name for label in LABELS}
    coarse = {names[fine]: names[int(coarse_labels(np.array([fine], np.uint8))[0])] for fine in np.unique(labels).tolist()}
    moved = {fine: before for fine, before in coarse.items() if fine != before}
    assert set(moved.values()) <= {"trim", "seat"}
    fine = {"door", "dashboard", "console", "mirror", "screen", "steering_column", "headrest"}
    assert set(moved) == (fine if cabin.steering_wheel is not None else {"door", "headrest"}) & set(coarse)
    assert {"seat", "trim", "glass", "floor"} <= set(coarse)
