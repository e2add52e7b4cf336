"""YAML of users: every reader of it refuses what stands for more than it says."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from cabinpose.core import yaml_text
from cabinpose.core.errors import CabinposeError, ConfigError
from cabinpose.core.yaml_text import parse_yaml, read_yaml
from cabinpose.record.config import load_rig, load_take
from cabinpose.scene.cabin.car_file import read_car_file
from cabinpose.store.split import read_splits
from cabinpose.store.yaml_file import read_mapping
from cabinpose.synth.config import SynthConfig


def bomb(merged: bool = False) -> str:
    """Nine levels of ten aliases each, in lists or merged into mappings: a billion values in a kilobyte."""
    lines = ["a0: &a0 {x: 1}" if merged else "a0: &a0 [x]"]
    for i in range(1, 10):
        aliases = ", ".join([f"*a{i - 1}"] * 10)
        lines.append(f"a{i}: &a{i} {{<<: [{aliases}]}}" if merged else f"a{i}: &a{i} [{aliases}]")
    return "\n".join(lines)


READERS: dict[str, Callable[[Path], object]] = {
    "read_yaml": lambda path: read_yaml(path, hint="x"),
    "settings": lambda path: read_mapping(path, hint="x"),
    "synth": SynthConfig.load,
    "car": read_car_file,
    "rig": load_rig,
    "take": load_take,
    "splits": read_splits,
}


@pytest.mark.parametrize("name", READERS)
def test_every_reader_refuses_a_bomb_before_it_makes_anything_of_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[int] = []
    monkeypatch.setattr(yaml.SafeLoader, "construct_document", lambda *_: counted.append(1))
    for text in (bomb(), bomb(merged=True)):
        (tmp_path / "a.yaml").write_text(text)
        with pytest.raises(CabinposeError, match="aliases stand for more than 100000 values") as raised:
            READERS[name](tmp_path / "a.yaml")
        assert raised.value.hint
    assert counted == []


def test_no_node_is_counted_twice() -> None:
    """A kilobyte that stands for a billion values takes a step for each node that is written down."""
    sizes: dict[int, int | None] = {}
    node = yaml.compose(bomb(), Loader=yaml.SafeLoader)
    assert yaml_text._size(node, sizes) > 10**9
    assert len(sizes) == 1 + 10 + 10 + 1  # the mapping, its keys, its values, x


def test_values_of_a_command_line_are_held_to_the_same() -> None:
    with pytest.raises(ConfigError, match="says nothing of the configuration"):
        SynthConfig.load(None, [f"scene={{{bomb().replace(chr(10), ', ')}}}"])


def test_usual_aliases_are_kept() -> None:
    assert parse_yaml("a: &a {x: [1, 2]}\nb: *a\nc: {<<: *a, y: 3}") == {
        "a": {"x": [1, 2]}, "b": {"x": [1, 2]}, "c": {"x": [1, 2], "y": 3}
    }  # fmt: skip
    many = "a: &a [" + "1, " * 1000 + "1]\nb: [" + "*a, " * 90 + "*a]"
    assert len(parse_yaml(many)["b"]) == 91
    with pytest.raises(yaml.YAMLError, match="aliases"):
        parse_yaml(many.replace("b: [", "b: [" + "*a, " * 10))
    assert parse_yaml("") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &a [*a]", "contains itself"), ("[" * 5000, "nested too deep"), ("a: 2026-99-99", "month must be"),
        ("a: " + "x" * 8_000_000, "8000003 characters"), ("a: [", "expected"),
    ],
)  # fmt: skip
def test_what_cannot_be_read(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(ConfigError, match=message) as raised:
        read_yaml(tmp_path / "a.yaml", hint="see the docs")
    assert str(raised.value).startswith(f"{tmp_path / 'a.yaml'} is not YAML that can be read: ")
    assert raised.value.hint == "see the docs"


def test_brackets_that_nest_deep_are_refused_at_once() -> None:
    began = time.process_time()
    for text in ("a: " + "[" * 20_000, "a: " + "{ " * 20_000, "[" * 200_000):
        with pytest.raises(yaml.YAMLError, match="nested too deep"):
            parse_yaml(text)
    assert time.process_time() - began < 0.5  # a second each, where PyYAML looks ahead
    assert parse_yaml(f"a: {'[' * 50}{']' * 50}\nb: '{'[' * 400}'")["b"] == "[" * 400


@pytest.mark.parametrize("text", ["[" * 200_000, "- " * 100_000, "{a: " * 60_000, "? " * 100_000, "a:\n" + " [\n" * 100_000])
def test_long_text_that_nests_deep_is_refused(text: str) -> None:
    """The quick parser would end the process."""
    with pytest.raises(yaml.YAMLError):
        parse_yaml(text)


def test_long_text_is_read_as_short_text_is() -> None:
    rows = "\n".join(
        f"- {{n: {i}, x: {i / 7!r}, s: 'é {i:>99}', d: 2026-01-0{i % 9 + 1}, t: [true, null, 0x1f]}}" for i in range(700)
    )
    assert len(rows) > 100_000
    assert parse_yaml(rows) == [parse_yaml(row)[0] for row in rows.split("\n")[:50]] + yaml.safe_load(rows)[50:]
    with pytest.raises(yaml.YAMLError, match="aliases stand for more"):
        parse_yaml(bomb() + "\n# " + "x" * 100_000)
