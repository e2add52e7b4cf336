"""Presets with dimensions changed: what they say of a car, what is refused, and that datasets show and remember them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from synth_scenes import PART, fingerprint, small_config, start

from cabinpose.core.errors import CabinposeError, ConfigError
from cabinpose.scene.cabin import PRESET_DIMENSIONS, PRESETS, Cabin, build_cabin
from cabinpose.store import open_dataset
from cabinpose.synth.cabins import car_names
from cabinpose.synth.cars import ChangedPreset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.exact import exact_config, without_defaults
from cabinpose.synth.frame_maker import FrameMaker
from cabinpose.synth.generate import generate
from cabinpose.synth.preflight import preflight
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng

WIDE: dict[str, Any] = {"preset": "suv", "name": "wide", "w3_mm": 1700, "w3_2_mm": 1690, "w20_mm": 450, "h61_mm": 985}
CARS: dict[str, Any] = {"cars": ["hatchback", WIDE]}


def built(**changes: Any) -> Cabin:
    return build_cabin(ChangedPreset.model_validate({"preset": "suv", "name": "mine"} | changes).dimensions)


def part(cabin: Cabin, name: str) -> np.ndarray:
    """(V, 3) m of a part that does not move."""
    return next(p for p in cabin.parts if p.name == name).surface.vertices.astype(np.float64)


@pytest.mark.parametrize("preset", PRESETS)
def test_nothing_changed_is_the_preset(preset: str) -> None:
    car = build_cabin(ChangedPreset(preset=preset, name="mine").dimensions)
    one, other = car.surface(), build_cabin(preset).surface()
    for name in ("vertices", "normals", "faces", "label", "material"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_a_changed_preset_keeps_its_trim_in_every_image() -> None:
    frames = []
    for car in ("suv", {"preset": "suv", "name": "mine"}):
        frame, scene = FrameMaker(small_config(cars=[car], right_hand_drive=0.0), 1).make(0)
        frames.append((frame["amplitude"], scene.trim))
    np.testing.assert_array_equal(frames[0][0], frames[1][0])
    assert frames[0][1] == frames[1][1] == "suv"


def test_changes_are_where_they_are_measured() -> None:
    """By the definitions of SAE J1100: H61 is measured 8 degrees rearward of the vertical."""
    suv = PRESET_DIMENSIONS["suv"]
    assert built(w20_mm=450).seats["driver"].design_h_point[1] == pytest.approx(0.450)
    couple = np.subtract(*(built(l50_mm=1000).seats[slot].design_h_point for slot in ("driver", "rear_left")))
    assert couple[0] == pytest.approx(1.0)
    wheel = built(w9_mm=420).steering_wheel
    assert wheel is not None
    assert 2 * (wheel.rim_radius_m + wheel.rim_section_m) == pytest.approx(0.420)
    higher = part(built(h61_mm=suv.h61_mm + 150, h61_2_mm=suv.h61_2_mm + 150), "headlining")[:, 2].max()
    assert higher - part(built(), "headlining")[:, 2].max() == pytest.approx(0.150 * np.cos(np.deg2rad(8)), abs=2e-3)
    doors = [np.abs(part(car, "front door trim")[:, 1]).max() for car in (built(w3_mm=1700), built())]
    assert doors[0] - doors[1] == pytest.approx((1700 - suv.w3_mm) / 2000, abs=2e-3)


def test_written_out_it_is_the_same_car() -> None:
    """One of the values is the default of another car: left out, it would be the preset's."""
    config = SynthConfig.parse({"scene": CARS})
    told = config.model_dump(mode="json")["scene"]["cars"]
    assert told == ["hatchback", WIDE]
    for data in (config.model_dump(mode="json"), without_defaults(config)):
        assert SynthConfig.parse(yaml.safe_load(yaml.safe_dump(json.loads(json.dumps(data))))) == config
    assert car_names(config) == ("hatchback", "wide")
    same = SynthConfig.parse({"scene": {"cars": ["hatchback", WIDE | {"l50_mm": PRESET_DIMENSIONS["suv"].l50_mm}]}})
    assert same == config
    assert same.model_dump(mode="json") == config.model_dump(mode="json")


def test_schema_has_every_dimension_with_its_range() -> None:
    properties = SynthConfig.model_json_schema()["$defs"]["ChangedPreset"]["properties"]
    assert set(properties) == set(type(PRESET_DIMENSIONS["suv"]).model_fields) - {"layout"} | {"preset"}
    lengths = [name for name in properties if name.endswith(("_mm", "_deg"))]
    assert len(lengths) == 30
    assert all(properties[name]["minimum"] < properties[name]["maximum"] for name in lengths)
    assert not any("default" in each for each in properties.values())


