"""What was written before version 2 of the standard (`version1/`) is read by every verb, and upgraded in place."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from cabinpose.app.label.labelling import Labelling, open_labels
from cabinpose.core import CABINPOSE, OTHER_SKELETONS, DatasetError
from cabinpose.store import open_dataset, part_facts, read_manifest
from cabinpose.store.part import PartWriter
from cabinpose.store.upgrade import missing_variables, upgrade_dataset
from cabinpose.store.variables import SCHEMA_VERSION, VARIABLES, joints_variable

OLD = Path(__file__).with_name("version1")
SEATS = {"adult", "child_in_child_seat", "child_seat_empty", "empty", "object", "child"}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """The dataset of version 1, with its predictions and labels beside it."""
    with zipfile.ZipFile(OLD / "dataset.zip") as packed:
        packed.extractall(tmp_path / "v1")
    for name in ("predictions.jsonl", "labels.jsonl", "model.onnx", "best.ckpt"):
        shutil.copy(OLD / name, tmp_path)
    return tmp_path / "v1"


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_it_opens_as_it_was_and_info_says_what_it_lacks(old: Path, run: Callable[..., Any]) -> None:
    dataset = open_dataset(old)
    assert dataset.attrs["schema_version"] == 1
    assert {"child", "child_seat"} <= set(dataset.coords)
    assert "occupancy" not in dataset.variables
    parts = [zarr.open_group(part, mode="r")["belt"] for part in sorted(old.glob("part-*.zarr"))]
    stored = np.concatenate([np.asarray(part).astype(object) for part in parts])
    assert "worn" in stored
    assert "worn" in stored
    np.testing.assert_array_equal(dataset["belt"].values, np.where(stored == "worn", "correct", stored))  # Euro NCAP's word
    told = run("info", old)
    assert (told.code, told.err) == (0, "")
    assert "version 1" in told.out
    assert all(name in told.out for name in ("occupancy", "box_3d", "reflectance", f"cabinpose upgrade {old}"))


@pytest.mark.parametrize("upgraded", [False, True])
def test_predictions_and_labels_stay_its_own(old: Path, run: Callable[..., Any], tmp_path: Path, upgraded: bool) -> None:
    if upgraded:
        upgrade_dataset(old)
    judged = run("evaluate", old, "--predictions", tmp_path / "predictions.jsonl", "--out", tmp_path / "report")
    assert judged.code == 0, judged.err
    dataset = open_dataset(old)
    labels = open_labels(tmp_path / "labels.jsonl", dataset)
    (shown,) = (each for each in Labelling(dataset, labels).shown(0, "driver") if each.joint == "head")
    labels.close()
    assert shown.origin == "label"


@pytest.mark.slow
@pytest.mark.parametrize("upgraded", [False, True])
def test_every_other_verb_takes_it(old: Path, run: Callable[..., Any], tmp_path: Path, upgraded: bool) -> None:
    if upgraded:
        upgrade_dataset(old)
    for words in (
        ("view", old, "--out", tmp_path / "view"),
        ("predict", old, "--model", tmp_path / "model.onnx", "--out", tmp_path / "again.zarr"),
        ("export", "png-json", old, "--out", tmp_path / "png"),
        ("export", "dataset", old, "--where", 'belt == "behind_back"', "--out", tmp_path / "chosen"),
        ("export", "onnx", tmp_path / "best.ckpt", "--out", tmp_path / "best.onnx"),
        ("train", old, "--config", OLD / "train.yaml", "--val", "0.25", "--out", tmp_path / "run"),
    ):
        assert (told := run(*words)).code == 0, told.err


def test_upgraded_it_holds_what_it_held_and_says_it_in_the_words_of_version_2(old: Path, run: Callable[..., Any]) -> None:
    before = open_dataset(old).load()
    told = run("upgrade", old)
    assert told.code == 0, told.err
    assert read_manifest(old).schema_version == 2
    assert missing_variables(read_manifest(old)) == []
    after = open_dataset(old).load()
    for name in set(before.variables) - {"child", "child_seat", "belt"}:
        np.testing.assert_array_equal(after[name].values, before[name].values, err_msg=str(name))
    np.testing.assert_array_equal(after["belt"].values, before["belt"].values)
    state, child = after["occupancy"].values, before["child"].values
    assert set(state.ravel().tolist()) <= SEATS
    somebody = before["subject"].values != ""
    np.testing.assert_array_equal(np.isin(state, ("adult", "child", "child_in_child_seat")), somebody)
    np.testing.assert_array_equal(np.isin(state, ("child", "child_in_child_seat")), somebody & (child == 1))
    np.testing.assert_array_equal(state == "child_seat_empty", before["child_seat"].values == "empty")
    assert np.isnan(after["stature"].values).all()  # nothing is estimated
    for frame in range(before.sizes["frame"]):
        for row in range(before.sizes["person"]):
            pixels = np.argwhere((before["instance"][frame].values == 1 + row) & (before["labels"][frame].values < 64))
            box = after["box_2d"][frame, row].values
            if len(pixels):
                np.testing.assert_allclose(box, [*pixels.min(0)[::-1], *pixels.max(0)[::-1]])
            else:
                assert np.isnan(box).all()


def test_it_is_upgraded_once(old: Path, run: Callable[..., Any]) -> None:
    upgrade_dataset(old)
    held = files_of(old)
    told = run("upgrade", old)
    assert told.code == 2
    assert "of version 2 already" in told.err
    assert "hint:" in told.err
    assert files_of(old) == held


def test_what_is_no_part_of_it_is_not_lost(old: Path) -> None:
    (old / "mine.labels.jsonl").write_text("x")
    held = files_of(old)
    with pytest.raises(DatasetError, match=r"holds mine\.labels\.jsonl, which is no part of the dataset"):
        upgrade_dataset(old)
    assert files_of(old) == held


def test_an_upgrade_that_ends_early_leaves_it_as_it_was(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held, done, append = files_of(old), [], PartWriter.append

    def fails(part: PartWriter, frame: Any) -> None:
        if len(done) == 2:
            raise OSError(28, "No space left on device")
        done.append(frame)
        append(part, frame)

    monkeypatch.setattr(PartWriter, "append", fails)
    with pytest.raises((DatasetError, OSError), match=r"(?i)no space left"):
        upgrade_dataset(old)
    assert files_of(old) == held
    assert [path for path in old.parent.iterdir() if path.name.startswith(".")] == []


def test_each_part_is_checked_once(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checked, check = [], part_facts.check_part

    def counted(path: Path, *facts: Any) -> part_facts.PartFacts:
        checked.append(path)
        return check(path, *facts)

    monkeypatch.setattr(part_facts, "check_part", counted)
    upgrade_dataset(old)
    assert [path.name for path in checked] == sorted(path.name for path in old.glob("part-*.zarr"))


def test_joints_are_those_of_the_standard(old: Path) -> None:
    assert [str(name) for name in open_dataset(old)["joint"].values] == list(CABINPOSE.joints)


def test_the_page_names_every_variable() -> None:
    page = Path(__file__).parents[2].joinpath("docs/dataset.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith(("| `", "Coordinates of a frame"))]
    sets = {joints_variable(each.name) for each in OTHER_SKELETONS} - {"itop_joints_3d"}
    names = [each.name for each in VARIABLES if each.until >= SCHEMA_VERSION and each.name not in sets]
    assert [name for name in names if not any(f"`{name}`" in row for row in rows)] == []
