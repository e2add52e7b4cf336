"""Whether a model's confidence can be trusted: presence against what is there, and error against what the model said of it.

The expected calibration error is that of Naeini et al. ("Obtaining well calibrated probabilities using Bayesian binning", AAAI
2015) with ten bins of one width, and the errors of the surest joints are a risk-coverage curve (El-Yaniv and Wiener, "On the
foundations of noise-free selective classification", JMLR 2010).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Visibility
from cabinpose.evaluate.samples import Samples

_BINS = 10
_KEPT = np.arange(5, 101, 5)  # per cent of the joints found, the surest ones
Array = NDArray[np.float64]


class Reliability(NamedTuple):
    """In B bins that are not empty, (B,): samples, the mean of what they said, and the mean of what was."""

    samples: NDArray[np.int64]
    said: Array
    was: Array

    @property
    def error(self) -> float:
        """Mean over all samples of how far the two are apart in their bin: for probabilities, the expected calibration error."""
        return float(np.average(np.abs(self.said - self.was), weights=self.samples)) if len(self.samples) else np.nan

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {name: np.round(values, 6).tolist() for name, values in self._asdict().items()}


def reliability(said: Array, was: Array, edges: Array) -> Reliability:
    """Bins between rising `edges`, the last one with its end, of what was said (S,) and what was (S,)."""
    at = np.clip(np.searchsorted(edges, said, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(at, minlength=len(edges) - 1)
    held = count > 0
    means = (np.bincount(at, values, minlength=len(count))[held] / count[held] for values in (said, was))
    return Reliability(count[held], *means)


def of_presence(samples: Samples, members: tuple[int, ...]) -> tuple[Reliability, Reliability]:
    """Presence against the share of joints that are in the image, and of those that are and were found within d."""
    answered = np.isfinite(samples.presence) & (samples.counts | samples.absent)
    chosen = answered[:, members]
    said = samples.presence[:, members][chosen].astype(np.float64)
    inside = (samples.visibility > Visibility.OUTSIDE_IMAGE)[:, members][chosen]
    near = inside & samples.near[:, members][chosen]
    edges = np.linspace(0, 1, _BINS + 1)
    return reliability(said, inside.astype(float), edges), reliability(said, near.astype(float), edges)


class Confidence(NamedTuple):
    """Joints found, the surest first: error in the unit of reports (S,), and what is expected of it, NaN = not known."""

    error: Array
    expected: Array
    rank_correlation: float

    def of_surest(self, within: float) -> dict[str, list[float]]:
        """The risk-coverage curve: of the surest 5, 10, ... 100 % the median and mean error, and the share (%) within d."""
        counts = np.maximum(np.ceil(len(self.error) * _KEPT / 100).astype(int), 1) if len(self.error) else []
        kept = [self.error[:n] for n in counts]
        return {
            "kept": _KEPT[: len(kept)].tolist(),
            "median": [round(float(np.median(e)), 4) for e in kept],
            "mean": [round(float(e.mean()), 4) for e in kept],
            "within": [round(100 * float((e <= within).mean()), 3) for e in kept],
        }

    def of_expected(self) -> Reliability:
        """The expected error against the mean error, in ten bins of as many joints each."""
        known = np.isfinite(self.expected)
        said, was = self.expected[known], self.error[known]
        if not known.any():
            return Reliability(np.zeros(0, np.int64), said, was)
        edges = np.unique(np.quantile(said, np.linspace(0, 1, _BINS + 1)))
        return reliability(said, was, edges if len(edges) > 1 else np.repeat(edges, 2))


def confidence(samples: Samples, error: NDArray[np.floating], unit: float, members: tuple[int, ...]) -> Confidence:
    """How a model ranks its joints: by the expected error where it gives one, else by its score.

    error: (S, J) in the unit of reports, NaN where a joint does not count or was not found · unit: of it in a metre.
    """
    chosen = np.isfinite(error[:, members])
    far, expected, score = (
        values[:, members][chosen].astype(np.float64) for values in (error, samples.expected * unit, samples.score)
    )
    doubt = np.nan_to_num(expected, nan=np.inf) if np.isfinite(expected).any() else -score
    order = np.argsort(doubt, kind="stable")
    return Confidence(far[order], expected[order], _rank_correlation(doubt, far))


def _rank_correlation(a: Array, b: Array) -> float:
    """Spearman's, equal values sharing their mean rank; NaN where either does not vary."""

    def ranks(values: Array) -> Array:
        _, at, count = np.unique(values, return_inverse=True, return_counts=True)
        return (np.cumsum(count) - 0.5 * (count - 1))[at]

    one, other = ranks(a), ranks(b)
    if not (len(a) and np.ptp(one) and np.ptp(other)):
        return np.nan
    return float(np.corrcoef(one, other)[0, 1])
