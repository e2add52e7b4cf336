"""Frames that a condition holds for: `car == "suv" and action in ["sleep", "phone"] and error_cm > 5`, in Python's words.

The condition is parsed and walked here, never run: names of coordinates, texts, numbers, comparisons, `in`, `and`, `or`, `not`
and brackets are all there is.

Of what each person has (`subject`, `action`, `person`), a comparison holds for people, and `and` asks it of the same one:
`person == "driver" and action == "sleep"` are the frames whose driver sleeps. A frame is chosen if anybody in it is. `not`, `!=`
and `not in` choose the frames in which nobody is.
"""

from __future__ import annotations

import ast
import operator
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ConfigError, Visibility, unknown_name

if TYPE_CHECKING:
    import xarray as xr

_Holds = NDArray[np.bool_]  # (F,) or (F, P)
_ORDER: Final[Mapping[type[ast.cmpop], Callable[[Any, Any], Any]]] = {
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
}  # fmt: skip
_EXAMPLE = 'write car == "suv" and error_cm > 5'
_MOST = 2000  # characters: what is longer nests deeper than a condition that anybody means
_MOST_NAMED = 12  # values in a hint


def query_columns(dataset: xr.Dataset) -> dict[str, NDArray[Any]]:
    """What a condition can ask, by name: (F,) of frames, (F, P) of people, "" or NaN where there is nobody.

    Beside the dataset's coordinates: `view` (pov), `person` (the slot) and `people` (how many). Reads `visibility` of all frames.
    """
    frames, people = dataset.sizes["frame"], dataset.sizes["person"]
    shapes = (("frame",), ("frame", "person"))
    columns = {str(name): values.values for name, values in dataset.coords.items() if values.dims in shapes}
    there = (dataset["visibility"].values > Visibility.ABSENT).any(axis=2) | (dataset["subject"].values != "")
    if "pov" in columns:
        columns["view"] = columns["pov"]
    columns["person"] = np.where(there, np.broadcast_to(dataset["person"].values.astype(str), (frames, people)), "")
    columns["people"] = there.sum(axis=1)
    return columns


