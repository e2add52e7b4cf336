"""Which numbers people are shown, in which order, and how one is written."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from cabinpose.evaluate import ALL, METRICS, PEOPLE, Grouping, Report, Value, value_among


class Column(NamedTuple):
    """A metric in tables: its name and space in reports, its threshold, and what stands above it; up = more is better."""

    metric: str
    space: str
    threshold: float | None
    title: str
    up: bool


def group_columns(reports: Sequence[Report]) -> list[Column]:
    """The metrics of the table by joint group, for the spaces that any model answers in."""

    def column(metric: str, space: str, title: str, threshold: float | None = None) -> Column:
        return Column(METRICS[metric].name, space, threshold, title, METRICS[metric].better == "more")

    both = []
    for space, mean, unit in (("2d", "mean_error", "px"), ("3d", "mpjpe", "cm")):
        name = space.upper()
        alphas = sorted(
            {v.threshold for r in reports for v in r.values if v.metric == "PCKh" and v.space == space and v.threshold}
        )
        both += [column("pckh", space, f"PCKh@{alpha:g} {name} %", alpha) for alpha in alphas[:1]]
        both += [
            column("auc_of_pckh", space, f"AUC {name} %"),
            column(mean, space, f"mean {name} {unit}"),
            column("median_error", space, f"median {name} {unit}"),
        ]
    answered = "2d" if any(r.value(METRICS["found"].name, "2d") for r in reports) else "3d"
    both.append(column("found", answered, "found %"))
    return [c for c in both if any(r.value(c.metric, c.space) for r in reports)]


def grouping_rows(grouping: Grouping, columns: Sequence[Column], cell: Callable[[Value | None], object]) -> list[list[object]]:
    """The table of the groups by one label, its head first; the share of training is left out where it is not known.

    cell: how a number is written with its interval.
    """
    learnt = any(math.isfinite(group.training) for group in grouping.groups)
    rows: list[list[object]] = [
        [grouping.by, "people", "subjects", *(["in training %"] if learnt else []), *(c.title for c in columns)]
    ]
    for group in grouping.groups:
        share = [f"{group.training:.1f}"] if learnt else []
        cells = (cell(value_among(group.values, c.metric, c.space, ALL, c.threshold)) for c in columns)
        rows.append([group.name, group.people, group.subjects or "–", *share, *cells])
    return rows


def worst_words(grouping: Grouping) -> str:
    """Which of the groups is worst, as far as it can be said."""
    worst = grouping.worst
    if worst is None:
        return f"by {grouping.by}: too few groups of people to say which is worst"
    told = f"PCKh@0.5 {worst.space.upper()} of '{worst.group}' is {worst.below:.1f} points below the others"
    if not math.isfinite(worst.low):
        return f"by {grouping.by}: {told}"
    span = f"({worst.low:.1f} to {worst.high:.1f}, for all groups together)"
    return f"by {grouping.by}: {told} {span}" + ("" if worst.is_certain else ": no group is surely worse")


def people_rows(report: Report) -> Iterator[tuple[str, Value]]:
    """Every pooled number about all joints, or about people, with its name as people read it."""
    for v in report.values:
        if v.joints in (ALL, PEOPLE) and v.visibility == "any" and v.samples:
            yield label(v), v


def label(v: Value) -> str:
    """What a number is called, threshold included: "PCKh@0.5 2D", "PCK@10 cm 3D"."""
    name = v.metric
    if v.threshold is not None and not name.startswith("AUC"):
        unit = f" {v.threshold_unit}" if v.threshold_unit in ("px", "cm") else ""
        at = f"@{v.threshold:g}{unit}"
        name = name.replace("@d", at) if "@d" in name else f"{name}{at}"
    where = "" if v.space == "image" else f" {v.space.upper()}"
    people = " of people" if v.joints == PEOPLE and v.metric.startswith("presence") else ""
    return f"{name}{people}{where}"


def number(v: Value | None) -> str:
    """A number with as many digits as its unit deserves, without the unit; a dash where there is none."""
    return "–" if v is None or not math.isfinite(v.value) else f"{v.value:.{digits(v)}f}"


def digits(v: Value) -> int:
    """Decimals: 1 for per cent and px, 2 for cm, 3 for an OKS."""
    return 3 if v.unit == "" else 1 if v.unit == "%" else 2


def interval(v: Value | None) -> str:
    """The 95 % interval, "97.1 to 97.9"; empty where there is none."""
    if v is None or not math.isfinite(v.low):
        return ""
    return f"{v.low:.{digits(v)}f} to {v.high:.{digits(v)}f}"
