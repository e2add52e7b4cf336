"""Each rule of tools/check_tree.py finds what it is there for, and nothing else."""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def check_tree() -> ModuleType:
    return importlib.import_module("check_tree")


@pytest.mark.parametrize(
    "line",
    [
        "open('/" + "home/somebody/x.npz')",
        "see /" + "tmp/out.png",
        "CACHE=/" + "root/.cache",
        "C:" + "\\Users\\x",
        "uv pip install --index" + "-url x",
        "https://example.org/" + "simple/numpy",
        "# TO" + "DO: later",
        "a word" + "  ",
    ],
)
def test_bad_lines_are_found(check_tree: ModuleType, line: str) -> None:
    assert len(list(check_tree.text_breaches("a.md", f"fine\n{line}\nfine\n"))) == 1
    assert next(iter(check_tree.text_breaches("a.md", f"fine\n{line}\n"))).startswith("a.md:2:")


def test_a_file_ends_in_a_new_line(check_tree: ModuleType) -> None:
    assert list(check_tree.text_breaches("a.md", "fine\nfine")) == ["a.md:2: no new line at the end of the file"]
    assert list(check_tree.text_breaches("a.md", "")) == []


@pytest.mark.parametrize(
    "line",
    [
        "shared/data/tof/x",
        "https://example.org/home/page",
        "the depth/range/work of a ray",
        "~/work/x",
        "--no-emit-index" + "-url",
        "XXXL",
    ],
)
def test_good_lines_pass(check_tree: ModuleType, line: str) -> None:
    assert list(check_tree.text_breaches("a.md", line + "\n")) == []


def test_a_lock_file_names_no_address(check_tree: ModuleType) -> None:
    assert list(check_tree.text_breaches("requirements.lock", "cabinpose @ file" + "://x\n"))
    assert not list(check_tree.text_breaches("requirements.lock", "numpy==2.4.6\n"))


@pytest.mark.parametrize(
    ("source", "breaches"),
    [
        ("def f(rng): ...", 1),
        ("def f(*, rng=None): ...", 1),
        ("def f(*, rng): ...", 0),
        ("class A:\n    def f(self, x, *, rng): ...", 0),
        ("def _f(rng): ...", 0),
        ("x = 1\n" * 501, 1),
        ("x = 1\n" * 500, 0),
    ],
)
def test_module_rules(check_tree: ModuleType, source: str, breaches: int) -> None:
    assert len(list(check_tree.module_breaches("src/cabinpose/a.py", source))) == breaches


def test_lines_of_code(check_tree: ModuleType) -> None:
    source = '"""Two\nlines."""\nimport os\n\n# why\ndef f(\n    x: int,\n) -> int:\n    """Doc."""\n    return x  # behind\n'
    assert check_tree.code_lines("a.py", source) == 4
    assert check_tree.code_lines("a.cpp", "#include <cmath>\n// why\n\nint f() {\n  return 1;\n}\n") == 3
    assert check_tree.code_lines("a.md", "words\n") == 0


def test_parameters(check_tree: ModuleType) -> None:
    function = ast.parse("def f(self, a, /, b, *args, c, d=1, **rest): ...").body[0]
    assert isinstance(function, ast.FunctionDef)
    assert check_tree.parameters(function.args) == 4


