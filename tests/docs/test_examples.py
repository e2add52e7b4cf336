"""Every numbered example runs, in order, in one empty folder, and says something; the demo's configuration is valid."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cabinpose.estimate.train_config import read_train_config
from cabinpose.estimate.training import frame_spec
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.preflight import preflight
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
pytestmark = pytest.mark.slow
SCRIPTS = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))


def run(script: Path, folder: Path) -> str:
    done = subprocess.run([sys.executable, str(script)], cwd=folder, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that has the dataset of the first example, which others read."""
    made = tmp_path_factory.mktemp("examples")
    assert "10 frames made, 10 in my-dataset" in run(SCRIPTS[0], made)
    return made


def test_the_first_example_resumes(folder: Path) -> None:
    assert "0 frames made, 10 in my-dataset" in run(SCRIPTS[0], folder)


@pytest.mark.parametrize("script", SCRIPTS[1:], ids=lambda script: script.stem)
def test_example_runs(script: Path, folder: Path) -> None:
    assert run(script, folder).strip()


def test_index_has_every_example() -> None:
    index = (EXAMPLES / "index.md").read_text("utf-8")
    assert SCRIPTS
    assert [script.name for script in SCRIPTS if script.name not in index] == []


def test_the_demo_shows_every_car_from_both_views() -> None:
    config = SynthConfig.load(EXAMPLES / "demo.yaml")
    assert config.scene.kind == "cabin"
    assert len(config.scene.cars) == 7
    assert set(config.camera.views) == {"driver", "front_row"}


def test_the_demo_evaluates_on_people_it_never_saw() -> None:
    seen, unseen = (SynthConfig.load(EXAMPLES / name) for name in ("demo.yaml", "demo-unseen.yaml"))
    assert seen.people.subjects
    assert not unseen.people.subjects
    assert seen.people.random is None
    assert unseen.people.random is not None
    assert (unseen.scene, unseen.camera) == (seen.scene, seen.camera)


def test_the_demos_training_is_a_configuration() -> None:
    config = read_train_config(EXAMPLES / "demo-train.yaml", None)
    assert config.method == "compact"
    assert set(frame_spec(config).slots) == {"driver", "front_passenger"}


@pytest.mark.parametrize(("name", "frames"), [("s25k.yaml", 25_200), ("s63k.yaml", 63_000)])
def test_the_thesis_datasets_have_its_sizes(name: str, frames: int) -> None:
    config = SynthConfig.load(EXAMPLES / name)
    assert config.frames == frames
    preflight(config, frames=frames)


def test_who_sits_where() -> None:
    config = SynthConfig.load(EXAMPLES / "who_sits_where.yaml")
    scene = SceneSampler(config, 0).sample(0, rng=frame_rng(0, 0))
    assert [(person.slot, person.subject) for person in scene.people] == [("driver", "anna"), ("front_passenger", "bob")]
    assert scene.people[1].action == "sleep"
