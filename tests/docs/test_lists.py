"""Lists on pages are whole: verbs, kinds of sources, formats, extras, sensors and methods are those that there are."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from cabinpose.app.cli import VERBS
from cabinpose.core import CABINPOSE
from cabinpose.estimate import METHODS
from cabinpose.record.sources import SOURCES
from cabinpose.scene.sensor import SENSORS
from cabinpose.store.convert import FORMATS

ROOT = Path(__file__).resolve().parents[2]
CODE = re.compile(r"`([\w./-]+)`")


def page(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def column(text: str, heading: str, number: int = 0) -> list[str]:
    """The names in a column of the table whose first line begins so."""
    lines = text[text.index(f"| {heading}") :].split("\n\n")[0].splitlines()[2:]
    return [name for line in lines for name in CODE.findall(line.strip("|").split("|")[number])]


def test_every_verb_is_in_the_table() -> None:
    first = {re.split(r"[ `]", cell)[1] for cell in re.findall(r"^\| (`[^|]+) \|", page("docs/cli.md"), re.M)}
    assert set(VERBS) <= first


def test_every_kind_of_source_is_in_the_table() -> None:
    assert set(column(page("docs/recording.md"), "kind | device")) == set(SOURCES.names(own=True))


def test_every_format_is_in_the_table() -> None:
    text = page("docs/cli.md")
    listed = {*column(text, "| import | export", 1), *column(text, "| import | export", 2)}
    assert listed == set(FORMATS.names(own=True))
    for method, number in (("read", 1), ("write", 2)):
        able = {name for name, form in FORMATS.items() if form.can(method)}
        assert set(column(text, "| import | export", number)) == able, method


def test_every_extra_is_in_the_readme() -> None:
    extras = tomllib.loads(page("pyproject.toml"))["project"]["optional-dependencies"]
    assert set(column(page("README.md"), "extra | for")) == extras.keys() - {"dev"}


def test_every_sensor_and_method_has_its_row() -> None:
    sensors = set(column(page("docs/sensor-model.md"), "name | pixels"))
    assert sensors | {"pico_monstar_105"} == set(SENSORS.names(own=True))  # which stands below the table
    assert set(METHODS.names(own=True)) <= set(column(page("docs/methods.md"), "method |"))


def test_the_reach_of_a_joint_is_the_models() -> None:
    text = page("docs/visibility.md")
    rows = [
        line.strip("| ").split(" | ") for line in text[text.index("| joint | own labels") :].split("\n\n")[0].splitlines()[2:]
    ]
    told = {row[0].partition(" (")[0]: float(row[2]) for row in rows}
    sides = {name.removeprefix(side) if name[1:] in told else name: name for side in "lr" for name in CABINPOSE.reach_m}
    assert told == {name: CABINPOSE.reach_m[joint] for name, joint in sides.items() if name in told}
    assert len(told) == len({name[1:] if name[1:] in told else name for name in CABINPOSE.reach_m})


def test_a_column_is_read() -> None:
    assert column("x\n| a | b |\n|---|---|\n| `one`, `two` | `three` |\n\n| c |\n", "a |") == ["one", "two"]
    assert column("| a | b |\n|---|---|\n| `one` | `three` |\n", "a |", 1) == ["three"]
