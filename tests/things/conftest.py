"""Makes the helpers of this folder and the exact contact test of `tools` importable; a car for its tests."""

import sys
from pathlib import Path

import pytest

from cabinpose.scene.cabin import Cabin, build_cabin
from cabinpose.scene.contact import ContactField

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(1, str(Path(__file__).parents[2] / "tools"))


@pytest.fixture(scope="session")
def suv() -> tuple[Cabin, ContactField]:
    """A car and its distance fields."""
    cabin = build_cabin("suv")
    return cabin, ContactField(cabin)
