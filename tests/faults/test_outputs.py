"""Outputs of every command through kills, refusals of the disk, signals and second writers."""

from __future__ import annotations

import outputs
import pytest

LONG = ("train", "lab", "export-onnx", "calibrate-confidence", "car-init", "calibrate", "align")  # seconds each time


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize(("names", "most"), [(tuple(n for n in outputs.COMMANDS if n not in LONG), 3), (LONG, 2)])
def test_outputs_are_whole_or_absent(names: tuple[str, ...], most: int) -> None:
    done = outputs.preloaded(["--most", str(most), *names])
    assert done.returncode == 0, done.stdout + done.stderr
