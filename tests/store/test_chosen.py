"""Chosen frames as a dataset of their own, or as a split."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.app.cli import main
from cabinpose.core import DatasetError
from cabinpose.store import frame_mask, number_at_first, open_dataset, read_manifest, told_apart
from cabinpose.store.convert import export_dataset


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chosen") / "whole"
    settings = ["scene.cars=[suv, van]", "output.frames_per_part=3", "camera.sensor=pico_monstar_105/4"]
    assert main(["synth", "--out", str(folder), "--frames", "8", "--seed", "3", *settings]) == 0
    return folder


def bytes_of(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest() for path in files}


def test_all_frames_are_the_same_bytes(generated: Path, tmp_path: Path) -> None:
    """Of images and values; what the parts say of themselves names another dataset."""
    before = bytes_of(generated)
    export_dataset(open_dataset(generated), "dataset", tmp_path / "a")
    export_dataset(open_dataset(generated), "dataset", tmp_path / "b")
    made = bytes_of(tmp_path / "a")
    own = {name for name in made if name.count("/") < 2}  # dataset.yaml, and zarr.json of the parts
    assert len(made) - len(own) > 100
    assert {name: made[name] for name in made if name not in own} == {name: before[name] for name in before if name not in own}
    assert made == bytes_of(tmp_path / "b")
    assert bytes_of(generated) == before


def test_chosen_frames_say_where_they_are_from(generated: Path, tmp_path: Path, run: Callable[..., Any]) -> None:
    whole, some = open_dataset(generated), tmp_path / "some"
    assert run("export", "dataset", generated, "--where", "frame in [1, 2, 3, 4, 7]", "--out", some).code == 0
    chosen = open_dataset(some)
    assert chosen["frame"].values.tolist() == [0, 1, 2, 3, 4]
    for name in ("depth", "labels", "joints_3d", "subject", "camera_k", "seed"):
        np.testing.assert_array_equal(chosen[name].values, whole[name].values[[1, 2, 3, 4, 7]])
    told = read_manifest(some).selection
    assert told == {"of": whole.attrs["dataset_id"], "name": "whole", "frames": "1-4 7", "by": "--where frame in [1, 2, 3, 4, 7]"}
    assert chosen.attrs["dataset_id"] != whole.attrs["dataset_id"]
    fewer = export_dataset(chosen.isel(frame=[0, 4]), "dataset", tmp_path / "fewer")
    last = read_manifest(fewer).selection
    assert last["before"] == told
    assert [number_at_first(last, number) for number in (0, 1)] == [1, 7]
    assert "chosen of" in run("info", some).out
    scenes = [run("config", "frame", folder, number).out for folder, number in ((generated, 7), (some, 4), (fewer, 1))]
    assert len({scene.split("\n", 1)[1] for scene in scenes}) == 1  # below the line with the number


def test_nothing_is_left_of_an_export_that_fails_or_would_replace(generated: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged"
    export_dataset(open_dataset(generated), "dataset", damaged)
    with pytest.raises(DatasetError, match="never replaces"):
        export_dataset(open_dataset(generated), "dataset", damaged, overwrite=True)
    shard = next(path for path in (damaged / "part-00001.zarr" / "depth" / "c").rglob("*") if path.is_file())
    data = bytearray(shard.read_bytes())
    data[100] ^= 1
    shard.write_bytes(data)
    with pytest.raises(DatasetError, match="part-00001"):
        export_dataset(open_dataset(damaged), "dataset", tmp_path / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["damaged"]
    with pytest.raises(DatasetError, match="order of their numbers"):
        export_dataset(open_dataset(generated).isel(frame=[2, 1]), "dataset", tmp_path / "out")


def test_splits_that_tell_chosen_frames_apart(generated: Path) -> None:
    dataset = open_dataset(generated)
    car = dataset["car"].values == "suv"
    nobody_twice = dataset.assign_coords(subject=(("frame", "person"), np.full((8, 5), "S01", object)))
    assert told_apart(nobody_twice, car) == ({"test": {"car": ("suv",)}, "train": {"car": ("van",)}}, 0)
    subject = np.full((8, 5), "", object)
    subject[:, 0], subject[3, 1] = ["A", "B", "A", "B", "C", "B", "C", "B"], "A"
    people = dataset.assign_coords(subject=(("frame", "person"), subject))
    splits, left_out = told_apart(people, (subject == "A").any(axis=1))
    assert (splits, left_out) == ({"test": {"subject": ("A",)}, "train": {"subject": ("B", "C")}}, 1)  # the frame of A beside B
    assert np.flatnonzero(frame_mask(people, splits["test"])).tolist() == [0, 2]
    assert np.flatnonzero(frame_mask(people, splits["train"])).tolist() == [1, 4, 5, 6, 7]
    with pytest.raises(DatasetError, match="tells the chosen frames from the others"):
        told_apart(dataset, np.zeros(8, bool))
