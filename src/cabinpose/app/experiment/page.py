"""The page of an experiment, and its table and pictures as files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cabinpose import __version__
from cabinpose.app.experiment.cells import code_state
from cabinpose.app.experiment.config import file_name, merged
from cabinpose.app.experiment.examples import RULE, ShownFrames, shown_frames
from cabinpose.app.experiment.plan import ExperimentPlan, same_cells
from cabinpose.app.experiment.results import (
    Lines,
    Results,
    as_many_rows,
    cell_text,
    cost_rows,
    csv_text,
    differences_csv,
    first_differences,
    frames_of,
    losses,
    table_rows,
)
from cabinpose.app.finite import finite
from cabinpose.app.report.charts import ValueScale, charts, legend, series_chart
from cabinpose.app.report.html import Html, document, el, figure, join, remark, section, table, with_small
from cabinpose.app.report.raster import curves_chart, write_grid, write_png, write_svg
from cabinpose.core import ConfigError, make_folder, write_together, write_whole

PLAN = "experiment.json"
_INTERVALS = (
    "Each cell: the mean over the repeats, and below it what 95 of 100 resamples give, then each repeat. Drawn with replacement "
    "are repeats and, the same for all of them, whole sequences and single frames. Over few repeats, or few sequences, that is "
    "narrower than an interval of confidence. Mean errors are of the joints that were found, from the root of those "
    "with which it was found: the share of these stands below them. "
    "Published figures are of the source's own frames: they stand beside ours to be seen, and are no target."
)
_DIFFERENCES = (
    "How far a row is above another: that at the left less that above. In parentheses: less far than 95 of 100 resamples tell, "
    "which draw the same sequences and frames for both, and what repeats of one row differ by, of all rows together. Of twenty "
    "pairs that do not differ one stands without parentheses. All columns, with intervals, are in differences.csv."
)
_AS_MANY = (
    "Below each chart: as many frames of the first line, between its points by the logarithm of their numbers, have the value of "
    "those of another line. Read off the lines, without an interval."
)
_ACROSS = 4  # frames of a contact sheet
_NAMES = 8  # of cells in a line
_LOSSES = ("training loss", "validation loss")


def write_results(folder: Path, plan: ExperimentPlan, results: Results, asked: dict[str, object]) -> None:
    """Write index.html, table.md, table.csv, report.json, pictures, and what was asked for, with which the page is made again."""
    make_folder(folder)
    rows, shown, protocol = table_rows(plan, results), shown_frames(plan, results), _protocol(plan, results, asked)
    numbers = {f"{row}: {title}": None if n is None else n._asdict() for (row, title), n in results.numbers.items()}
    found = {f"{row}: {title}": share for (row, title), share in results.found.items()}
    report = {"title": plan.experiment.title, "protocol": protocol, "numbers": numbers, "found": found}
    files = {
        "index.html": page_html(plan, results, shown, protocol),
        "table.md": markdown(plan, results, rows, protocol),
        "table.csv": csv_text(plan, results),
        "differences.csv": differences_csv(results),
        "report.json": json.dumps(finite(report), allow_nan=False, indent=1) + "\n",
        PLAN: _asked_text(asked),
    }
    write_together(folder, files)
    for name, chart, lines in _drawn_charts(plan, results):
        write_png(folder / f"{name}.png", [chart], lines)
        write_svg(folder / f"{name}.svg", chart, lines)
    for (test, kind), frames in shown.items():
        write_grid(folder / f"frames-{file_name(test)}-{file_name(kind)}.png", [frame for frame, _ in frames], _ACROSS)


def _drawn_charts(plan: ExperimentPlan, results: Results) -> Iterator[tuple[str, Html, Iterable[str]]]:
    """The charts that are files as well: what each is called, the chart, and what its colours stand for."""
    for test, lines in results.accuracy.items():
        yield f"accuracy-{file_name(test)}", _accuracy(test, lines), lines
    for (test, row), lines in results.by_joint.items():
        yield f"joints-{file_name(test)}-{file_name(row)}", _by_joint(test, row, lines), lines
    for title, lines in results.curves.items():
        yield f"curve-{file_name(title)}", _over_count(title, lines), lines
    for row, cells in plan.trained.items():
        if rows := losses(cells[0]):
            yield f"training-{file_name(row)}", curves_chart(rows, None, "", False), _LOSSES


def is_written(folder: Path, asked: dict[str, object]) -> bool:
    """Whether the page is there, made of the same file and cells."""
    there = all((folder / name).exists() for name in ("index.html", "table.md", PLAN))
    return there and (folder / PLAN).read_text("utf-8") == _asked_text(asked)


def _asked_text(asked: Mapping[str, object]) -> str:
    return json.dumps(asked, indent=1) + "\n"


def begin(folder: Path, asked: Mapping[str, object]) -> None:
    """Write what is asked for, so that `report` makes the page of a run which never ended."""
    make_folder(folder)
    write_whole(folder / PLAN, _asked_text(asked))


def refuse_other(folder: Path, asked: Mapping[str, object]) -> None:
    """Raise ConfigError where the page there is of another file, or of other folders in place of datasets."""
    with suppress(OSError, ValueError):
        found = json.loads((folder / PLAN).read_text("utf-8"))
        for key, what in (("file", "file"), ("data", "--data")):
            if isinstance(found, dict) and found.get(key, asked[key]) != asked[key]:
                raise ConfigError(
                    f"{folder} has the page of another {what}",
                    hint="move that folder away, rename the file, or give another --out",
                )


def stale(plan: ExperimentPlan) -> str:
    """Which cells were made by another state of the code than the one that runs; "" where none was."""
    names = [cell.name for cell in plan.cells if (record := cell.record) and record.get("code") != code_state()]
    told = ", ".join(names[:_NAMES]) + (f" and {len(names) - _NAMES} more" if len(names) > _NAMES else "")
    return f"made by another state of the code than this one: {told}" if names else ""


def remarks(plan: ExperimentPlan) -> list[str]:
    """What is to be known before the numbers: stand-ins, what is shared on purpose, rows that are one, states of the code."""
    experiment, told = plan.experiment, []
    for name, pieces in plan.data.items():
        if any(piece.config for piece in pieces):
            what = experiment.data[name].stands_for
            made = "recorded in the virtual laboratory" if experiment.data[name].lab is not None else "generated"
            meant = f"a stand-in, {made}, for {what}: figures on it say nothing of those frames" if what else made
            told.append(f"{name} is {meant}")
    for name, row in experiment.trainings.items():
        if row.may_share:
            told.append(f"{name}: validated on other frames of people who are learnt from")
    for name, test in experiment.tests.items():
        if test.may_share:
            told.append(
                f"{name}: the tested frames may share the {', '.join(test.may_share)} with those learnt from, as the file says"
            )
    first = [cell for cells in plan.trained.values() for cell in cells]
    told += [f"{name} is {other} at this scale" for name, other in same_cells(first).items()]
    if another := stale(plan):
        told.append(another)
    for pair, cells in plan.tested.items():
        if 0 < (done := sum(cell.done for cell in cells)) < len(cells):
            told.append(f"{' on '.join(pair)}: over {done} of {len(cells)} repeats, the others are not made")
    missing = sum(not cell.done for cell in plan.cells)
    if missing:
        told.append(f"{missing} of {len(plan.cells)} cells are not made: their numbers are missing")
    return told


def _protocol(plan: ExperimentPlan, results: Results, asked: Mapping[str, object]) -> list[str]:
    """How the numbers came about, beside the rows' frames."""
    scale, cells = plan.scale, [cells[0] for cells in plan.trained.values()]
    recipe = merged(plan.experiment.recipe, scale.recipe)
    first = [stage.recipe for stage in (cells[0].begins, cells[0]) if stage is not None]
    epochs = sum(recipe["epochs"] for recipe in first)
    steps = f"{epochs * first[0]['epoch_steps']} batches" if scale.steps else "whole passes"
    tested = [f"test {test}: {what}" for test, what in results.judged.items()]
    least = (
        f", of those to validate and to test on no fewer than {scale.least}" if scale.frames != 1.0 and scale.least > 1 else ""
    )
    return [
        f"scale {asked['scale']}: frames of the file times {scale.frames:g}{least}",
        f"each training: {steps} in {epochs} epochs, {scale.repeats} repeats with seeds from 1",
        *tested,
        f"recipe, but for what rows change: {json.dumps(recipe)}",
        f"{asked['resamples']} resamples; cabinpose {__version__}, code {asked['code']}",
    ]


