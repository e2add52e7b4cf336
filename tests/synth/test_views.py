"""`config views`: what the places of a car see is what generated frames show."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cabinpose.app.cli import main
from cabinpose.core import JOINTS, Visibility
from cabinpose.scene.cabin import SEATS_OF_ALL, build_cabin
from cabinpose.scene.sensor import sensor_by_name
from cabinpose.synth import FrameMaker, SynthConfig, views_seen

pytestmark = pytest.mark.slow  # scenes are drawn
SEED = 5


def test_shares_are_those_of_the_frame_that_synth_makes() -> None:
    """By the whole way of a frame: its own camera, its own size, the variable `visibility`."""
    occupancy = dict.fromkeys(("rear_center", *SEATS_OF_ALL), 0.5) | {"driver": 1.0}
    scene = {"kind": "cabin", "cars": ["hatchback"], "right_hand_drive": 0.0, "occupancy": occupancy}
    config = SynthConfig.parse({"scene": scene, "camera": {"jitter_m": 0.0, "jitter_deg": 0.0}})
    frame, made = FrameMaker(config, SEED).make(0)
    reports = {r.place.view: r for r in views_seen("hatchback", sensor_by_name("pico_monstar_105/5"), frames=1, seed=SEED)}
    report = reports[made.pov]
    distance = np.linalg.norm(frame["joints_3d"], axis=-1)
    seen = (frame["visibility"] == Visibility.VISIBLE) & (distance >= 0.3) & (distance <= 2.0)
    there = (frame["visibility"] != Visibility.ABSENT).any(axis=1)
    assert report.people == there.sum() == len(made.people)
    assert report.heads == pytest.approx(seen[there][:, JOINTS.index("head")].mean())
    assert report.hands == pytest.approx(seen[there][:, [JOINTS.index("lhand"), JOINTS.index("rhand")]].mean())
    assert {slot for slot, share in report.seats.items() if not np.isnan(share)} == {person.slot for person in made.people}


def test_the_command_prints_every_place_of_the_car_and_the_same_again(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "views", "suv", "--frames", "2", "--json"]) == 0
    out = capsys.readouterr().out
    told = json.loads(out)
    views = build_cabin("suv").views
    assert {view["view"]: view["position_m"] for view in told["views"]} == {n: v.eye.tolist() for n, v in views.items()}
    assert main(["config", "views", "suv", "--frames", "2", "--json"]) == 0
    assert capsys.readouterr().out == out
    assert main(["config", "views", "suv", "--frames", "2"]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.split()[:6] == ["view", "position_m", "look_at_m", "pixels", "heads", "hands"]
    assert [row.split()[0] for row in rows] == list(views)


@pytest.mark.parametrize(("words", "told"), [(["suvv"], "did you mean suv"), (["suv", "--frames", "0"], "--frames")])
def test_mistakes_are_told(words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "views", *words]) == 2
    err = capsys.readouterr().err
    assert told in err
    assert err.count("hint: ") == 1
