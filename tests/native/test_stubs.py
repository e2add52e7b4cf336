"""The committed stubs say what the extension takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_stubs_are_those_of_the_extension(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(ROOT / "tools" / "make_stubs.py"), str(tmp_path)], check=True)
    for made in sorted(tmp_path.glob("*.pyi")):
        committed = ROOT / "src" / "cabinpose" / "_native" / made.name
        assert committed.read_text() == made.read_text(), f"{made.name}: run tools/make_stubs.py"
