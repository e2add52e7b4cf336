"""The documentation is true: its commands and snippets run, its links lead somewhere, what it names exists.

A fenced block marked `python run` or `console run` is executed, in order, page by page, in one empty folder a page.
"""

from __future__ import annotations

import importlib
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import faces
import pytest
import yaml

from cabinpose.synth.config import SynthConfig

Run = Callable[..., Any]
ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
BLOCK = re.compile(r"^```(?P<kind>python|console) run\n(?P<code>.*?)^```$", re.M | re.S)
FENCE = re.compile(r"^```.*?^```$", re.M | re.S)
API_NAME = re.compile(r"^::: ([\w.]+)$", re.M)
LINK = re.compile(r"\[[^\]]*\]\((?!https?://|mailto:)(?P<target>[^)#\s]*)(?:#(?P<anchor>[^)\s]+))?\)")
DOTTED = re.compile(r"`(cabinpose(?:\.\w+)+)")
REPOSITORY_PATH = re.compile(r"`((?:src|tests|tools|docs|\.ci)/[\w./-]+)`")
MAKE_TARGET = re.compile(r"`make (\w+)")
SECONDS = 120
# pages whose blocks take more than six seconds
LONG = ("docs/dataset.md", "docs/five-minutes.md", "docs/own-car.md", "docs/pictures.md", "docs/recording.md", "docs/scenes.md")


class Block(NamedTuple):
    """A fenced block to execute: its language, its text and the line of the page on which it starts."""

    kind: str
    code: str
    line: int


def page_id(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(text: str) -> list[Block]:
    return [Block(m["kind"], m["code"], text[: m.start()].count("\n") + 2) for m in BLOCK.finditer(text)]


def commands(code: str) -> list[str]:
    """The lines after a `$` prompt, with lines that a backslash continues joined to theirs."""
    joined = re.sub(r"\\\n\s*", " ", code)
    return [line[2:] for line in joined.splitlines() if line.startswith("$ ")]


def anchors(page: Path) -> set[str]:
    """The anchors that a page's headings get; none for a file that is not a page."""
    if page.suffix != ".md":
        return set()
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text("utf-8")), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def leads_to_a_name(page: Path, anchor: str) -> bool:
    """Whether an anchor on a page of the API is a name of what that page describes. The build of the site asks for more."""
    if page.parent.name != "api":
        return False
    described = API_NAME.findall(page.read_text("utf-8") + faces.page(f"cabinpose.{page.stem}"))
    if not any(anchor == name or anchor.startswith(f"{name}.") for name in (*described, f"cabinpose.{page.stem}")):
        return False
    try:
        resolve(anchor)
    except (ImportError, AttributeError):
        return False
    return True


def resolve(dotted: str) -> object:
    """The module or attribute of a dotted name; AttributeError or ImportError if there is none."""
    parts = dotted.split(".")
    found: object = importlib.import_module(parts[0])
    for depth, part in enumerate(parts[1:], 2):
        if not hasattr(found, part):
            with suppress(ImportError):
                importlib.import_module(".".join(parts[:depth]))
            found = importlib.import_module(".".join(parts[: depth - 1]))  # a face may have a function of the module's name
        found = getattr(found, part)
    return found


def test_there_are_pages() -> None:
    assert {"README.md", "docs/conventions.md", "docs/architecture.md"} <= {page_id(page) for page in PAGES}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page_id(page), marks=[pytest.mark.slow] if page_id(page) in LONG else [])
        for page in PAGES
        if blocks(page.read_text("utf-8"))
    ],
)
def test_blocks_run(page: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Our own commands in this process; that they start as one of their own is `test_package`'s."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])))
    namespace: dict[str, object] = {}
    for block in blocks(page.read_text("utf-8")):
        if block.kind == "python":
            source = "\n" * (block.line - 1) + block.code
            exec(compile(source, str(page), "exec"), namespace)
            continue
        assert commands(block.code), f"{page_id(page)}:{block.line}: a console block without a `$ ` line runs nothing"
        for command in commands(block.code):
            words = shlex.split(command)
            if words[0] == "cabinpose":
                code, out, err = run(*words[1:])
            else:
                done = subprocess.run(words, capture_output=True, text=True, timeout=SECONDS, check=False)
                code, out, err = done.returncode, done.stdout, done.stderr
            assert code == 0, f"{page_id(page)}: `{command}` ended with {code}\n{out}{err}"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for match in LINK.finditer(FENCE.sub("", page.read_text("utf-8"))):
        target = (page.parent / match["target"]).resolve() if match["target"] else page
        anchor = match["anchor"]
        if not target.exists() or (anchor and anchor not in anchors(target) and not leads_to_a_name(target, anchor)):
            broken.append(match.group())
    assert broken == []


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_named_things_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    missing = [path for path in REPOSITORY_PATH.findall(text) if not (ROOT / path).exists()]
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text("utf-8"), re.M))
    missing += [f"make {target}" for target in MAKE_TARGET.findall(text) if target not in targets]
    for dotted in [*DOTTED.findall(text), *API_NAME.findall(text)]:
        try:
            resolve(dotted)
        except (ImportError, AttributeError):
            missing.append(dotted)
    assert missing == []


@pytest.mark.parametrize("guide", ["own-people", "own-camera"])
def test_the_yaml_of_a_guide_is_a_configuration(guide: str) -> None:
    text = (ROOT / "docs" / "guides" / f"{guide}.md").read_text("utf-8")
    found = re.findall(r"^```yaml\n(.*?)^```$", text, re.M | re.S)
    assert found
    for block in found:
        SynthConfig.parse(yaml.safe_load(block))


def test_the_checks_find_what_is_wrong() -> None:
    """The helpers of this file, held against text that is known to be wrong."""
    assert blocks("x\n```python run\na = 1\n```\n") == [Block("python", "a = 1\n", 3)]
    assert blocks("```python\na = 1\n```\n") == []
    assert commands("$ a \\\n    b\noutput\n$ c\n") == ["a  b", "c"]
    with pytest.raises((ImportError, AttributeError)):
        resolve("cabinpose.core.frames.no_such_function")
    assert leads_to_a_name(ROOT / "docs" / "api" / "index.md", "cabinpose.generate")
    assert not leads_to_a_name(ROOT / "docs" / "api" / "index.md", "cabinpose.no_such_function")
    assert not leads_to_a_name(ROOT / "docs" / "api" / "store.md", "cabinpose.generate")
    assert leads_to_a_name(ROOT / "docs" / "api" / "store.md", "cabinpose.store.Manifest.stored")
    assert LINK.search("[a](b.md#c)") is not None
    assert LINK.search("[a](https://example.org)") is None
