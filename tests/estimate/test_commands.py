"""`cabinpose train` and `cabinpose export onnx` for every method, from a dataset's folder to a model that answers."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import small
import sphere_people
import yaml
from PIL import Image

from cabinpose.app.cli import main, output
from cabinpose.estimate import open_model


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    manifest = sphere_people.manifest(frames=12, frames_per_part=6, width=small.SIZE[0], height=small.SIZE[1])
    return sphere_people.write(tmp_path_factory.mktemp("data") / "spheres", manifest)


def run(*arguments: str) -> int:
    try:
        return int(main(list(arguments)) or 0)
    except SystemExit as done:
        return int(done.code or 0)


@pytest.mark.parametrize("method", small.NETWORKS)
def test_train_and_export(
    method: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "LOG_EVERY_S", 0.0)  # every state is told, as if it had lasted
    monkeypatch.setattr(output, "QUIET_S", 0.0)
    config = tmp_path / "run.yaml"
    config.write_text(yaml.safe_dump({"settings": json.loads(json.dumps(small.TINY[method])), "epochs": 1, "batch": 4}))
    out = tmp_path / "run"
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S04]}\n")
    arguments = ["train", str(data), "--method", method, "--config", str(config), "--out", str(out), "--json"]
    assert run(*arguments, "--devices", "1", "--splits", str(splits)) == 0
    said = capsys.readouterr()
    told = [next((i for i, line in enumerate(said.err.splitlines()) if words in line), -1) for words in (
        "loading torch", "opening datasets", "reading frames", "epoch 1 of 1", "epoch 1 of 1, loss", "validating"
    )]  # fmt: skip
    assert told == sorted(told)
    assert told[0] >= 0
    best = json.loads(said.out.strip().splitlines()[-1])["best"]
    assert Image.open(out / "curves.png").size == (960, 2 * (260 + 28))
    assert run("export", "onnx", best, "--out", str(tmp_path / "model.onnx"), "--json") == 0
    assert json.loads(capsys.readouterr().out.strip().splitlines()[-1])["difference"] <= 1e-4
    assert run("export", "onnx", best, "--out", best, "--overwrite") == 2  # it would replace the checkpoint
    assert f"{best} is the model itself" in capsys.readouterr().err


def test_a_run_learns_from_several_datasets(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more = sphere_people.manifest(frames=6, frames_per_part=6, width=small.SIZE[0], height=small.SIZE[1], seed=8)
    other = sphere_people.write(tmp_path / "more", more)
    config = tmp_path / "run.yaml"
    config.write_text(yaml.safe_dump({"settings": json.loads(json.dumps(small.TINY["compact"])), "epochs": 1, "batch": 4}))
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S04]}\n")
    arguments = ["--config", str(config), "--out", str(tmp_path / "run"), "--devices", "1", "--splits", str(splits)]
    model = tmp_path / "model.onnx"
    assert run("train", str(data), str(other), *arguments, "--export", str(model)) == 0
    assert (tmp_path / "run" / "best.ckpt").exists()
    assert capsys.readouterr().out.split() == [str(tmp_path / "run" / "best.ckpt"), str(model)]
    assert open_model(model).name == "model"
    for method, words in (("dpm", "dpm has no network"), ("compact", "already exists")):
        assert run("train", str(data), "--method", method, "--out", str(tmp_path / "again"), "--export", str(model)) == 2
        assert words in capsys.readouterr().err
    assert run("train", str(other), str(other), *arguments) == 2
    assert "a dataset is named twice" in capsys.readouterr().err


def test_labels_are_looked_at_before_anything_is_learnt(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A split that nobody belongs to ends the runs once the labels were looked at."""
    right = sphere_people.frame
    monkeypatch.setattr(sphere_people, "frame", lambda i, m: right(i, m) | {"joints_2d": right(i, m)["joints_2d"] / 64})
    wrong = sphere_people.write(tmp_path / "wrong", sphere_people.manifest(frames=4))
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S09]}\n")
    arguments = ("--method", "compact", "--splits", str(splits), "--out", str(tmp_path / "run"))
    said = f"warning: {wrong}: joints_2d is from "
    assert run("train", str(data), *arguments) == 2
    assert "warning" not in capsys.readouterr().err
    assert run("train", str(data), str(wrong), *arguments) == 2
    assert capsys.readouterr().err.count(said) == 1
    monkeypatch.setenv("LOCAL_RANK", "1")  # a process that helps another one
    assert run("train", str(wrong), *arguments) == 2
    assert said not in capsys.readouterr().err


@pytest.mark.slow
def test_of_several_processes_one_speaks(data: Path, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(yaml.safe_dump({"settings": json.loads(json.dumps(small.TINY["compact"])), "epochs": 1, "batch": 2}))
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S04]}\n")
    arguments = ["train", str(data), "--config", str(config), "--splits", str(splits), "--out", str(tmp_path / "run"), "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "cabinpose", *arguments, "--devices", "2"], capture_output=True, text=True, timeout=300, check=True
    )
    assert json.loads(done.stdout) == {"best": str(tmp_path / "run" / "best.ckpt")}  # one line
    assert "warning" not in done.stderr


def test_a_run_needs_one_source_of_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("train", "--out", str(tmp_path)) == 2
    assert "hint: give DATASET or --synth SCENE.yaml" in capsys.readouterr().err
