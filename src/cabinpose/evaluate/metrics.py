"""The metrics, a row of `TABLE` each; reports, JSON and pages have what each of `METRICS` yields, in the order of that registry.

A metric is pooled: sums or quantiles over all samples. Only the thesis' numbers are averages over joints. Formulas, units,
denominators and sources are in docs/evaluation.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Registry
from cabinpose.evaluate.bootstrap import interval
from cabinpose.evaluate.oks import THRESHOLDS, average_precision
from cabinpose.evaluate.sample_view import ANY, IMAGE, NO_THRESHOLD, PEOPLE, Number, SampleView, Threshold

TRUE = "true joints that count; one that was not found is wrong"
FOUND = "true joints that count and were found"
HITS = "true joints that count, found within d"
_TP_FP = "TP + FP: found within d, or found where there is none"
_TP_FN = "TP + FN: true joints, found within d or not"
_IN_A_ROW = "joints that count and were found in three frames in a row"
_FROM_ROOT = "found joints, but the root, of people whose root counts and was found"
_ALIGNED = "found joints of people with three or more of them"
_BOTH_ENDS = "bones of which both ends count and were found"
_ANSWERED = "joints with a position, however improbable, but those too hidden to count"
_PEOPLE = "true people with a joint that counts"


@dataclass(frozen=True)
class Value:
    """One number. `joints`: "All", a group, a joint, or "Person"; `low`, `high`: its 95 % interval, NaN without one."""

    metric: str
    space: str
    joints: str
    value: float
    unit: str
    threshold: float | None
    threshold_unit: str
    denominator: str
    samples: int
    low: float
    high: float
    visibility: str = "any"
    average: str = "pooled"


def value_among(
    values: Iterable[Value], metric: str, space: str, joints: str, threshold: float | None = None, visibility: str = ANY
) -> Value | None:
    """The number of that name; with `threshold` left out, the first one. None if there is none."""
    for v in values:
        if (v.metric, v.space, v.joints, v.visibility) == (metric, space, joints, visibility) and (
            threshold is None or (v.threshold is not None and abs(v.threshold - threshold) < 1e-9)
        ):
            return v
    return None


@dataclass(frozen=True)
class Metric:
    """One metric.

    name: in reports · unit: of its numbers; `{length}` in it stands for px in 2D and cm in 3D · better: whether more or less of
    it is · numbers: what it measures in a view · spaces: the views that it is for, "2d", "3d", "image" · by_visibility: also for
    the joints of each state of visibility · listed_by: by what the numbers of neighbours that have the same are in order before
    they are by metric: fields of `Value` among "space", "visibility", "joints".
    """

    name: str
    unit: str
    better: Literal["more", "less"]
    numbers: Callable[[SampleView], Iterable[Number]]
    spaces: tuple[str, ...] = ("2d", "3d")
    by_visibility: bool = False
    listed_by: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError for a space or a field that there is not, which would be left out silently."""
        for given, known in ((self.spaces, ("2d", "3d", IMAGE)), (self.listed_by, ("space", "visibility", "joints"))):
            if unknown := set(given) - set(known):
                raise ValueError(f"{self.name}: {', '.join(sorted(unknown))}: not one of {', '.join(known)}")

    def values(self, view: SampleView) -> Iterator[Value]:
        """What it measures in a view, with its name and unit; nothing where the view is none that it is for."""
        if view.space not in self.spaces or (view.visibility != ANY and not self.by_visibility):
            return
        unit = self.unit.format(length=view.unit)
        for n in self.numbers(view):
            yield Value(
                n.name or self.name, view.space, n.joints, n.value, unit, *n.threshold, n.denominator, n.samples, n.low, n.high,
                view.visibility, n.average,
            )  # fmt: skip


METRICS: Registry[Metric] = Registry("cabinpose.metrics", "metric", Metric)


def _pck(view: SampleView) -> Iterator[Number]:
    for t in view.options.pck_px if view.space == "2d" else view.options.pck_m:
        yield from view.share(view.found & (view.error <= np.float32(t)), view.counts, TRUE, threshold=view.length(t))


