"""`cabinpose evaluate`: its table, its page, its JSON, and one hint for what the user can mend."""

from __future__ import annotations

import csv
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.core import Visibility
from cabinpose.evaluate import EvaluationOptions
from cabinpose.store import read_manifest
from cabinpose.store.predictions import Predictions, write_predictions
from cabinpose.store.schema import dataset_id


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], dataset_folder: Path) -> Callable[..., Outcome]:
    """`run(file, "--json")`: the outcome of `cabinpose evaluate` on the sphere people, with few resamples."""

    def call(*arguments: object, data: Path = dataset_folder) -> Outcome:
        code = main(["evaluate", str(data), "--resamples", "5", "--predictions", *map(str, arguments)])
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return call


@pytest.fixture
def files(tmp_path: Path, predictions: Predictions) -> list[Path]:
    """Two models: one with 2D and 3D, one with 2D alone and without hands."""
    arrays = {name: getattr(predictions, name)[:, :, 2:] for name in ("joints_2d", "joints_3d", "score", "presence")}
    arrays["joints_3d"] = np.full_like(arrays["joints_3d"], np.nan)
    flat = replace(predictions, model="flat <b>", joints=predictions.joints[2:], **arrays)
    return [write_predictions(tmp_path / "a.jsonl", predictions), write_predictions(tmp_path / "b.jsonl", flat)]


def test_table(run: Callable[..., Outcome], files: list[Path]) -> None:
    code, out, err = run(files[0])
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "noisy on dataset: 5 frames, 9 people"
    unchecked = "the predictions name no dataset: that they are of this one is not checked"
    assert lines.count(unchecked) == 2
    lines = [line for line in lines if line != unchecked]
    assert [line.split()[0] for line in lines[2:9]] == ["All", "Head", "Shoulder", "Elbow", "Wrist", "Hip", "Hand"]
    assert all(words in lines[1] for words in ("PCKh@0.5 2D %", "AUC 2D %", "mean 3D cm", "found %"))
    assert "95 % interval" in out
    assert re.search(r"^MPJPE 3D +\d", out, re.M)
    assert [line.split("  ")[0] for line in lines[11:19]] == [
        "PCKh@0.5 2D", "AUC of PCKh 2D", "PCK@10 cm 3D", "MPJPE 3D", "presence precision", "presence recall", "median error 2D",
        "median error 3D",
    ]  # fmt: skip
    assert len(re.findall(r"\d to +\d", out)) == 8
    assert re.search(r"^and 4\d more with --all$", out, re.M)
    everything = run(files[0], "--all").out
    assert re.search(r"^mAP@10 cm \(among detected\) 3D +\d", everything, re.M)
    assert "--all" not in everything


def test_json_and_page_hold_the_same_numbers(run: Callable[..., Outcome], files: list[Path], tmp_path: Path) -> None:
    code, out, err = run(*files, "--out", tmp_path / "out", "--json", "--hit-m", 0.08, "--hit-px", 13)
    assert code == 0, err
    assert out.count("\n") == 1
    record = json.loads(out)
    assert record == json.loads((tmp_path / "out" / "report.json").read_text())
    noisy, flat = record["models"]
    assert {v["threshold"] for v in noisy["values"] if v["metric"] in ("mAD@d", "mAR@d (literal)")} == {8, 13}
    assert [list(noisy["boxes"][space]) for space in ("2d", "3d")] == [
        ["all found", "< 6.5 px", "< 13 px"], ["all found", "< 4 cm", "< 8 cm"],
    ]  # fmt: skip
    assert "lhand" in run(files[0], "--json").out
    assert "lhand" not in record["joints"]  # both answer for the same joints
    assert {v["space"] for v in flat["values"]} == {"2d", "image"}
    for value in noisy["values"]:
        assert value["denominator"]
        assert {"unit", "threshold", "joints", "samples", "low", "high"} <= value.keys()
    page = (tmp_path / "out" / "index.html").read_text()
    mean = next(v for v in noisy["values"] if (v["metric"], v["space"], v["joints"]) == ("MPJPE", "3d", "Wrist"))
    assert f"{mean['value']:.2f}" in page
    assert "flat &lt;b&gt;" in page
    assert "flat <b>" not in page
    assert not re.search(r"<script|(?:src|href)=\"(?!data:)", page)
    charts = re.findall(r"<svg.*?</svg>", page, re.S)
    frames = [c for c in charts if 'class="frame"' in c]
    assert len(frames) == 2 * 5
    # a chart for each space, kind and group, boxes in three ranges, d(t) of both models, d(t, j) twice of three, confidence, and
    # the frames of the model in 3D in their clouds
    assert len(charts) == 2 * 5 + 5 + 4 * 6 + 2 * 3 + 2 + 2 * 3 + 4
    for chart in charts:
        ET.fromstring(chart)
    assert any("#ff9f1c" in f and "#ffffff" in f for f in frames)
    assert (tmp_path / "out" / "boxes.png").stat().st_size > 10_000


