"""What a reader copies from the pages passes mypy, as it is by default."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = re.compile(r"^```python(?: run)?\n(.*?)^```$", re.M | re.S)
# Pages whose code begins from nothing; on others a block goes on with what only its text tells.
PAGES = ("README", "docs/index", "docs/five-minutes", "docs/scenes", "docs/style", "docs/training", "docs/guides/own-camera",
         "docs/guides/own-detector")  # fmt: skip


def mypy(*files: Path) -> str:
    """What mypy says of files; nothing where it is content."""
    flags = ("--config-file=", "--ignore-missing-imports", "--follow-imports=silent", "--no-error-summary")
    command = [sys.executable, "-m", "mypy", *flags, "--cache-dir", os.devnull, *map(str, files)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False).stdout


@pytest.mark.slow
def test_code_of_the_pages_has_right_types(tmp_path: Path) -> None:
    files = []
    for page in PAGES:
        blocks = PYTHON.findall((ROOT / f"{page}.md").read_text("utf-8"))
        assert blocks, f"{page}.md has no Python any more"
        files.append(tmp_path / f"{page.replace('/', '_').replace('-', '_')}.py")
        files[-1].write_text("\n".join(blocks), "utf-8")
    files.append(tmp_path / "wrong.py")
    files[-1].write_text("import cabinpose\ncabinpose.open('x').depth\n", "utf-8")  # the check is one
    told = mypy(*files).splitlines()
    assert [line for line in told if "wrong.py" not in line] == []
    assert any("union-attr" in line for line in told)
