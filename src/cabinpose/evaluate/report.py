"""The report of one model: every number with its unit, threshold, denominator, joints, sample count and interval."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.evaluate.bootstrap import Weights, frame_weights, interval, weighted_quantiles, weighted_sums
from cabinpose.evaluate.boxes import Boxes, boxes_by_range
from cabinpose.evaluate.calibration import confidence, of_presence
from cabinpose.evaluate.metrics import FOUND, UNIT, Ratio, ratios
from cabinpose.evaluate.oks import THRESHOLDS, average_precision
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.samples import Samples

Array = NDArray[np.float64]
ALL = "All"
PEOPLE = "Person"
_PCKH_GRID = np.linspace(0, 1, 51)
_ERROR_GRID = {"2d": np.linspace(0, 50, 51), "3d": np.linspace(0, 30, 61)}  # px, cm
_SHOWN = 12
ANSWERED = "joints with a position, however improbable, but those too hidden to count"
_MISS = 3.0  # head sizes that a missed joint, and at most a found one, counts in the ranking of frames


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


@dataclass(frozen=True)
class Report:
    """Everything about one model on one dataset.

    joint_sets: joints by name of the set · curves: by space and set, the share in per cent at each point of `grid`, for PCKh
    (of the head size) and for the error (px, cm) · calibration: see `_calibration` · boxes: by space, range of the error and
    joint (px, cm) · worst: numbers of the worst frames, worst first · typical: of those nearest to the median frame, best
    first · settings: the options in words.
    """

    model: str
    dataset: str
    frames: int
    people: int
    joint_sets: Mapping[str, tuple[str, ...]]
    values: tuple[Value, ...]
    curves: Mapping[str, Any]
    calibration: Mapping[str, Any]
    boxes: Mapping[str, Boxes]
    worst: tuple[int, ...]
    typical: tuple[int, ...]
    settings: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    def value(
        self, metric: str, space: str = "3d", joints: str = ALL, threshold: float | None = None, visibility: str = "any"
    ) -> Value | None:
        """The number of that name; with `threshold` left out, the first one. None if there is none."""
        for v in self.values:
            if (v.metric, v.space, v.joints, v.visibility) == (metric, space, joints, visibility) and (
                threshold is None or (v.threshold is not None and abs(v.threshold - threshold) < 1e-9)
            ):
                return v
        return None

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def make_report(samples: Samples, options: EvaluationOptions, model: str, dataset: str, notes: tuple[str, ...] = ()) -> Report:
    """All numbers of one model's samples. Equal samples, options and seed give equal numbers."""
    skeleton = samples.skeleton
    sets = {ALL: tuple(range(len(skeleton.joints))), **skeleton.groups} | {j: (i,) for i, j in enumerate(skeleton.joints)}
    rng = np.random.Generator(np.random.Philox(key=options.seed))
    weights = frame_weights(len(samples.frames), options.resamples, rng=rng)
    values: list[Value] = []
    for ratio in ratios(samples, options):
        values += _ratio_values(ratio, samples, {PEOPLE: (0,)} if ratio.people else sets, weights)
    errors = {name: _found_errors(samples, name) for name in samples.spaces()}
    for name in errors:
        values += _quantile_values(samples, name, errors[name], sets, weights)
    if samples.px.found.any():
        values += _precision_values(samples, weights)
    shown = {name: members for name, members in sets.items() if name == ALL or name in skeleton.groups}
    calibration, more = _calibration(samples, errors, shown, options)
    ranked = _ranked(samples)
    middle = (len(ranked) - _SHOWN) // 2
    return Report(
        model=model,
        dataset=dataset,
        frames=len(samples.frames),
        people=int(samples.true.sum()),
        joint_sets={name: tuple(skeleton.joints[i] for i in members) for name, members in shown.items()},
        values=(*values, *more),
        calibration=calibration,
        curves={name: _curves(samples, name, errors[name], shown) for name in errors},
        boxes={name: boxes_by_range(errors[name], skeleton.joints, _limit(name, options), UNIT[name][0]) for name in errors},
        worst=ranked[:_SHOWN],
        typical=ranked[middle : middle + _SHOWN][::-1] if middle > 0 else (),  # few frames are all among the worst
        settings={**asdict(options), "min_visibility": options.min_visibility.name.lower()},
        notes=notes,
    )


