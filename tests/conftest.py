"""Fixtures that every room's tests share."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from cabinpose.app.cli import main

REAL_DATA = "CABINPOSE_REAL_DATA"


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """`real_data("mocap/cmu_131_01.bvh")` is the file's path; skips without the variable, fails where a file is missing."""

    def find(name: str) -> Path:
        root = os.environ.get(REAL_DATA)
        if not root:
            pytest.skip(f"needs real data: set {REAL_DATA} to the folder that holds it ({name})")
        path = Path(root) / name
        if not path.exists():
            pytest.fail(f"{REAL_DATA} is set, but {path} does not exist", pytrace=False)
        return path

    return find


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """`run("info", folder)`: exit code, stdout and stderr of a command."""

    def call(*arguments: object) -> Outcome:
        try:
            code = main([str(a) for a in arguments])
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return call
