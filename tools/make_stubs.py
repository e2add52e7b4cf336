"""Type stubs of the compiled kernels, made from the extension itself: run after a kernel's signature changes.

    python tools/make_stubs.py [FOLDER]

FOLDER is where they are written, by default beside the extension's Python module, where mypy and editors find them.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tempfile
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "src" / "cabinpose" / "_native"
HEAD = """\"\"\"Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
\"\"\"

"""


def make_stubs(folder: Path) -> None:
    """One stub a room, and one of the package that names them."""
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, "-m", "nanobind.stubgen", "-q", "-r", "-m", "cabinpose._native._baseline", "-O", name]
        subprocess.run(command, check=True)
        rooms = {path.name: path.read_text(encoding="utf-8") for path in sorted((Path(name) / "_baseline").glob("*.pyi"))}
    rooms["__init__.pyi"] = "".join(f"from . import {room[:-4]} as {room[:-4]}\n" for room in rooms if room != "__init__.pyi")
    rooms["__init__.pyi"] += "\nSIMD: str\n"
    for name, text in rooms.items():
        # Tuples that are constants are of numbers; the stub generator says no more than that they are tuples.
        text = re.sub(r": tuple = ", ": tuple[float, ...] = ", text)
        rooms[name] = re.sub(r", order='C'|, device='cpu'", "", text)
    structs = {node.name: name for name, text in rooms.items() for node in _structs(text)}
    for name, text in rooms.items():
        (folder / name).write_text(HEAD + _with_structs(name, text, structs), encoding="utf-8")
    options = ["-q", "--isolated", "--config", "line-length=130", str(folder)]
    for command in (["check", "--select", "I", "--fix"], ["format"]):
        subprocess.run([sys.executable, "-m", "ruff", *command, *options], check=True)


def _structs(text: str) -> list[ast.FunctionDef]:
    """The functions of a stub that stand for structs, their parameters for the fields: `describe` in core/bind.hpp."""
    return [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef) and node.name[0].isupper()]


def _with_structs(name: str, text: str, structs: dict[str, str]) -> str:
    """The stub of a room with a class for each of its structs, those of other rooms imported."""
    lines = text.splitlines()
    for node in reversed(_structs(text)):
        fields = [
            f"    @property\n    def {a.arg}(self) -> {ast.unparse(a.annotation)}: ..." for a in node.args.args if a.annotation
        ]
        lines[node.lineno - 1 : node.end_lineno] = [f"class {node.name}(Protocol):", *fields]
    used = [struct for struct in structs if re.search(rf"\b{struct}\b", text)]
    imports = ["from typing import Protocol"] if name in structs.values() else []
    imports += [f"from .{structs[struct][:-4]} import {struct}" for struct in used if structs[struct] != name]
    return "\n".join([*imports, *lines]) + "\n"


if __name__ == "__main__":
    make_stubs(Path(sys.argv[1]) if len(sys.argv) > 1 else PACKAGE)