def test_distances_of_each_joint_over_the_frames(
    run: Callable[..., Outcome], files: list[Path], dataset: xr.Dataset, predictions: Predictions, tmp_path: Path
) -> None:
    """The file, joint by joint, against loops over frames and people; the page has them to tick."""
    assert run(files[0], "--out", tmp_path / "out").code == 0
    with (tmp_path / "out" / "distances.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["space"], int(row["frame"])) for row in rows] == [(space, n) for space in ("2d", "3d") for n in range(5)]
    order = "frame", "person", "joint", ...
    states, *places = (dataset[of].transpose(*order).values for of in ("visibility", "joints_2d", "joints_3d"))  # read once
    persons, joints = dataset["person"].values.tolist(), dataset["joint"].values.tolist()
    missed = 0
    for row in rows:
        everything, counted = [], 0
        frame = dataset["frame"].values.tolist().index(int(row["frame"]))
        at = predictions.frame.tolist().index(int(row["frame"]))
        for joint in predictions.joints:
            d, counts = [], 0
            for p, person in enumerate(predictions.persons):
                true = frame, persons.index(person), joints.index(joint)
                if int(states[true]) < Visibility.OCCLUDED:
                    continue
                counts += 1
                j = predictions.joints.index(joint)
                name, place, factor = ("joints_2d", places[0], 1) if row["space"] == "2d" else ("joints_3d", places[1], 100)
                found = getattr(predictions, name)[at, p, j]
                if np.isfinite(found).all() and predictions.presence[at, p, j] >= 0.5:
                    d.append(factor * float(np.linalg.norm(found - place[true])))
            everything, counted = everything + d, counted + counts
            missed += counts > 0 and not d
            expected = np.mean(d) if d else np.inf if counts else np.nan
            np.testing.assert_allclose(float(row[joint] or "nan"), expected, rtol=1e-3)
        np.testing.assert_allclose(float(row["mean"]), np.mean(everything), rtol=1e-3)
    assert missed
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.count('type="checkbox"') == 2 * (1 + len(predictions.joints))
    assert page.count('checked="checked"') == 2 * 4  # the mean, and the three that are farthest off
    assert "threshold 26 px" in page
    assert "threshold 10 cm" in page


def test_places_that_no_model_looks_at_are_told_and_not_counted(
    run: Callable[..., Outcome], predictions: Predictions, tmp_path: Path
) -> None:
    at = predictions.persons.index("driver")
    arrays = {name: getattr(predictions, name)[:, [at]] for name in ("joints_2d", "joints_3d", "score", "presence")}
    alone = write_predictions(tmp_path / "alone.jsonl", replace(predictions, persons=("driver",), **arrays))
    done = run(alone, "--json")
    assert json.loads(done.out)["models"][0]["people"] == 5
    assert done.err.startswith("not counted, since no model looks there: 3 in front_passenger, 1 in rear_left (--persons")
    everybody = run(alone, "--json", "--persons", *predictions.persons)
    assert json.loads(everybody.out)["models"][0]["people"] == 9
    assert everybody.err == ""


def test_overwrite(run: Callable[..., Outcome], files: list[Path], tmp_path: Path) -> None:
    assert run(files[0], "--out", tmp_path / "out").code == 0
    before = (tmp_path / "out" / "index.html").read_bytes()
    code, out, err = run(files[1], "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert "already has index.html and report.json\nhint: --overwrite" in err
    assert (tmp_path / "out" / "index.html").read_bytes() == before
    assert run(files[1], "--out", tmp_path / "out", "--overwrite").code == 0
    assert (tmp_path / "out" / "index.html").read_bytes() != before


def test_selection(run: Callable[..., Outcome], files: list[Path], tmp_path: Path) -> None:
    assert json.loads(run(files[0], "--json", "--select", "car=sedan").out)["frames"] == 2
    assert json.loads(run(files[0], "--json", "--select", "car=sedan,van", "pov=driver").out)["frames"] == 3
    assert json.loads(run(files[0], "--json", "--select", "sequence=0").out)["frames"] == 5
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {car: [sedan, van]}\ntest: {car: [coupe]}\n")
    assert json.loads(run(files[0], "--json", "--splits", splits, "--split", "test").out)["frames"] == 1


def test_options_reach_the_numbers(run: Callable[..., Outcome], files: list[Path]) -> None:
    changed = run(
        files[0], "--json", "--min-visibility", "visible", "--head", "true", "--match", "distance", "--presence", "0.7",
        "--pckh", "0.3", "--pck-px", "5", "--pck-m", "0.08", "--seed", "3",
    )  # fmt: skip
    settings = json.loads(changed.out)["models"][0]["settings"]
    assert settings == {
        "min_visibility": "visible", "presence": 0.7, "head": "true", "pck_px": [5.0], "pck_m": [0.08], "pckh": [0.3],
        "hit_px": 26.0, "hit_m": 0.1, "match": "distance", "resamples": 5, "seed": 3,
        "clusters": 3,
    }  # fmt: skip


def test_flags_are_the_fields_of_the_options(capsys: pytest.CaptureFixture[str]) -> None:
    """The verb has no list of its own: a field more is a flag more."""
    with pytest.raises(SystemExit):
        main(["evaluate", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    for each in fields(EvaluationOptions):
        assert f"--{each.name.replace('_', '-')} " in told


def test_the_flags_of_the_last_release_warn_and_work(run: Callable[..., Outcome], files: list[Path]) -> None:
    old, new = (
        run(files[0], "--json", "--pck-cm", "8", "12", "--hit-cm=7"),
        run(files[0], "--json", "--pck-m", "0.08", "0.12", "--hit-m", "0.07"),
    )
    told = ["--pck-cm is called --pck-m now", "--hit-cm is called --hit-m now"]
    assert json.loads(old.out) == json.loads(new.out) | {"warnings": told}
    assert old.err == "warning: --pck-cm is called --pck-m now\nwarning: --hit-cm is called --hit-m now\n"
    assert "--pck-m is given twice" in run(files[0], "--pck-cm", "8", "--pck-m", "0.1").err


def test_models_of_one_name_are_told_apart(run: Callable[..., Outcome], files: list[Path]) -> None:
    other = files[0].with_name("c.jsonl")
    other.write_bytes(files[0].read_bytes())
    record = json.loads(run(files[0], other, "--json").out)
    assert [m["model"] for m in record["models"]] == [f"noisy ({files[0]})", f"noisy ({other})"]
    assert "is given twice" in run(files[0], files[0]).err


def test_the_dataset_may_be_named(
    run: Callable[..., Outcome], dataset_folder: Path, predictions: Predictions, tmp_path: Path
) -> None:
    for i, name in enumerate((dataset_id(read_manifest(dataset_folder)), "dataset")):
        assert run(write_predictions(tmp_path / f"{i}.jsonl", replace(predictions, dataset=name))).code == 0
    code, _, err = run(write_predictions(tmp_path / "other.jsonl", replace(predictions, dataset="other")))
    assert code == 2
    assert err.count("hint:") == 1


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--select", "car"), "'car' selects nothing"),
        (("--select", "colour=red"), "unknown coordinate 'colour'"),
        (("--select", "car=tank"), "the dataset has no car 'tank'"),
        (("--select", "sequence=a"), "sequences are numbers"),
        (("--select", "car=coupe", "pov=driver"), "no frame has all"),
        (("--split", "test"), "a split needs its file"),
        (("--presence", "2"), "presence is a probability"),
        (("--pck-m", "0"), "a threshold is a positive number"),
        (("absent.jsonl",), "there is no predictions file"),
    ],
)
def test_mistakes_have_one_hint(run: Callable[..., Outcome], files: list[Path], flags: tuple[str, ...], message: str) -> None:
    code, out, err = run(files[0], *flags)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("hint: ") == 1
    assert "Traceback" not in err


def test_no_dataset(run: Callable[..., Outcome], files: list[Path], tmp_path: Path) -> None:
    code, _, err = run(files[0], data=tmp_path)
    assert code == 2
    assert "holds no dataset" in err


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--persons", "pilot"], "unknown slot 'pilot'"),
        (["--seed", "-1"], "-1 is no seed"),
        (["--itop-npz", "x.npz"], "ITOP frames are scored for one model"),
    ],
)
def test_words_that_mean_nothing_are_told(run: Callable[..., Outcome], files: list[Path], words: list[str], error: str) -> None:
    done = run(files[0], *words)
    assert (done.code, error in done.err) == (2, True), done.err


def test_files_of_one_name_have_rows_of_their_own(run: Callable[..., Outcome], predictions: Predictions, tmp_path: Path) -> None:
    """By the words by which they were given, each with numbers and curves of its own."""
    (tmp_path / "second").mkdir()
    worse = replace(predictions, joints_2d=predictions.joints_2d + 30)
    paths = [write_predictions(tmp_path / "a.jsonl", predictions), write_predictions(tmp_path / "second" / "a.jsonl", worse)]
    done = run(*paths, "--json", "--out", tmp_path / "out")
    models = json.loads(done.out)["models"]
    assert [model["model"] for model in models] == [f"noisy ({path})" for path in paths]
    rows = list(csv.DictReader((tmp_path / "out" / "distances.csv").open()))
    assert {row["model"] for row in rows} == {f"noisy ({path})" for path in paths}
