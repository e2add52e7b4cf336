"""Two numbers cannot be swapped on their way into a kernel: fields and parameters travel by name."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cabinpose._native import contact

STUBS = sorted((Path(__file__).parents[2] / "src" / "cabinpose" / "_native").glob("*.pyi"))
BY_CONVENTION = {"atan2"}  # y, x


def swappable(stub: str) -> Iterator[str]:
    """Functions of a stub two of whose positional parameters are of one type; any numbers are of one."""
    for node in ast.parse(stub).body:
        if isinstance(node, ast.FunctionDef) and node.name not in BY_CONVENTION:
            types = [ast.unparse(a.annotation) for a in node.args.args if a.annotation is not None]
            types = ["number" if t in ("bool", "int", "float") else t for t in types]
            if len(types) > len(set(types)):
                yield node.name


@pytest.mark.parametrize("path", STUBS, ids=lambda path: path.stem)
def test_no_two_positional_parameters_of_a_kernel_are_of_one_type(path: Path) -> None:
    assert not list(swappable(path.read_text()))


def test_the_rule_sees_what_it_forbids() -> None:
    assert list(swappable("def fill(values: Array, step: float, band: int) -> None: ...")) == ["fill"]
    assert not list(swappable("def fill(values: Array, step: float, *, band: int) -> None: ..."))


def field(**changes: Any) -> SimpleNamespace:
    """A field of clearance, its values in quanta of 1 cm on a grid of 2 cm; what is beyond it is 0.5 m clear."""
    values = np.arange(27, dtype=np.int8).reshape(3, 3, 3)
    own = {"values": values, "outside_m": 0.5, "quantum_m": 0.01, "step": 0.02, "origin": np.zeros(3)}
    return SimpleNamespace(**own | changes)


def sampled(grid: object) -> list[float]:
    clearance = np.full(2, np.inf)
    contact.sample(np.array([[0.02, 0.02, 0.02], [1.0, 1.0, 1.0]]), np.eye(4), grid, clearance)  # type: ignore[arg-type]
    return clearance.tolist()


def test_fields_are_read_by_name_in_any_order() -> None:
    assert sampled(field()) == pytest.approx([0.13, 0.5])
    assert sampled(field(quantum_m=0.02, outside_m=0.25)) == pytest.approx([0.26, 0.25])


@pytest.mark.parametrize(
    "wrong",
    [
        SimpleNamespace(**{("quantum" if name == "quantum_m" else name): value for name, value in vars(field()).items()}),
        field(step="0.02"),
        field(values=np.zeros((3, 3, 3), np.int16)),
        tuple(vars(field()).values()),
    ],
    ids=["another name", "no number", "another array", "no names"],
)
def test_what_lacks_a_field_of_name_and_type_is_refused(wrong: object) -> None:
    with pytest.raises(TypeError, match="field: FieldGrid"):
        sampled(wrong)


def test_an_array_that_is_made_for_the_call_lives_as_long() -> None:
    class Fresh(SimpleNamespace):
        @property
        def values(self) -> Any:
            return np.full((3, 3, 3), 7, np.int8)

    own = vars(field())
    del own["values"]
    assert sampled(Fresh(**own)) == pytest.approx([0.07, 0.5])
