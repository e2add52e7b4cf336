"""Whom a model finds less well: accuracy by stature, age, seat, view or any other label of people, with the group that is worst.

All groups of a report are drawn by the same resamples of sequences and single frames, so that the difference between two of them
has an interval of its own. The worst of several groups is worse than the others by chance alone: its interval is widened by their
number (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core import ConfigError, DatasetError, unknown_name
from cabinpose.evaluate.bootstrap import LEVEL, Weights, interval, weighted_sums
from cabinpose.evaluate.metrics import METRICS, Value, within_head
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.sample_view import ALL, SampleView, Sets, by_frames, resampled_frames
from cabinpose.evaluate.samples import Samples, Space
from cabinpose.store import UNKNOWN as UNKNOWN_NAME

SEAT = "seat"
UNKNOWN = "not known"
WORST_BY = 0.5  # head sizes within which a joint is right where the worst group is looked for
_QUANTILES = (0.25, 0.5, 0.75)
_MOST = 40  # groups by one label
_FEWEST = 20  # people of a group that may be named the worst
_MEASURED = ("pckh", "auc_of_pckh", "mean_error", "mpjpe", "median_error", "found")

Bool = NDArray[np.bool_]


class GroupBy(NamedTuple):
    """What people are told apart by.

    label: `seat`, or a variable or coordinate of the dataset by frame, by person or both · of: which entry of its third
    dimension, such as `top` of `reflectance` · edges: where a number's groups meet, rising; without any its quartiles.
    """

    label: str
    of: str = ""
    edges: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """As it is written: `stature`, `reflectance:top`."""
        return f"{self.label}:{self.of}" if self.of else self.label


@dataclass(frozen=True)
class Group:
    """Some people and what a model reaches on them.

    people, frames, subjects: how many there are, the last without those whose name is not known · training: their share of the
    people that the model was trained on, per cent, NaN where it is not known · values: over all joints.
    """

    name: str
    people: int
    frames: int
    subjects: int
    training: float
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Worst:
    """The group with the least PCKh@0.5, and how far it is below all others together.

    below: percentage points; low, high: their interval at 95 % for all groups of the label together · space: "2d" or "3d".
    """

    group: str
    space: str
    below: float
    low: float
    high: float

    @property
    def is_certain(self) -> bool:
        """Whether the interval says that it is worse."""
        return self.low > 0


@dataclass(frozen=True)
class Grouping:
    """The groups by one label; worst is None where fewer than two of them have enough people."""

    by: str
    groups: tuple[Group, ...]
    worst: Worst | None


class _AllJoints(SampleView):
    """A view whose numbers are of all joints together, which is what groups are compared by."""

    @cached_property
    def sets(self) -> Sets:
        return {ALL: tuple(range(len(self.samples.skeleton.joints)))}


def read_group_by(word: str) -> GroupBy:
    """What `--by LABEL`, `LABEL:ENTRY` or `LABEL=EDGE,EDGE` means. Raises ConfigError for what means nothing."""
    name, equals, given = word.partition("=")
    label, _, of = name.partition(":")
    try:
        edges = tuple(float(edge) for edge in given.split(",")) if equals else ()
    except ValueError as error:
        raise ConfigError(f"'{word}': edges of groups are numbers", hint="write --by stature=1.6,1.75") from error
    if not label or list(edges) != sorted(set(edges)) or not np.isfinite(edges).all():
        raise ConfigError(f"'{word}' makes no groups", hint="write a label, with rising edges if you like: stature=1.6,1.75")
    return GroupBy(label, of, edges)


def groupings(
    samples: Samples, dataset: xr.Dataset, by: Sequence[GroupBy], options: EvaluationOptions, training: Sequence[xr.Dataset] = ()
) -> tuple[Grouping, ...]:
    """The people of samples, grouped by each label.

    Parameters
    ----------
    samples
        Those of `samples_of`.
    dataset
        The dataset of the samples, with the slots that were evaluated.
    by
        The labels.
    options
        Those of the samples.
    training
        Datasets that the model was trained on, for each group's share of their people.

    Raises
    ------
    ConfigError
        For a label that the dataset or one of `training` has not, or of more than 40 values.
    DatasetError
        Where a label is known of nobody.
    """
    if not by:
        return ()
    weights = resampled_frames(samples, options)
    return tuple(_grouping(samples, dataset, each, options, weights, training) for each in by)


def _grouping(
    samples: Samples, dataset: xr.Dataset, by: GroupBy, options: EvaluationOptions, weights: Weights,
    training: Sequence[xr.Dataset],
) -> Grouping:  # fmt: skip
    there = samples.true & (samples.place < dataset.sizes["person"])
    where = samples.at[there], samples.place[there]
    values, unit = people_labels(dataset, by)
    values = values[where]
    known = np.isfinite(values) if values.dtype.kind == "f" else values != ""
    if not known.any():
        raise DatasetError(f"'{by.name}' is known of nobody in these frames", hint="group by another label")
    by = by if by.edges or values.dtype.kind != "f" else by._replace(edges=_quartiles(values[known]))
    names, rows_there = _names(values, by, unit), np.flatnonzero(there)
    members = {name: names == name for name in _in_order(names, by, unit)}
    learnt = [_names(_of_people(each, by), by, unit) for each in training]
    shares = {name: 100.0 * float(np.mean(np.concatenate(learnt) == name)) if learnt else np.nan for name in members}
    subject = dataset["subject"].transpose("frame", "person").values[where].astype(str)
    groups = []
    for name, of_group in members.items():
        chosen = _rows(samples, rows_there[of_group])
        views = [_AllJoints(chosen, options, weights, space) for space in samples.spaces()]
        measured = tuple(value for metric in _MEASURED for view in views for value in METRICS[metric].values(view))
        counts = len(chosen.at), len(np.unique(chosen.at)), len(set(subject[of_group].tolist()) - {"", UNKNOWN_NAME})
        groups.append(Group(name, *counts, shares[name], measured))
    return Grouping(by.name, tuple(groups), _worst(_rows(samples, rows_there), members, options, weights))


def people_labels(dataset: xr.Dataset, by: GroupBy) -> tuple[NDArray[np.generic], str]:
    """(F, P) a label of everybody in every frame, as text or floats, and its unit; ConfigError where there is none."""
    shape = dataset.sizes["frame"], dataset.sizes["person"]
    if by.label == SEAT:
        return np.broadcast_to(dataset["person"].values.astype(str), shape), ""
    known = {
        str(name): array
        for name, array in (*dataset.coords.items(), *dataset.data_vars.items())
        if 0 < len(array.dims) <= 3 and set(array.dims[:2]) & {"frame", "person"} and not _is_place(array)
    }
    if by.label not in known:
        raise unknown_name("label", by.label, [SEAT, *known])
    array = known[by.label]
    (third,) = [dim for dim in array.dims if dim not in ("frame", "person")] or [None]
    if third is not None:
        entries = [str(entry) for entry in dataset[third].values]
        if by.of not in entries:
            raise ConfigError(
                f"'{by.label}' is known by {third}: say which" if not by.of else f"'{by.label}' has no {third} '{by.of}'",
                hint=f"write {by.label}:{entries[0]}; there are {', '.join(entries)}",
            )
        array = array.sel({third: by.of})
    elif by.of:
        raise ConfigError(f"'{by.label}' is one value for each person", hint=f"write {by.label}")
    everybody = xr.DataArray(np.zeros(shape), dims=("frame", "person"))
    values = array.reset_coords(drop=True).broadcast_like(everybody).transpose("frame", "person").values
    text = values.dtype.kind in "OUSb"
    if text and by.edges:
        raise ConfigError(f"'{by.label}' is no number: it has no edges", hint=f"write {by.name}")
    return values.astype(str if text else np.result_type(values, np.float32)), str(array.attrs.get("units", ""))


def _is_place(array: xr.DataArray) -> bool:
    """Whether an array's third dimension has no names: places and matrices, which are no labels."""
    return any(dim not in ("frame", "person") and dim not in array.coords for dim in array.dims)


