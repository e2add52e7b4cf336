"""Fixtures of the store's tests: the dataset of sphere people, without a package around the tests."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import sphere_people


@pytest.fixture(scope="session")
def spheres() -> ModuleType:
    return sphere_people


@pytest.fixture(scope="session")
def dataset_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames in three parts; read only."""
    return sphere_people.write(tmp_path_factory.mktemp("spheres") / "dataset", sphere_people.manifest())