def frames_where(columns: Mapping[str, NDArray[Any]], condition: str) -> NDArray[np.bool_]:
    """(F,) whether a condition holds for each frame.

    Parameters
    ----------
    columns
        Of `query_columns`.
    condition
        See the module.

    Raises
    ------
    ConfigError
        Where it is no condition, asks for what there is not, or compares texts with numbers.
    """
    if len(condition) > _MOST:
        raise ConfigError(f"a condition of {len(condition)} characters is none", hint=f"{_EXAMPLE}; at most {_MOST}")
    try:
        tree = ast.parse(condition.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        at = getattr(error, "offset", None) or len(condition)
        raise ConfigError(f"'{condition}' is no condition (see its character {at})", hint=_EXAMPLE) from None
    with np.errstate(over="ignore"):  # more than single precision holds is infinite there, and compares as that
        return _by_frame(_Walk(columns, condition).holds(tree))


def completions(columns: Mapping[str, NDArray[Any]], text: str) -> list[str]:
    """What the last word of a condition that is being written may become: the whole text with a name, or a value of one."""
    begin = re.search(r"[\w\"']*$", text)
    assert begin is not None
    before, word = text[: begin.start()], begin.group().lstrip("\"'")
    asked = re.search(r"(\w+)\s*(?:==|!=|(?:not\s+)?in\s*[\[(](?:[^\])]*,)?)\s*$", before)
    if asked and asked.group(1) in columns:
        candidates = [repr(value) for value in _values(columns[asked.group(1)])]
    elif re.search(r"(^|\(|\b(and|or|not)\s)\s*$", before):
        candidates = list(columns)
    else:
        candidates = ["and", "or"]
    return [before + each.replace("'", '"') for each in candidates if each.strip("'").lower().startswith(word.lower())]


def _by_frame(holds: _Holds) -> NDArray[np.bool_]:
    return np.asarray(holds.any(axis=1) if holds.ndim == 2 else holds)


def _aligned(parts: Iterable[Any]) -> list[Any]:
    """What is of frames as (F, 1) where anything is of people, (F, P); numbers stay, and are compared as a column has them."""
    each = list(parts)
    several = any(np.ndim(one) == 2 for one in each)
    return [one[:, None] if several and np.ndim(one) == 1 else one for one in each]


def _values(column: NDArray[Any]) -> list[Any]:
    return sorted({value for value in column.ravel().tolist() if value != "" and value == value})  # without NaN


class _Walk:
    """A condition's way through its tree."""

    def __init__(self, columns: Mapping[str, NDArray[Any]], condition: str) -> None:
        self._columns, self._condition = columns, condition

    def holds(self, node: ast.expr) -> _Holds:
        """Whether a part of the condition holds."""
        if isinstance(node, ast.BoolOp):
            together = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
            return reduce(together, _aligned(self.holds(value) for value in node.values))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return ~_by_frame(self.holds(node.operand))
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            pairs = zip(sides, node.ops, sides[1:], strict=False)
            return reduce(np.logical_and, _aligned(self._compared(left, op, right) for left, op, right in pairs))
        raise self._no_condition(node)

    def _compared(self, left: ast.expr, op: ast.cmpop, right: ast.expr) -> _Holds:
        if isinstance(op, ast.NotEq | ast.NotIn):
            return ~_by_frame(self._compared(left, ast.Eq() if isinstance(op, ast.NotEq) else ast.In(), right))
        if isinstance(op, ast.In):
            if not isinstance(left, ast.Name) or not isinstance(right, ast.List | ast.Tuple | ast.Set):
                raise self._no_condition(right, 'write car in ["suv", "van"]')
            column = self._column(left)
            return np.logical_or.reduce([np.zeros(column.shape, bool), *(self._equal(left, each) for each in right.elts)])
        if isinstance(op, ast.Eq):
            name, value = (left, right) if isinstance(left, ast.Name) else (right, left)
            return self._equal(name, value)
        if type(op) not in _ORDER:
            raise self._no_condition(left)
        sides = [self._column(side) if isinstance(side, ast.Name) else self._number(side) for side in (left, right)]
        for side, values in zip((left, right), sides, strict=True):
            if isinstance(values, np.ndarray) and values.dtype.kind not in "iuf":
                raise ConfigError(f"{ast.unparse(side)} is text, which is neither more nor less", hint=self._of(side))
        return np.asarray(_ORDER[type(op)](*_aligned(sides)))

    def _equal(self, name: ast.expr, value: ast.expr) -> _Holds:
        if not isinstance(name, ast.Name):
            raise self._no_condition(name)
        column = self._column(name)
        if isinstance(value, ast.Name):
            raise ConfigError(f"{name.id} == {value.id}: {value.id} is no value", hint=self._of(name))
        if column.dtype.kind in "iuf":
            return np.asarray(column == self._number(value))
        if not isinstance(value, ast.Constant) or not isinstance(value.value, str):
            raise ConfigError(f"{name.id} is text, and {ast.unparse(value)} is none", hint=self._of(name))
        if value.value not in (known := _values(column)):
            raise ConfigError(f'no frame has {name.id} "{value.value}"', hint=self._of(name)) if known else self._nothing(name)
        return np.asarray(column.astype(str) == value.value)

    def _column(self, name: ast.Name) -> NDArray[Any]:
        if name.id not in self._columns:
            raise unknown_name("coordinate", name.id, list(self._columns))
        return self._columns[name.id]

    def _number(self, node: ast.expr) -> float:
        sign = -1 if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) else 1
        inner = node.operand if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd) else node
        if not isinstance(inner, ast.Constant) or isinstance(inner.value, bool) or not isinstance(inner.value, int | float):
            raise ConfigError(f"{ast.unparse(node)} is no number, in '{self._condition}'", hint=_EXAMPLE)
        return sign * (inner.value if abs(inner.value) < sys.float_info.max else np.inf)

    def _of(self, name: ast.expr) -> str:
        assert isinstance(name, ast.Name)
        values = _values(self._columns[name.id])
        shown = ", ".join(f'"{value}"' if isinstance(value, str) else str(value) for value in values[:_MOST_NAMED])
        return f"{name.id} == one of: {shown}" + (f", and {len(values) - _MOST_NAMED} more" * (len(values) > _MOST_NAMED))

    @staticmethod
    def _nothing(name: ast.Name) -> ConfigError:
        return ConfigError(f"no frame has a {name.id}", hint="ask for another coordinate")

    def _no_condition(self, node: ast.expr, hint: str = _EXAMPLE) -> ConfigError:
        return ConfigError(f"{ast.unparse(node)} is no condition, in '{self._condition}'", hint=hint)
