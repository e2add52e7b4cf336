"""The page on own cars has every key of the YAML, with the type, default and meaning that the loader knows."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args, get_origin

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from cabinpose.scene.cabin.car_file import Belt, CabinFile, PedalSpec, Point, Rule, SeatSpec, ViewSpec, WheelSpec

PAGE = Path(__file__).resolve().parents[2] / "docs" / "own-car.md"
MODELS = (CabinFile, SeatSpec, Belt, WheelSpec, PedalSpec, Rule, ViewSpec)
WORDS = {str: "text", float: "number", bool: "true or false", Point: "point"}
UNITS = {"_mm": ", mm", "_deg": ", degrees"}


def type_words(annotation: Any) -> str:
    """A field's type in words."""
    if annotation in WORDS:
        return WORDS[annotation]
    arguments = [a for a in get_args(annotation) if a is not type(None)]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "keys below"
    if get_origin(annotation) is dict:
        return f"{type_words(arguments[1])} by name"
    if get_origin(annotation) is tuple and arguments[-1] is ...:
        return f"list of {type_words(arguments[0])}"
    if get_origin(annotation) is tuple:
        return f"two {type_words(arguments[0])}s"
    if all(isinstance(a, str) for a in arguments):
        return " or ".join(arguments)
    return type_words(arguments[0])


def row(name: str, field: Any) -> str:
    """The line of the page on a key."""
    unit = next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")
    default = "required" if field.default is PydanticUndefined else plain(field.default)
    return f"| `{name}` | {type_words(field.annotation)}{unit} | {default} | {field.description} |"


def plain(value: Any) -> str:
    if value is None or value in ({}, ()):
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(plain(v) for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_the_page_has_every_key(model: type[BaseModel]) -> None:
    lines = PAGE.read_text("utf-8").splitlines()
    assert [line for name, field in model.model_fields.items() if (line := row(name, field)) not in lines] == []


def test_the_page_has_no_key_of_old() -> None:
    known = {name for model in MODELS for name in model.model_fields}
    keys = {
        line.split("`")[1] for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| `") and line.count("|") == 5
    }
    assert keys == known
