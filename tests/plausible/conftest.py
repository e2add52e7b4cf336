"""A true frame, and a model that answers it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

import cabinpose
from cabinpose.estimate import JointPredictor, load_model

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "store")]  # modules beside the tests


@pytest.fixture(scope="session")
def frame() -> dict[str, Any]:
    """People in a car; read only."""
    return next(cabinpose.generate("scene.cars=[suv]", frames=1, seed=4))


@pytest.fixture(scope="module")
def model() -> JointPredictor:
    """It warns once of each kind, so that modules have their own."""
    return load_model("in_car", threads=1)
