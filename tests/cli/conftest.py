"""Fixtures of the command line's tests: the sphere people of the store's tests."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import get_args

import pytest

from cabinpose.app.cli import VERBS, output, verb_module
from cabinpose.app.cli.commands import Choices


def _load_sphere_people() -> ModuleType:
    path = Path(__file__).parents[1] / "store" / "sphere_people.py"
    spec = importlib.util.spec_from_file_location("cli_sphere_people", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


sys.path.insert(0, str(Path(__file__).parents[1] / "cabin"))  # presets as mesh files
sys.path.insert(0, str(Path(__file__).parents[1] / "store"))  # files of other tools


@pytest.fixture(autouse=True)
def _no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """However slow the machine, progress is not among what a command says; tests of it set these times themselves."""
    monkeypatch.setattr(output, "QUIET_S", 3600.0)


@pytest.fixture(scope="session")
def spheres() -> ModuleType:
    return _load_sphere_people()


@pytest.fixture(scope="session")
def dataset_folder(tmp_path_factory: pytest.TempPathFactory, spheres: ModuleType) -> Path:
    """Five frames in three parts; read only."""
    return spheres.write(tmp_path_factory.mktemp("spheres") / "dataset", spheres.manifest())


@pytest.fixture(scope="session")
def helps() -> list[tuple[str, ...]]:
    """Every verb, and every verb of a verb."""
    found: list[tuple[str, ...]] = []
    for verb in VERBS:
        command = verb_module(verb).COMMAND
        inner = command.names() if isinstance(command, Choices) else [each.__metadata__[0].name for each in get_args(command)]
        found += [(verb, name) for name in inner] or [(verb,)]
    return found
