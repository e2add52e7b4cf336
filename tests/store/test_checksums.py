"""Damage to what describes the data, `dataset.yaml` and each `zarr.json`: refused with a hint, or the data are what they were."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import xarray as xr
from mutations import survive

from cabinpose.app.cli import main
from cabinpose.core.errors import DatasetError
from cabinpose.store import create_dataset, open_dataset, read_manifest
from cabinpose.store.schema import checksum, manifest_yaml

PART = "part-00001.zarr"
FILES = ["dataset.yaml", f"{PART}/zarr.json", f"{PART}/joints_3d/zarr.json", f"{PART}/depth/zarr.json"]


def strip_checksums(folder: Path) -> None:
    """The dataset as it was written before there were checksums of `dataset.yaml` and `zarr.json`."""
    (folder / "dataset.yaml").write_text(manifest_yaml(read_manifest(folder)))
    for path in folder.glob("part-*.zarr/zarr.json"):
        text = re.sub(r'\n *"(checksum|dataset)": .*', "", path.read_text(), count=2)
        path.write_text(re.sub(r'\n *"chunk_crc32c": \{[^}]*\},', "", text))


@pytest.fixture(params=["sealed", "old"])
def copy(request: pytest.FixtureRequest, dataset_folder: Path, tmp_path: Path) -> Path:
    folder = tmp_path / request.param
    shutil.copytree(dataset_folder, folder)
    if request.param == "old":
        strip_checksums(folder)
    return folder


def damaged(data: bytes, step: int) -> Iterator[bytes]:
    """`data` with one bit flipped, or cut off, at every `step`-th byte."""
    for at in range(0, len(data), step):
        yield data[:at] + bytes([data[at] ^ 1 << at % 8]) + data[at + 1 :]
        yield data[:at]


def opened(folder: Path) -> xr.Dataset | None:
    """All values of a dataset; None where it is refused with a hint."""
    try:
        return open_dataset(folder, missing="raise").load()
    except DatasetError as error:
        if error.hint is None:
            raise
        return None


@pytest.mark.parametrize("name", FILES)
def test_every_damage_is_refused_or_harmless(copy: Path, name: str) -> None:
    truth, path = opened(copy), copy / name
    assert truth is not None
    data = path.read_bytes()
    harmless = refused = 0
    for changed in damaged(data, 53 if len(data) < 4000 else 997):
        path.write_bytes(changed)
        found = opened(copy)
        if found is None:
            refused += 1
            continue
        harmless += 1
        assert found.drop_attrs().identical(truth.drop_attrs()), changed
        if copy.name == "sealed":
            assert changed.split() == data.split()  # white space alone
    assert refused > 20
    assert harmless < refused


@pytest.mark.slow
def test_a_manifest_that_was_cut_is_refused_at_every_byte(copy: Path) -> None:
    path = copy / "dataset.yaml"
    text = path.read_text()
    assert opened(copy) is not None
    for size in range(len(text.rstrip())):
        path.write_text(text[:size])
        assert opened(copy) is None, size


@pytest.mark.parametrize(("name", "dimension"), [("lwrist", "joint"), ("driver", "person")])
def test_a_renamed_joint_or_place_is_refused(copy: Path, name: str, dimension: str) -> None:
    path = copy / "dataset.yaml"
    text = path.read_text()
    assert len(re.findall(rf"\b{name}\b", text)) == 1
    path.write_text(re.sub(rf"\b{name}\b", name[:-1] + "x", text))
    said = "was changed or damaged" if copy.name == "sealed" else f"do not agree on the names of {dimension}"
    with pytest.raises(DatasetError, match=said):
        open_dataset(copy)
    path.write_text(text)
    open_dataset(copy)


def test_a_renamed_class_of_an_old_dataset_is_refused(copy: Path) -> None:
    path = copy / "dataset.yaml"
    path.write_text(path.read_text().replace("torso_left", "torso_lift"))
    with pytest.raises(DatasetError, match="was changed or damaged" if copy.name == "sealed" else "classes of labels"):
        open_dataset(copy)


def test_a_change_on_purpose_has_a_way(copy: Path) -> None:
    path = copy / "dataset.yaml"
    path.write_text(path.read_text().replace("CC0-1.0", "CC-BY-4.0"))
    if copy.name == "sealed":
        with pytest.raises(DatasetError, match=r"checksum of its content is sha256:") as error:
            read_manifest(copy)
        right = re.findall(r"sha256:[0-9a-f]{16}", str(error.value))[0]
        path.write_text(re.sub(r"checksum: .*", f"checksum: {right}", path.read_text()))
    assert read_manifest(copy).licence == "CC-BY-4.0"
    assert opened(copy) is not None


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a crash is looked for in a process of its own")
@pytest.mark.parametrize("count", [30, pytest.param(150, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FILES[:3])
def test_damage_of_many_kinds_is_borne(copy: Path, name: str, count: int, tmp_path: Path) -> None:
    truth, original = opened(copy), (copy / name).read_bytes()
    assert truth is not None

    def read(path: Path) -> None:
        (copy / name).write_bytes(path.read_bytes())
        found = open_dataset(copy, missing="ignore").load()
        if copy.name == "sealed":
            assert found.drop_attrs().identical(truth.drop_attrs())

    done = survive(read, original, tmp_path / "damaged", Path(name).suffix, count=count)
    assert done.refused > 2 * count / 3


def test_checksums_are_needed_once_there_are_some(dataset_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(dataset_folder, folder)
    (folder / "dataset.yaml").write_text(manifest_yaml(read_manifest(folder)))
    with pytest.raises(DatasetError, match="has lost its checksum"):
        open_dataset(folder)


@pytest.mark.parametrize("verb", ["info", "info --verify", "view", "evaluate", "export"])
def test_every_verb_refuses_damaged_metadata(copy: Path, tmp_path: Path, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "answers.jsonl").write_text("")
    out = str(tmp_path / "out")
    rest = {
        "view": ["--out", out],
        "evaluate": ["--predictions", str(tmp_path / "answers.jsonl"), "--out", out],
        "export": ["--out", out],
    }
    word, *flags = verb.split()
    command = [word, *(["coco"] if word == "export" else []), str(copy), *flags, *rest.get(word, [])]
    path = copy / PART / "zarr.json"
    text = path.read_text()
    for changed in (text[: len(text) // 2], text.replace('"shape"', '"shapf"', 1), "[]", '{"attributes": {"schema_version": 1}}'):
        path.write_text(changed)
        assert main(command) == 2
        said = capsys.readouterr().err
        assert PART in said
        assert "hint:" in said
        assert "Traceback" not in said


def test_old_datasets_are_read_and_verify_says_what_it_cannot_vouch_for(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(copy), "--verify"]) == 0
    said = capsys.readouterr().out
    assert "all checksums are right" in said
    assert ("dataset.yaml and 3 of 3 parts were written without a checksum" in said) == (copy.name == "old")
    assert main(["info", str(copy), "--verify", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["checksum"] is None, told["parts_without_checksum"]) == ((True, 3) if copy.name == "old" else (False, 0))


def test_an_old_dataset_is_resumed(spheres: ModuleType, copy: Path, dataset_folder: Path) -> None:
    """What is missing is made with checksums, what is there stays as it is."""
    shutil.rmtree(copy / PART)
    kept = (copy / "part-00000.zarr" / "zarr.json").read_bytes()
    spheres.write(copy, spheres.manifest(), resume=True)
    assert (copy / "dataset.yaml").read_bytes() == (dataset_folder / "dataset.yaml").read_bytes()
    assert (copy / PART / "zarr.json").read_bytes() == (dataset_folder / PART / "zarr.json").read_bytes()
    assert (copy / "part-00000.zarr" / "zarr.json").read_bytes() == kept
    assert open_dataset(copy).attrs["parts_without_checksum"] == (2 if copy.name == "old" else 0)
    create_dataset(copy, spheres.manifest(), resume=True).close()


def test_the_checksum_is_that_of_the_lines_before_it(dataset_folder: Path) -> None:
    lines = (dataset_folder / "dataset.yaml").read_text().splitlines(keepends=True)
    assert lines[-1] == f"checksum: {checksum(''.join(lines[:-1]))}\n"


@pytest.mark.slow
def test_every_file_of_a_part_is_compared(dataset_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of each file, the numbers of the frames among them, a byte that differs is found by `info --verify`."""
    folder = tmp_path / "copy"
    shutil.copytree(dataset_folder, folder)
    files = [path for path in sorted((folder / PART).rglob("*")) if path.is_file()] + [folder / "dataset.yaml"]
    assert folder / PART / "frame/c/0" in files
    assert main(["info", str(folder), "--verify"]) == 0
    for path in files:
        sound = path.read_bytes()
        at = 20 if len(sound) > 25 else 1
        path.write_bytes(sound[:at] + bytes([sound[at] ^ 1]) + sound[at + 1 :])
        assert main(["info", str(folder), "--verify"]) == 2, path
        path.write_bytes(sound)
    whole = (folder / "dataset.yaml").read_bytes()
    (folder / "dataset.yaml").write_bytes(whole[:-1])
    capsys.readouterr()
    assert main(["info", str(folder), "--verify"]) == 2
    assert "dataset.yaml is cut off" in capsys.readouterr().err


def test_a_manifest_of_too_many_joints_is_refused_at_once(dataset_folder: Path, tmp_path: Path) -> None:
    text = manifest_yaml(read_manifest(dataset_folder))
    at, end = text.index("joints:"), text.index("variables:")
    names = "".join(f"- joint_{i}\n" for i in range(100_000))
    (tmp_path / "dataset.yaml").write_text(text[:at] + "joints:\n" + names + text[end:])
    began = time.process_time()
    with pytest.raises(DatasetError, match="joints: must have at most 1000 items"):
        read_manifest(tmp_path)
    assert time.process_time() - began < 2  # it took 14 s