def page_html(plan: ExperimentPlan, results: Results, shown: ShownFrames, protocol: Iterable[str]) -> str:
    """The page."""
    experiment = plan.experiment
    notes = join(el("p", el("b", told)) for told in remarks(plan))
    sections = [
        section("What to know first", notes + remark(experiment.about)),
        section("Table", _table(plan, results), _INTERVALS),
        section("Differences", _differences(plan, results), _DIFFERENCES),
        section("Accuracy over thresholds", _accuracies(results), "Per cent of all joints within a part of the head size."),
        section("Frames of the tests", _frames_shown(shown), RULE),
        section("Over numbers of frames", _over_frames(results), _AS_MANY),
        section("Training", _losses(plan), "Training loss, blue, and validation loss, red, of the first repeat."),
        section("How it was measured", join(el("p", line) for line in protocol)),
        section("Frames", table(_frame_rows(plan))),
        section("What the cells took", table(cost_rows(plan), words=(0, 4))),
    ]
    return document(experiment.title, experiment.title, experiment.source, sections)


def markdown(plan: ExperimentPlan, results: Results, rows: Sequence[Sequence[str]], protocol: Iterable[str]) -> str:
    """The tables as Markdown, below what is to be known before them."""
    told = [*remarks(plan), *protocol]
    lines = [f"# {plan.experiment.title}", "", *(f"- {line}" for line in told), "", *_pipes(rows)]
    for title, apart in first_differences(plan, results):
        lines += ["", f"## Differences of {title}", "", *_pipes(apart)]
    return "\n".join(lines) + "\n"


