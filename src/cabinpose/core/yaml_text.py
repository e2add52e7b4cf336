"""YAML files of users as plain data, within bounds.

An alias repeats a value without its text, and a model that is built of it repeats it in full: a kilobyte of aliases of aliases
stands for a billion values.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from cabinpose.core.errors import CabinposeError, ConfigError

_LONGEST = 8_000_000  # characters
_LONG = 20_000  # which take 0.2 s without libyaml
_FLAT = 300  # levels at the most
_DEEP = re.compile(r"(?:[\[{]\s*){500}")  # deeper than recursion goes; PyYAML looks ahead for a second before it finds out
_MOST_REPEATED = 100_000  # values that aliases add to those that are written down


def read_yaml(path: Path, *, hint: str, error: type[CabinposeError] = ConfigError) -> Any:
    """The plain data of a YAML file, None of an empty one. Raises `error` with the hint where there is none."""
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise error(f"cannot read {path}: {problem.strerror}", hint=hint) from problem
    except (UnicodeDecodeError, yaml.YAMLError) as problem:
        raise error(f"{path} is not YAML that can be read: {_in_one_line(problem)}", hint=hint) from problem


def _in_one_line(problem: Exception) -> str:
    """What is wrong with a text, and where."""
    mark = getattr(problem, "problem_mark", None)
    where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
    return f"{where}{getattr(problem, 'problem', None) or ' '.join(str(problem).split())}"


def parse_yaml(text: str) -> Any:
    """The plain data of YAML.

    Raises
    ------
    yaml.YAMLError
        Where the text is no YAML, is longer than 8 million characters, is nested too deep, or has aliases that stand for more
        than 100 000 values.
    """
    if len(text) > _LONGEST:
        raise yaml.YAMLError(f"it has {len(text)} characters, more than {_LONGEST}")
    loader = _QuickLoader if _is_long_and_flat(text) else _Loader
    if loader is _Loader and _DEEP.search(text):
        raise yaml.YAMLError("it is nested too deep")
    try:
        return yaml.load(text, Loader=loader)  # noqa: S506 - SafeLoaders
    except RecursionError:
        raise yaml.YAMLError("it is nested too deep") from None
    except ValueError as problem:  # a date that is none, for example
        raise yaml.YAMLError(str(problem)) from problem


def _is_long_and_flat(text: str) -> bool:
    """Whether a text is for libyaml: ten times as quick, it says less of errors, and ends the process where one nests deep."""
    if len(text) < _LONG or not yaml.__with_libyaml__:
        return False
    depth = 0
    for event in yaml.parse(text, yaml.CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _FLAT:
            return False
    return True


class _Counted:
    """Counts what aliases stand for before anything is made of them."""

    def get_single_node(self) -> yaml.Node | None:
        node: yaml.Node | None = super().get_single_node()  # type: ignore[misc]  # of the loader
        if node is not None:
            sizes: dict[int, int | None] = {}
            if _size(node, sizes) - len(sizes) > _MOST_REPEATED:
                raise yaml.YAMLError(f"its aliases stand for more than {_MOST_REPEATED} values")
        return node


class _Loader(_Counted, yaml.SafeLoader):
    pass


class _QuickLoader(_Counted, yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader):  # type: ignore[misc]
    pass


def _size(node: yaml.Node, sizes: dict[int, int | None]) -> int:
    """The number of nodes of a tree, those of aliases each time; `sizes` keeps it by id, None while a node is counted."""
    if id(node) in sizes:
        known = sizes[id(node)]
        if known is None:
            raise yaml.YAMLError("it holds a value that contains itself")
        return known
    sizes[id(node)] = None
    total = 1
    for item in node.value if isinstance(node, yaml.CollectionNode) else ():
        total += sum(_size(each, sizes) for each in (item if isinstance(item, tuple) else (item,)))
    sizes[id(node)] = total
    return total
