"""The normal distribution of the core: against fifty digits, at its edges, inverse to itself, the same bits in both builds."""

from __future__ import annotations

import importlib

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from cabinpose._native import core

Array = NDArray[np.float64]


def cdf(x: Array) -> Array:
    out = np.empty_like(x)
    core.normal_cdf(x, out)
    return out


def quantile(p: Array) -> Array:
    out = np.empty_like(p)
    core.normal_quantile(p, out)
    return out


def test_cdf_within_1e_13_of_the_truth_in_the_tail_too() -> None:
    x = np.concatenate([np.linspace(-37.0, 8.0, 451), np.nextafter(-8.0, [-9.0, 0.0])])
    with mpmath.workdps(50):
        truth = [mpmath.ncdf(mpmath.mpf(float(v))) for v in x]
        errors = [float(abs(mpmath.mpf(float(p)) / t - 1)) for p, t in zip(cdf(x), truth, strict=True)]
    assert max(errors) < 1e-13
    assert cdf(np.array([0.0, np.inf, -np.inf])).tolist() == [0.5, 1.0, 0.0]
    assert np.isnan(cdf(np.array([np.nan]))).all()


def test_quantile_within_1e_15_of_the_truth() -> None:
    rng = np.random.default_rng(0)
    p = np.concatenate([rng.uniform(0.0, 1.0, 200), 10.0 ** rng.uniform(-300, -1, 200), [0.075, 0.925]])
    with mpmath.workdps(50):
        truth = []
        for share, guess in zip(p, quantile(p), strict=True):
            x = mpmath.mpf(float(guess))
            for _ in range(3):  # Newton's steps, from a guess that is right to 15 digits
                x -= (mpmath.ncdf(x) - mpmath.mpf(float(share))) / mpmath.npdf(x)
            truth.append(x)
        errors = [float(abs(mpmath.mpf(float(q)) / t - 1)) for q, t in zip(quantile(p), truth, strict=True)]
    assert max(errors) < 1e-14
    assert quantile(np.array([0.0, 0.5, 1.0])).tolist() == [-np.inf, 0.0, np.inf]
    assert np.isnan(quantile(np.array([-0.1, 1.1, np.nan]))).all()


def test_they_undo_each_other() -> None:
    x = np.linspace(-30.0, 5.0, 701)
    np.testing.assert_allclose(quantile(cdf(x)), x, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["normal_cdf", "normal_quantile"])
def test_both_builds_give_the_same_bits(name: str) -> None:
    x = np.linspace(-38.0, 9.0, 5000) if name == "normal_cdf" else np.linspace(0.0, 1.0, 5001)
    results = []
    for build in ("_baseline", "_avx2"):
        module = pytest.importorskip(f"cabinpose._native.{build}")
        if build == "_avx2" and not importlib.import_module("cabinpose._native._baseline").runs_here():
            pytest.skip("this processor has no AVX2")
        out = np.empty_like(x)
        getattr(module.core, name)(x, out)
        results.append(out.tobytes())
    assert results[0] == results[1]
