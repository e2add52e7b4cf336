"""The numbers of an experiment from the cells that are there: its table, curves, and what the cells took."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from cabinpose.app.experiment.cells import TestCell, TrainCell
from cabinpose.app.experiment.config import MEAN_ERRORS, TableColumn
from cabinpose.app.experiment.plan import ExperimentPlan, joints_of
from cabinpose.core import CABINPOSE
from cabinpose.evaluate import ALL, ModelErrors, OverRepeats, RowDifference, accuracy_curve, over_repeats, row_differences

_GRID = np.linspace(0.0, 1.0, 51)  # head sizes
_RESUMED = "the last of several runs"
Lines = dict[str, tuple[list[float], list[float]]]
"""By name the xs and ys of lines."""
JudgedRuns = Sequence[tuple[ModelErrors, tuple[str, ...]]]
"""The errors of each repeat of a training on a test, and the joints or parts that they are of."""


@dataclass(frozen=True)
class Results:
    """What is known of an experiment.

    numbers: by training and title of the column, over the repeats that are there, None without any · found: of mean errors, per
    cent of the joints over which they are · accuracy: by test, per cent of all joints
    within each part of the head size, by training · by_joint: the same by test and training, by group of joints · curves: by
    title, over numbers of frames, of those that have a point · differences: by title of the column and two trainings whose cells
    are there, the first less the second · judged: by test, what is judged on it.
    """

    numbers: Mapping[tuple[str, str], OverRepeats | None]
    found: Mapping[tuple[str, str], float]
    accuracy: Mapping[str, Lines]
    by_joint: Mapping[tuple[str, str], Lines]
    curves: Mapping[str, Lines]
    differences: Mapping[str, Mapping[tuple[str, str], RowDifference]]
    judged: Mapping[str, str]


def results_of(plan: ExperimentPlan, resamples: int) -> Results:
    """The numbers of all cells that are there; resamples: of the bootstrap for the intervals."""
    experiment, known = plan.experiment, _ErrorsRead()
    numbers = {
        (row, column.title): _number(known.runs(plan.tested.get((row, column.test), ())), column, resamples)
        for row in experiment.trainings
        for column in experiment.columns
    }
    found = {
        (row, column.title): _found_share(runs, column, plan.trained[row][0].settings.joint_set.root)
        for row in experiment.trainings
        for column in experiment.columns
        if column.measure in MEAN_ERRORS
        if (runs := known.runs(plan.tested.get((row, column.test), ())))
    }
    accuracy, by_joint, judged_on = {}, {}, dict[str, str]()
    for test in experiment.tests:
        space = next((column.space for column in experiment.columns if column.test == test), "2d")
        lines: Lines = {}
        for row in experiment.trainings:
            read = known.runs(plan.tested.get((row, test), ()))
            if read:
                judged_on[test] = _judged_on(read[0][0])
            runs = [(errors, names) for errors, names in read if errors.error_px.size]
            if not runs:
                continue
            lines[row] = _mean_accuracy(runs, space, None)
            groups = [name for name, members in CABINPOSE.groups.items() if set(members) & set(runs[0][1])]
            by_joint[test, row] = {name: _mean_accuracy(runs, space, joints_of(name, runs[0][1])) for name in groups}
        if lines:
            accuracy[test] = lines
    curves: dict[str, Lines] = {}
    for curve in experiment.curves:
        drawn: Lines = {}
        for name, rows in curve.lines.items():
            points = [(frames_in_all(plan.trained[row][0], curve.over), numbers[row, curve.column]) for row in rows]
            there = sorted((float(x), number.value) for x, number in points if number is not None)
            drawn[name] = ([x for x, _ in there], [y for _, y in there])
        if any(xs for xs, _ in drawn.values()):
            curves[curve.title] = drawn
    differences = {}
    for column in experiment.columns:
        judged = {row: known.runs(plan.tested.get((row, column.test), ())) for row in experiment.trainings}
        differences[column.title] = _differences({row: runs for row, runs in judged.items() if runs}, column, resamples)
    return Results(numbers, found, accuracy, by_joint, curves, differences, judged_on)


def _judged_on(errors: ModelErrors) -> str:
    people = f", {len(errors.at)} people in them" if len(errors.at) else ""
    return f"{errors.frames} frames{people}, drawn as {len(np.unique(errors.cluster))} sequences and single frames"


def _mean_accuracy(runs: JudgedRuns, space: str, joints: Sequence[str] | None) -> tuple[list[float], list[float]]:
    """The line of some joints, None = all: the mean over the repeats."""
    columns = None if joints is None else [runs[0][1].index(joint) for joint in joints]
    mean = np.mean([accuracy_curve(errors, _GRID, space, columns) for errors, _ in runs], axis=0)
    return _GRID.tolist(), mean.tolist()


class _ErrorsRead:
    """The errors of tests that are there, each read once."""

    def __init__(self) -> None:
        self._read: dict[str, tuple[ModelErrors, tuple[str, ...]]] = {}

    def runs(self, cells: Sequence[TestCell]) -> list[tuple[ModelErrors, tuple[str, ...]]]:
        """Those of the repeats of a training that are there."""
        done = [cell for cell in cells if cell.done]
        for cell in done:
            if cell.key not in self._read:
                self._read[cell.key] = cell.errors()
        return [self._read[cell.key] for cell in done]


def _number(runs: JudgedRuns, column: TableColumn, resamples: int) -> OverRepeats | None:
    if not runs:
        return None
    return over_repeats(
        [errors for errors, _ in runs], column.measure, space=column.space, threshold=column.threshold or 0.5,
        joints=_counted(runs, column), resamples=resamples,
    )  # fmt: skip


def _differences(rows: Mapping[str, JudgedRuns], column: TableColumn, resamples: int) -> dict[tuple[str, str], RowDifference]:
    return row_differences(
        {row: [errors for errors, _ in runs] for row, runs in rows.items()},
        column.measure,
        space=column.space,
        threshold=column.threshold or 0.5,
        joints={row: _counted(runs, column) for row, runs in rows.items()},
        resamples=resamples,
    )


def _counted(runs: JudgedRuns, column: TableColumn) -> list[int]:
    """The columns of the joints that count."""
    names = runs[0][1]
    return list(range(len(names))) if column.joints == ALL else [names.index(j) for j in joints_of(column.joints, names)]


def _found_share(runs: JudgedRuns, column: TableColumn, root: str | None) -> float:
    """Per cent of a column's joints over which its mean error is: of those from the root, that of joints but the root."""
    from_root = column.measure == "root_relative_error"
    joints = [joint for joint in _counted(runs, column) if not (from_root and runs[0][1][joint] == root)]
    shares = []
    for errors, _ in runs:
        judged = (errors.error_px if column.space == "2d" else errors.error_m)[:, joints]
        measured = errors.relative_m[:, joints] if from_root else judged
        shares.append(100.0 * np.isfinite(measured).sum() / max(int((~np.isnan(judged)).sum()), 1))
    return float(np.mean(shares))


