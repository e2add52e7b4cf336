"""Parts that are not of their dataset are refused with what tells it; those made apart, resumed or long ago are taken."""

from __future__ import annotations

import json
import shutil
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cabinpose.app.cli import main
from cabinpose.core import DatasetError
from cabinpose.store import PartWriter, Source, create_dataset, import_source, open_dataset, read_manifest

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))

import sphere_people
import test_checksums

SIZE = {"frames": 3, "frames_per_part": 1}


def put(part: int, source: Path, into: Path, instead_of: int | None = None) -> None:
    """Copy a part over that of another folder."""
    target = into / f"part-{part if instead_of is None else instead_of:05d}.zarr"
    shutil.rmtree(target)
    shutil.copytree(source / f"part-{part:05d}.zarr", target)


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames in three parts; read only."""
    return sphere_people.write(tmp_path_factory.mktemp("true") / "cabins", sphere_people.manifest(**SIZE))


@pytest.fixture
def mine(true: Path, tmp_path: Path) -> Path:
    return shutil.copytree(true, tmp_path / "mine")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 8}, r"its seed is 8, dataset\.yaml says 7"),
        ({"generator_version": "1.1"}, r"its generator version is '1\.1', dataset\.yaml says '1\.0'"),
        ({"config": {"scene": {"wall_m": 2.6}}}, r"its configuration is another"),
    ],
    ids=("seed", "version", "configuration"),
)
def test_a_part_of_another_dataset_is_refused(mine: Path, tmp_path: Path, change: dict[str, object], said: str) -> None:
    put(1, sphere_people.write(tmp_path / "other", sphere_people.manifest(**SIZE, **change)), mine)
    with pytest.raises(DatasetError, match=rf"part-00001\.zarr is a part of another dataset: .*{said}") as error:
        open_dataset(mine)
    assert "move it back" in str(error.value.hint)
    with pytest.raises(DatasetError, match="another dataset"):
        create_dataset(mine, sphere_people.manifest(**SIZE), resume=True)
    assert main(["info", str(mine), "--verify"]) == 2


def test_a_part_copied_over_its_neighbour_is_refused(mine: Path) -> None:
    put(1, mine, mine, instead_of=2)
    with pytest.raises(DatasetError, match=r"part-00002\.zarr does not hold the frames"):
        open_dataset(mine)


def imported(folder: Path, first: int) -> Path:
    """An import of frames from `first` on: the configuration does not say which. Depths are noise, which takes equal space."""
    manifest, rng = sphere_people.manifest(**SIZE), np.random.Generator(np.random.Philox(key=first))
    frames = [sphere_people.frame(first + i, manifest) for i in range(3)]
    for frame in frames:
        frame["depth"] = rng.integers(5_000, 50_000, frame["depth"].shape, np.uint16)
    return import_source(Source(Path("theirs"), manifest, partial(iter, frames)), folder)


@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_part_of_another_import_with_the_same_settings_is_refused(tmp_path: Path, part: int) -> None:
    mine, other = imported(tmp_path / "mine", 0), imported(tmp_path / "other", 5)
    assert read_manifest(mine).parts_belong_to == read_manifest(other).parts_belong_to
    assert open_dataset(mine).sizes["frame"] == 3
    put(part, other, mine)
    with pytest.raises(DatasetError, match=r"do not belong together: part-0000\d\.zarr was made after a part"):
        open_dataset(mine)


def test_the_parts_of_another_import_with_the_same_settings_are_refused(tmp_path: Path) -> None:
    mine, same, other = imported(tmp_path / "mine", 0), imported(tmp_path / "same", 0), imported(tmp_path / "other", 5)
    assert (mine / "dataset.yaml").read_bytes() == (same / "dataset.yaml").read_bytes() != (other / "dataset.yaml").read_bytes()
    for part in range(3):
        put(part, same, mine)
    assert open_dataset(mine).sizes["frame"] == 3
    for part in range(3):
        put(part, other, mine)
    with pytest.raises(DatasetError, match="are of another import with the same settings"):
        open_dataset(mine)


@pytest.mark.parametrize(("array", "file"), [("depth", "c/0/0/0"), ("sync_ns", "c/0")])
def test_a_file_of_another_dataset_within_a_part_is_refused(
    tmp_path: Path, array: str, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of equal size, and with a right checksum of its own."""
    mine, other = imported(tmp_path / "mine", 0), imported(tmp_path / "other", 5)
    assert main(["info", str(mine), "--verify"]) == 0
    old, new = (folder / "part-00001.zarr" / array / file for folder in (mine, other))
    assert old.stat().st_size == new.stat().st_size
    assert old.read_bytes() != new.read_bytes()
    opened = open_dataset(mine)
    shutil.copy(new, old)
    with pytest.raises(DatasetError, match=rf"part-00001\.zarr is damaged: cannot read {array} .*of another part or dataset"):
        opened.variables[array].load()
    assert opened.variables["joints_3d"].load().size
    with pytest.raises(DatasetError, match=rf"part-00001\.zarr is damaged: {array} is not what .*of another part or dataset"):
        open_dataset(mine)
    assert main(["info", str(mine), "--verify"]) == 2
    assert "of another part or dataset" in capsys.readouterr().err


def test_parts_made_apart_extended_or_with_another_licence_fit_together(true: Path, mine: Path, tmp_path: Path) -> None:
    elsewhere, manifest = tmp_path / "elsewhere", sphere_people.manifest(**SIZE | {"frames": 4})
    with create_dataset(elsewhere, manifest), PartWriter(elsewhere, manifest.parts[3], manifest) as part:
        part.append(sphere_people.frame(3, manifest))
    create_dataset(mine, manifest, resume=True).close()
    shutil.copytree(elsewhere / "part-00003.zarr", mine / "part-00003.zarr")
    assert open_dataset(mine, missing="raise").attrs["parts_without_dataset"] == 0
    assert (mine / "part-00002.zarr/zarr.json").read_bytes() == (true / "part-00002.zarr/zarr.json").read_bytes()
    assert manifest.model_copy(update={"licence": "CC-BY-4.0"}).parts_belong_to == read_manifest(mine).parts_belong_to


def test_a_manifest_that_was_read_names_its_parts_as_the_one_that_was_written(tmp_path: Path) -> None:
    config = {"tiny": 1e-300, "none": None, "text": "1e-5 ü \u2028", "day": "2026-01-01", "3": (True, -0.0, float("inf"))}
    manifest = sphere_people.manifest(**SIZE, config=config)
    create_dataset(tmp_path / "odd", manifest).close()
    assert read_manifest(tmp_path / "odd").parts_belong_to == manifest.parts_belong_to


def test_parts_made_before_are_read_and_info_says_that_they_cannot_know(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(mine)]) == 0
    assert "named their dataset" not in capsys.readouterr().out
    test_checksums.strip_checksums(mine)
    assert main(["info", str(mine)]) == 0
    assert "3 of 3 parts were written before parts named their dataset" in capsys.readouterr().out
    assert main(["info", str(mine), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parts_without_dataset"] == 3
    create_dataset(mine, sphere_people.manifest(**SIZE), resume=True).close()
