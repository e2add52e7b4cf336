"""Fixtures of the command line's tests: the sphere people of the store's tests, and a way to run commands."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest

from cabinpose.app.cli import main


def _load_sphere_people() -> ModuleType:
    path = Path(__file__).parents[1] / "store" / "sphere_people.py"
    spec = importlib.util.spec_from_file_location("cli_sphere_people", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def spheres() -> ModuleType:
    return _load_sphere_people()


@pytest.fixture(scope="session")
def dataset_folder(tmp_path_factory: pytest.TempPathFactory, spheres: ModuleType) -> Path:
    """Five frames in three parts; read only."""
    return spheres.write(tmp_path_factory.mktemp("spheres") / "dataset", spheres.manifest())


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