def _of_people(dataset: xr.Dataset, by: GroupBy) -> NDArray[np.generic]:
    """(N,) the label of everybody who is there."""
    return people_labels(dataset, by)[0][(dataset["subject"] != "").transpose("frame", "person").values]


def _quartiles(values: NDArray[np.generic]) -> tuple[float, ...]:
    """The quartiles, rounded to three digits so that they can be read, those that are apart."""
    edges = np.quantile(values.astype(np.float64), _QUANTILES)
    return tuple(sorted({float(f"{edge:.3g}") for edge in edges}))


def _names(values: NDArray[np.generic], by: GroupBy, unit: str) -> NDArray[np.str_]:
    """(N,) the name of the group that each value belongs to."""
    if values.dtype.kind != "f":
        return np.where(values == "", UNKNOWN, values.astype(str))
    names, edges = np.array([*_ranges(by, unit), UNKNOWN]), np.array(by.edges, values.dtype)  # as exact as the numbers
    return names[np.where(np.isfinite(values), np.searchsorted(edges, values, side="right"), len(names) - 1)]


def _ranges(by: GroupBy, unit: str) -> list[str]:
    """The names of a number's groups, rising: "below 1.6 m", "1.6 to 1.75 m", "1.75 m and more"."""
    told, after = [f"{edge:g}" for edge in by.edges], f" {unit}" if unit else ""
    between = [f"{low} to {high}{after}" for low, high in pairwise(told)]
    return [f"below {told[0]}{after}", *between, f"{told[-1]}{after} and more"]


