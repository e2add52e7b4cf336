"""Random cars of a dataset: which there are, that frames show them, and what is refused before any work."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from synth_scenes import PART, fingerprint, small_config, start

from cabinpose.core.errors import ConfigError
from cabinpose.scene.cabin import build_cabin
from cabinpose.store import open_dataset
from cabinpose.synth.cabins import car_dimensions, car_names
from cabinpose.synth.camera import Camera
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import generate
from cabinpose.synth.preflight import preflight
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng

ONLY_RANDOM: dict[str, Any] = {"cars": [], "random_cars": 2}
DRIVER = {"driver": 1.0}


def test_names_follow_those_of_the_configuration() -> None:
    assert car_names(small_config(**ONLY_RANDOM)) == ("C0000", "C0001")
    assert car_names(small_config(random_cars=2)) == ("hatchback", "C0000", "C0001")
    assert car_names(small_config()) == ("hatchback",)


def test_a_car_is_the_same_whatever_is_drawn_beside_it() -> None:
    assert car_dimensions(3, "C0007") == car_dimensions(3, "C0007")
    others = [car_dimensions(3, "C0008"), car_dimensions(4, "C0007")]
    assert all(other.h30_mm != car_dimensions(3, "C0007").h30_mm for other in others)
    assert car_dimensions(3, "C0007").name == "C0007"


@pytest.mark.slow
def test_frames_show_the_random_cars_whatever_the_number_of_workers(tmp_path: Path) -> None:
    generate(small_config(**ONLY_RANDOM), 2 * PART, tmp_path / "one", seed=7, workers=1)
    process = start(tmp_path / "run.py", tmp_path / "two", workers=2, frames=2 * PART, **ONLY_RANDOM)
    assert process.wait(timeout=600) == 0
    assert fingerprint(tmp_path / "two") == fingerprint(tmp_path / "one")
    assert set(open_dataset(tmp_path / "one")["car"].values.tolist()) == {"C0000", "C0001"}


def test_a_scene_is_in_the_car_that_it_names() -> None:
    """Named and random cars both appear; the steering wheel is where the dimensions of the car say."""
    sampler, seen = SceneSampler(small_config(random_cars=2), 7), set()
    for index in (0, 1, 2, 3, 100):
        scene = sampler.sample(index, rng=frame_rng(7, index))
        assert scene.cabin is not None
        assert scene.cabin.steering_wheel is not None
        wheel = scene.cabin.steering_wheel.vehicle_from_wheel[:3, 3]
        if scene.place == "hatchback":
            hatchback = build_cabin("hatchback").steering_wheel
            assert hatchback is not None
            expected = hatchback.vehicle_from_wheel[:3, 3].tolist()
        else:
            d = car_dimensions(7, scene.place)
            expected = [-d.l11_mm / 1000, d.w20_mm / 1000, d.h17_mm / 1000]
        assert wheel.tolist() == pytest.approx(expected)
        seen.add(scene.place)
    assert seen == {"hatchback", "C0000", "C0001"}


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ({"cars": [], "random_cars": 0}, "there is no car"),
        ({"cars": [], "random_cars": -1}, "random_cars"),
        ({"cars": ["cars/C0001.yaml"], "random_cars": 1}, "C0001.yaml would be taken for a random car"),
    ],
)
def test_cars_that_cannot_be_are_refused(scene: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        SynthConfig.parse({"scene": {"kind": "cabin"} | scene})
    assert caught.value.hint


def test_an_own_car_may_have_such_a_name_where_no_car_is_random() -> None:
    assert car_names(small_config(cars=["C0001.yaml"])) == ("C0001.yaml",)


STANDS_FOR_ALL = car_dimensions(0, "C0000")
DOOR_TRIM = (-STANDS_FOR_ALL.l53_mm / 1000, STANDS_FOR_ALL.w3_mm / 2000 + 0.03, STANDS_FOR_ALL.h30_mm / 1000 + 0.2)
INSIDE_A_DOOR = {"mine": {"position_m": DOOR_TRIM, "look_at_m": (0.0, 0.0, 1.0)}}


@pytest.mark.parametrize(
    ("scene", "views", "words"),
    [
        ({"occupancy": {"rear_center": 1.0}}, {}, "a random car: no seat of it is ever taken"),  # some have two places
        ({"occupancy": DRIVER, "motion": {"front_passenger": {"drive": 1.0}}}, {}, "a random car: drive makes no sense"),
        ({"occupancy": DRIVER, "motion": {"rear_center": {"drive": 1.0}}}, {}, "a random car: drive makes no sense"),
        ({"occupancy": DRIVER}, {"bonnet": 1.0}, "bonnet"),
        ({"occupancy": DRIVER}, INSIDE_A_DOOR, "a random car: the camera of view 'mine'"),
    ],
)
def test_what_no_random_car_allows_is_refused(scene: dict[str, Any], views: dict[str, Any], words: str) -> None:
    camera = {"camera": {"views": views}} if views else {}
    config = SynthConfig.parse({"scene": {"kind": "cabin", "cars": [], "random_cars": 40} | scene} | camera)
    with pytest.raises(ConfigError, match=words) as caught:
        preflight(config, frames=1)
    assert caught.value.hint


@pytest.mark.parametrize(
    ("scene", "views", "cars"),
    [
        ({}, {"driver": 0.5, "rear": 0.5, "bonnet": 0.0}, 0),  # what every car has
        ({"motion": {"driver": {"drive": 1.0}}}, {"driver": 1.0}, 2),
        ({}, {"mine": {"position_m": (-0.35, 0.0, 0.92), "look_at_m": (-1.0, 0.0, 0.6)}}, 2),
        ({"occupancy": {"driver": 0.0, "rear_center": 1.0}, "cars": ["hatchback"], "random_cars": 0}, {"driver": 1.0}, 1),
    ],
)
def test_cars_are_built_beforehand_where_they_differ(
    monkeypatch: pytest.MonkeyPatch, scene: dict[str, Any], views: dict[str, Any], cars: int
) -> None:
    """One random car stands for all."""
    built = []

    def counting(*arguments: Any, **options: Any) -> Any:
        built.append(arguments)
        return build_cabin(*arguments, **options)

    monkeypatch.setattr(import_module("cabinpose.synth.cabins"), "build_cabin", counting)
    config = small_config(**({"cars": ["hatchback"], "random_cars": 40, "occupancy": DRIVER} | scene))
    camera = config.camera.model_copy(update={"views": Camera(views=views).views})
    preflight(config.model_copy(update={"camera": camera}), frames=1)
    assert len(built) == cars