def within_head(error: NDArray[np.floating], head: NDArray[np.floating], alpha: float) -> NDArray[np.bool_]:
    """Which errors are at most a part of the head size; False for those that are NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray(error <= alpha * head)


def area_to_half(error: NDArray[np.floating], head: NDArray[np.floating]) -> NDArray[np.floating]:
    """The area, 0 to 1, under the accuracy of each error over parts of the head size from 0 to 0.5."""
    with np.errstate(invalid="ignore"):
        return np.clip(1 - error / (0.5 * head), 0, None)


def _pckh(view: SampleView) -> Iterator[Number]:
    sized = view.counts & np.isfinite(view.head)
    for alpha in view.options.pckh:
        near = sized & view.found & within_head(view.error, view.head, alpha)
        yield from view.share(near, sized, TRUE, threshold=Threshold(alpha, _head_size(view)))


def _auc(view: SampleView) -> Iterator[Number]:
    sized = view.counts & np.isfinite(view.head)
    area = np.where(sized & view.found, area_to_half(view.error, view.head), 0)
    return view.share(area, sized, TRUE, threshold=Threshold(0.5, _head_size(view)))


def _head_size(view: SampleView) -> str:
    size = "26 px" if view.space == "2d" else "200 mm"
    return f"head size ({size})" if view.options.head == "thesis" else "true head-neck length"


# The thesis' numbers: per joint, then averaged over the joints. TP: a true joint, found within d. FN: a true joint that is not
# found, or found farther than d. FP: found where no true joint is. By that formula, mAR = TP / (TP + FN) has all true joints
# below the line; "detected" asks only that a joint is found.


def _map_literal(view: SampleView) -> Iterator[Number]:
    false = view.samples.absent & view.errors.found
    return view.share(view.near, view.near | false, _TP_FP, threshold=view.d, per_joint=True)


# What single joints do not show: the pose as a whole, its sides, its bones, its steadiness.


def _swaps(view: SampleView) -> Iterator[Number]:
    swap = view.errors.swap
    return view.share(np.nan_to_num(swap), np.isfinite(swap), "symmetric pairs that count and were found")


def _known(view: SampleView, values: NDArray[np.float32], denominator: str) -> Iterator[Number]:
    return view.mean(values, np.isfinite(values), denominator)


# Whether joints, and people, were predicted to be there.


def _presence_precision(view: SampleView) -> Iterator[Number]:
    samples = view.samples
    answered = samples.found & (samples.counts | samples.absent)
    return view.share(samples.found & samples.counts, answered, "joints found, but those too hidden to count")


def _presence_recall(view: SampleView) -> Iterator[Number]:
    samples = view.samples
    return view.share(samples.found & samples.counts, samples.counts, "true joints that count")


def _people_precision(view: SampleView) -> Iterator[Number]:
    samples, counting = view.samples, np.asarray(view.samples.counts.any(axis=1))
    claimed = samples.predicted & (counting | ~samples.true)
    return view.share((counting & samples.predicted)[:, None], claimed[:, None], "people found", people=True)


def _people_recall(view: SampleView) -> Iterator[Number]:
    counting = np.asarray(view.samples.counts.any(axis=1))
    return view.share((counting & view.samples.predicted)[:, None], counting[:, None], _PEOPLE, people=True)


def _elsewhere(view: SampleView) -> Iterator[Number]:
    counting = np.asarray(view.samples.counts.any(axis=1))[:, None]
    return view.share(view.samples.elsewhere[:, None], counting, _PEOPLE, people=True)


def _oks(view: SampleView) -> Iterator[Number]:
    if view.errors.found.any():
        counting = np.asarray(view.samples.counts.any(axis=1))[:, None]
        yield from view.mean(view.samples.oks[:, None], counting, f"{_PEOPLE}; one not found has 0", people=True)


def _average_precision(view: SampleView) -> Iterator[Number]:
    if not view.errors.found.any():
        return
    detections = view.samples.detections
    now = average_precision(detections)
    resampled = np.array([average_precision(detections, w.astype(np.int64)) for w in view.weights]).reshape(-1, len(THRESHOLDS))
    people = int(detections.true.sum())
    denominator = f"{_PEOPLE}; precision at 101 recalls"
    for threshold, columns in ((None, slice(None)), (0.5, slice(0, 1)), (0.75, slice(5, 6))):
        (low,), (high,) = interval(100 * resampled[:, columns].mean(axis=1, keepdims=True))
        at = NO_THRESHOLD if threshold is None else Threshold(threshold, "OKS")
        yield Number(PEOPLE, float(100 * now[columns].mean()), denominator, people, float(low), float(high), at)


def _median_and_p95(view: SampleView) -> Iterator[Number]:
    return view.quantiles(view.found_errors, {"median error": 0.5, "P95 of the error": 0.95}, FOUND)


# How far a model's confidence can be trusted, by set of joints; see `calibration`. Without intervals.


def _ece_of_presence(view: SampleView) -> Iterator[Number]:
    for joints, (in_image, _) in view.presence.items():
        yield Number(joints, 100 * in_image.error, _ANSWERED, int(in_image.samples.sum()))


def _ece_of_presence_at_d(view: SampleView) -> Iterator[Number]:
    judged = replace(view, space="3d" if "3d" in view.samples.spaces() else "2d")
    at = Threshold(judged.hit_shown, judged.unit)
    for joints, (_, within) in view.presence.items():
        yield Number(joints, 100 * within.error, _ANSWERED, int(within.samples.sum()), threshold=at)


def _rank_correlation(view: SampleView) -> Iterator[Number]:
    for joints, sure in view.confidence.items():
        yield Number(joints, sure.rank_correlation, FOUND, len(sure.error))


def _error_of_expected(view: SampleView) -> Iterator[Number]:
    for joints, sure in view.confidence.items():
        if (expected := sure.of_expected()).samples.any():
            yield Number(joints, expected.error, FOUND, int(expected.samples.sum()))


_BY_SPACE = ("space", "visibility")
_accuracy, _pose = partial(Metric, listed_by=_BY_SPACE, by_visibility=True), partial(Metric, listed_by=_BY_SPACE)
_of_image = partial(Metric, spaces=(IMAGE,))
_confidence = partial(Metric, listed_by=("joints",))

TABLE: Mapping[str, Metric] = MappingProxyType(
    {
        "pck": _accuracy("PCK", "%", "more", _pck),
        "pckh": _accuracy("PCKh", "%", "more", _pckh),
        "auc_of_pckh": _accuracy("AUC of PCKh", "%", "more", _auc),
        "mean_error": _accuracy("mean error", "px", "less", lambda v: v.mean(v.error, v.found, FOUND), spaces=("2d",)),
        "mpjpe": _accuracy("MPJPE", "cm", "less", lambda v: v.mean(v.error, v.found, FOUND), spaces=("3d",)),
        "mean_error_of_hits": _accuracy(
            "mean error of hits", "{length}", "less", lambda v: v.mean(v.error, v.near, HITS, threshold=v.d)
        ),
        "found": _accuracy("found", "%", "more", lambda v: v.share(v.found, v.counts, TRUE)),
        "mad": _pose("mAD", "{length}", "less", lambda v: v.mean(v.error, v.found, FOUND, per_joint=True)),
        "mad_at_d": _pose("mAD@d", "{length}", "less", lambda v: v.mean(v.error, v.near, HITS, threshold=v.d, per_joint=True)),
        "map_literal": _pose("mAP@d (literal)", "%", "more", _map_literal),
        "map_among_detected": _pose(
            "mAP@d (among detected)", "%", "more", lambda v: v.share(v.near, v.found, FOUND, threshold=v.d, per_joint=True)
        ),
        "mar_literal": _pose(
            "mAR@d (literal)", "%", "more", lambda v: v.share(v.near, v.counts, _TP_FN, threshold=v.d, per_joint=True)
        ),
        "mar_detected": _pose("mAR (detected)", "%", "more", lambda v: v.share(v.found, v.counts, TRUE, per_joint=True)),
        "left_right_swaps": _pose("left-right swaps", "%", "less", _swaps),
        "jitter": _pose("jitter", "{length}/frame²", "less", lambda v: _known(v, v.errors.jitter, _IN_A_ROW)),
        "root_relative_mpjpe": _pose(
            "root-relative MPJPE", "cm", "less", lambda v: _known(v, v.errors.relative, _FROM_ROOT), spaces=("3d",)
        ),
        "p_mpjpe": _pose("P-MPJPE", "cm", "less", lambda v: _known(v, v.errors.aligned, _ALIGNED), spaces=("3d",)),
        "bone_length_error": _pose(
            "bone length error", "cm", "less", lambda v: _known(v, v.errors.bone, _BOTH_ENDS), spaces=("3d",)
        ),
        "presence_precision": _of_image("presence precision", "%", "more", _presence_precision),
        "presence_recall": _of_image("presence recall", "%", "more", _presence_recall),
        "presence_precision_of_people": _of_image("presence precision", "%", "more", _people_precision),
        "presence_recall_of_people": _of_image("presence recall", "%", "more", _people_recall),
        "people_elsewhere": _of_image("people found in another's place", "%", "less", _elsewhere),
        "oks": Metric("OKS", "", "more", _oks, spaces=("2d",)),
        "median_error": Metric("median error", "{length}", "less", _median_and_p95),  # and the 95th percentile, in one go
        "average_precision": Metric("AP", "%", "more", _average_precision, spaces=("2d",)),
        "ece_of_presence": _confidence("ECE of presence", "%", "less", _ece_of_presence, spaces=(IMAGE,)),
        "ece_of_presence_at_d": _confidence("ECE of presence@d", "%", "less", _ece_of_presence_at_d, spaces=(IMAGE,)),
        "rank_correlation": _confidence("rank correlation of doubt and error", "", "more", _rank_correlation),
        "error_of_expected_error": _confidence(
            "calibration error of the expected error", "cm", "less", _error_of_expected, spaces=("3d",)
        ),
    }
)
