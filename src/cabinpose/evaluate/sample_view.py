"""What a metric is given: samples seen in one space, and how its numbers are pooled over them, with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Visibility
from cabinpose.evaluate.bootstrap import Weights, clusters_of, frame_weights, interval, weighted_quantiles, weighted_sums
from cabinpose.evaluate.calibration import Confidence, Reliability, confidence, of_presence
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.samples import Samples, Space

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]
Sets = Mapping[str, tuple[int, ...]]  # joints by the name of their set, as columns

ALL = "All"
PEOPLE = "Person"
ANY = "any"
IMAGE = "image"
STATES = (Visibility.VISIBLE, Visibility.SELF_OCCLUDED, Visibility.OCCLUDED, Visibility.OUTSIDE_IMAGE)
_UNIT = MappingProxyType({"2d": ("px", 1.0), "3d": ("cm", 100.0), IMAGE: ("", 1.0)})  # of reports, how many of it a px or m has


class Threshold(NamedTuple):
    """From where on a metric counts something, in the unit of reports."""

    value: float | None = None
    unit: str = ""


NO_THRESHOLD = Threshold()


class Number(NamedTuple):
    """One number of a metric.

    joints: the set of joints that it is about, or "Person" · denominator: what it rests on, in words; samples: how many of them ·
    low, high: its 95 % interval, NaN without one · average: how joints were averaged · name: "" for that of the metric.
    """

    joints: str
    value: float
    denominator: str
    samples: int
    low: float = np.nan
    high: float = np.nan
    threshold: Threshold = NO_THRESHOLD
    average: str = "pooled"
    name: str = ""


@dataclass(frozen=True)
class SampleView:
    """Samples in one space and one state of visibility: what a metric measures.

    space: "2d" (px), "3d" (m), or "image" for what is no matter of distance · visibility: of the true joints that count here,
    "any" = all · weights: (B, F) how often each frame was drawn in each resample of the bootstrap.
    """

    samples: Samples
    options: EvaluationOptions
    weights: Weights
    space: str
    visibility: str = ANY

    @property
    def unit(self) -> str:
        """Unit of lengths in reports: px, cm."""
        return _UNIT[self.space][0]

    @property
    def per_unit(self) -> float:
        """How many of `unit` a px or m has."""
        return _UNIT[self.space][1]

    @cached_property
    def sets(self) -> Sets:
        """The sets of joints that every number is given for: all, the groups, each joint."""
        skeleton = self.samples.skeleton
        groups = {name: tuple(skeleton.indices(members)) for name, members in skeleton.groups.items()}
        return {ALL: tuple(range(len(skeleton.joints))), **groups} | {joint: (i,) for joint, i in skeleton.index.items()}

    @property
    def groups(self) -> Sets:
        """All joints, and the groups."""
        return {name: members for name, members in self.sets.items() if name == ALL or name in self.samples.skeleton.groups}

    @cached_property
    def errors(self) -> Space:
        """The errors in this space, 2D or 3D."""
        return self.samples.space(self.space)

    @cached_property
    def counts(self) -> Bool:
        """(S, J) true joints that count, have this visibility, and a known place in this space."""
        counts = self.samples.counts if self.space == "image" else self.samples.counts & self.errors.known
        if self.visibility == ANY:
            return counts
        return counts & (self.samples.visibility == Visibility[self.visibility.upper()])

    @cached_property
    def found(self) -> Bool:
        """(S, J) those of `counts` that were found in this space."""
        return self.counts & self.errors.found

    @cached_property
    def error(self) -> Array:
        """(S, J) distance to the truth, px or m; infinite where there is none."""
        return np.nan_to_num(self.errors.error.astype(np.float64), nan=np.inf)

    @cached_property
    def near(self) -> Bool:
        """(S, J) those of `found` within the threshold d."""
        return self.found & (self.error <= np.float32(self.hit))

    @property
    def hit(self) -> float:
        """The threshold d of the options, px or m."""
        return self.options.hit_px if self.space == "2d" else self.options.hit_m

    @property
    def d(self) -> Threshold:
        """The threshold d as numbers name it."""
        return self.length(self.hit)

    @property
    def hit_shown(self) -> float:
        """The threshold d in the unit of reports."""
        return round(self.hit * self.per_unit, 9)

    @cached_property
    def head(self) -> Array:
        """(S, 1) head size, px or m; NaN where it is not known."""
        return self.errors.head.astype(np.float64)[:, None]

    @property
    def found_errors(self) -> NDArray[np.float32]:
        """(S, J) distance to the truth, px or m, of `found`; NaN of the others."""
        return np.where(self.found, self.errors.error, np.nan)

    @cached_property
    def presence(self) -> Mapping[str, tuple[Reliability, Reliability]]:
        """For all joints and each group: presence against what is in the image, and against what was found within d."""
        return {joints: of_presence(self.samples, members) for joints, members in self.groups.items()}

    @cached_property
    def confidence(self) -> Mapping[str, Confidence]:
        """For all joints, each group and each joint: the errors in this space, those that the model is surest of first."""
        errors, per_m = self.found_errors * self.per_unit, _UNIT["3d"][1]
        return {joints: confidence(self.samples, errors, per_m, members) for joints, members in self.sets.items()}

    def length(self, threshold: float) -> Threshold:
        """A threshold in px or m as reports show it."""
        return Threshold(threshold * self.per_unit, self.unit)

    def share(
        self, some: NDArray[Any], every: Bool, denominator: str, *, threshold: Threshold = NO_THRESHOLD,
        per_joint: bool = False, people: bool = False,
    ) -> Iterator[Number]:  # fmt: skip
        """Per cent of the samples of `every` that are of `some`, for each set of joints, with intervals.

        Parameters
        ----------
        some
            (S, J) true or false, or how much of a sample, 0 to 1.
        every
            (S, J) what 100 % is.
        denominator
            The same in words.
        threshold
            What was asked of `some`.
        per_joint
            The mean of the joints' shares in place of the share of all samples (the thesis' way).
        people
            The arrays are (S, 1), about whole people.
        """
        return self._ratios(100.0, some, every, denominator, threshold, per_joint=per_joint, people=people)

    def mean(
        self, values: NDArray[np.floating], known: Bool, denominator: str, *, threshold: Threshold = NO_THRESHOLD,
        per_joint: bool = False, people: bool = False,
    ) -> Iterator[Number]:  # fmt: skip
        """The mean of values (S, J) in px or m, over the samples that are `known`; the rest as `share` has it."""
        told = np.where(known, values, 0)
        return self._ratios(self.per_unit, told, known, denominator, threshold, per_joint=per_joint, people=people)

    def _ratios(
        self, scale: float, tops: NDArray[Any], bottoms: NDArray[Any], denominator: str, threshold: Threshold, *,
        per_joint: bool, people: bool,
    ) -> Iterator[Number]:  # fmt: skip
        sets = {PEOPLE: (0,)} if people else self.sets
        totals = []
        for values in (tops, bottoms):
            by_frame = by_frames(values, self.samples)
            totals.append(np.concatenate((by_frame.sum(axis=0)[None], weighted_sums(self.weights, by_frame))))  # (1 + B, J)
        every = [[total[:, list(members)] for total in totals] for members in sets.values()]
        values = np.stack([_ratio(scale, top, bottom, per_joint=per_joint) for top, bottom in every], axis=1)
        lows, highs = interval(values[1:])
        average = "per joint, then averaged" if per_joint else "pooled"
        for i, (joints, (_, bottom)) in enumerate(zip(sets, every, strict=True)):
            numbers = float(values[0, i]), denominator, int(bottom[0].sum()), float(lows[i]), float(highs[i])
            yield Number(joints, *numbers, threshold, average)

    def quantiles(self, values: NDArray[np.float32], shares: Mapping[str, float], denominator: str) -> Iterator[Number]:
        """Quantiles of values (S, J) in px or m, NaN where one does not count, for each set of joints; shares: by name."""
        wanted = np.array([*shares.values()])
        for joints, members in self.sets.items():
            chosen = values[:, list(members)] * self.per_unit
            rows, _ = known = np.nonzero(np.isfinite(chosen))
            flat = chosen[known].astype(np.float64)
            now = np.quantile(flat, wanted) if flat.size else np.full(len(wanted), np.nan)
            low, high = interval(weighted_quantiles(flat, self.samples.at[rows], self.weights, wanted))
            for i, name in enumerate(shares):
                yield Number(joints, float(now[i]), denominator, len(flat), float(low[i]), float(high[i]), name=name)


def resampled_frames(samples: Samples, options: EvaluationOptions) -> Weights:
    """(B, F) how often each frame is drawn in each resample: by the options' seed, so that all numbers of a report share them."""
    drawn_with = clusters_of(samples.sequence, samples.sync_ns)
    return frame_weights(drawn_with, options.resamples, rng=np.random.Generator(np.random.Philox(key=options.seed)))


def sample_views(samples: Samples, options: EvaluationOptions) -> tuple[SampleView, ...]:
    """All views, in the order of reports: of each space with all joints that count, then by visibility; last the image's."""
    weights = resampled_frames(samples, options)
    states = (ANY, *(state.name.lower() for state in STATES if state >= options.min_visibility))
    views = [SampleView(samples, options, weights, space, state) for space in samples.spaces() for state in states]
    return (*views, SampleView(samples, options, weights, IMAGE))


def by_frames(values: NDArray[Any], samples: Samples) -> Array:
    """(F, J) sums over the samples (S, J) of each frame."""
    sums = np.zeros((len(samples.frames), values.shape[1]))
    np.add.at(sums, samples.at, values)
    return sums


def _ratio(scale: float, tops: Array, bottoms: Array, *, per_joint: bool) -> Array:
    """(1 + B,) a ratio over some joints, from their sums (1 + B, joints); NaN where nothing was measured."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if not per_joint:
            return scale * tops.sum(axis=1) / bottoms.sum(axis=1)
        known = bottoms > 0
        return scale * np.where(known, tops / bottoms, 0).sum(axis=1) / known.sum(axis=1)