def _pipes(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(rows[0])} |"
    yield "|" + "---|" * len(rows[0])
    yield from (f"| {' | '.join(row)} |" for row in rows[1:])


def _table(plan: ExperimentPlan, results: Results) -> Html:
    experiment = plan.experiment
    head: list[object] = ["", *(column.title for column in experiment.columns)]
    rows = [head]
    for row in experiment.trainings:
        cells: list[object] = [row]
        for column in experiment.columns:
            value, span = cell_text(results.numbers[row, column.title], results.found.get((row, column.title)))
            figure = experiment.published.get(row, {}).get(column.title)
            cells.append(with_small(value, " ".join([span, *([] if figure is None else [f"· published {figure:g}"])])))
        rows.append(cells)
    return table(rows)


def _differences(plan: ExperimentPlan, results: Results) -> str:
    return join(join((el("h3", title), table(rows))) for title, rows in first_differences(plan, results))


def _accuracy(test: str, lines: Lines) -> Html:
    return series_chart(test, "head sizes", lines, scale=ValueScale(top=100.0), size=(640, 300))


def _by_joint(test: str, row: str, lines: Lines) -> Html:
    return series_chart(f"{row} on {test}", "head sizes", lines, scale=ValueScale(top=100.0))


def _frames_shown(shown: ShownFrames) -> str:
    return join(
        join((el("h3", f"{test}: {kind}"), el("div", *(figure(*frame) for frame in frames), class_="frames")))
        for (test, kind), frames in shown.items()
    )


def _accuracies(results: Results) -> str:
    names: Iterable[str] = dict.fromkeys(name for lines in results.accuracy.values() for name in lines)
    drawn = [_accuracy(test, lines) for test, lines in results.accuracy.items()]
    if not drawn:
        return ""
    groups: Iterable[str] = dict.fromkeys(name for lines in results.by_joint.values() for name in lines)
    each = [_by_joint(test, row, lines) for (test, row), lines in results.by_joint.items()]
    return legend(names) + charts(drawn, "two") + el("h3", "By joint") + legend(groups) + charts(each)


def _over_frames(results: Results) -> str:
    drawn = []
    for title, lines in results.curves.items():
        drawn += [legend(lines), charts([_over_count(title, lines)], "two")]
        if len(rows := as_many_rows(lines)) > 1:
            drawn.append(table(rows, words=(0,)))
    return join(drawn)


def _over_count(title: str, lines: Lines) -> Html:
    return series_chart(title, "frames", lines, scale=ValueScale(stops=True), size=(640, 300))


def _losses(plan: ExperimentPlan) -> str:
    drawn = []
    for row, cells in plan.trained.items():
        if rows := losses(cells[0]):
            drawn.append(el("div", el("h3", row), curves_chart(rows, None, "", False)))
    return legend(_LOSSES) + charts(drawn) if drawn else ""


def _frame_rows(plan: ExperimentPlan) -> list[list[str]]:
    names = list(plan.data)
    rows = [["", *(f"learnt: {name}" for name in names), "validated", "epochs", "steps an epoch", "repeats"]]
    for name, cells in plan.trained.items():
        for told, cell in ((f"{name}, first", cells[0].begins), (name, cells[0])):
            if cell is not None:
                counts = [frames_of(cell, data) for data in names]
                steps = cell.recipe["epoch_steps"] or "one pass"
                numbers = [sum(s.frames for s in cell.validation), cell.recipe["epochs"], steps, len(cells)]
                rows.append([told, *map(str, counts), *map(str, numbers)])
    return rows
