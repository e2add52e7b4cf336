"""Elementary functions of the core: against fifty digits, at their edges, and the same bits in both builds."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from cabinpose._native import core

Array = NDArray[np.float64]
BUILDS = ["_baseline", "_avx2"]


def _values(seed: int, low: float, high: float) -> Array:
    rng = np.random.default_rng(seed)
    spread = rng.uniform(low, high, 3000)
    near_zero = rng.uniform(-1, 1, 500) * 10.0 ** rng.uniform(-300, 0, 500)
    inside = near_zero[(near_zero >= low) & (near_zero <= high)]
    return np.concatenate([spread, inside])


CASES: list[tuple[str, float, float, Callable[..., mpmath.mpf]]] = [
    ("sin", -1000.0, 1000.0, mpmath.sin),
    ("cos", -1000.0, 1000.0, mpmath.cos),
    ("exp", -700.0, 700.0, mpmath.exp),
    ("log", 1e-300, 1e6, mpmath.log),
    ("tanh", -20.0, 20.0, mpmath.tanh),
    ("acos", -1.0, 1.0, mpmath.acos),
    ("asin", -1.0, 1.0, mpmath.asin),
]


def _worst(values: Array, exact: list[mpmath.mpf]) -> float:
    """The largest error in units in the last place of the exact value."""
    worst = 0.0
    for value, truth in zip(values, exact, strict=True):
        worst = max(worst, float(abs(mpmath.mpf(float(value)) - truth)) / math.ulp(float(truth)))
    return worst


@pytest.mark.parametrize(("name", "low", "high", "exact"), CASES, ids=[c[0] for c in CASES])
def test_within_three_units_of_the_last_place(name: str, low: float, high: float, exact: Callable[..., mpmath.mpf]) -> None:
    x = _values(1, low, high)
    out = np.empty_like(x)
    getattr(core, name)(x, out)
    with mpmath.workdps(50):
        # Reduction by pi / 2 leaves an absolute error where a large argument's sine is nearly zero.
        near_root = np.abs(out) < 1e-3 if name in ("sin", "cos") else np.zeros(len(x), bool)
        truth = [exact(mpmath.mpf(float(v))) for v in x[~near_root]]
        assert _worst(out[~near_root], truth) < 3.0


def test_atan2_in_all_quadrants_and_on_the_axes() -> None:
    rng = np.random.default_rng(2)
    y, x = (rng.uniform(-1, 1, 4000) * 10.0 ** rng.uniform(-8, 8, 4000) for _ in range(2))
    out = np.empty_like(x)
    core.atan2(y, x, out)
    with mpmath.workdps(50):
        truth = [mpmath.atan2(mpmath.mpf(float(a)), mpmath.mpf(float(b))) for a, b in zip(y, x, strict=True)]
        assert _worst(out, truth) < 2.5
    edges = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf])
    y, x = (a.ravel().copy() for a in np.meshgrid(edges[:4], edges[:4]))
    out = np.empty_like(x)
    core.atan2(y, x, out)
    np.testing.assert_array_equal(out, np.arctan2(y, x))
    np.testing.assert_array_equal(np.signbit(out), np.signbit(np.arctan2(y, x)))


def test_values_that_are_no_numbers() -> None:
    x = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0])
    out = np.empty_like(x)
    core.exp(x, out)
    np.testing.assert_array_equal(out[:4], [np.nan, np.inf, 0.0, 1.0])
    core.log(x, out)
    np.testing.assert_array_equal(out, [np.nan, np.inf, np.nan, -np.inf, np.nan])


@pytest.mark.parametrize("name", ["sin", "exp"])
def test_functions_for_loops_give_the_same_bits(name: str) -> None:
    low, high = next((c[1], c[2]) for c in CASES if c[0] == name)
    x = np.concatenate([_values(4, low, high), [0.0, -0.0, -708.0, -709.0, 709.0, 710.0]])
    alone, in_loops = np.empty_like(x), np.empty_like(x)
    getattr(core, name)(x, alone)
    getattr(core, f"{name}_in_loops")(x, in_loops)
    assert alone.tobytes() == in_loops.tobytes()


def test_the_scaled_error_function_within_four_units_of_the_last_place() -> None:
    x = np.concatenate([np.linspace(0.0, 6.0, 2000), _values(5, 0.0, 6.0)])
    out = np.empty_like(x)
    core.erfc_scaled(x, out)
    with mpmath.workdps(50):
        assert _worst(out, [mpmath.exp(v * v) * mpmath.erfc(v) for v in map(mpmath.mpf, x.tolist())]) < 4.0


@pytest.mark.parametrize("name", [c[0] for c in CASES])
def test_both_builds_give_the_same_bits(name: str) -> None:
    low, high = next((c[1], c[2]) for c in CASES if c[0] == name)
    x = _values(3, low, high)
    results = []
    for build in BUILDS:
        try:
            module = importlib.import_module(f"cabinpose._native.{build}")
        except ImportError:
            pytest.skip(f"{build} was not built for this processor")
        out = np.empty_like(x)
        getattr(module.core, name)(x, out)
        results.append(out.tobytes())
    assert results[0] == results[1]