def test_structure(check_tree: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "src" / "cabinpose"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("from cabinpose import long\n")
    lines = "\n".join(f"x{i} = {i}" for i in range(30))
    (package / "long.py").write_text(
        f"from cabinpose import __init__\nclass Twice: ...\ndef f(a, b, c, d, e, f, g, h): ...\n{lines}\n"
    )
    (package / "one.py").write_text("def f():\n    from cabinpose.two import Twice\n")
    (package / "two.py").write_text("import cabinpose.three\nclass Twice: ...\n")
    (package / "three.py").write_text("from cabinpose.one import f\n")
    (package / "bodies.cpp").write_text("int f();\n")
    names = [str(path.relative_to(tmp_path)) for path in sorted(package.iterdir())]
    monkeypatch.setattr(check_tree, "tracked_files", lambda _: names)
    monkeypatch.setattr(check_tree, "circles", lambda _: [["cabinpose.one", "cabinpose.three", "cabinpose.two"]])
    found = {name: figure for name, _, figure in check_tree.structure(tmp_path)}
    assert list(found) == list(check_tree.STRUCTURE)
    assert list(found.values()) == [1, 3, 4, 1, 1, 32]  # a line of three points alone is none of code


def test_circles_wherever_the_import_stands(tmp_path: Path) -> None:
    package = tmp_path / "cabinpose"
    package.mkdir()
    (package / "__init__.py").write_text("from cabinpose import one\n")
    (package / "one.py").write_text("import cabinpose\ndef f():\n    from cabinpose.two import g\n")
    (package / "two.py").write_text("from cabinpose import three\n")
    (package / "three.py").write_text("from cabinpose.one import f\n")
    (package / "four.py").write_text("from cabinpose.one import f\n")
    code = "import sys; sys.path.insert(0, 'tools'); from check_tree import circles, Path; print(circles(Path(sys.argv[1])))"
    told = subprocess.run(  # without `site`: an editable installation would put the package itself first
        [sys.executable, "-S", "-c", code, str(tmp_path)], env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert told.strip() == "[['cabinpose.one', 'cabinpose.three', 'cabinpose.two']]"


OFFERED = {"cabinpose.scene": {}, "cabinpose.scene.cabin": {"Seat": "cabinpose.scene.cabin.model"}}


@pytest.mark.parametrize(
    "line",
    [
        "from cabinpose.scene.cabin.model import Seat",
        "from cabinpose.scene import Seat",
        "from cabinpose.scene import cabin",
        "from cabinpose.scene.cabin import _seat",
        "import cabinpose.scene.cabin",
        "from cabinpose import scene",
        "def f():\n    from cabinpose.app.cli import main",
        "if TYPE_CHECKING:\n    from cabinpose.scene.cabin.model import Seat",
    ],
)
def test_imports_past_a_face_are_found(check_tree: ModuleType, line: str) -> None:
    assert len(list(check_tree.face_breaches("src/cabinpose/synth/scene.py", line, OFFERED))) == 1


@pytest.mark.parametrize(
    "line",
    [
        "from cabinpose.scene.cabin import Seat",
        "from cabinpose.synth.streams import frame_rng",
        "from cabinpose._native import core",
        "import cabinpose",
        "from cabinpose import __version__",
        "import numpy as np",
    ],
)
def test_imports_through_a_face_and_of_the_own_room_are_none(check_tree: ModuleType, line: str) -> None:
    assert list(check_tree.face_breaches("src/cabinpose/synth/scene.py", line, OFFERED)) == []


def test_the_packages_own_face_is_of_app(check_tree: ModuleType) -> None:
    line = "from cabinpose.app.cli import main"
    assert list(check_tree.face_breaches("src/cabinpose/__main__.py", line, OFFERED)) == []


@pytest.mark.parametrize(
    "code",
    ["a @ b", "x ** 3", "x ** 0.5", "np.sin(x)", "math.atan2(y, x)", "np.linalg.inv(a)", "np.linalg.norm(a)", "np.argsort(a)",
     "np.partition(a, 3)", "np.arccos(x)", "np.log10(x)", "np.roots(p)"],
)  # fmt: skip
def test_what_differs_between_processors_is_found_where_datasets_are_made(check_tree: ModuleType, code: str) -> None:
    assert len(list(check_tree.arithmetic_breaches("src/cabinpose/synth/a.py", code))) == 1
    assert not list(check_tree.arithmetic_breaches("src/cabinpose/estimate/a.py", code))
    assert not list(check_tree.arithmetic_breaches("src/cabinpose/core/reproducible.py", code))


@pytest.mark.parametrize(
    "code",
    [
        "x**2",
        "2**63",
        "rp.sin(x)",
        "np.linalg.norm(a, axis=1)",
        "np.argsort(a, kind='stable')",
        "np.sqrt(x)",
        "np.logical_not(x)",
    ],
)
def test_what_is_the_same_everywhere_is_not(check_tree: ModuleType, code: str) -> None:
    assert not list(check_tree.arithmetic_breaches("src/cabinpose/scene/a.py", code))
