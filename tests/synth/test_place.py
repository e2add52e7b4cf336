"""What is said of a camera's place in a car: nothing of good ones, the cause of bad ones."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.app.cli import main
from cabinpose.core import Camera as Lens
from cabinpose.core import ConfigError, Matrix, apply, invert
from cabinpose.scene.cabin import PRESETS, PRODUCT_VIEWS, VIEWS_OF_ALL, Cabin, build_cabin
from cabinpose.scene.contact import ContactField, first_crossings
from cabinpose.scene.sensor import PhysicalNoise, place_camera, sensor_by_name, simulate
from cabinpose.synth import PlaceReport, SynthConfig, frame_rng, judge_place, preflight
from cabinpose.synth.camera import Camera
from cabinpose.synth.place import FEWEST_VALID, reduced
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.viewpoint import LENS_M

SENSOR = sensor_by_name("pico_monstar_105/5")
built: Callable[[str], Cabin] = cache(build_cabin)
Vector = tuple[float, float, float]
BAD: dict[str, tuple[Vector, Vector, list[str]]] = {
    "before the windscreen": ((2.0, 0.0, 1.0), (-1.0, 0.0, 0.7), ["outside of the car", "through glass", "no seat"]),
    "beside the door": ((-1.0, 1.5, 0.9), (-1.0, 0.0, 0.6), ["outside of the car", "no seat"]),
    "on the bonnet": ((0.3, 0.0, 1.0), (-1.0, 0.0, 0.6), ["through glass", "% see glass", "no seat"]),
    "above the roof": ((-1.0, 0.0, 1.9), (-1.0, 0.0, 0.6), ["outside of the car", "no seat"]),
    "looks ahead": ((-0.35, 0.0, 0.92), (1.0, 0.0, 0.9), ["% of its pixels deliver a depth", "% see glass", "no seat"]),
    "too near": ((-0.95, 0.37, 1.08), (-1.2, 0.37, 0.6), ["% see what is beyond range_m [0.6, 2.0]"]),
}


def pose(eye: Vector, target: Vector) -> Matrix:
    """vehicle_from_camera, upright."""
    return place_camera(eye, target, rng=frame_rng(0, 0))


def judged(cabin: Cabin, eye: Vector, target: Vector, **changes: Any) -> PlaceReport:
    """The report on a place, of the usual sensor with some fields changed."""
    return judge_place(cabin, "mine", pose(eye, target), SENSOR.model_copy(update=changes), PhysicalNoise())


@pytest.mark.parametrize("car", PRESETS)
def test_nothing_is_said_of_the_views_of_the_cars(car: str) -> None:
    cabin = built(car)
    for sensor in (SENSOR, sensor_by_name("evk75123")):
        for name in VIEWS_OF_ALL:
            anchor = cabin.view(name)
            place = place_camera(anchor.eye, anchor.target, rng=frame_rng(0, 0))
            report = judge_place(cabin, name, place, sensor, PhysicalNoise())
            assert report.doubts == ()
            assert report.seen


@pytest.mark.parametrize("name", BAD)
def test_a_bad_place_is_told_with_its_cause(name: str) -> None:
    eye, target, words = BAD[name]
    changes = {"range_m": (0.6, 2.0)} if name == "too near" else {}
    told = "; ".join(judged(built("sedan"), eye, target, **changes).doubts)
    assert [each for each in words if each not in told] == []


def test_a_place_under_the_mirror_is_good() -> None:
    report = judged(built("sedan"), (-0.35, 0.0, 0.92), (-1.0, 0.15, 0.5))
    assert report.doubts == ()
    assert {"driver", "front_passenger"} <= set(report.seen)


def test_seats_are_seen_as_lines_to_them_are_free() -> None:
    """By exact segments through the car's triangles, where the report goes by the pixels of a small image."""
    cabin = built("hatchback")
    for view in map(cabin.view, VIEWS_OF_ALL):
        place = place_camera(view.eye, view.target, rng=frame_rng(0, 0))
        report = judge_place(cabin, "view", place, SENSOR, PhysicalNoise())
        surface = cabin.surface()
        triangles = surface.vertices[surface.faces].astype(np.float64)
        for slot, seat in cabin.seats.items():
            back = seat.vehicle_from_back(seat.default)
            head = apply(back, np.array([[0.02, y, 0.66] for y in (-0.06, 0.06)]))
            in_camera = apply(invert(place), head)
            free = first_crossings(np.repeat(place[None, :3, 3], 2, axis=0), head, triangles)[1] < 0
            inside = SENSOR.camera.contains(SENSOR.camera.project(in_camera)) & (in_camera[:, 2] < 2.0)
            if report.seats[slot] == 1.0:
                assert (free & inside).all()
            if report.seats[slot] == 0.0:
                assert not (free & inside).any()