def frames_of(cell: TrainCell, data: str) -> int:
    """The frames of a dataset that a training learns from; planned ones, before it is made."""
    if isinstance(known := cell.record.get("by_data"), dict):
        return int(known.get(data, 0))
    return sum(source.frames for source in cell.train if source.part.data == data)


def frames_in_all(cell: TrainCell, data: str) -> int:
    """The same of a training and of the one that it begins with."""
    return sum(frames_of(stage, data) for stage in (cell, cell.begins) if stage is not None)


def cell_text(number: OverRepeats | None, found: float | None = None, digits: int = 1) -> tuple[str, str]:
    """A number, and its interval with each repeat and the per cent of joints that it is over; a dash where there is none."""
    if found == 0.0:
        return "none found", ""
    if number is None or not math.isfinite(number.value):
        return "–", ""
    span = f"{number.low:.{digits}f} to {number.high:.{digits}f}" if math.isfinite(number.low) else ""
    if len(number.each) > 1:
        span += f" ({', '.join(f'{each:.{digits}f}' for each in number.each)})"
    if found is not None:
        span = f"{span}, of {found:.1f} % found".removeprefix(", ")
    return f"{number.value:.{digits}f}", span


def table_rows(plan: ExperimentPlan, results: Results) -> list[list[str]]:
    """The table as text: a row a training, its frames, each column's number with its interval, and the source's figure."""
    experiment = plan.experiment
    titles = [column.title for column in experiment.columns]
    published = [title for title in titles if any(title in row for row in experiment.published.values())]
    names = list(experiment.data)
    head = ["", *(f"frames of {name}" for name in names), *titles, *(f"{title}, published" for title in published)]
    rows = [head]
    for row, cells in plan.trained.items():
        counts = [frames_in_all(cells[0], name) for name in names]
        told = (cell_text(results.numbers[row, title], results.found.get((row, title))) for title in titles)
        theirs = (experiment.published.get(row, {}).get(title) for title in published)
        rows.append(
            [
                row,
                *(str(count) if count else "–" for count in counts),
                *(f"{value}, {span}" if span else value for value, span in told),
                *("–" if figure is None else f"{figure:g}" for figure in theirs),
            ]
        )
    return rows


