"""Rules of this tree that no linter knows: run by `make lint`, with one line for each breach.

A file carries no absolute path of somebody's machine and no package index address; nothing is left unfinished; no line ends in
blanks and every file in a new line; no file is larger than 10 MB; a module stays below 500 lines; randomness is the required
keyword `rng`; what makes datasets leaves products and elementary functions to `core.reproducible`; a room takes of another what
its faces offer, and through them; no figure of the structure is larger than its row in `STRUCTURE`. With `--structure`, those
figures are all that is printed, with what each counts.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import faces
import grimp
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

MAX_LINES = 500
MAX_PARAMETERS = 7
FEW_LINES = 25
# What each figure of the structure may be at most. One that has come down is written down here, so that it stays there.
STRUCTURE = {
    "functions with more than 7 parameters": 0,
    "Python modules under 25 lines of code": 41,
    "modules under 25 lines of code, with C++": 64,
    "import circles": 0,
    "names of classes that stand twice": 35,
    "lines of code in src and benchmarks": 75_310,
}
# Rooms whose results are the same bits on every processor, and what in them is no part of a dataset, with the reason.
SAME_BITS = ("core", "scene", "synth")
ANY_BITS = {
    "core/reproducible.py": "is what the others use",
    "core/intrinsics.py": "fits lenses to measured rays",
    "scene/sensor/noise_fit.py": "fits a sensor to recordings",
    "scene/sensor/walls.py": "the same",
    "scene/cabin/find_seats.py": "drafts a car's file, which is kept",
    "scene/cabin/find_wheel.py": "the same",
    "scene/cabin/car_draft.py": "the same",
    "scene/cabin/mesh_parts.py": "the same",
    "synth/style/": "networks of torch, which promise nothing",
}
_ELEMENTARY = re.compile(
    r"(np|math)\.(a?(sin|cos|tan)|arc\w+|atan2|exp2?|expm1|log(10|2|1p|addexp)?|pow(er)?|hypot|\w+h|cbrt|dist|dot|vdot|inner|matmul|tensordot|convolve"
    r"|correlate|cov|corrcoef|polyfit|roots|partition|argpartition)|np\.linalg\.(?!norm$|LinAlgError$)\w+"
)
_SILENT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
MAX_BYTES = 10_000_000
LONG_MODULES: dict[str, str] = {  # path -> why it is one module nevertheless
    "src/cabinpose/synth/posture/places.py": "a class for each place of a hand, side by side",
    "src/cabinpose/synth/config.py": "every key of `synth` with what it means, side by side",
}

MACHINE_PATH = re.compile(r"(?<![\w.~/}-])/(?:home|Users|root|work|tmp|mnt|media|srv)/[\w.]|[A-Z]:\\Users", re.ASCII)
INDEX_ADDRESS = re.compile(
    r"--(?:extra-)?index-url|--find[-]links|index[-_]url\s*=|://[^\s\"')>]*(?:/simple/|pypi|artifactory|nexus|jfrog)",
    re.I,
)
UNFINISHED = re.compile(r"\b(?:TO" + r"DO|FIX" + r"ME|XX" + r"X)\b")  # in two pieces, or this file would be in breach itself
TEXT_RULES = (
    (MACHINE_PATH, "an absolute path of one machine"),
    (INDEX_ADDRESS, "a package index address"),
    (UNFINISHED, "unfinished work"),
)


def text_breaches(name: str, text: str) -> Iterator[str]:
    """Breaches of the rules on plain text, as `name:line: what`."""
    for number, line in enumerate(text.splitlines(), 1):
        for pattern, what in TEXT_RULES:
            if found := pattern.search(line):
                yield f"{name}:{number}: {what}: {found.group().strip()}"
        if line != line.rstrip():
            yield f"{name}:{number}: blanks at the end of the line"
        if name.startswith("requirements") and "://" in line:
            yield f"{name}:{number}: a lock file names versions, not addresses"
    if text and not text.endswith("\n"):
        yield f"{name}:{text.count(chr(10)) + 1}: no new line at the end of the file"


def module_breaches(name: str, text: str) -> Iterator[str]:
    """Breaches of the rules on a module of the package."""
    lines = len(text.splitlines())
    if lines > MAX_LINES and name not in LONG_MODULES:
        yield f"{name}:1: {lines} lines; split it, or give the reason in tools/check_tree.py"
    for node in ast.walk(ast.parse(text, name)):
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield from (f"{name}:{node.lineno}: {node.name}: {breach}" for breach in _rng_breaches(node.args))


def _rng_breaches(args: ast.arguments) -> Iterator[str]:
    if any(arg.arg == "rng" for arg in args.args + args.posonlyargs):
        yield "`rng` is a keyword: put it after `*`"
    for arg, default in zip(args.kwonlyargs, args.kw_defaults, strict=True):
        if arg.arg == "rng" and default is not None:
            yield "`rng` is required: no default"


def arithmetic_breaches(name: str, text: str) -> Iterator[str]:
    """Products, elementary functions and orders that differ between processors, in a module of what makes datasets."""
    within = name.removeprefix("src/cabinpose/")
    if not within.startswith(tuple(f"{room}/" for room in SAME_BITS)) or within.startswith(tuple(ANY_BITS)):
        return
    for node in ast.walk(ast.parse(text, name)):
        match node:
            case ast.BinOp(op=ast.MatMult()):
                what = "@"
            case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=2)) | ast.BinOp(op=ast.Pow(), left=ast.Constant()):
                continue
            case ast.BinOp(op=ast.Pow()):
                what = "**"
            case ast.Call(func=ast.Attribute()) if _ELEMENTARY.fullmatch(ast.unparse(node.func)):
                what = ast.unparse(node.func)
            case ast.Call(func=ast.Attribute(attr="norm"), args=[_], keywords=[]) if ast.unparse(node.func) == "np.linalg.norm":
                what = "np.linalg.norm without an axis"
            case ast.Call(func=ast.Attribute(attr="argsort"), keywords=keywords) if "kind" not in {k.arg for k in keywords}:
                what = "argsort that is not stable"
            case _:
                continue
        yield f"{name}:{node.lineno}: {what}: its result differs between processors; use cabinpose.core.reproducible"


def face_breaches(name: str, text: str, offered: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Imports of another room past its faces; offered: the names of each face. The package's own face may use `app`."""
    own = name.split("/")[2] if name.startswith("src/cabinpose/") and name.count("/") > 2 else None
    for line, module, imported in faces.imports(text) if own else ():
        if module == "cabinpose":
            module, imported = f"cabinpose.{imported}", ""
        top, _, rest = module.partition(".")
        if top != "cabinpose" or rest.split(".")[0] in ("", "__version__", "_native", own):
            continue
        if imported not in offered.get(module, ()):
            yield f"{name}:{line}: {module} {imported}: of another room, only names in the `__init__.pyi` of its folders"


