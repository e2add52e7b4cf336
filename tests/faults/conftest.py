"""The tests of faults use the sound files of others."""

from __future__ import annotations

import sys
from pathlib import Path

for _folder in ("faults", "store", "cli"):
    sys.path.insert(0, str(Path(__file__).parents[1] / _folder))
