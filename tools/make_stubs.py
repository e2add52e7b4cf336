"""Type stubs of the compiled kernels, made from the extension itself: run after a kernel's signature changes.

    python tools/make_stubs.py [FOLDER]

FOLDER is where they are written, by default beside the extension's Python module, where mypy and editors find them.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "src" / "cabinpose" / "_native"
HEAD = '"""Made by tools/make_stubs.py from the extension."""\n\n'


def make_stubs(folder: Path) -> None:
    """One stub a room, and one of the package that names them."""
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, "-m", "nanobind.stubgen", "-q", "-r", "-m", "cabinpose._native._baseline", "-O", name]
        subprocess.run(command, check=True)
        rooms = {path.name: path.read_text(encoding="utf-8") for path in sorted((Path(name) / "_baseline").glob("*.pyi"))}
    rooms["__init__.pyi"] = "".join(f"from . import {room[:-4]} as {room[:-4]}\n" for room in rooms if room != "__init__.pyi")
    rooms["__init__.pyi"] += "\nSIMD: str\n"
    for path, text in rooms.items():
        # Tuples that are constants are of numbers; the stub generator says no more than that they are tuples.
        (folder / path).write_text(HEAD + re.sub(r": tuple = ", ": tuple[float, ...] = ", text), encoding="utf-8")
    subprocess.run(
        [sys.executable, "-m", "ruff", "format", "-q", "--isolated", "--config", "line-length=130", str(folder)], check=True
    )


if __name__ == "__main__":
    make_stubs(Path(sys.argv[1]) if len(sys.argv) > 1 else PACKAGE)
