"""Outputs of every command through kills, refusals of the disk, signals and second writers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import outputs
import pytest

LONG = {  # seconds each time: one call of each with every fault
    "train, lab": ("train", "lab", "export-onnx", "calibrate-confidence", "car-init", "calibrate", "align"),
    "car, style, experiment, mocap": ("car-check", "train-style", "experiment", "evaluate-mocap"),
}
REST = tuple(name for name in outputs.COMMANDS if not any(name in names for names in LONG.values()))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A folder that the first of these tests fills, with a session where it has a command that needs one."""
    return str(tmp_path_factory.mktemp("outputs") / "inputs")


@pytest.fixture(scope="module")
def tried(inputs: str) -> Iterator[Callable[..., tuple[bool, str]]]:
    """`tried("--most", "2", "view")`: whether all held, and what was said."""
    with outputs.serving() as ask:
        yield lambda *words: ask("--inputs", inputs, "--halves", *words)


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize("names", [*LONG.values(), REST], ids=[*LONG, "the rest"])
def test_outputs_are_whole_or_absent(names: tuple[str, ...], tried: Callable[..., tuple[bool, str]]) -> None:
    held, said = tried("--most", "2" if names is REST else "1", *names)
    assert held, said


@pytest.mark.slow
@pytest.mark.faults
def test_outputs_on_another_file_system_than_temporary_files(tmp_path: Path, tried: Callable[..., tuple[bool, str]]) -> None:
    """In memory; where temporary files are there, on the disk."""
    there = (Path(name) for name in ("/dev/shm", "/var/tmp"))
    others = [path for path in there if path.exists() and path.stat().st_dev != tmp_path.stat().st_dev]
    if not others:
        pytest.skip("needs /dev/shm")
    held, said = tried("--most", "2", "--on", str(others[0]), "synth", "train", "import-coco", "predict")
    assert held, said