def _in_order(names: NDArray[np.str_], by: GroupBy, unit: str) -> list[str]:
    """The groups that have people: of numbers rising, of texts by their number of people; last those who are not known."""
    found, counts = np.unique(names, return_counts=True)
    many = dict(zip(found.tolist(), counts.tolist(), strict=True))
    order = _ranges(by, unit) if by.edges else sorted(many, key=lambda name: -many[name])
    if len(order) > _MOST:
        raise ConfigError(f"'{by.name}' has {len(order)} values", hint=f"group by what has {_MOST} at most")
    return [name for name in order if name in many and name != UNKNOWN] + [UNKNOWN] * (UNKNOWN in many)


def _rows(samples: Samples, rows: NDArray[np.int64]) -> Samples:
    """Some of the samples, over the same frames."""

    def some(space: Space) -> Space:
        return space._replace(**{name: array[rows] for name, array in space._asdict().items()})

    whole = ("skeleton", "frames", "sequence", "sync_ns", "px", "m", "detections")
    by_sample = {name: value[rows] for name, value in samples._asdict().items() if name not in whole}
    return samples._replace(**by_sample, px=some(samples.px), m=some(samples.m))


def _worst(samples: Samples, members: Mapping[str, Bool], options: EvaluationOptions, weights: Weights) -> Worst | None:
    """The group of the least PCKh@0.5 among those that are known and of some size."""
    judged = {name: rows for name, rows in members.items() if name != UNKNOWN and rows.sum() >= _FEWEST}
    if len(judged) < 2:
        return None
    view = _AllJoints(samples, options, weights, next(iter(samples.spaces())))
    sized = view.counts & np.isfinite(view.head)
    right = sized & view.found & within_head(view.error, view.head, WORST_BY)

    def share(rows: Bool) -> NDArray[np.float64]:
        """(1 + B,) per cent of the joints that are right, then of each resample."""
        frames = np.stack(
            [by_frames((array & rows[:, None]).sum(axis=1, keepdims=True), samples)[:, 0] for array in (right, sized)], axis=1
        )
        sums = np.concatenate((frames.sum(axis=0)[None], weighted_sums(weights, frames)))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(100.0 * sums[:, 0] / sums[:, 1])

    everybody = np.any([*judged.values()], axis=0)
    shares = {name: share(rows) for name, rows in judged.items()}
    name = min(shares, key=lambda name: (np.nan_to_num(shares[name][0], nan=np.inf), name))
    below = share(everybody & ~judged[name]) - shares[name]
    low, high = interval(below[1:, None], level=1 - (1 - LEVEL) / len(judged))
    return Worst(name, view.space, float(below[0]), float(low[0]), float(high[0]))
