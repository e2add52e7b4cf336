"""`config views`: what the places of a car see is what generated frames show."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
import yaml

from cabinpose.app.cli import main
from cabinpose.core import JOINTS, Visibility
from cabinpose.scene.cabin import SEATS_OF_ALL, build_cabin
from cabinpose.scene.sensor import sensor_by_name
from cabinpose.synth import FrameMaker, SynthConfig, views_seen

pytestmark = pytest.mark.slow  # scenes are drawn
SEED = 5
EXAMPLE = Path(__file__).resolve().parents[2] / "docs/examples/03_own_car_mesh.py"


def test_shares_are_those_of_the_frame_that_synth_makes() -> None:
    """By the whole way of a frame: its own camera, its own size, the variable `visibility`."""
    occupancy = dict.fromkeys(("rear_center", *SEATS_OF_ALL), 0.5) | {"driver": 1.0}
    scene = {"kind": "cabin", "cars": ["hatchback"], "right_hand_drive": 0.0, "occupancy": occupancy}
    views = dict.fromkeys(build_cabin("hatchback").views, 1.0)
    config = SynthConfig.parse({"scene": scene, "camera": {"views": views, "jitter_m": 0.0, "jitter_deg": 0.0}})
    frame, made = FrameMaker(config, SEED).make(0)
    reports = {r.place.view: r for r in views_seen("hatchback", sensor_by_name("pico_monstar_105/5"), frames=1, seed=SEED)}
    report = reports[made.pov]
    depth = frame["joints_3d"][..., 2]
    seen = (frame["visibility"] == Visibility.VISIBLE) & (depth >= 0.3) & (depth <= 2.0)
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


@pytest.mark.slow  # 20 scenes
def test_the_page_shows_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "views", "sedan"]) == 0
    page = (EXAMPLE.parents[1] / "guides/own-camera.md").read_text("utf-8")
    assert f"$ cabinpose config views sedan\n{capsys.readouterr().out}```" in page


def test_a_car_with_one_view_is_looked_at_from_there(tmp_path: Path) -> None:
    """An own mesh with one seat, as the example of the documentation writes it, for which a view is chosen."""
    example = runpy.run_path(str(EXAMPLE))
    cabin, mesh, file = build_cabin("hatchback"), tmp_path / "car.glb", tmp_path / "car.yaml"
    example["write_mesh"](cabin, mesh)
    file.write_text(yaml.safe_dump(example["describe"](cabin, mesh)))
    (report,) = views_seen(str(file), sensor_by_name("pico_monstar_105/5"), frames=1)
    assert (report.place.view, list(report.seats), report.people) == ("driver", ["driver"], 1)


@pytest.mark.parametrize(("words", "told"), [(["suvv"], "did you mean suv"), (["suv", "--frames", "0"], "--frames")])
def test_mistakes_are_told(words: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "views", *words]) == 2
    err = capsys.readouterr().err
    assert told in err
    assert err.count("hint: ") == 1
