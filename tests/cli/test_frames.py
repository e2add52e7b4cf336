"""Frames that are no dataset: what `predict` and `evaluate` make of depth images, recordings and COCO folders."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from cabinpose.store import open_dataset
from cabinpose.store.frames import depth_mm

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory, dataset_folder: Path) -> tuple[Path, Path]:
    """The frames of a dataset as somebody has their own: 16-bit PNGs in mm, and the camera's file."""
    folder = tmp_path_factory.mktemp("own")
    dataset = open_dataset(dataset_folder)
    for number, depth in enumerate(dataset.depth.values):
        Image.fromarray(depth_mm(depth)).save(folder / f"{number}.png")
    k = dataset.camera_k[0].values
    camera = folder / "camera.json"
    camera.write_text(json.dumps({"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}))
    return folder, camera


def test_predictions_of_a_folder_are_those_of_its_import(run: Run, own: tuple[Path, Path], tmp_path: Path) -> None:
    folder, camera = own
    assert run("import", "depth-images", folder, "--camera", camera, "--out", tmp_path / "in")[0] == 0
    assert run("predict", tmp_path / "in", "--model", "paf", "--out", tmp_path / "a.jsonl")[0] == 0
    code, _, err = run("predict", folder, "--camera", camera, "--model", "paf", "--out", tmp_path / "b.jsonl")
    assert code == 0, err
    assert "the depth is taken to be in mm" in err
    assert (tmp_path / "a.jsonl").read_text().splitlines()[1:] == (tmp_path / "b.jsonl").read_text().splitlines()[1:]


def test_one_image(run: Run, own: tuple[Path, Path], tmp_path: Path) -> None:
    folder, camera = own
    words = ("predict", folder / "3.png", "--camera", camera, "--model", "paf", "--out", tmp_path / "a.jsonl", "--json")
    code, out, err = run(*words)
    assert code == 0, err
    assert json.loads(out)["frames"] == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("predict", "{own}", "--model", "paf", "--out", "{out}"), "give --camera FILE"),
        (("predict", "{own}", "--camera", "{camera}", "--model", "in_car", "--out", "{out}"), "cabinpose models --reads depth"),
        (("predict", "{dataset}", "--unit", "mm", "--model", "paf", "--out", "{out}"), "--unit says nothing of a dataset"),
        (("predict", "{nix}", "--unit", "mm", "--model", "paf", "--out", "{out}"), "holds no dataset"),
        (("evaluate", "{own}", "--camera", "{camera}", "--model", "paf"), "is anybody labelled"),
        (("models", "--reads", "deph"), "unknown image 'deph'"),
        (("models", "in_car", "--reads", "depth"), "--reads chooses among the packaged models"),
    ],
)
def test_mistakes(
    run: Run, own: tuple[Path, Path], dataset_folder: Path, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    places = {"own": own[0], "camera": own[1], "dataset": dataset_folder, "nix": tmp_path, "out": tmp_path / "p.jsonl"}
    code, out, err = run(*(word.format(**places) for word in words))
    assert (code, out) == (2, "")
    assert said in err
    assert not (tmp_path / "p.jsonl").exists()


def test_a_coco_folder_is_evaluated_in_the_image_alone(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    assert run("export", "coco", dataset_folder, "--images", "depth16", "--out", tmp_path / "coco")[0] == 0
    code, out, err = run("evaluate", tmp_path / "coco", "--model", "paf", "--json")
    assert code == 0, err
    values = json.loads(out)["models"][0]["values"]
    assert {each["space"] for each in values if each["metric"] == "PCKh"} == {"2d"}  # it knows no metres


def test_models_by_what_they_read(run: Run) -> None:
    _, out, _ = run("models", "--reads", "depth")
    names = {line.split()[0] for line in out.splitlines()}
    assert {"paf", "room"} <= names
    assert not {"in_car", "lift"} & names
    assert run("models", "--reads", "nir") == (0, "", "no packaged model does with nir alone\n")


def test_frames_that_do_not_follow_each_other_are_not_smoothed_in_silence(
    run: Run, own: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, camera = own
    words = ("predict", folder, "--camera", camera, "--model", "paf", "--smooth", "one-euro", "--out", tmp_path / "a.jsonl")
    code, _, err = run(*words)
    assert code == 0
    assert "nothing was smoothed: no frame follows another" in err
