"""Arithmetic whose results are the same bits on every processor: products and elementary functions.

A BLAS adds up in the order, and with the fused operations, that suit the processor; numpy and the C library have elementary
functions of their own for several of them. What decides what a dataset shows is computed by these in their place, or in the
kernels (docs/decisions/0007-compiled-core.md). The names are numpy's. float32 stays float32; what is no array becomes float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cabinpose._native import core as native


def matmul(a: ArrayLike, b: ArrayLike, *more: ArrayLike) -> Any:
    """As numpy's, of arrays with the same axes but their last two, or of which one has no more than those; sums in order.

    Of several, from the left.
    """
    if more:
        return matmul(matmul(a, b), *more)
    left, right = np.asarray(a), np.asarray(b)
    if left.dtype == right.dtype == np.float32:
        result: Any = native.matmul_float32(a=left, b=right)
    else:
        result = native.matmul(a=left.astype(np.float64, copy=False), b=right.astype(np.float64, copy=False))
    return result if result.ndim else result[()]


def norm(x: Any) -> float:
    """Length of a vector (N,). Those of many vectors are numpy's, which with an axis adds up in order."""
    return math.sqrt(matmul(x, x))


def solve(a: ArrayLike, b: ArrayLike) -> Any:
    """x of a (N, N) x = b (N,) or (N, M), for small N: elimination with the largest pivot; LinAlgError where there is none."""
    left, right = np.array(a, np.float64), np.array(b, np.float64)
    for k in range(len(left)):
        pivot = k + int(np.argmax(np.abs(left[k:, k])))
        if left[pivot, k] == 0.0:
            raise np.linalg.LinAlgError("Singular matrix")
        left[[k, pivot]], right[[k, pivot]] = left[[pivot, k]], right[[pivot, k]]
        for row in range(k + 1, len(left)):
            factor = left[row, k] / left[k, k]
            left[row, k:] -= factor * left[k, k:]
            right[row] -= factor * right[k]
    for k in reversed(range(len(left))):
        for column in range(k + 1, len(left)):
            right[k] -= left[k, column] * right[column]
        right[k] /= left[k, k]
    return right


def inv(a: ArrayLike) -> Any:
    """Inverse of a (N, N), as `solve`."""
    return solve(a, np.eye(len(np.asarray(a))))


def _elementwise(function: Callable[..., Any], x: Any) -> Any:
    if isinstance(x, (float, int)):
        return function(float(x))
    values = np.asarray(x)
    result = np.empty(values.shape)
    function(np.ascontiguousarray(values, np.float64).reshape(-1), result.reshape(-1))
    if values.dtype == np.float32:
        return result.astype(np.float32)
    return result if result.ndim else result[()]


def sin(x: Any) -> Any:
    """Sine of an angle (rad) below 1e6."""
    return _elementwise(native.sin, x)


def cos(x: Any) -> Any:
    """Cosine of an angle (rad) below 1e6."""
    return _elementwise(native.cos, x)


def tan(x: Any) -> Any:
    """Tangent of an angle (rad) below 1e6."""
    return sin(x) / cos(x)


def arcsin(x: Any) -> Any:
    """Angle (rad) of a sine."""
    return _elementwise(native.asin, x)


def arccos(x: Any) -> Any:
    """Angle (rad) of a cosine."""
    return _elementwise(native.acos, x)


def arctan(x: Any) -> Any:
    """Angle (rad) of a tangent."""
    return arctan2(x, 1.0)


def arctan2(y: Any, x: Any) -> Any:
    """Angle (rad) of points (x, y)."""
    if isinstance(x, (float, int)) and isinstance(y, (float, int)):
        return native.atan2(float(y), float(x))
    ys, xs = np.broadcast_arrays(np.asarray(y, np.float64), np.asarray(x, np.float64))
    result = np.empty(ys.shape)
    native.atan2(np.ascontiguousarray(ys).reshape(-1), np.ascontiguousarray(xs).reshape(-1), result.reshape(-1))
    return result if result.ndim else result[()]


def exp(x: Any) -> Any:
    """e to the power of x."""
    return _elementwise(native.exp, x)


def log(x: Any) -> Any:
    """Natural logarithm."""
    return _elementwise(native.log, x)


def power(x: Any, exponent: float) -> Any:
    """x, 0 or more, to a power of 0 or more, to 1e-13 of its size; whole powers of any x by multiplication."""
    if exponent == 0:
        return np.ones_like(x)
    if exponent == int(exponent) and 0 < exponent <= 64:
        result, factor, left = None, x if isinstance(x, (float, int)) else np.asarray(x), int(exponent)
        while left:
            if left & 1:
                result = factor if result is None else result * factor
            factor, left = factor * factor, left >> 1
        return result
    return exp(exponent * log(x))


def hypot(x: Any, y: Any) -> Any:
    """Length of (x, y)."""
    if isinstance(x, (float, int)) and isinstance(y, (float, int)):
        return math.sqrt(x * x + y * y)
    xs, ys = np.asarray(x), np.asarray(y)
    return np.sqrt(xs * xs + ys * ys)
