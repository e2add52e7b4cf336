"""Notebooks are stored without outputs, and small. That they run is for the site, which runs them: see `test_site`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import nbformat
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST_BYTES = 16_000


def not_clean(notebook: Any) -> list[str]:
    """Cells of a notebook (plain JSON) that carry what a run has left in them."""
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return [cell["id"] for cell in cells if cell["outputs"] or cell["execution_count"] is not None]


def test_there_are_notebooks() -> None:
    assert [path.stem[0] for path in NOTEBOOKS] == list("123456")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_clean(path: Path) -> None:
    assert path.stat().st_size < LARGEST_BYTES
    notebook = json.loads(path.read_text("utf-8"))
    nbformat.validate(notebook)
    assert not_clean(notebook) == []
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}  # nothing of the machine it was written on


def test_what_a_run_leaves_is_seen() -> None:
    cell = {"cell_type": "code", "id": "a", "outputs": [], "execution_count": None}
    assert not_clean({"cells": [cell]}) == []
    assert not_clean({"cells": [cell | {"execution_count": 1}]}) == ["a"]
    assert not_clean({"cells": [cell | {"outputs": [{"output_type": "stream"}]}]}) == ["a"]
