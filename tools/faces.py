"""The rooms' public names, as their stubs list them: what `docs/api` shows, and what other rooms may import.

A face is a package of the tree with an `__init__.pyi`, one line a name: `from .module import Name as Name`.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

SOURCE = Path(__file__).resolve().parent.parent / "src"
NATIVE = "cabinpose._native"  # the kernels: their stubs are types, no face
_LONGEST = 60  # characters of a constant's value on a page


class Constant(NamedTuple):
    """A public name that is no function and no class: its value as it is written, and the comment on it."""

    value: str
    comment: str

    @property
    def shown(self) -> str:
        """The value where it is short enough for a page, else ""."""
        return self.value if len(self.value) <= _LONGEST else ""


def faces(source: Path = SOURCE) -> dict[str, dict[str, str]]:
    """By face, its names and the module that defines each: `{"cabinpose.store": {"Manifest": "cabinpose.store.schema"}}`."""
    found = {}
    for stub in sorted(source.glob("cabinpose/**/__init__.pyi")):
        face = ".".join(stub.parent.relative_to(source).parts)
        if face != NATIVE:
            tree = ast.parse(stub.read_text(encoding="utf-8"), str(stub))
            lines = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
            # `from . import module as module` offers a module whole.
            pairs = [(line.module, alias.name) for line in lines for alias in line.names]
            found[face] = {name: f"{face}.{module or name}" for module, name in pairs}
    return found


def page(room: str, source: Path = SOURCE) -> str:
    """The Markdown of all names of a room ("cabinpose.store"), for mkdocstrings: by face, then by module."""
    return "\n\n".join(
        _section(face, names, source) for face, names in faces(source).items() if face == room or face.startswith(f"{room}.")
    )


def _section(face: str, names: Mapping[str, str], source: Path) -> str:
    parts = [f"## {face} {{ #{face} }}", _docstring(_text(face, source))]
    for module in dict.fromkeys(names.values()):
        text = _text(module, source)
        mine = [name for name, place in names.items() if place == module]
        known = constants(text)
        parts += [f"### {module.removeprefix(f'{face}.')} {{ #{module} }}", _docstring(text)]
        parts += [f"::: {face}.{name}\n    options:\n      heading_level: 4" for name in mine if name not in known]
        if rows := [_row(face, name, known[name]) for name in mine if name in known]:
            parts.append("\n".join(("| name | value | |", "|---|---|---|", *rows)))
    return "\n\n".join(parts)


def _row(face: str, name: str, constant: Constant) -> str:
    value = f"`{constant.shown}`".replace("|", "\\|") if constant.shown else ""
    return f'| <span id="{face}.{name}">`{name}`</span> | {value} | {constant.comment} |'


@cache
def constants(text: str) -> dict[str, Constant]:
    """The names of a module to which it assigns something at its top level.

    The comment is the string below the assignment, or what is written behind it or in the lines before it.
    """
    lines = text.splitlines()
    body: list[ast.stmt] = []
    for statement in ast.parse(text).body:
        body += [*statement.orelse, *statement.body] if isinstance(statement, ast.If) else [statement]
    found = {}
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
            comment = " ".join(after.value.value.split())
        else:
            comment = _comment(lines, node.lineno - 1, (node.end_lineno or node.lineno) - 1)
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        pairs = [(target, node.value)]
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            pairs = list(zip(target.elts, node.value.elts, strict=True))
        for name, value in pairs:
            if isinstance(name, ast.Name):
                found[name.id] = Constant(" ".join((ast.get_source_segment(text, value) or "").split()), comment)
    return found


def _comment(lines: list[str], first: int, last: int) -> str:
    """The comment behind the first or the last line of a statement, else that in the lines before it."""
    for at in dict.fromkeys((first, last)):
        _, mark, behind = lines[at].partition("  # ")
        if mark and not behind.startswith(("fmt:", "noqa", "type:")):
            return behind.split("  # ")[0]
    before: list[str] = []
    while first and lines[first - 1].startswith("# "):
        first -= 1
        before.insert(0, lines[first].removeprefix("# "))
    return " ".join(before)


@cache
def _docstring(text: str) -> str:
    """The first paragraph of a module's docstring."""
    told = ast.get_docstring(ast.parse(text)) or ""
    return told.partition("\n\n")[0]


def file_of(module: str, source: Path = SOURCE) -> Path:
    """The file of a module or package."""
    place = source.joinpath(*module.split("."))
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")


def _text(module: str, source: Path) -> str:
    return file_of(module, source).read_text(encoding="utf-8")


def imports(text: str) -> Iterator[tuple[int, str, str]]:
    """Every import of this package in a module, wherever it stands: line, module, and name; "" for `import module`."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((node.lineno, node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name, "") for alias in node.names)