def test_range_is_depth_as_in_the_sensor() -> None:
    """Of a camera that looks straight down nobody is deeper than the lowest H-point, though the rear seats are farther away."""
    cabin = built("van")
    eye, lens = (-0.9, 0.0, 1.3), Lens.from_fov(160, 160, np.radians(140.0))
    lowest = min(seat.h_point(seat.default)[2] for seat in cabin.seats.values())
    near, far = (
        judged(cabin, eye, (-0.9001, 0.0, 0.0), camera=lens, field_radius_px=None, range_m=(0.1, far))
        for far in (eye[2] - lowest, 9.0)
    )
    assert near.seats == far.seats
    assert near.seats["rear_left"] > 0.5


def test_the_share_of_pixels_is_that_of_the_whole_image() -> None:
    cabin = built("hatchback")
    anchor = cabin.views["front_row"]
    place = place_camera(anchor.eye, anchor.target, rng=frame_rng(0, 0))
    rendered = Rasteriser(SENSOR.camera).render(cabin.surface(), invert(place))
    depth = simulate(rendered.buffers, SENSOR, PhysicalNoise(), rng=frame_rng(1, 1)).depth_m
    rows, columns = np.mgrid[: SENSOR.camera.height, : SENSOR.camera.width]
    assert SENSOR.field_radius_px is not None
    lit = np.hypot(columns - SENSOR.camera.cx, rows - SENSOR.camera.cy) < SENSOR.field_radius_px
    report = judge_place(cabin, "front_row", place, SENSOR, PhysicalNoise())
    assert report.valid == pytest.approx(np.isfinite(depth)[lit].mean(), abs=0.03)


def test_a_small_image_has_the_same_view() -> None:
    small = reduced(SENSOR).camera
    for name, u, v in (("first", -0.5, -0.5), ("last", SENSOR.camera.width - 0.5, SENSOR.camera.height - 0.5)):
        whole = SENSOR.camera.unproject((u, v), 1.0)
        back = small.project(whole)
        corner = (-0.5, -0.5) if name == "first" else (small.width - 0.5, small.height - 0.5)
        np.testing.assert_allclose(back, corner, atol=1.0)


