"""The metrics, each as sums over samples: a numerator and a denominator per sample and joint, pooled before they are divided.

Formulas, units, denominators and sources are in docs/evaluation.md. Only the thesis' numbers are averages over joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Visibility
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.samples import Samples, Space

TRUE = "true joints that count; one that was not found is wrong"
FOUND = "true joints that count and were found"
HITS = "true joints that count, found within d"
UNIT = MappingProxyType({"2d": ("px", 1.0), "3d": ("cm", 100.0)})  # of reports, and how many of it a px or m has
_STATES = (Visibility.VISIBLE, Visibility.SELF_OCCLUDED, Visibility.OCCLUDED, Visibility.OUTSIDE_IMAGE)


@dataclass(frozen=True)
class Ratio:
    """One metric over all samples: scale x sum(numerator) / sum(denominator), both (S, J), numbers or booleans.

    space: "2d", "3d" or "image" · threshold: in `threshold_unit` · visibility: which true joints, "any" = all that count ·
    per_joint: the mean of the joints' ratios in place of the ratio of sums (the thesis' way) · people: (S, 1) arrays about whole
    people.
    """

    metric: str
    unit: str
    scale: float
    numerator: NDArray[Any]
    denominator: NDArray[Any]
    denominator_is: str
    space: str
    threshold: float | None = None
    threshold_unit: str = ""
    visibility: str = "any"
    per_joint: bool = False
    people: bool = False


def ratios(samples: Samples, options: EvaluationOptions) -> Iterator[Ratio]:
    """All metrics that are ratios of sums."""
    for name, space in samples.spaces().items():
        yield from _accuracy(space, name, options, samples.counts, "any")
        yield from _thesis(samples, space, name, options)
        yield from _structure(space, name)
        for state in _STATES:
            if state >= options.min_visibility:
                chosen = samples.counts & (samples.visibility == state)
                yield from _accuracy(space, name, options, chosen, state.name.lower())
    yield from _presence(samples)


def _accuracy(space: Space, name: str, options: EvaluationOptions, counts: NDArray[np.bool_], visibility: str) -> Iterator[Ratio]:
    """PCK, PCKh, AUC, mean errors, over the joints with `counts` (S, J)."""
    unit, per_unit = UNIT[name]
    error = np.nan_to_num(space.error.astype(np.float64), nan=np.inf)
    found = counts & space.found
    head = space.head.astype(np.float64)[:, None]
    sized = counts & np.isfinite(head)
    head_is = "26 px" if name == "2d" else "200 mm"
    head_unit = f"head size ({head_is})" if options.head == "thesis" else "true head-neck length"
    hit = options.hit_px if name == "2d" else options.hit_m
    ratio = partial(Ratio, space=name, visibility=visibility)
    for t in options.pck_px if name == "2d" else options.pck_m:
        near = found & (error <= np.float32(t))
        yield ratio("PCK", "%", 100, near, counts, TRUE, threshold=t * per_unit, threshold_unit=unit)
    with np.errstate(invalid="ignore"):
        for alpha in options.pckh:
            near = sized & found & (error <= alpha * head)
            yield ratio("PCKh", "%", 100, near, sized, TRUE, threshold=alpha, threshold_unit=head_unit)
        area = np.where(sized & found, np.clip(1 - error / (0.5 * head), 0, None), 0)
    yield ratio("AUC of PCKh", "%", 100, area, sized, TRUE, threshold=0.5, threshold_unit=head_unit)
    metric = "mean error" if name == "2d" else "MPJPE"
    yield ratio(metric, unit, per_unit, np.where(found, error, 0), found, FOUND)
    near = found & (error <= np.float32(hit))
    at_hit = partial(ratio, threshold=hit * per_unit, threshold_unit=unit)
    yield at_hit("mean error of hits", unit, per_unit, np.where(near, error, 0), near, HITS)
    yield ratio("found", "%", 100, found, counts, TRUE)


def _thesis(samples: Samples, space: Space, name: str, options: EvaluationOptions) -> Iterator[Ratio]:
    """mAD, mAD@d, and mAP@d and mAR in both readings: per joint, then averaged over the joints.

    TP: a true joint, found within d. FN: a true joint that is not found, or found farther than d. FP: found where no true joint
    is. By that formula, mAR = TP / (TP + FN) has all true joints below the line; "detected" asks only that a joint is found.
    """
    unit, per_unit = UNIT[name]
    hit = options.hit_px if name == "2d" else options.hit_m
    error = np.nan_to_num(space.error.astype(np.float64), nan=np.inf)
    true = samples.counts
    found = true & space.found
    near = found & (error <= np.float32(hit))
    false = samples.absent & space.found
    ratio = partial(Ratio, space=name, per_joint=True)
    at_d = partial(ratio, threshold=hit * per_unit, threshold_unit=unit)
    yield ratio("mAD", unit, per_unit, np.where(found, error, 0), found, FOUND)
    yield at_d("mAD@d", unit, per_unit, np.where(near, error, 0), near, HITS)
    yield at_d("mAP@d (literal)", "%", 100, near, near | false, "TP + FP: found within d, or found where there is none")
    yield at_d("mAP@d (among detected)", "%", 100, near, found, FOUND)
    yield at_d("mAR@d (literal)", "%", 100, near, true, "TP + FN: true joints, found within d or not")
    yield ratio("mAR (detected)", "%", 100, found, true, TRUE)


def _structure(space: Space, name: str) -> Iterator[Ratio]:
    """What single joints do not show: the pose as a whole, its sides, its bones, its steadiness."""
    unit, per_unit = UNIT[name]
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
        yield Ratio(metric, shown, scale, np.where(known, values, 0), known, what, name)


def _presence(samples: Samples) -> Iterator[Ratio]:
    """Whether joints, and people, were predicted to be there; and the mean OKS of people."""
    right = samples.found & samples.counts
    answered = samples.found & (samples.counts | samples.absent)
    of_joints = partial(Ratio, unit="%", scale=100, space="image")
    of_people = partial(of_joints, people=True)
    precision, recall = "presence precision", "presence recall"
    yield of_joints(
        precision, numerator=right, denominator=answered, denominator_is="joints found, but those too hidden to count"
    )
    yield of_joints(recall, numerator=right, denominator=samples.counts, denominator_is="true joints that count")
    counting = np.asarray(samples.counts.any(axis=1))
    both = (counting & samples.predicted)[:, None]
    claimed = (samples.predicted & (counting | ~samples.true))[:, None]
    people = counting[:, None]
    yield of_people(precision, numerator=both, denominator=claimed, denominator_is="people found")
    yield of_people(recall, numerator=both, denominator=people, denominator_is="true people with a joint that counts")
    if samples.px.found.any():
        similar = np.where(people, samples.oks[:, None], 0.0)
        yield Ratio("OKS", "", 1, similar, people, "true people with a joint that counts; one not found has 0", "2d", people=True)
