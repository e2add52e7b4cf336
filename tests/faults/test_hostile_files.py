"""Foreign files that are damaged on purpose end in words: see `foreign`. The corpus holds files that once did not."""

from __future__ import annotations

import os
import time
import typing
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from foreign import READERS, borne, damaged

from cabinpose.core.errors import CabinposeError
from cabinpose.record.sources import SOURCES
from cabinpose.scene.cabin.meshfile import SUFFIXES
from cabinpose.store.convert import FORMATS

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="a crash is looked for in a process of its own")
CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())
SLOW = {  # more than 5 ms a file, or a second to begin
    "c3d", "xdf", "adtfdat", "azure-mkv", "rosbag2", "configuration", "onnx", "onnx style", "onnx weights", "itop depth",
    "ntu depth", "ticam depth", "ticam mask", "coco pictures", "coco masks", "coco-labels", "png-json", "png-json classes",
    "png-json pose", "png-json labels", "checkpoint", "vgg19", "training", "npz walks", "npz dpm", "source azure_mkv",
    "classes chunk", "folder mat",
}  # fmt: skip
MANY = {name: 40 if name in SLOW else 200 for name in READERS} | {
    "azure-mkv": 20, "adtfdat": 30, "source azure_mkv": 10, "npz dpm": 20, "vgg19": 20,
}  # fmt: skip
GOES_ON = {"azure-mkv", "mcap", "source replay", "source azure_mkv"}  # after damage, and says what is left out
DEVICES = {  # sources with a path that is no file of somebody's: what stands there
    "simulated": "a dataset", "synth": "a configuration", "bta": "a file of the vendor's library",
    "genicam": "the vendor's library", "stepper": "a serial line", "mt": "a serial line",
    "v4l2": "a device of the kernel",
}  # fmt: skip


@pytest.mark.parametrize("name", [name for name in READERS if name not in SLOW])
def test_damaged_files_end_in_words(name: str, tmp_path: Path) -> None:
    """A few of each, none of which takes a second; `faults` has thousands."""
    found = borne(name, tmp_path, count=12, seed=8)
    assert found.read + found.refused == 12


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize("name", READERS)
def test_many_damaged_files_end_in_words(name: str, tmp_path: Path) -> None:
    """Within 2 GB and 20 s of processor time each, which `survive` compares."""
    found = borne(name, tmp_path, count=MANY[name], seed=2)
    assert found.read + found.refused == MANY[name]
    assert found.refused > 0 or name in GOES_ON


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow, pytest.mark.faults] * ("endless" in path.stem))
        for path in CORPUS
    ],
)
def test_what_once_failed(path: Path, tmp_path: Path) -> None:
    name = max((name for name in READERS if path.stem.startswith(f"{name.replace(' ', '_')}-")), key=len)
    began = time.process_time()
    with suppress(CabinposeError):
        READERS[name].read(tmp_path)(path)
    assert time.process_time() - began < 5


def test_every_reader_has_its_row() -> None:
    """A new format, or a new source that plays files, is not forgotten."""
    first = {name.partition(" ")[0] for name in READERS}
    assert {name for name, form in FORMATS.items() if form.can("read")} <= first
    sources = {kind for kind, source in SOURCES.items() if "Path" in str(typing.get_type_hints(source.Settings))}
    assert sources == DEVICES.keys() | {name.removeprefix("source ") for name in READERS if name.startswith("source ")}
    assert {suffix.removeprefix(".") for suffix in SUFFIXES} <= first
    assert MANY.keys() == READERS.keys() >= SLOW


def test_faults_know_where_lengths_are(tmp_path: Path) -> None:
    """A quarter and more of the files differ in lengths alone, and half of what has checksums is damaged under right ones."""
    rng = np.random.default_rng(0)
    for name in ("mcap", "glb", "npz frames"):
        foreign = READERS[name]
        folder = tmp_path / name
        folder.mkdir()
        data = foreign.make(folder)
        places = foreign.lengths(data)
        assert len(places) > 3
        assert all(0 <= at < at + size <= len(data) for at, size in places)
        files = {damaged(data, rng, foreign, places) for _ in range(60)}
        assert len(files) > 40
        assert sum(len(file) == len(data) for file in files) > 5
