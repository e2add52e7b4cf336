"""Sensors and effects of noise that installed packages offer, used by name like our own."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.app.studio import scene_form
from cabinpose.core import ConfigError, ExtensionError
from cabinpose.scene.sensor import NOISE_EFFECTS, OWN_SENSORS, SENSORS, PhysicalNoise, StructuredLightNoise, simulate
from cabinpose.store.schema import read_manifest
from cabinpose.synth.config import SynthConfig
from tests.sensor.sensor_scenes import generator, wall

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
ACME = "\n\n".join(
    block
    for section in ("## A sensor", "## A noise effect")
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8").split(section)[1].split("\n## ")[0], re.DOTALL)
)


@pytest.fixture
def acme(extension: Callable[..., None]) -> None:
    extension("acme", {"sensors": {"acme_tof": "ACME_TOF"}, "noise_effects": {"warmth": "Warmth"}}, ACME)


def depth(noise: Any) -> Any:
    return simulate(wall(SENSORS["acme_tof"], 1.0), SENSORS["acme_tof"], noise, rng=generator(1, 1)).depth_m


def test_the_registry_holds_our_table_under_its_names() -> None:
    assert SENSORS.names(own=True) == tuple(OWN_SENSORS)
    assert all(SENSORS[name] is sensor for name, sensor in OWN_SENSORS.items())


@pytest.mark.usefixtures("acme")
def test_effects_act_after_the_noise_in_their_order() -> None:
    assert "acme_tof" in SENSORS.names()
    warm = {"kind": "warmth", "kelvin": 20.0}
    plain = depth(PhysicalNoise())
    warmed = depth(PhysicalNoise.model_validate({"effects": [warm]}))
    np.testing.assert_allclose(warmed, plain + np.float32(0.02), atol=1e-6)
    both = depth(PhysicalNoise.model_validate({"effects": [warm, {"kind": "warmth", "m_per_k": 0.0, "lost": 0.5}]}))
    lost = np.isnan(both).all(axis=1)
    assert 0.2 < lost.mean() < 0.8
    np.testing.assert_array_equal(both[~lost], warmed[~lost])


@pytest.mark.usefixtures("acme")
def test_effects_act_on_every_noise_model() -> None:
    kinect, warm = SENSORS["kinect_v1"], {"effects": [{"kind": "warmth"}]}
    plain, warmed = (
        simulate(wall(kinect, 1.0), kinect, StructuredLightNoise.model_validate(noise), rng=generator(1, 1)).depth_m
        for noise in ({}, warm)
    )
    np.testing.assert_allclose(warmed, plain + np.float32(0.01), atol=1e-6)


@pytest.mark.usefixtures("acme")
def test_a_dataset_says_both_and_can_be_made_again_of_what_it_says(run: Callable[..., Any], tmp_path: Path) -> None:
    chosen = ["scene={kind: room, rooms: 1}", "camera.sensor=acme_tof", "camera.views={room: 1.0}"]
    warm = "noise={kind: physical, effects: [{kind: warmth, m_per_k: 2.0e-3}]}"
    done = run("synth", "--frames", 1, "--seed", 3, "--out", tmp_path / "data", *chosen, warm)
    assert done.code == 0, done.err
    said = SynthConfig.parse(read_manifest(tmp_path / "data").config)
    assert said.camera.sensor_model.frequency_ratio == (4, 3)
    assert [effect.model_dump() for effect in said.noise.effects] == [
        {"kind": "warmth", "kelvin": 10.0, "m_per_k": 2e-3, "lost": 0.0}
    ]


def test_nothing_is_said_of_effects_where_there_are_none() -> None:
    assert "effects" not in SynthConfig().model_dump(mode="json")["noise"]
    assert SynthConfig.model_json_schema()["$defs"]["PhysicalNoise"]["properties"]["effects"]["items"] == {"not": {}}


@pytest.mark.usefixtures("acme")
def test_the_schema_and_the_studio_offer_what_is_installed() -> None:
    scene_form.schema.cache_clear()
    try:
        fields = {field.name: field for field in scene_form.form({"noise": {"effects": [{"kind": "warmth"}]}}).walk()}
        assert fields["kelvin"].value == 10.0
        assert "acme_tof" in fields["sensor"].choices
    finally:
        scene_form.schema.cache_clear()


def test_what_is_unknown_or_wrong_is_named(extension: Callable[..., None]) -> None:
    extension("acme", {"noise_effects": {"warmth": "Warmth"}}, ACME)
    extension("no_effect", {"noise_effects": {"frost": "Frost"}, "sensors": {"frost_tof": "Frost"}}, "class Frost: ...")
    with pytest.raises(ConfigError, match="unknown noise effect 'warmt'") as unknown:
        SynthConfig.parse({"noise": {"effects": [{"kind": "warmt"}]}})
    assert "warmth" in str(unknown.value.hint)
    with pytest.raises(ConfigError, match=r"noise.*effects.*kelvin"):
        SynthConfig.parse({"noise": {"effects": [{"kind": "warmth", "kelvin": -1.0}]}})
    for offered, name in ((NOISE_EFFECTS, "frost"), (SENSORS, "frost_tof")):
        with pytest.raises(ExtensionError, match=f"'{name}' of no_effect is not a"):
            offered[name]
