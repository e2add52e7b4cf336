"""What is public: it is there, it says what it is, and it stands on a page of the API."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path

import faces
import pytest
import yaml

import cabinpose

ROOT = Path(__file__).resolve().parents[2]
FACES = faces.faces()
ROOMS = sorted({face.split(".")[1] for face in FACES})


def test_rooms_have_faces() -> None:
    assert {"core", "signals", "scene", "store", "synth", "record", "align", "estimate", "evaluate"} == set(ROOMS)
    assert FACES["cabinpose.store"]["Manifest"] == "cabinpose.store.schema"


@pytest.mark.parametrize("face", FACES)
def test_what_a_face_offers_is_there_and_says_what_it_is(face: str) -> None:
    module = importlib.import_module(face)
    assert sorted(module.__all__) == sorted(FACES[face])
    silent = []
    for name, place in FACES[face].items():
        doc = inspect.getdoc(getattr(module, name)) or ""
        constant = faces.constants(faces.file_of(place).read_text(encoding="utf-8")).get(name)
        says = bool(constant.comment or constant.shown) if constant else bool(doc) and not doc.startswith(f"{name}(")
        if not says:
            silent.append(name)
    assert silent == []


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_stands_on_the_page_of_its_room(room: str) -> None:
    nav = yaml.safe_dump(yaml.unsafe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    assert f"api/{room}.md" in nav
    assert (ROOT / "docs" / "api" / f"{room}.md").read_text(encoding="utf-8").startswith(f"# cabinpose.{room}\n")
    text = faces.page(f"cabinpose.{room}")
    lacking = [
        f"{face}.{name}"
        for face, names in FACES.items()
        for name in names
        if face.split(".")[1] == room and f"::: {face}.{name}\n" not in text and f'id="{face}.{name}"' not in text
    ]
    assert lacking == []


def test_the_packages_own_names_stand_on_the_first_page() -> None:
    text = (ROOT / "docs" / "api" / "index.md").read_text(encoding="utf-8")
    (members,) = [line for line in text.splitlines() if "members: [" in line]
    assert set(cabinpose.__all__) - {"__version__"} == set(members.partition("[")[2].rstrip("]").split(", "))


def test_the_comment_on_a_constant(tmp_path: Path) -> None:
    text = (
        "# before\nA = 1\nB = 2  # behind\nC, D = (  # of both\n    3, 4\n)  # fmt: skip\n"
        'E: int = 5\n"""below"""\nF = 6  # noqa: X\nG.h = 7\n'
    )
    assert faces.constants(text) == {
        "A": ("1", "before"), "B": ("2", "behind"), "C": ("3", "of both"), "D": ("4", "of both"), "E": ("5", "below"),
        "F": ("6", ""),
    }  # fmt: skip


def test_a_name_that_is_new_is_on_the_page_by_itself(tmp_path: Path) -> None:
    folder = tmp_path / "cabinpose" / "room"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text('"""A room."""\n')
    (folder / "__init__.pyi").write_text("from .walls import WALLS as WALLS\nfrom .walls import Wall as Wall\n")
    (folder / "walls.py").write_text('"""Walls."""\n\nclass Wall: ...\nWALLS = 4  # of a room\n')
    text = faces.page("cabinpose.room", tmp_path)
    assert "::: cabinpose.room.Wall\n" in text
    assert '| <span id="cabinpose.room.WALLS">`WALLS`</span> | `4` | of a room |' in text
