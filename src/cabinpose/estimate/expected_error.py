"""How far off a joint is likely to be, in metres, from what a model says of itself: its score and the spreads of its answer.

Of each joint a weighted sum of these cues ranks the answers (least squares with weights of no sign but plus, on the logarithm of
the error: Lawson and Hanson, "Solving least squares problems", 1974), and the mean error is a rising function of that rank
(isotonic regression: Barlow et al., "Statistical inference under order restrictions", 1972), as in the calibration of
probabilities by Zadrozny and Elkan ("Transforming classifier scores into accurate multiclass probability estimates", KDD 2002).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.found import Found

METADATA_KEY = "expected_error"
FEWEST = 100  # errors of a joint that are enough to say what is to be expected
_STEPS, _OF_STEP = 20, 10  # most steps of a table, fewest errors of each
SCORE_MARGIN, LEAST_SPREAD_M, _ERROR_M = 1e-6, 1e-4, 1e-3  # least values of which a logarithm is taken

Array = NDArray[np.float64]
Table = Mapping[str, Mapping[str, Sequence[float]]]


def cues(found: Found) -> Array:
    """(N, P, J, C) what goes with the error, more is worse: the doubt in the score, and the logarithm of each spread."""
    if found.spreads is None:
        return -np.asarray(found.score, np.float64)[..., None]
    score = np.clip(found.score, SCORE_MARGIN, 1 - SCORE_MARGIN)
    doubt = np.log(1 - score) - np.log(score)
    return np.concatenate((doubt[..., None], np.log(np.maximum(found.spreads, LEAST_SPREAD_M))), axis=-1)


def fit_expected_error(known: Array, error_m: Array, joints: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """The table of a model: by joint the weights of the cues, and the expected error (m) by their weighted sum.

    Parameters
    ----------
    known
        (N, P, J, C) the cues.
    error_m
        (N, P, J) the distance to the truth; NaN where there is nothing to compare.
    joints
        Their names. Joints with fewer than `FEWEST` errors are left out.
    """
    table = {}
    for j, name in enumerate(joints):
        there = np.isfinite(error_m[:, :, j])
        if there.sum() >= FEWEST:
            table[name] = _fit_joint(known[:, :, j][there], error_m[:, :, j][there])
    return table


def _fit_joint(known: Array, error_m: Array) -> dict[str, list[float]]:
    from scipy.optimize import isotonic_regression, nnls  # noqa: PLC0415 - half a second, and prediction needs neither

    target = np.log(error_m + _ERROR_M)
    weights, _ = nnls(known - known.mean(axis=0), target - target.mean())
    doubt = known @ weights
    edges = np.unique(np.quantile(doubt, np.linspace(0, 1, min(_STEPS, len(doubt) // _OF_STEP) + 1)))
    step = np.searchsorted(edges[1:-1], doubt, side="right")
    count = np.bincount(step)
    held = count > 0
    centre, mean = (np.bincount(step, values)[held] / count[held] for values in (doubt, error_m))
    rising = isotonic_regression(mean, weights=count[held]).x
    return {"weights": weights.tolist(), "doubt": centre.tolist(), "error_m": rising.tolist()}


def expected_errors(table: Table, joints: Sequence[str], found: Found) -> Array:
    """(N, P, J) m, between the steps of the table along a straight line, beyond its ends as at them; NaN = not known.

    Raises ValueError where the model has other cues than the table was fitted to.
    """
    result = np.full(found.score.shape, np.nan)
    if not table:
        return result
    known = cues(found)
    for j, name in enumerate(joints):
        if name in table:
            steps = table[name]
            result[:, :, j] = np.interp(known[:, :, j] @ np.asarray(steps["weights"]), steps["doubt"], steps["error_m"])
    return np.where(np.isfinite(found.joints_3d).all(axis=-1), result, np.nan)


def usual_errors(table: Table, joints: Sequence[str]) -> Array:
    """(J,) m, what half of the answers were expected to be better than where the table was fitted; NaN = not known."""
    return np.array([_middle(table[name]["error_m"]) if name in table else np.nan for name in joints])


def _middle(rising: Sequence[float]) -> float:
    """The median of numbers that rise; numpy's own loads half a megabyte the first time."""
    return (rising[(len(rising) - 1) // 2] + rising[len(rising) // 2]) / 2


def check(table: Any) -> Table:
    """A table as a file holds it. Raises ValueError, KeyError or TypeError for anything else."""
    for steps in table.values():
        weights, doubt, error_m = (np.asarray(steps[name], np.float64) for name in ("weights", "doubt", "error_m"))
        if weights.ndim != 1 or doubt.shape != error_m.shape or not doubt.size:
            raise ValueError("the table of expected errors is damaged")
        if (np.diff(doubt) <= 0).any() or (np.diff(error_m) < 0).any() or not np.isfinite(doubt.sum() + weights.sum()):
            raise ValueError("the table of expected errors does not rise")
    return table
