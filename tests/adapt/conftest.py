"""Fixtures of the tests of adaptation: the sphere people of the store's tests serve as frames."""

from __future__ import annotations

import sys
from pathlib import Path

for folder in ("estimate", "store"):
    sys.path.insert(0, str(Path(__file__).parents[1] / folder))