def checked(text: str, *changes: str) -> tuple[tuple[PlaceReport, ...], list[str]]:
    """What `preflight` gives and warns of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        places = preflight(SynthConfig.load(None, (text, *changes)), frames=1)
    return places, [str(each.message) for each in caught]


def test_own_places_are_judged_before_a_run_and_the_packages_own_are_not() -> None:
    doubtful = "camera.views={feet: {position_m: [-0.45, 0.12, 0.6], look_at_m: [0.15, 0.36, 0.05]}}"
    (place,), (words,) = checked("scene.cars=[sedan]", doubtful)
    assert (place.car, place.view) == ("sedan", "feet")
    assert place.valid < FEWEST_VALID
    assert words.startswith("view 'feet' in sedan: ")
    assert checked("scene.cars=[sedan]") == ((), [])


@pytest.mark.parametrize("name", [name for name in BAD if name != "too near"])
def test_a_camera_that_sees_a_wall_is_refused_with_the_reason(name: str) -> None:
    eye, target, words = BAD[name]
    view = f"camera.views={{mine: {{position_m: {list(eye)}, look_at_m: {list(target)}}}}}"
    with pytest.raises(ConfigError, match="view 'mine' sees nobody in sedan") as caught:
        checked("scene.cars=[sedan]", view)
    assert [each for each in words if each not in str(caught.value)] == []


def test_a_car_that_lacks_a_view_is_named_with_those_that_it_has() -> None:
    with pytest.raises(ConfigError, match="shuttle has no view 'mirror'") as caught:
        checked("scene.cars=[suv, shuttle]", "camera.views={mirror: 1}")
    assert "driver, front_row, rear; name the cars" in str(caught.value.hint)


def test_a_camera_that_is_blind_in_one_car_of_two_is_told() -> None:
    """It is in the van's cabin, and above the coupe's roof."""
    _, words = checked("scene.cars=[coupe, van]", "camera.views={mine: {position_m: [-0.5, 0, 1.2], look_at_m: [-1.2, 0, 0.6]}}")
    assert [each for each in words if "view 'mine' in coupe" in each and "it sees no seat" in each]
    assert not [each for each in words if "in van" in each]


NARROW = {
    "preset": "pico_monstar_105/5",
    "camera": {"width": 320, "height": 240, "hfov": 74.4, "vfov": 59.3},
    "range_m": [0.2, 2.0],
}


@pytest.mark.parametrize(
    "car", [pytest.param(c, marks=() if c in {"sedan", "van"} else pytest.mark.slow) for c in PRESETS if c != "shuttle"]
)
def test_places_of_products_are_free_and_see_the_driver(car: str) -> None:
    """`cluster` and `display` with the narrow lens of such cameras, the others with the wide one, too."""
    cabin, narrow = built(car), Camera.model_validate({"sensor": NARROW}).sensor_model
    settings = {slot: seat.default for slot, seat in cabin.seats.items()}
    for name in PRODUCT_VIEWS:
        anchor = cabin.view(name)
        assert ContactField(cabin).clearance(anchor.eye[None], settings, 0.0)[0] > LENS_M, name
        place = place_camera(anchor.eye, anchor.target, rng=frame_rng(0, 0))
        for sensor in (narrow,) if name in {"cluster", "display"} else (narrow, SENSOR):
            report = judge_place(cabin, name, place, sensor, PhysicalNoise())
            assert report.doubts == (), name
            assert "driver" in report.seen, name


def test_an_own_sensor_is_judged_in_the_first_car() -> None:
    places, words = checked("scene.cars=[sedan, suv]", "camera.sensor={camera: {width: 64, height: 48, fov_deg: 95}}")
    assert ([(place.car, place.view) for place in places], words) == ([("sedan", "driver"), ("sedan", "front_row")], [])


@pytest.mark.slow  # each of the three draws scenes
def test_config_check_and_synth_tell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(
        "scene: {cars: [sedan]}\n"
        "camera:\n"
        "  sensor: {camera: {width: 64, height: 48, fov_deg: 95}, fps: 5}\n"
        "  views: {feet: {position_m: [-0.45, 0.12, 0.6], look_at_m: [0.15, 0.36, 0.05]}}\n"
    )
    assert main(["config", "check", str(file)]) == 0
    out, err = capsys.readouterr()
    assert "view feet  sedan: " in out
    assert "own_camera (64x48 px, 95° x 78.6°" in out
    assert "range_m 0.3 2, " in out
    assert "fps" not in out
    assert "warning: view 'feet' in sedan: " in err
    assert main(["config", "check", str(file), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["places"][0]["seats"]["driver"] == 0.0
    assert told["taken"].startswith("range_m 0.3 2, ")
    assert main(["synth", "--config", str(file), "--frames", "1", "--out", str(tmp_path / "made")]) == 0
    _, err = capsys.readouterr()
    assert err.count("view 'feet'") == 1
    assert "not given, taken as in a Pico Monstar with even light: range_m 0.3 2, " in err
