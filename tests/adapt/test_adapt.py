"""`cabinpose adapt` on the frames of the package, and what it says of frames and words that it cannot take."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.app.adapt import tuning
from cabinpose.app.adapt.facts import facts_of
from cabinpose.app.adapt.scenes import in_their_light, their_scenes, with_fitted_noise
from cabinpose.app.api import SAMPLE
from cabinpose.app.cli.adapt import Adapt, _next_command
from cabinpose.core import ConfigError
from cabinpose.store import open_dataset, read_predictions
from cabinpose.synth import SynthConfig

Run = Callable[..., Any]


def test_the_first_call_tells_what_differs_and_what_is_next(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("adapt", "in_car", "sample", "--out", out)
    assert done.code == 0, done.err
    assert "mixed pixels to a px of silhouette" in done.out
    assert "of 15 frames may be learnt from" in done.out
    assert f"cabinpose adapt in_car {SAMPLE} --out {out} --train --resume" in done.err
    page, told = (out / "index.html").read_text(), json.loads((out / "report.json").read_text())
    assert "Pseudo-labels" in page
    assert "Better?" not in page
    rows = {row["what"]: row for row in told["differences"]}
    assert rows["depth: median (5 to 95 %), m"]["theirs"] == rows["depth: median (5 to 95 %), m"]["reference"]
    labels = read_predictions(out / "pseudo-labels.jsonl")
    assert np.isfinite(labels.joints_3d).all(axis=-1).sum() == told["pseudo_labels"]["joints"] > 0
    assert labels.presence[np.isfinite(labels.joints_3d).all(axis=-1)].min() >= 0.9
    again = run("adapt", "in_car", "sample", "--out", out)
    assert (again.code, "already has index.html" in again.err) == (2, True)


def test_what_is_next_says_all_that_was_said() -> None:
    first = Adapt(
        model="room", dataset=Path("my frames"), out=Path("out"), intrinsics=(90.0, 90.0, 47.5, 35.5), unit="mm", rate_hz=30.0,
        frames=1000, epochs=8, seed=5,
    )  # fmt: skip
    assert _next_command(first) == (
        "cabinpose adapt room 'my frames' --out out --intrinsics 90.0 90.0 47.5 35.5 --unit mm --frames 1000 --epochs 8"
        " --seed 5 --rate-hz 30.0 --train --resume"
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("in_cra sample", "in_cra"),
        ("in_car sample --scenes no.yaml", "--scenes is of --train"),
        ("in_car sample --look 3", "--look 3 is too few"),
        ("in_car sample --rate-hz 0", "is no rate"),
        ("in_car sample --learn generated", "--learn is of --train"),
        ("in_car sample --train --learn pseudo-labels --noise no.yaml", "--noise is of generated frames"),
        ("in_car sample --seed -1", "seed -1 is not"),
        ("paf sample --train", "not gone on with"),
        ("in_car sample --fov-deg 90", "says nothing of a dataset"),
        ("in_car nothing", "nothing"),
    ],
)
def test_words_that_cannot_be(words: str, told: str, run: Run, tmp_path: Path) -> None:
    done = run("adapt", *words.split(), "--out", tmp_path / "out")
    assert done.code == 2
    assert told in done.err
    assert "hint:" in done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("count", "told"), [(4, "4 frames are too few"), (9, "finds nobody in any of the 9 frames")])
def test_frames_that_cannot_be(count: int, told: str, run: Run, tmp_path: Path) -> None:
    """A wall, from a folder of depth images."""
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth" / "wall.npy", np.full((count, 60, 80), 900, np.uint16))
    done = run("adapt", "room", tmp_path / "depth", "--fov-deg", 70, "--unit", "mm", "--out", tmp_path / "out")
    assert done.code == 2
    assert told in done.err


def test_scenes_have_their_lens_place_and_noise() -> None:
    dataset = open_dataset(SAMPLE)
    theirs = facts_of(dataset)
    poses = dataset["vehicle_from_camera"].values
    config = their_scenes(theirs, theirs, ("driver",), poses=poses)
    sensor = config.camera.sensor_model
    assert sensor.camera == theirs.camera
    assert sensor.field_radius_px == pytest.approx(94, abs=2)  # of the sample's sensor
    assert not config.noise.remove_edges
    for view in config.camera.views.values():
        assert min(np.abs(poses - np.array(view.vehicle_from_camera)).max(axis=(1, 2))) < 1e-9
    assert len(config.camera.views) == 4
    assert "mirror" in their_scenes(theirs, theirs, ("driver",), poses=np.full((3, 4, 4), np.nan)).camera.views
    same, told = with_fitted_noise(config, theirs, 1)  # single frames: nothing tells the noise over time
    assert same == config
    assert "the preset's" in told.words
    law = SynthConfig.parse({"noise": {"kind": "empirical", "a_mm": 2.0}})  # of walls, without --sensor
    fitted = their_scenes(theirs, theirs, ("driver",), measured=law)
    assert (fitted.camera.sensor_model, fitted.noise) == (sensor, law.noise)
    preset = SynthConfig.parse({"camera": {"sensor": "evk75023"}, "noise": {"ambient": 0.3}})
    known = their_scenes(theirs, theirs, ("driver",), measured=preset).camera.sensor_model
    assert (known.range_m, known.camera) == ((0.3, 4.0), theirs.camera)
    with pytest.raises(ConfigError, match="people in cars"):
        their_scenes(theirs, theirs, ("standing",))


def test_amplitudes_of_zero_say_nothing_of_the_light() -> None:
    dataset = open_dataset(SAMPLE).isel(frame=slice(4))
    dark = dataset.assign(amplitude=dataset["amplitude"] * 0)
    dark["depth"] = dark["depth"].where(dark["frame"] > 0)  # nothing in the first frame
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = facts_of(dark)
    assert np.isnan(found.light)
    assert found.noise_m == pytest.approx(facts_of(dataset.isel(frame=slice(1, 4))).noise_m)


def test_amplitudes_come_into_their_unit() -> None:
    dataset = open_dataset(SAMPLE)
    ours = facts_of(dataset)
    brighter = in_their_light(dataset, facts_of(dataset.assign(amplitude=dataset["amplitude"] * 3)), ours)
    assert facts_of(brighter).light == pytest.approx(3 * ours.light, rel=0.01)


@pytest.mark.slow
def test_from_frames_to_an_adapted_model(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trained for an epoch, judged, and told on the page; a second call with --resume gives the same."""
    monkeypatch.setattr(tuning, "FEWEST_FRAMES", 2)  # the model is sure of few of the sample's fifteen
    words = [
        "adapt",
        "in_car",
        "sample",
        "--out",
        tmp_path / "out",
        "--train",
        "--frames",
        20,
        "--epochs",
        1,
        "--threads",
        1,
        "--json",
    ]
    done = run(*words)
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert {name: each["said"] for name, each in told["measures"].items()}.keys() == {
        "unsteadiness", "limbs that change their length", "joints before the surface", "errors on generated frames",
    }  # fmt: skip
    assert len(told["labelled"]) == 2
    assert "Better?" in (tmp_path / "out" / "index.html").read_text()
    assert run("evaluate", "sample", "--model", tmp_path / "out" / "adapted.onnx", "--json").code == 0
    assert run(*words).code == 2  # nothing is overwritten
    again = run(*words, "--resume")
    assert again.code == 0, again.err
    assert json.loads(again.out)["measures"] == told["measures"]