def _ratio_values(ratio: Ratio, samples: Samples, sets: Mapping[str, tuple[int, ...]], weights: Weights) -> Iterator[Value]:
    top, bottom = (_by_frame(x, samples) for x in (ratio.numerator, ratio.denominator))  # (F, J)
    totals = [np.concatenate((x.sum(axis=0)[None], weighted_sums(weights, x))) for x in (top, bottom)]  # (1 + B, J)
    resampled = np.stack([_pooled(ratio, *(x[:, list(members)] for x in totals)) for members in sets.values()], axis=1)
    lows, highs = interval(resampled[1:])
    for i, (name, members) in enumerate(sets.items()):
        yield Value(
            ratio.metric, ratio.space, name, float(resampled[0, i]), ratio.unit, ratio.threshold, ratio.threshold_unit,
            ratio.denominator_is, int(totals[1][0, list(members)].sum()), float(lows[i]), float(highs[i]), ratio.visibility,
            "per joint, then averaged" if ratio.per_joint else "pooled",
        )  # fmt: skip


def _pooled(ratio: Ratio, tops: Array, bottoms: Array) -> Array:
    """(1 + B,) the metric over some joints, from their sums (1 + B, joints); NaN where nothing was measured."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if not ratio.per_joint:
            return ratio.scale * tops.sum(axis=1) / bottoms.sum(axis=1)
        known = bottoms > 0
        return ratio.scale * np.where(known, tops / bottoms, 0).sum(axis=1) / known.sum(axis=1)


def _by_frame(values: Array, samples: Samples) -> Array:
    """(F, J) sums over the samples of each frame."""
    sums = np.zeros((len(samples.frames), values.shape[1]))
    np.add.at(sums, samples.at, values)
    return sums


def _found_errors(samples: Samples, name: str) -> Array:
    """(S, J) errors in the unit of reports, NaN where a joint does not count or was not found."""
    space = samples.spaces()[name]
    return np.where(samples.counts & space.found, space.error, np.nan) * UNIT[name][1]


def _quantile_values(
    samples: Samples, name: str, errors: Array, sets: Mapping[str, tuple[int, ...]], weights: Weights
) -> Iterator[Value]:
    shares = np.array([0.5, 0.95])
    for joints, members in sets.items():
        chosen = errors[:, list(members)]
        rows, _ = known = np.nonzero(np.isfinite(chosen))
        flat = chosen[known].astype(np.float64)
        now = np.quantile(flat, shares) if flat.size else np.full(2, np.nan)
        low, high = interval(weighted_quantiles(flat, samples.at[rows], weights, shares))
        for i, metric in enumerate(("median error", "P95 of the error")):
            numbers = float(now[i]), UNIT[name][0], None, "", FOUND, len(flat), float(low[i]), float(high[i])
            yield Value(metric, name, joints, *numbers)


def _precision_values(samples: Samples, weights: Weights) -> Iterator[Value]:
    detections = samples.detections
    now = average_precision(detections)
    resampled = np.array([average_precision(detections, w.astype(np.int64)) for w in weights]).reshape(-1, len(THRESHOLDS))
    people = int(detections.true.sum())
    denominator = "true people with a joint that counts; precision at 101 recalls"
    for metric, threshold, columns in (("AP", None, slice(None)), ("AP", 0.5, slice(0, 1)), ("AP", 0.75, slice(5, 6))):
        low, high = interval(100 * resampled[:, columns].mean(axis=1, keepdims=True))
        yield Value(
            metric, "2d", PEOPLE, float(100 * now[columns].mean()), "%", threshold, "" if threshold is None else "OKS",
            denominator, people, float(low[0]), float(high[0]),
        )  # fmt: skip


def _curves(samples: Samples, name: str, errors: Array, sets: Mapping[str, tuple[int, ...]]) -> dict[str, Any]:
    shares = errors / (samples.spaces()[name].head[:, None] * UNIT[name][1])
    result: dict[str, Any] = {}
    for kind, values, grid in (("pckh", shares, _PCKH_GRID), ("error", errors, _ERROR_GRID[name])):
        lines = {}
        for joints, members in sets.items():
            columns = list(members)
            known = np.sort(values[:, columns][np.isfinite(values[:, columns])])
            total = max(int(samples.counts[:, columns].sum()), 1)
            lines[joints] = (100 * np.searchsorted(known, grid, side="right") / total).round(3).tolist()
        result[kind] = {"grid": grid.round(4).tolist(), "lines": lines}
    return result


def _calibration(
    samples: Samples, errors: Mapping[str, Array], sets: Mapping[str, tuple[int, ...]], options: EvaluationOptions
) -> tuple[dict[str, Any], list[Value]]:
    """How far a model's confidence can be trusted, by set of joints, and the numbers of it.

    presence: bins of presence with the share that is `in_image`, and `within` d too · surest: by space, the errors of the surest
    joints · expected_error: bins of the expected error with the mean error (cm). See `calibration`.
    """
    result: dict[str, Any] = {"presence": {}, "surest": {name: {} for name in errors}, "expected_error": {}}
    values: list[Value] = []
    space = "3d" if "3d" in errors else "2d"
    hit, unit = _limit(space, options), UNIT[space][0]
    for joints, members in sets.items():
        bins = dict(zip(("in_image", "within"), of_presence(samples, members), strict=True))
        result["presence"][joints] = {name: each.to_dict() for name, each in bins.items()}
        for (name, each), at in zip(bins.items(), ((None, ""), (hit, unit)), strict=True):
            metric = "ECE of presence" if name == "in_image" else "ECE of presence@d"
            n = int(each.samples.sum())
            values.append(Value(metric, "image", joints, 100 * each.error, "%", *at, ANSWERED, n, np.nan, np.nan))
        for name, error in errors.items():
            sure = confidence(samples, error, UNIT["3d"][1], members)
            result["surest"][name][joints] = sure.of_surest(_limit(name, options))
            correlation = "rank correlation of doubt and error", name, joints, sure.rank_correlation, "", None, ""
            values.append(Value(*correlation, FOUND, len(sure.error), np.nan, np.nan))
            if name == "3d" and (expected := sure.of_expected()).samples.any():
                result["expected_error"][joints] = expected.to_dict()
                off = "calibration error of the expected error", name, joints, expected.error, "cm", None, ""
                values.append(Value(*off, FOUND, int(expected.samples.sum()), np.nan, np.nan))
    return result, values


def _limit(name: str, options: EvaluationOptions) -> float:
    """The user's threshold d in the unit of reports."""
    return round((options.hit_px if name == "2d" else options.hit_m) * UNIT[name][1], 9)


def _ranked(samples: Samples) -> tuple[int, ...]:
    """Frames that are not perfect, worst first, by the mean error of their joints in head sizes; a missed joint counts 3."""
    space = next(iter(samples.spaces().values()))
    shares = np.where(samples.counts & space.found, space.error, np.inf) / space.head[:, None]
    counted = np.where(samples.counts, np.fmin(np.nan_to_num(shares, nan=np.inf), _MISS), 0.0)
    top, bottom = (_by_frame(x.astype(np.float64), samples).sum(axis=1) for x in (counted, samples.counts))
    mean = np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0)
    order = np.argsort(-mean, kind="stable")
    return tuple(int(samples.frames[i]) for i in order if mean[i] > 0)
