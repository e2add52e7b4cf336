"""The metrics, each as sums over samples: a numerator and a denominator per sample and joint, pooled before they are divided.

Formulas, units, denominators and sources are in docs/evaluation.md. Only the thesis' numbers are averages over joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.pose import Visibility
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.samples import Samples, Space

Array = NDArray[np.float64]
SpaceName = Literal["2d", "3d", "image"]

TRUE = "true joints that count; one that was not found is wrong"
FOUND = "true joints that count and were found"
HITS = "true joints that count, found within d"
_UNIT = MappingProxyType({"2d": ("px", 1.0), "3d": ("cm", 100.0)})  # of reports, and its number in a px or m
_STATES = (Visibility.VISIBLE, Visibility.SELF_OCCLUDED, Visibility.OCCLUDED, Visibility.OUTSIDE_IMAGE)


@dataclass(frozen=True)
class Ratio:
    """One metric over all samples: scale x sum(numerator) / sum(denominator), both (S, J).

    per_joint: the mean of the joints' ratios in place of the ratio of sums (the thesis' way) · people: (S, 1) arrays about
    whole people · threshold: in `threshold_unit` · visibility: which true joints, "any" = all that count.
    """

    metric: str
    space: SpaceName
    unit: str
    scale: float
    denominator_is: str
    numerator: Array
    denominator: Array
    threshold: float | None = None
    threshold_unit: str = ""
    visibility: str = "any"
    per_joint: bool = False
    people: bool = False


def spaces_of(samples: Samples) -> list[SpaceName]:
    """The spaces in which the model answers at all: 2D, 3D or both; 2D where it never answers."""
    names: list[SpaceName] = [n for n, space in (("2d", samples.px), ("3d", samples.m)) if space.found.any()]  # type: ignore[misc]
    return names or ["2d"]


def space_of(samples: Samples, name: SpaceName) -> Space:
    """The errors in a space."""
    return samples.px if name == "2d" else samples.m


def ratios(samples: Samples, options: EvaluationOptions) -> Iterator[Ratio]:
    """All metrics that are ratios of sums."""
    for name in spaces_of(samples):
        space = space_of(samples, name)
        yield from _accuracy(space, name, options, samples.counts, "any")
        yield from _thesis(samples, space, name, options)
        yield from _structure(space, name)
        for state in _STATES:
            if state >= options.min_visibility:
                chosen = samples.counts & (samples.visibility == state)
                yield from _accuracy(space, name, options, chosen, state.name.lower())
    yield from _presence(samples)


def _accuracy(
    space: Space, name: SpaceName, options: EvaluationOptions, counts: NDArray[np.bool_], visibility: str
) -> Iterator[Ratio]:
    """PCK, PCKh, AUC, mean errors, over the joints with `counts` (S, J)."""
    unit, per_unit = _UNIT[name]
    error = np.nan_to_num(space.error.astype(np.float64), nan=np.inf)
    found = counts & space.found
    head = space.head.astype(np.float64)[:, None]
    sized = counts & np.isfinite(head)
    head_is = "26 px" if name == "2d" else "200 mm"
    head_unit = f"head size ({head_is})" if options.head == "thesis" else "true head-neck length"
    hit = options.hit_px if name == "2d" else options.hit_m

    def ratio(
        metric: str, shown: str, scale: float, top: Any, bottom: Any, what: str, threshold: float | None = None, of: str = ""
    ) -> Ratio:
        return Ratio(metric, name, shown, scale, what, top.astype(float), bottom.astype(float), threshold, of, visibility)

    for t in options.pck_px if name == "2d" else options.pck_m:
        yield ratio("PCK", "%", 100, found & (error <= np.float32(t)), counts, TRUE, t * per_unit, unit)
    with np.errstate(invalid="ignore"):
        for alpha in options.pckh:
            yield ratio("PCKh", "%", 100, sized & found & (error <= alpha * head), sized, TRUE, alpha, head_unit)
        area = np.where(sized & found, np.clip(1 - error / (0.5 * head), 0, None), 0)
    yield ratio("AUC of PCKh", "%", 100, area, sized, TRUE, 0.5, head_unit)
    yield ratio("mean error" if name == "2d" else "MPJPE", unit, per_unit, np.where(found, error, 0), found, FOUND)
    near = found & (error <= np.float32(hit))
    yield ratio("mean error of hits", unit, per_unit, np.where(near, error, 0), near, HITS, hit * per_unit, unit)
    yield ratio("found", "%", 100, found, counts, TRUE)


def _thesis(samples: Samples, space: Space, name: SpaceName, options: EvaluationOptions) -> Iterator[Ratio]:
    """mAD, mAD@d, and mAP@d and mAR in both readings: per joint, then averaged over the joints.

    TP: a true joint, found within d. FN: a true joint that is not found, or found farther than d. FP: found where no true joint
    is. By that formula, mAR = TP / (TP + FN) has all true joints below the line; "detected" asks only that a joint is found.
    """
    unit, per_unit = _UNIT[name]
    hit = options.hit_px if name == "2d" else options.hit_m
    error = np.nan_to_num(space.error.astype(np.float64), nan=np.inf)
    found = samples.counts & space.found
    near = found & (error <= np.float32(hit))
    false = samples.absent & space.found
    at = {"threshold": hit * per_unit, "threshold_unit": unit}

    def ratio(metric: str, shown: str, scale: float, top: Any, bottom: Any, what: str, **more: Any) -> Ratio:
        return Ratio(metric, name, shown, scale, what, top.astype(float), bottom.astype(float), per_joint=True, **more)

    yield ratio("mAD", unit, per_unit, np.where(found, error, 0), found, FOUND)
    yield ratio("mAD@d", unit, per_unit, np.where(near, error, 0), near, HITS, **at)
    yield ratio("mAP@d (literal)", "%", 100, near, near | false, "TP + FP: found within d, or found where there is none", **at)
    yield ratio("mAP@d (among detected)", "%", 100, near, found, FOUND, **at)
    yield ratio("mAR@d (literal)", "%", 100, near, samples.counts, "TP + FN: true joints, found within d or not", **at)
    yield ratio("mAR (detected)", "%", 100, found, samples.counts, TRUE)


def _structure(space: Space, name: SpaceName) -> Iterator[Ratio]:
    """What single joints do not show: the pose as a whole, its sides, its bones, its calm."""
    unit, per_unit = _UNIT[name]
    measured: list[tuple[str, str, float, NDArray[np.float32], str]] = [
        ("left-right swaps", "%", 100, space.swap, "symmetric pairs that count and were found"),
        ("jitter", f"{unit}/frame²", per_unit, space.jitter, "joints that count and were found in three frames in a row"),
    ]
    if name == "3d":
        measured += [
            ("P-MPJPE", unit, per_unit, space.aligned, "found joints of people with three or more of them"),
            ("bone length error", unit, per_unit, space.bone, "bones of which both ends count and were found"),
        ]
    for metric, shown, scale, values, what in measured:
        known = np.isfinite(values)
        yield Ratio(metric, name, shown, scale, what, np.where(known, values, 0).astype(float), known.astype(float))


def _presence(samples: Samples) -> Iterator[Ratio]:
    """Whether joints, and people, were said to be there; and the mean OKS of people."""
    right = samples.found & samples.counts
    said = samples.found & (samples.counts | samples.absent)
    yield Ratio("presence precision", "image", "%", 100, "joints found, but those too hidden to count", *_pair(right, said))
    yield Ratio("presence recall", "image", "%", 100, "true joints that count", *_pair(right, samples.counts))
    counting = np.asarray(samples.counts.any(axis=1))
    both = (counting & samples.predicted)[:, None]
    said_people = (samples.predicted & (counting | ~samples.true))[:, None]
    people = counting[:, None]
    yield Ratio("presence precision", "image", "%", 100, "people found", *_pair(both, said_people), people=True)
    yield Ratio("presence recall", "image", "%", 100, "true people with a joint that counts", *_pair(both, people), people=True)
    if samples.px.found.any():
        similar = np.where(people, samples.oks[:, None], 0.0).astype(np.float64)
        what = "true people with a joint that counts; one not found has 0"
        yield Ratio("OKS", "2d", "", 1, what, similar, people.astype(float), people=True)


def _pair(top: NDArray[np.bool_], bottom: NDArray[np.bool_]) -> tuple[Array, Array]:
    return top.astype(float), bottom.astype(float)