def as_many_rows(lines: Lines) -> list[list[str]]:
    """How many frames of the first line have the value of each point of the others, at the first place where it has that."""
    (first, (counts, values)), *others = lines.items()
    known = [(math.log(n), value) for n, value in zip(counts, values, strict=True) if n > 0 and math.isfinite(value)]
    rows = [["", "frames", f"as many of {first}"]]
    if len(known) < 2:
        return rows
    better = 1.0 if known[-1][1] > known[0][1] else -1.0  # what more frames do
    for name, points in others:
        for count, value in zip(*points, strict=True):
            told = f"fewer than {math.exp(known[0][0]):.0f}" if better * (value - known[0][1]) < 0 else ""
            for (n, low), (m, high) in pairwise(known):
                if not told and min(low, high) <= value <= max(low, high) and low != high:
                    told = f"{math.exp(n + (m - n) * (value - low) / (high - low)):.0f}"
            rows.append([name, f"{count:.0f}", told or f"more than {math.exp(known[-1][0]):.0f}"])
    return rows


def csv_text(plan: ExperimentPlan, results: Results) -> str:
    """Every number on a line of its own, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["training", "column", "test", "value", "low", "high", "repeats", "found", "published"])
    for column in plan.experiment.columns:
        for row in plan.experiment.trainings:
            number = results.numbers[row, column.title]
            figure = plan.experiment.published.get(row, {}).get(column.title, "")
            share = results.found.get((row, column.title))
            values = ["", "", "", ""]
            if number is not None:
                values = [
                    f"{number.value:.4f}",
                    f"{number.low:.4f}",
                    f"{number.high:.4f}",
                    " ".join(f"{e:.4f}" for e in number.each),
                ]
            writer.writerow([row, column.title, column.test, *values, "" if share is None else f"{share:.4f}", figure])
    return text.getvalue()


def first_differences(plan: ExperimentPlan, results: Results) -> Iterator[tuple[str, list[list[str]]]]:
    """How far rows differ: titles, each the first column of a test, and how far each row, down, is above each other one, across.

    In parentheses stands what is not sure; columns of a single row are left out.
    """
    firsts: dict[str, str] = {}
    for column in plan.experiment.columns:
        firsts.setdefault(column.test, column.title)
    for title in firsts.values():
        if pairs := results.differences[title]:
            names = list(dict.fromkeys(row for row, _ in pairs))
            told = {pair: f"{each.value:+.1f}" if each.sure else f"({each.value:+.1f})" for pair, each in pairs.items()}
            yield title, [["", *names], *([row, *(told.get((row, other), "") for other in names)] for row in names)]


def differences_csv(results: Results) -> str:
    """Every difference on a line of its own, as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["column", "training", "less", "value", "low", "high"])
    for column, pairs in results.differences.items():
        writer.writerows([column, *pair, *(f"{number:.4f}" for number in each)] for pair, each in pairs.items())
    return text.getvalue()


def losses(cell: TrainCell) -> list[dict[str, float]]:
    """The figures of each epoch of a training, by name; none where there are none."""
    path: Path = cell.folder / "log" / "metrics.csv"
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [{name: float(value) for name, value in row.items() if value} for row in csv.DictReader(file)]


def cost_rows(plan: ExperimentPlan) -> list[list[str]]:
    """What each cell took: wall seconds, CPU seconds and hours; and in all."""
    rows, total = [["", "wall s", "CPU s", "CPU h", ""]], 0.0
    for cell in plan.cells:
        if not (record := cell.record):
            rows.append([cell.name, "–", "–", "–", "not made"])
            continue
        total += record["cpu_s"]
        note = _RESUMED if record["resumed"] else ""
        rows.append([cell.name, f"{record['wall_s']:.1f}", f"{record['cpu_s']:.1f}", f"{record['cpu_s'] / 3600:.3f}", note])
    lacking = sum(row[-1] == _RESUMED for row in rows)
    rest = f"without the earlier runs of {lacking}" if lacking else ""
    return [*rows, ["all", "", f"{total:.1f}", f"{total / 3600:.3f}", rest]]
