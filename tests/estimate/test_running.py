"""`cabinpose predict` and `cabinpose models`: running a model, and what is known of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import small
import sphere_people

from cabinpose.app.cli import main
from cabinpose.estimate.predictor import describe_model, load_model, packaged_models
from cabinpose.evaluate.offline import BATCH, frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.predictions import read_predictions

FRAMES = BATCH + 2  # more than one batch


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    manifest = sphere_people.manifest(
        frames=FRAMES, frames_per_part=6, width=small.SIZE[0], height=small.SIZE[1], persons=small.PERSONS
    )
    return sphere_people.write(tmp_path_factory.mktemp("data") / "spheres", manifest)


def test_predictions_are_the_models_answers(
    data: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.jsonl"
    arguments = ["predict", str(data), "--model", str(trained["compact"]), "--out", str(out)]
    assert main(arguments) == 0
    assert capsys.readouterr().out.strip() == str(out)
    read = read_predictions(out)
    model, dataset = load_model(trained["compact"]), open_dataset(data)
    assert (read.model, read.persons, read.joints) == (model.name, model.persons, model.joints)
    np.testing.assert_array_equal(read.frame, dataset["frame"].values)
    for frame in (0, FRAMES - 1):  # one by one: batches must neither mix frames nor lose the last ones
        alone = model.predict(frame_batch(dataset, slice(frame, frame + 1)))
        np.testing.assert_allclose(read.joints_3d[frame], alone.joints_3d[0], atol=1e-4)
        np.testing.assert_allclose(read.presence[frame], alone.presence[0], atol=1e-4)
    before = out.read_bytes()
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert out.read_bytes() == before
    # Evaluation accepts them as of this dataset.
    assert main(["evaluate", str(data), "--predictions", str(out), "--resamples", "0", "--json"]) == 0


def test_a_split_is_run_alone(data: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    car = str(open_dataset(data)["car"].values[0])
    splits, out = tmp_path / "splits.yaml", tmp_path / "found.jsonl"
    splits.write_text(f"one: {{car: [{car}]}}\n")
    arguments = ["predict", str(data), "--model", str(trained["compact"]), "--out", str(out), "--splits", str(splits)]
    assert main([*arguments, "--split", "one", "--json"]) == 0
    cars = open_dataset(data)["car"].values
    assert json.loads(capsys.readouterr().out)["frames"] == (cars == car).sum() < FRAMES
    np.testing.assert_array_equal(read_predictions(out).frame, np.flatnonzero(cars == car))


@pytest.mark.parametrize("method", ["compact", "paf", "lifting", "unet"])
def test_a_model_says_what_it_is(trained: dict[str, Path], method: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = trained[method]
    assert main(["models", str(path)]) == 0
    said = capsys.readouterr().out
    assert method in said
    assert "data: spheres" in said  # the card
    assert main(["models", str(path), "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert described == json.loads(json.dumps(describe_model(path)))
    assert described["bytes"] == path.stat().st_size
    assert described["card"] == {"data": "spheres"}


def test_packaged_models_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert sorted(listed) == sorted(packaged_models())


def test_what_is_no_model_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "no-such-model"]) == 2
    assert "hint:" in capsys.readouterr().err
