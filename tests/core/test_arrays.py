"""Rows told apart."""

from __future__ import annotations

import numpy as np
import pytest

from cabinpose.core.arrays import distinct_rows


@pytest.mark.parametrize(
    "rows", [np.round(np.random.default_rng(2).normal(0, 1, (500, 3))), np.array([[3, 1], [0, 9], [3, 1]]), np.zeros((0, 2))]
)
def test_rows_are_told_apart_as_numpy_does(rows: np.ndarray) -> None:
    _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    got_first, got_which = distinct_rows(rows)
    np.testing.assert_array_equal(got_first, first)
    np.testing.assert_array_equal(got_which, which.reshape(-1))
