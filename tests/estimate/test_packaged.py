"""The models that come with the package: whole, small, described, and able to find people."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from cabinpose.app.cli import main
from cabinpose.core.skeleton import ITOP, JOINTS
from cabinpose.estimate.predictor import describe_model, load_model, packaged_detectors, packaged_models
from cabinpose.evaluate.offline import evaluate
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import generate

RECIPES = Path(__file__).resolve().parents[2] / "docs" / "models"


def test_the_models_are_there_and_small() -> None:
    assert sorted(packaged_models()) == ["five_seats", "in_car", "lift", "paf", "parts", "room", "room_top"]
    assert sorted(packaged_detectors()) == ["five_seats", "in_car", "paf", "room", "room_top"]
    assert sum(path.stat().st_size for path in packaged_models().values()) < 26_000_000
    in_car, room = load_model("in_car"), load_model("room")
    assert (in_car.persons, in_car.joints) == (("driver", "front_passenger"), JOINTS)
    assert (room.persons, room.joints) == (("standing",), ITOP.joints)


@pytest.mark.parametrize("name", ["five_seats", "in_car", "lift", "paf", "parts", "room", "room_top"])
def test_each_model_carries_the_card_of_the_documentation(name: str) -> None:
    card = describe_model(packaged_models()[name])["card"]
    assert card == yaml.safe_load((RECIPES / f"{name}-card.yaml").read_text("utf-8"))
    assert {"summary", "trained", "recipe", "data", "tested on", "command", "figures", "limits", "licence"} == set(card)


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("model", "file", "view", "figures"),
    [
        ("room", "itop_front_64.npz", "side", (85.2, 65.8, 7.06, 98.8)),
        pytest.param("room_top", "itop_top_64.npz", "top", (66.8, 47.0, 9.45, 93.0), marks=pytest.mark.slow),
    ],
)
def test_the_room_models_find_real_people_as_their_cards_say(
    model: str, file: str, view: str, figures: tuple[float, ...],
    real_data: Callable[[str], Path], capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    frames = str(real_data(f"itop/{file}"))
    assert main(["evaluate", "--itop-npz", frames, "--model", model, "--itop-view", view, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == 64
    found = [result[name] for name in ("within_10cm", "within_10cm_anatomical", "mean_cm", "pck_2d_26px")]
    assert found == pytest.approx(figures, abs=0.3)


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
    assert within.value > 90
    assert median.value < 2.5
    assert np.isfinite(median.value)


_RUNS = """
import sys
import numpy as np
from cabinpose.estimate import METHODS, Lifter, PartSegmenter, open_model, packaged_models
assert len(METHODS.names(own=True)) == 7
assert not any(name.startswith("cabinpose.estimate.compact") for name in sys.modules), "listing imports nothing"
frames = {
    "depth": np.full((1, 48, 64), 1.5, np.float32), "amplitude": np.full((1, 48, 64), 60.0, np.float32),
    "camera_k": np.array([[40.0, 0, 31.5], [0, 40.0, 23.5], [0, 0, 1]]), "camera_dist": np.zeros(5),
}
for name in packaged_models():
    model = open_model(name, threads=1)
    if isinstance(model, Lifter):
        model.lift(np.zeros((1, len(model.joints), 2)))
    elif isinstance(model, PartSegmenter):
        model.segment(frames)
    else:
        model.predict(frames)
for name in METHODS.names(own=True):  # those of arrays, too
    METHODS[name]
print(*sys.modules)
"""


@pytest.mark.slow
def test_running_models_loads_nothing_that_trains() -> None:
    done = subprocess.run([sys.executable, "-c", _RUNS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not {name.split(".")[0] for name in done.stdout.split()} & {"torch", "lightning", "onnx"}
