"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from typing import Annotated, overload

import numpy
from numpy.typing import NDArray

def undistort(
    distorted: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), writable=False)],
    dist: Annotated[NDArray[numpy.float64], dict(shape=(5), writable=False)],
    steps: int,
    ideal: Annotated[NDArray[numpy.float64], dict(shape=(None, 2))],
) -> None:
    """Distorted normalised coordinates to ideal ones."""

def matmul(
    *,
    a: Annotated[NDArray[numpy.float64], dict(device="cpu", writable=False)],
    b: Annotated[NDArray[numpy.float64], dict(device="cpu", writable=False)],
) -> NDArray[numpy.float64]:
    """numpy's matmul, the same bits everywhere."""

def matmul_float32(
    *,
    a: Annotated[NDArray[numpy.float32], dict(device="cpu", writable=False)],
    b: Annotated[NDArray[numpy.float32], dict(device="cpu", writable=False)],
) -> NDArray[numpy.float32]:
    """The same of float32."""

@overload
def sin(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Sine, the same bits everywhere."""

@overload
def sin(x: float) -> float: ...
@overload
def cos(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Cosine, the same bits everywhere."""

@overload
def cos(x: float) -> float: ...
@overload
def exp(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Exponential, the same bits everywhere."""

@overload
def exp(x: float) -> float: ...
@overload
def log(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Natural logarithm, the same bits everywhere."""

@overload
def log(x: float) -> float: ...
@overload
def tanh(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Hyperbolic tangent, the same bits everywhere."""

@overload
def tanh(x: float) -> float: ...
@overload
def acos(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Arc cosine, the same bits everywhere."""

@overload
def acos(x: float) -> float: ...
@overload
def asin(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Arc sine, the same bits everywhere."""

@overload
def asin(x: float) -> float: ...
def sin_in_loops(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Sine without branches, the same bits."""

def exp_in_loops(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Exponential without branches, the same bits."""

def erfc_scaled(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """exp(x^2) erfc(x) for 0 <= x <= 6."""

@overload
def atan2(y: float, x: float) -> float: ...
@overload
def atan2(
    y: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Angle of a point, the same bits everywhere."""

def normal_cdf(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Probability of values below x, standard normal."""

def normal_quantile(
    p: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Inverse of normal_cdf."""
