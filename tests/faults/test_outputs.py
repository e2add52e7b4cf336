"""Outputs of every command through kills, refusals of the disk, signals and second writers."""

from __future__ import annotations

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


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize("names", [*LONG.values(), REST], ids=[*LONG, "the rest"])
def test_outputs_are_whole_or_absent(names: tuple[str, ...], inputs: str) -> None:
    done = outputs.preloaded(["--inputs", inputs, "--most", "2" if names is REST else "1", *names])
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.faults
def test_outputs_on_another_file_system_than_temporary_files(tmp_path: Path, inputs: str) -> None:
    other = Path("/dev/shm")
    if not other.exists() or other.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("needs /dev/shm")
    done = outputs.preloaded(["--inputs", inputs, "--most", "2", "--on", str(other), "synth", "train", "import-coco", "predict"])
    assert done.returncode == 0, done.stdout + done.stderr
