"""Datasets with child seats and objects: what they say of them, and that others do not change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from cabinpose.core.errors import ConfigError, SceneError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.scene.labels import LABEL_ID, THING_LABELS
from cabinpose.store import open_dataset
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.exact import exact_scene
from cabinpose.synth.generate import generate
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng, noise_rng
from cabinpose.synth.variables import build_manifest

SCENE = {
    "cars": ["suv"], "occupancy": {"driver": 1.0}, "right_hand_drive": 0.0,
    "child_seats": {"rear_left": "infant", "rear_right": {"toddler": 0.5, "booster": 0.5}},
    "objects": {"rear_center": {"bottle": 1.0}},
}  # fmt: skip


def config(**scene: object) -> SynthConfig:
    camera = {"sensor": "pico_monstar_105/5", "views": {"rear": 1.0}}
    return SynthConfig.parse({"scene": SCENE | scene, "camera": camera, "people": {"subjects": ["S01", "S02"]}})


def test_frames_say_what_is_in_them(tmp_path: Path) -> None:
    generate(config(), 3, tmp_path / "seats", seed=2, workers=1)
    dataset = open_dataset(tmp_path / "seats")
    things = dataset.things.values
    left, center, right = (OCCUPANT_SLOTS.index(slot) for slot in ("rear_left", "rear_center", "rear_right"))
    assert (things[:, left] == "infant").all()
    assert (things[:, center] == "bottle").all()
    assert set(things[:, right]) <= {"toddler", "booster"}
    labels, instance = dataset.labels.values, dataset.instance.values
    for name in ("infant_seat", "child_seat", "bottle"):
        seen = labels == LABEL_ID[name]
        assert seen.any(axis=(1, 2)).all()
        assert (instance[seen] == 0).all()
    assert dict(zip(dataset.labels.flag_values, dataset.labels.flag_ticam, strict=True))[LABEL_ID["infant_seat"]] == 15


def test_any_object_is_hard() -> None:
    labels = {row.name for row in build_manifest(config(objects={"rear_center": "any", "driver": "any"}, clutter=0), 1, 0).labels}
    assert "bottle" in labels
    assert not {"blanket", "jacket"} & labels


def test_datasets_without_things_do_not_know_of_them() -> None:
    plain = build_manifest(config(child_seats={}, objects={}, clutter=0), 1, 0)
    assert not {label.id for label in THING_LABELS} & {row.id for row in plain.labels}
    assert not {"blanket", "jacket"} & {row.name for row in build_manifest(config(clutter=0), 1, 0).labels}
    assert {row.name for row in build_manifest(config(), 1, 0).labels} >= {"jacket", "phone"}  # a jacket may hang there
    assert not {"belt", "child"} & set(build_manifest(config(), 1, 0).variables)
    assert "things" not in plain.variables
    assert not {"child_seats", "objects", "things"} & set(plain.config["scene"])
    assert "ticam" not in plain.to_mapping()["labels"][0]


def test_a_kept_scene_has_its_things() -> None:
    drawn = config(objects={"rear_center": "any", "driver": {"box": 0.5}})
    maker = FrameMaker(drawn, 2)
    frame, scene = maker.make(1)
    told = exact_scene(drawn, scene)
    again = SynthConfig.parse(yaml.safe_load(yaml.safe_dump(told.model_dump(mode="json"))))
    kept, kept_scene = FrameMaker(again, 2).make(1)
    assert [t.thing for t in kept_scene.things] == [t.thing for t in scene.things]
    for name in ("depth_clean", "labels", "instance", "amplitude"):
        np.testing.assert_array_equal(kept[name], frame[name])
    assert kept["things"] == frame["things"]
    assert FrameMaker(again, 2).see(kept_scene, rng=noise_rng(2, 1))["things"] == frame["things"]


def test_an_empty_front_seat_makes_room_for_a_carrier() -> None:
    sampler = SceneSampler(config(cars=["city_car"], child_seats={"rear_right": "infant"}, objects={}, clutter=0), 0)
    scene = sampler.sample(0, rng=frame_rng(0, 0))
    (carrier,) = scene.things
    assert carrier.thing.kind == "infant"
    assert scene.settings["front_passenger"].fore_aft_m > 0.04


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"child_seats": {"rear_left": "cradle"}}, "unknown child seat 'cradle'"),
        ({"child_seats": {"driver": "booster"}}, "no child seat stands in the driver's seat"),
        ({"child_seats": {"boot": "booster"}}, "unknown seat 'boot'"),
        ({"child_seats": {"rear_left": {"infant": 0.7, "toddler": 0.7}}}, "the probabilities are 1.4 together"),
        ({"objects": {"rear_left": {"piano": 0.1}}}, "unknown object 'piano'"),
    ],
)
def test_what_cannot_be_is_refused(scene: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        config(**scene)
    assert caught.value.hint


@pytest.mark.slow
def test_a_seat_that_cannot_hold_a_child_seat_is_named_with_what_is_in_the_way() -> None:
    short = {"preset": "city_car", "name": "short", "l50_mm": 640}
    sampler = SceneSampler(
        config(cars=[short], occupants={"driver": {"subject": "S01"}}, child_seats={"rear_left": "infant"}, objects={}), 0
    )
    with pytest.raises(SceneError, match=r"rear_left: infant in driver backrest"):
        sampler.sample(0, rng=frame_rng(0, 0))
