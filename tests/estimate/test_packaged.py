"""The models that come with the package: whole, small, described, and able to find people."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from cabinpose.app.cli import main
from cabinpose.core.skeleton import ITOP_JOINTS, JOINTS
from cabinpose.estimate.predictor import describe_model, load_model, packaged_models
from cabinpose.evaluate.offline import evaluate
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import generate

RECIPES = Path(__file__).resolve().parents[2] / "docs" / "models"


def test_the_models_are_there_and_small() -> None:
    assert sorted(packaged_models()) == ["in_car", "room"]
    assert sum(path.stat().st_size for path in packaged_models().values()) < 12_000_000
    in_car, room = load_model("in_car"), load_model("room")
    assert (in_car.persons, in_car.joints) == (("driver", "front_passenger"), JOINTS)
    assert (room.persons, room.joints) == (("standing",), ITOP_JOINTS)


@pytest.mark.parametrize("name", ["in_car", "room"])
def test_each_model_carries_the_card_of_the_documentation(name: str) -> None:
    card = describe_model(packaged_models()[name])["card"]
    assert card == yaml.safe_load((RECIPES / f"{name}-card.yaml").read_text("utf-8"))
    assert {"summary", "trained", "recipe", "data", "tested on", "command", "figures", "limits", "licence"} == set(card)


@pytest.mark.real_data
def test_the_room_model_finds_real_people_as_its_card_says(
    real_data: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--itop-npz", str(real_data("itop/itop_front_64.npz")), "--model", "room", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == 64
    assert result["within_10cm"] == pytest.approx(75.9, abs=0.5)
    assert result["mean_cm"] == pytest.approx(8.27, abs=0.05)
    assert result["pck_2d_26px"] == pytest.approx(98.9, abs=0.3)


@pytest.mark.slow
def test_the_in_car_model_finds_people_it_never_saw(tmp_path: Path) -> None:
    """A dozen frames of the card's test recipe from another seed: not far below its figures."""
    generate(SynthConfig.load(RECIPES / "in-car-test-scenes.yaml"), 12, tmp_path / "frames", seed=77, workers=1)
    options = EvaluationOptions(resamples=0)
    report = evaluate(open_dataset(tmp_path / "frames"), load_model("in_car"), options, persons=("driver", "front_passenger"))
    within, median = report.value("PCK", "3d", threshold=10.0), report.value("median error", "3d")
    assert within is not None
    assert median is not None
    assert within.samples > 100
    assert within.value > 70
    assert median.value < 5
    assert np.isfinite(median.value)
