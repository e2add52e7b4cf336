"""CONTRIBUTING says where things go: the files that it names are there, and hold what it says they hold."""

from __future__ import annotations

import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
REGISTRIES = {
    "methods": "cabinpose.estimate:METHODS",
    "formats": "cabinpose.store.convert:FORMATS",
    "sources": "cabinpose.record.sources:SOURCES",
    "sensors": "cabinpose.scene.sensor:SENSORS",
    "things": "cabinpose.scene.things:THINGS",
    "actions": "cabinpose.synth.posture:ACTIONS",
    "metrics": "cabinpose.evaluate:METRICS",
}
# What people change most often; each is a row that says where.
CHANGES = (
    "set of joints", "detector", "object", "place of a hand", "device", "format", "noise effect", "variable of the dataset",
    "metric", "tab of the studio", "action", "car", "key of a scene",
)  # fmt: skip


def rows(text: str) -> list[list[str]]:
    """The cells of the table of additions."""
    table = text[text.index("| to add |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def broken(row: list[str]) -> list[str]:
    """What a row names that is not there: paths, from the package or the root, and names in files ("`NAME` of `path`")."""
    wrong, folder = [], Path()
    text = " | ".join(row)
    places: dict[str, Path] = {}
    for word in re.findall(r"`([\w./*-]+)`", text):
        if "/" not in word and not re.search(r"\.(py|toml|md|cpp|hpp)$", word):
            continue
        found = next((base / word for base in (ROOT / "src" / "cabinpose", ROOT, folder) if (base / word).exists()), None)
        if found is None:
            wrong.append(word)
            continue
        places[word] = found
        folder = found if found.is_dir() else found.parent
    for name, place in re.findall(r"`(\w+)` (?:of|in|at the end of) `([\w./-]+)`", text):
        if place in places and not re.search(rf"\b{name}\b", places[place].read_text("utf-8")):
            wrong.append(f"{name} of {place}")
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["entry-points"]
    wrong += [group for group in re.findall(r"\*(cabinpose\.\w+)\*", text) if group not in groups]
    return wrong


@pytest.mark.parametrize("row", rows(TEXT), ids=lambda row: row[0])
def test_what_it_names_is_there(row: list[str]) -> None:
    assert broken(row) == []


@pytest.mark.parametrize("change", CHANGES)
def test_every_usual_change_has_its_row(change: str) -> None:
    assert [row for row in rows(TEXT) if re.search(rf"\b{change}\b", row[0])]


def test_the_check_finds_what_is_wrong() -> None:
    row = ["a car", "`scene/cabin/presets.py`, `nowhere.py`, `NOTHING` of `core/skeleton.py`", "*cabinpose.wishes*"]
    assert broken(row) == ["nowhere.py", "NOTHING of core/skeleton.py", "cabinpose.wishes"]


@pytest.mark.parametrize("kind", REGISTRIES)
def test_registries_hold_what_is_registered(kind: str) -> None:
    """All that the package registers of a kind can be loaded, and the page for extensions has its section."""
    module, _, name = REGISTRIES[kind].partition(":")
    registry = getattr(import_module(module), name)
    registered = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["entry-points"][f"cabinpose.{kind}"]
    assert registry.names(own=True) == tuple(registered)
    assert all(registry[each] is not None for each in registered)
    page = (ROOT / "docs" / "extending.md").read_text("utf-8")
    assert f"*cabinpose.{kind}*" in page or f'"cabinpose.{kind}"' in page
