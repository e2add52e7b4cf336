"""Fixtures of the estimation's tests; the sphere people of the store's tests serve as dataset."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

for folder in (Path(__file__).parent, Path(__file__).parents[1] / "store"):
    sys.path.insert(0, str(folder))


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> None:
    """Tiny networks lose more by threads than they win, and other work shares the cores."""
    torch.set_num_threads(1)