def tracked_files(root: Path) -> list[str]:
    """Paths of the files under version control, relative to the root."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, check=True, capture_output=True, text=True).stdout
    return [name for name in listed.split("\0") if name and (root / name).is_file()]


def code_lines(name: str, text: str) -> int:
    """Lines of code of a file in Python or C++: those with more than docstrings, comments, imports or nothing."""
    if name.endswith((".cpp", ".hpp")):
        lines = (line.strip() for line in text.splitlines())
        return sum(bool(line) and not line.startswith(("//", "#include")) for line in lines)
    if not name.endswith(".py"):
        return 0
    without: set[int] = set()
    for node in ast.walk(ast.parse(text, name)):
        left_out = [node] if isinstance(node, ast.Import | ast.ImportFrom) else []
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            left_out += [x for x in node.body if isinstance(x, ast.Expr) and isinstance(x.value, ast.Constant)]
        without |= {line for each in left_out for line in range(each.lineno, (each.end_lineno or each.lineno) + 1)}
    said = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in _SILENT
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(said - without)


def parameters(args: ast.arguments) -> int:
    """How many parameters a function has, without `self` and `cls`."""
    names = [arg.arg for arg in args.posonlyargs + args.args + args.kwonlyargs]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def circles(source: Path) -> list[list[str]]:
    """Modules of the package that import each other, directly or through others, wherever the import stands in them.

    The package's own face, which offers what `app` has and loads it when it is asked for, ties no circle.
    """
    sys.path.insert(0, str(source))
    graph = grimp.build_graph("cabinpose", cache_dir=None)
    modules = sorted(graph.modules - {"cabinpose"})
    at = {module: i for i, module in enumerate(modules)}
    pairs = [(i, at[to]) for module, i in at.items() for to in graph.find_modules_directly_imported_by(module) if to in at]
    arrows = coo_array((np.ones(len(pairs)), np.array(pairs).T), shape=(len(modules), len(modules)))
    _, group = connected_components(arrows, connection="strong")
    members = [[modules[i] for i in np.flatnonzero(group == number)] for number in range(group.max() + 1)]
    return [found for found in members if len(found) > 1]


def structure(root: Path) -> Iterator[tuple[str, list[str], int]]:
    """The figures of the structure: name, what was counted, figure; in the order of `STRUCTURE`."""
    wide: list[str] = []
    small: list[str] = []
    classes: Counter[str] = Counter()
    lines = 0
    for name in tracked_files(root):
        if not name.startswith(("src/", "benchmarks/")) or not name.endswith((".py", ".cpp", ".hpp")):
            continue
        text = (root / name).read_text(encoding="utf-8")
        code = code_lines(name, text)
        lines += code
        if not name.startswith("src/"):
            continue
        if code < FEW_LINES and not name.endswith("__init__.py"):
            small.append(name)
        for node in ast.walk(ast.parse(text, name)) if name.endswith(".py") else ():
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and parameters(node.args) > MAX_PARAMETERS:
                wide.append(f"{name}:{node.lineno} {node.name}: {parameters(node.args)}")
            if isinstance(node, ast.ClassDef):
                classes[node.name] += 1
    python = [name for name in small if name.endswith(".py")]
    tied = [" ".join(found) for found in circles(root / "src")]
    twice = sorted(name for name, times in classes.items() if times > 1)
    counted = (wide, python, small, tied, twice)
    yield from ((name, found, len(found)) for name, found in zip(STRUCTURE, counted, strict=False))
    yield (*STRUCTURE,)[-1], [], lines


def main() -> int:
    """Print every breach and the figures of the tree, or with `--structure` what they count; 1 if there is a breach."""
    root = Path(__file__).resolve().parent.parent
    figures = list(structure(root))
    if sys.argv[1:] == ["--structure"]:
        for name, found, figure in figures:
            print(f"{name}: {figure}", *found, sep="\n  ")
        return 0
    breaches = [
        f"tools/check_tree.py:1: {name}: {figure}, and {STRUCTURE[name]} at most; --structure lists them"
        for name, _, figure in figures
        if figure > STRUCTURE[name]
    ]
    offered = faces.faces(root / "src")
    for name in tracked_files(root):
        data = (root / name).read_bytes()
        if len(data) > MAX_BYTES:
            breaches.append(f"{name}:1: {len(data)} bytes; the most is {MAX_BYTES}")
        if b"\0" in data or ".zarr/" in name:  # binary, or as zarr writes it
            continue
        text = data.decode("utf-8")
        breaches += text_breaches(name, text)
        if name.startswith(("src/", "benchmarks/")) and name.endswith(".py"):
            breaches += [*module_breaches(name, text), *face_breaches(name, text, offered), *arithmetic_breaches(name, text)]
    print("\n".join(breaches) or "The tree keeps its rules.")
    print(*(f"{figure} {name}" for name, _, figure in figures), sep="\n")
    return 1 if breaches else 0


if __name__ == "__main__":
    sys.exit(main())
