"""Every wrong input that the page on limits lists names the test that holds what is said of it, and its case there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/limits.md").read_text(encoding="utf-8")
FEWEST = 60
FILE = re.compile(r"`(tests/[a-z_/]+\.py)`")
TEST = re.compile(r"`(test_\w+)`")


class Row(NamedTuple):
    """A row of a table: what is wrong, and what its last cell names."""

    section: str
    wrong: str
    file: str
    tests: tuple[str, ...]
    cases: str


def rows() -> list[Row]:
    """Of all tables of inputs, what is said and tests."""
    found = []
    for section in PAGE.split("\n### ")[1:]:
        title, stated = section.split("\n", 1)[0], FILE.findall(section.split("\n|", 1)[0])
        default = next(iter(TEST.findall(section.split("\n|", 1)[0])), "")
        if "| input | what is said now | test |" not in section:
            continue
        for line in section.splitlines():
            cells = line.strip("| ").split(" | ")
            if not line.startswith("| ") or len(cells) != 3 or cells[0] == "input":
                continue
            here, tests = FILE.findall(cells[2]), TEST.findall(cells[2])
            cases = re.sub(r"`[^`]*`", "", cells[2]).strip(" ,;")
            found.append(Row(title, cells[0], (here or stated)[0], tuple(tests or [default]), cases))
    return found


ROWS = rows()


def test_there_are_as_many_rows_as_promised() -> None:
    assert len(ROWS) >= FEWEST
    assert {row.section for row in ROWS} >= {"Cameras and calibration", "Cars", "Labels", "Recordings", "Datasets", "Predictions"}
    assert len({row.wrong for row in ROWS if row.section != "Datasets"}) > FEWEST


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.section}: {row.wrong}"[:60])
def test_a_row_names_its_test_and_its_case(row: Row) -> None:
    files = sorted({ROOT / row.file, *(ROOT / "tests/plausible").glob("test_*.py"), *(ROOT / "tests/evaluate").glob("test_*.py"),
                    *(ROOT / "tests/estimate").glob("test_*.py"), *(ROOT / "tests/studio").glob("test_*.py")})  # fmt: skip
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    for test in row.tests:
        assert re.search(rf"def {test}\(", text), test

    def stands(case: str) -> bool:
        return f'"{case.removesuffix("…")}' + ("" if case.endswith("…") else '"') in text

    # A case may have commas in its name.
    separate = [[row.cases], row.cases.split("; "), re.split(r"[;,] +", row.cases)] if row.cases else [[]]
    assert any(all(stands(case.strip(" ,")) for case in cases) for cases in separate), row.cases
