"""Things, actions and places of hands of another package: the code of the page, asked for by name, and in nobody's defaults."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import ConfigError, ExtensionError
from cabinpose.scene.labels import LABEL_ID
from cabinpose.scene.things import THINGS
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import generate
from cabinpose.synth.posture import ACTIONS
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
CODE = "\n\n".join(
    block
    for section in ("## A thing", "## An action")
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8").split(section)[1].split("\n## ")[0], re.DOTALL)
)
OFFERS = {"things": {"umbrella": "UMBRELLA"}, "actions": {"open_umbrella": "OPEN_UMBRELLA"}}
BASE = {"cars": ["suv"], "occupancy": {"driver": 1.0, "rear_left": 1.0}}


def things_of(scene: dict[str, object], frames: int, seed: int = 3) -> list[list[tuple[str, str, str]]]:
    """Slot, kind and where of the things of each frame."""
    sampler = SceneSampler(SynthConfig.parse({"scene": BASE | {"clutter": 0} | scene}), seed)
    scenes = [sampler.sample(n, rng=frame_rng(seed, n)) for n in range(frames)]
    return [[(thing.slot, thing.thing.kind, thing.at) for thing in scene.things] for scene in scenes]


def test_the_page_s_thing_and_action(extension: Callable[..., None], tmp_path: Path) -> None:
    extension("acme", OFFERS, CODE)
    config = SynthConfig.parse(
        {
            "scene": BASE
            | {
                "objects": {"rear_right": "umbrella"},
                "motion": {"driver": {"rest_lap": 1.0}, "rear_left": {"open_umbrella": 1.0}},
            }
        }
    )
    generate(config, 2, tmp_path / "made", seed=3)  # a thing on the seat behind is hidden in half of the frames
    made = open_dataset(tmp_path / "made")
    slots = made.person.values.tolist()
    rear = slots.index("rear_left")
    assert made.action.values[:, rear].tolist() == ["open_umbrella"] * 2
    assert made.things.values[:, rear].tolist() == ["umbrella"] * 2
    assert made.things.values[:, slots.index("rear_right")].tolist() == ["umbrella"] * 2
    assert LABEL_ID["bag"] in np.unique(made.labels.values)


def test_hands_hold_what_is_named(extension: Callable[..., None]) -> None:
    extension("acme", OFFERS, CODE)
    drinking = {"motion": {"driver": {"drink": 1.0}, "rear_left": {"read": 1.0}}}
    for frame in things_of({**drinking, "held": ["umbrella"]}, 2):
        assert frame == [("driver", "umbrella", "hand"), ("rear_left", "open_book", "hand")]
    ours = [kind for frame in things_of(drinking, 6) for _, kind, _ in frame]
    assert set(ours) <= {"bottle", "cup", "open_book"}
    with pytest.raises(ConfigError, match="hands do not hold a box") as caught:
        SynthConfig.parse({"scene": {"held": ["box"]}})
    assert "phone" in str(caught.value.hint)


@pytest.mark.slow
def test_a_sequence_with_an_action_of_another_package(extension: Callable[..., None]) -> None:
    extension("acme", OFFERS, CODE)
    sequence = {"frames": 12, "rate_hz": 4, "activities": ["open_umbrella"]}
    scene = {"cars": ["suv"], "occupancy": {"rear_left": 1.0}, "in_hand": 1.0, "sequence": sequence}
    sampler = SceneSampler(SynthConfig.parse({"scene": scene}), 2)
    shown = [sampler.sample(n, rng=frame_rng(2, n)) for n in range(12)]
    assert {thing.thing.kind for scene in shown for thing in scene.things} == {"umbrella"}
    assert "open_umbrella" in {person.action for scene in shown for person in scene.people}


def test_a_sequence_with_what_hands_hold_by_name(extension: Callable[..., None]) -> None:
    extension("acme", OFFERS, CODE)
    sequence = {"frames": 6, "rate_hz": 4, "activities": ["drink"]}
    scene = {"cars": ["suv"], "occupancy": {"rear_left": 1.0}, "in_hand": 1.0, "held": ["umbrella"], "sequence": sequence}
    shown = SceneSampler(SynthConfig.parse({"scene": scene}), 2).sample(3, rng=frame_rng(2, 3))
    assert [thing.thing.kind for thing in shown.things] == ["umbrella"]


def test_defaults_are_ours_alone(extension: Callable[..., None]) -> None:
    scene = {"in_hand": 1.0, "objects": {"rear_right": "any"}}
    before = things_of(scene, 4)
    extension("acme", OFFERS, CODE)
    assert "umbrella" in THINGS.names()
    assert "open_umbrella" in ACTIONS.names()
    assert things_of(scene, 4) == before


def test_what_is_wrong_is_said_where_it_is_asked_for(extension: Callable[..., None]) -> None:
    code = 'from cabinpose.scene.things import Kind\n\nTENT = Kind("tent", None)\nSTAND = 1\n'
    extension("bad", {"things": {"tent": "TENT"}, "actions": {"stand": "STAND"}}, code)
    assert things_of({"objects": {"rear_right": "box"}}, 1)
    with pytest.raises(ExtensionError, match=r"the thing 'tent' of bad cannot be loaded: .* no class of things is called 'tent'"):
        SynthConfig.parse({"scene": {"objects": {"rear_right": "tent"}}})
    with pytest.raises(ExtensionError, match="the action 'stand' of bad cannot be loaded"):
        SynthConfig.parse({"scene": {"motion": {"driver": {"stand": 1.0}}}})
    for key, value in (("objects", {"rear_right": "open_book"}), ("child_seats", {"rear_right": "toddler_in_use"})):
        with pytest.raises(ConfigError, match=r"unknown (object|child seat)"):
            SynthConfig.parse({"scene": {key: value}})
