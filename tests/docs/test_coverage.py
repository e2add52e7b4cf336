"""docs/coverage.md and the other pages: the commands that they name parse, their flags are theirs; the tests named exist."""

from __future__ import annotations

import re
import shlex
from functools import cache
from pathlib import Path

import pytest

from cabinpose.app.cli import VERBS, main, verb_module
from cabinpose.app.cli.commands import Choices
from cabinpose.record.sources import SOURCES

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "coverage.md").read_text("utf-8")
COMMAND = re.compile(r"`cabinpose ([^`]+)`")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(test_\w+)`")
CHAPTERS = ("chapter 3", "chapter 4", "chapter 5", "chapter 6", "chapter 7", "8.2")


def spoken(command: str) -> tuple[tuple[str, ...], list[str]]:
    """The verb with its own verb or format, and the flags, of the words behind `cabinpose`."""
    words = shlex.split(command)
    inner = verb_module(words[0]).COMMAND if words[0] in VERBS else None
    many = isinstance(inner, Choices) or (inner is not None and not isinstance(inner, type) and hasattr(inner, "__args__"))
    count = 2 if many and len(words) > 1 and not words[1].startswith("-") else 1
    return tuple(words[:count]), [word for word in words if word.startswith("--")]


@cache
def help_of(verb: tuple[str, ...]) -> str:
    """What `cabinpose VERB --help` prints; AssertionError where it ends with an error."""
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            code = main([*verb, "--help"])
        except SystemExit as left:
            code = left.code if isinstance(left.code, int) else 1
    assert code == 0, f"{' '.join(verb)}: {out.getvalue()}"
    return out.getvalue()


def wrong_tests(text: str) -> list[str]:
    """The tests that a text names and that there are not."""
    wrong = []
    for file, name in TEST.findall(text):
        path = ROOT / file
        if not path.exists() or not re.search(rf"^def {name}\(", path.read_text("utf-8"), re.M):
            wrong.append(f"{file}::{name}")
    return wrong


@pytest.mark.parametrize("command", sorted(set(COMMAND.findall(PAGE))))
def test_a_command_parses_and_has_its_flags(command: str) -> None:
    verb, flags = spoken(command)
    text = help_of(verb)
    assert [flag for flag in flags if not re.search(rf"(?<![\w-]){flag}(?![\w-])", text)] == []


OLD = "docs/upgrading.md"  # has the spellings of before
CONSOLE = re.compile(r"^```console[^\n]*\n(.*?)^```", re.M | re.S)


def named_commands(text: str) -> list[str]:
    """What stands behind `cabinpose` in the consoles of a page, and between its backticks where it has flags."""
    consoles = [re.sub(r"\\\n\s*", " ", block) for block in CONSOLE.findall(text)]
    typed = re.findall(r"^\$ cabinpose ((?:'[^'\n]*'|[^#|>&\n])+)", "\n".join(consoles), re.M)
    told = re.findall(r"`(?:cabinpose )?([a-z][\w-]*(?: [^`]*)? --[^`]+)`", CONSOLE.sub("", text))
    told = [" ".join(re.sub(r"[|…]", " ", words).split()) for words in told]
    return [words for words in (*typed, *told) if words.split()[0] in VERBS]


def wrong_flags(text: str) -> list[str]:
    """The commands of a page of which a flag is none; but for those of a FORMAT, and of the format that extending.md adds."""
    wrong = []
    for command in named_commands(text):
        verb, flags = spoken(command)
        if len(verb) > 1 and (verb[1].isupper() or verb[1] == "joints"):
            continue
        known = help_of(verb)
        names = (flag.partition("=")[0] for flag in flags)
        if any(not re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", known) for name in names):
            wrong.append(command)
    return wrong


def test_commands_of_all_pages_have_their_flags() -> None:
    pages = [
        path for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")) if path != ROOT / OLD and path.name != "CHANGELOG.md"
    ]
    texts = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in pages}
    assert sum(len(named_commands(text)) for text in texts.values()) > 200
    assert {page: found for page, text in texts.items() if (found := wrong_flags(text))} == {}


def test_tests_exist() -> None:
    assert len(TEST.findall(PAGE)) > 40
    assert wrong_tests(PAGE) == []


def test_kinds_of_sources_exist() -> None:
    named = {kind for listed in re.findall(r"kinds? ((?:`\w+`(?:, | and )?)+)", PAGE) for kind in re.findall(r"`(\w+)`", listed)}
    assert named
    assert named - set(SOURCES.names()) == set()


def test_every_row_is_whole() -> None:
    """Each says what it asks; a command and a test, or why there is none."""
    for chapter in CHAPTERS:
        assert f"({chapter})" in PAGE
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in PAGE.splitlines() if line.startswith("|")]
    rows = [row for row in rows if row[0] not in ("section", "asks") and not row[0].startswith("---")]
    assert len(rows) > 35
    for row in rows:
        *_, asks, command, held, open_ = row
        assert asks
        assert command
        assert held != "–" or open_ != "–", row
        assert held == "–" or TEST.search(held), row


def test_the_checks_find_what_is_wrong() -> None:
    assert spoken("evaluate-mocap sse --out") == (("evaluate-mocap", "sse"), ["--out"])
    assert spoken("import adtfdat") == (("import", "adtfdat"), [])
    assert spoken("synth --config docs/examples/s25k.yaml") == (("synth",), ["--config"])
    with pytest.raises(AssertionError):
        help_of(("no-such-verb",))
    assert named_commands("`export --format coco` `--out`\n```console\n$ cabinpose view a \\\n  --new  # as\n```\n") == [
        "view a  --new  ", "export --format coco"
    ]  # fmt: skip
    assert wrong_flags("`cabinpose view FOLDER --frames 3` `view FOLDER --new`") == ["view FOLDER --new"]
    assert wrong_tests("`tests/docs/test_coverage.py::test_nothing`") == ["tests/docs/test_coverage.py::test_nothing"]
    assert wrong_tests("`tests/docs/test_coverage.py::test_tests_exist`") == []