@pytest.mark.parametrize(
    ("car", "words"),
    [
        ({"preset": "tank", "name": "mine"}, "unknown cabin preset 'tank'"),
        ({"name": "mine"}, "preset: this key is required"),
        ({"preset": "suv"}, "name: this key is required"),
        ({"preset": "suv", "name": "van"}, "'van' is the name of another car"),
        ({"preset": "suv", "name": "C0001"}, "'C0001' is the name of another car"),
        ({"preset": "suv", "name": "a.yaml"}, "'a.yaml' is the name of another car"),
        ({"preset": "suv", "name": "hatch", "w3_mm": 900}, "w3_mm: must be greater than or equal to 1200, not 900"),
        ({"preset": "suv", "name": "hatch", "w3mm": 1500}, "w3mm: unknown key"),
        ({"preset": "suv", "name": "hatch", "w20_mm": 480, "w3_mm": 1300}, "car 'hatch': .* shoulder room W3 of 1300"),
        ({"preset": "suv", "name": "hatch", "w20_2_mm": 540}, "car 'hatch': .* shoulder room W3-2 of 1480"),
        ({"preset": "suv", "name": "hatch", "dash_style": "none"}, "dashboard"),
        ({"preset": "suv", "name": "hatch", "layout": "facing"}, "layout of a preset stays"),
        (WIDE | {"w9_mm": 400}, "two cars are called 'wide'"),
        (7, "must be a text, not 7"),
    ],
)
def test_refusals_say_what_is_wrong(car: Any, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        SynthConfig.parse({"scene": {"cars": [WIDE, car]}})
    assert caught.value.hint
    assert len(str(caught.value)) < 200


def test_camera_inside_a_changed_part_is_refused() -> None:
    """The preset's view is free; with an upright windscreen the glass stands before it."""
    config = SynthConfig.parse({"scene": {"cars": [{"preset": "sedan", "name": "upright", "a121_1_deg": 5}]}})
    with pytest.raises(ConfigError, match="upright: the camera of view 'driver'"):
        preflight(config, frames=1)
    preflight(SynthConfig.parse({"scene": CARS}), frames=1)


def test_a_dimension_makes_another_car_for_the_same_people() -> None:
    """A sampler that takes over what another one has built does not take over a car of the same name."""
    first = SceneSampler(small_config(cars=[WIDE]), 7)
    one = first.sample(0, rng=frame_rng(7, 0))
    for car in (WIDE | {"h61_mm": 1100}, WIDE):
        scene = SceneSampler(small_config(cars=[car]), 7, like=first).sample(0, rng=frame_rng(7, 0))
        assert scene.place == "wide"
        assert (
            scene.backdrop.vertices.shape == one.backdrop.vertices.shape
            and (scene.backdrop.vertices == one.backdrop.vertices).all()
        ) == (car is WIDE)


@pytest.mark.slow
def test_dataset_is_the_same_with_two_workers_and_resumed(tmp_path: Path) -> None:
    frames = 2 * PART
    generate(small_config(**CARS), frames, tmp_path / "one", seed=7, workers=1)
    process = start(tmp_path / "run.py", tmp_path / "two", workers=2, frames=frames, **CARS)
    assert process.wait(timeout=600) == 0
    assert fingerprint(tmp_path / "two") == fingerprint(tmp_path / "one")
    assert set(open_dataset(tmp_path / "one")["car"].values.tolist()) == {"hatchback", "wide"}
    generate(small_config(**CARS), PART, tmp_path / "parts", seed=7)
    other = small_config(cars=["hatchback", WIDE | {"w9_mm": 400}])
    with pytest.raises(CabinposeError, match="config"):
        generate(other, frames, tmp_path / "parts", seed=7, existing="resume")
    generate(small_config(**CARS), frames, tmp_path / "parts", seed=7, existing="resume")
    assert fingerprint(tmp_path / "parts") == fingerprint(tmp_path / "one")


def test_frame_is_kept_with_its_car() -> None:
    config, seed = small_config(cars=[WIDE]), 7
    kept = SynthConfig.parse(without_defaults(exact_config(config, seed, 0)))
    assert kept.scene.kind == "cabin"
    assert kept.scene.cars == config.scene.cars  # type: ignore[union-attr]
    drawn, again = (SceneSampler(c, seed).sample(0, rng=frame_rng(seed, 0)) for c in (config, kept))
    np.testing.assert_array_equal(again.backdrop.vertices, drawn.backdrop.vertices)
    np.testing.assert_array_equal(again.people[0].posed.skin, drawn.people[0].posed.skin)


def test_headrest_on_the_middle_place_is_a_dimension() -> None:
    """Of the presets with three places the hatchback alone has none."""
    having = {name for name in PRESETS if any(p.name == "rear_center headrest" for p in build_cabin(name).parts)}
    assert having == {"sedan", "suv", "van", "shuttle"}  # the others have two places
    assert not any(p.name == "rear_center headrest" for p in built(centre_headrest=False).parts)
    hatchback = ChangedPreset(preset="hatchback", name="mine", centre_headrest=True).dimensions
    assert any(p.name == "rear_center headrest" for p in build_cabin(hatchback).parts)
