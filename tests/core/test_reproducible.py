"""`core.reproducible` beside numpy's own: the same values to the last digits, and sums in the order of their terms."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg

from cabinpose.core import nearest_rigid, rotation_vector, transform
from cabinpose.core import reproducible as rp

SHAPES = [
    ((3, 3), (3, 3)), ((4, 4), (4,)),
    ((3,), (3, 5)), ((3,), (3,)), ((6, 3, 3), (6, 3, 2)), ((6, 3, 3), (3, 3)), ((4, 4), (7, 4, 2)),
    ((2, 5, 3, 4), (2, 5, 4, 6)), ((200, 3), (3, 3)), ((7, 90), (90, 80)), ((2, 0), (0, 3)), ((0, 3), (3, 3)),
]  # fmt: skip


@pytest.mark.parametrize(("a", "b"), SHAPES)
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_products_are_numpys(a: tuple[int, ...], b: tuple[int, ...], kind: type) -> None:
    rng = np.random.default_rng(1)
    left, right = rng.standard_normal(a).astype(kind), rng.standard_normal(b).astype(kind)
    mine, theirs = rp.matmul(left, right), np.matmul(left, right)
    assert np.shape(mine) == theirs.shape
    assert mine.dtype == kind
    assert mine == pytest.approx(theirs, rel=1e-5 if kind is np.float32 else 1e-12, abs=1e-5 if kind is np.float32 else 1e-12)


def test_products_of_views_lists_and_several() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((4, 6))[::-1, ::2], rng.standard_normal((5, 3)).T
    assert rp.matmul(a, b) == pytest.approx(a @ b)
    assert rp.matmul([[1, 2], [3, 4]], (5, 6)).tolist() == [17.0, 39.0]
    assert rp.matmul(a, b, b.T) == pytest.approx(a @ b @ b.T)
    with pytest.raises(ValueError, match="do not fit"):
        rp.matmul(np.eye(3), np.eye(4))


def test_sums_are_in_the_order_of_their_terms() -> None:
    """Rounded after each product and each sum: neither fused nor in another order."""
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((30, 19)), rng.standard_normal((19, 4))
    for i in range(30):
        for j in range(4):
            total = 0.0
            for k in range(19):
                term = float(Fraction(a[i, k]) * Fraction(b[k, j]))
                total = term if k == 0 else float(Fraction(total) + Fraction(term))
            assert rp.matmul(a, b)[i, j] == total


@pytest.mark.parametrize("name", ["sin", "cos", "tan", "arcsin", "arccos", "exp", "log"])
def test_elementary_functions_are_numpys(name: str) -> None:
    x = np.random.default_rng(4).uniform(0.01, 0.99, (5, 7))
    mine, theirs = getattr(rp, name), getattr(np, name)
    assert mine(x) == pytest.approx(theirs(x), rel=4e-16, abs=4e-16)
    assert mine(x[:, ::2]) == pytest.approx(theirs(x[:, ::2]), rel=4e-16, abs=4e-16)
    assert mine(0.3) == mine(np.array(0.3)) == mine(np.float64(0.3)) == pytest.approx(theirs(0.3), rel=4e-16)
    assert mine(x.astype(np.float32)).dtype == np.float32


def test_functions_of_two() -> None:
    x, y = np.random.default_rng(5).uniform(-2, 2, (2, 40))
    assert rp.arctan2(y, x) == pytest.approx(np.arctan2(y, x), rel=4e-16)
    assert rp.arctan2(1.0, -2.0) == rp.arctan2(np.array(1.0), np.array(-2.0)) == pytest.approx(np.arctan2(1.0, -2.0))
    assert rp.arctan(x) == pytest.approx(np.arctan(x), rel=4e-16)
    assert rp.hypot(x, y) == pytest.approx(np.hypot(x, y), rel=1e-15)
    assert rp.hypot(3.0, 4.0) == 5.0
    assert rp.norm(x) == pytest.approx(np.linalg.norm(x), rel=1e-15)


@pytest.mark.parametrize("exponent", [0, 0.7, 1, 2.4, 3, 6.0, 24, 1 / 2.4])
def test_powers(exponent: float) -> None:
    x = np.append(np.random.default_rng(6).uniform(0, 3, 40), 0.0)
    assert rp.power(x, exponent) == pytest.approx(x**exponent, rel=1e-13)
    assert rp.power(1.7, exponent) == pytest.approx(1.7**exponent, rel=1e-13)


def test_small_systems() -> None:
    a, b = np.random.default_rng(7).standard_normal((4, 4)), np.arange(8.0).reshape(4, 2)
    a[0, 0] = 0.0  # needs a pivot
    assert rp.solve(a, b) == pytest.approx(np.linalg.solve(a, b))
    assert rp.solve(a, b[:, 0]) == pytest.approx(np.linalg.solve(a, b[:, 0]))
    assert rp.inv(a) == pytest.approx(np.linalg.inv(a))
    with pytest.raises(np.linalg.LinAlgError):
        rp.solve(np.ones((2, 2)), np.ones(2))


@pytest.mark.parametrize("angle", [0.1, 1.5, 3.1])
def test_the_nearest_rotation_is_that_of_the_polar_decomposition(angle: float) -> None:
    mixed = 0.5 * (
        transform(rotation_vector((0.2, -0.4, 0.1)), (1, 2, 3)) + transform(rotation_vector((angle, 0.1, 0.0)), (0, 0, 1))
    )
    found = nearest_rigid(mixed)
    assert found[:3, :3] == pytest.approx(scipy.linalg.polar(mixed[:3, :3])[0], abs=1e-12)
    assert found[:3, 3].tolist() == mixed[:3, 3].tolist()
