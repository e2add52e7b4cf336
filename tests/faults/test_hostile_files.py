"""Foreign files that are damaged on purpose end in words: see `foreign`. The corpus holds files that once did not."""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from foreign import READERS, borne, damaged

from cabinpose.core.errors import CabinposeError

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="a crash is looked for in a process of its own")
CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())
SLOW = {"c3d", "xdf", "adtfdat", "azure-mkv", "rosbag2", "configuration", "onnx", "h5 depth"}  # more than 5 ms a file
MANY = {name: 100 if name in SLOW else 400 for name in READERS} | {"azure-mkv": 20, "adtfdat": 30}


@pytest.mark.parametrize("name", [name for name in READERS if name not in SLOW])
def test_damaged_files_end_in_words(name: str, tmp_path: Path) -> None:
    """A few of each; `faults` has thousands."""
    found = borne(name, tmp_path, count=12, seed=1)
    assert found.read + found.refused == 12


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize("name", READERS)
def test_many_damaged_files_end_in_words(name: str, tmp_path: Path) -> None:
    """Within 2 GB and 20 s of processor time each, which `survive` compares."""
    found = borne(name, tmp_path, count=MANY[name], seed=2)
    assert found.read + found.refused == MANY[name]
    assert found.refused > 0 or name in ("azure-mkv", "mcap")  # these go on, and say what they left out


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow, pytest.mark.faults] * ("endless" in path.stem))
        for path in CORPUS
    ],
)
def test_what_once_failed(path: Path, tmp_path: Path) -> None:
    name = re.split("-", path.stem, maxsplit=1)[0].replace("_", " ")
    began = time.process_time()
    with suppress(CabinposeError):
        READERS[name].read(tmp_path)(path)
    assert time.process_time() - began < 5


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
