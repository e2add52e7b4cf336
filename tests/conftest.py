"""Fixtures that every room's tests share."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

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
