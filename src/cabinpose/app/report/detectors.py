"""The page on detectors: numbers, curves, typical and worst frames of one evaluation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from cabinpose.app.report.charts import ValueScale, box_chart, charts, legend, series_chart
from cabinpose.app.report.frames import ERROR, PREDICTION, TRUTH
from cabinpose.app.report.html import Html, document, el, join, remark, section, table, tiles, with_small
from cabinpose.app.report.numbers import Column, group_columns, grouping_rows, interval, label, number, people_rows, worst_words
from cabinpose.app.report.over_frames import NOTE, OverFrames, over_frames_html
from cabinpose.evaluate import ALL, FOUND, PEOPLE, Report, Value

_Row = tuple[object, Report, Sequence[object]]  # the first cell, the report that the row is of, the other cells
_SIZE, _PER_CENT = (420, 260), ValueScale(top=100.0)
_UNIT = MappingProxyType({"2d": "px", "3d": "cm"})
_BOX_NOTE = (
    "Joints found. Box: quartiles and median; whiskers: to the farthest error within 1.5 times the box's height; dots: outliers, "
    "of more than a hundred every so many. The threshold is --hit-px, --hit-m."
)
_CONFIDENCE_NOTE = (
    "Presence: by tenths of what the model said, the share of joints that are in the image, and of those found within the "
    "threshold, too; the thin line is that of a model which is right about itself. Expected error: by tenths of joints found. "
    "Surest joints: ordered by the expected error where the model gives one, else by the score."
)
_GROUPS_NOTE = (
    "All joints of the people of each group; numbers in quarters of the people, unless edges were given. The worst group has the "
    "least PCKh@0.5 of those with 20 people or more; the interval of its difference is widened by the number of groups."
)
_TILES = (
    ("PCKh", "2d", ALL, None), ("AUC of PCKh", "2d", ALL, None), ("mean error", "2d", ALL, None), ("AP", "2d", PEOPLE, None),
    ("PCKh", "3d", ALL, None), ("AUC of PCKh", "3d", ALL, None), ("MPJPE", "3d", ALL, None), ("PCK", "3d", ALL, 10.0),
)  # fmt: skip


def page_html(
    reports: Sequence[Report], typical: Mapping[str, Sequence[Html]], worst: Mapping[str, Sequence[Html]],
    over_frames: OverFrames = MappingProxyType({}),
) -> str:  # fmt: skip
    """The page on one or more models on one dataset.

    typical, worst: figures of such frames by model · over_frames: how far each is off over the frames; without it the page has no
    such section.
    """
    colours = ((TRUTH, " truth "), (PREDICTION, " prediction "), (ERROR, " error"))
    dots = join(part for colour, name in colours for part in (el("i", class_="dot", style=f"background:{colour}"), name))
    first = reports[0]
    draws = first.settings["resamples"]
    told = f"Small: 95 % interval, {first.settings['clusters']} sequences and single frames drawn with replacement {draws} times."
    intervals = told if draws else "Without intervals."
    near = join(("Those nearest to the median frame's error. ", dots))
    coverage = join(remark(f"{r.model}: {r.caveats.coverage}") for r in reports if r.caveats.coverage)
    curves = "Share of the true joints that count, in per cent; one that was not found is wrong."
    sections = [
        section("At a glance", "".join(map(_glance, reports))),
        *(
            section(title, body and coverage + body, note)
            for title, body, note in (
                ("By joint group", _group_table(reports), intervals),
                ("Curves", _curves(reports), curves),
                ("Error by joint", _boxes(reports), _BOX_NOTE),
                ("Over the frames", over_frames_html(over_frames), NOTE),
                ("Confidence", _confidence(reports), _CONFIDENCE_NOTE),
                ("By visibility", _visibility_table(reports), ""),
                ("By groups of people", _groupings(reports), _GROUPS_NOTE),
                ("Typical frames", _frames(reports, typical), near),
                ("Worst frames", _frames(reports, worst), dots),
                ("All numbers", _number_table(reports), ""),
            )
        ),
        section("Settings", _settings(first)),
    ]
    names = ", ".join(r.model for r in reports)
    summary = f"on {first.dataset}: {first.frames} frames, {first.people} people, {len(first.joint_sets[ALL])} joints"
    return document(f"{names} on {first.dataset}", names, summary, sections)


def _glance(report: Report) -> str:
    values = [report.value(metric, space, joints, threshold) for metric, space, joints, threshold in _TILES]
    entries = ((number(v), v.unit, label(v), (interval(v),), "") for v in values if v is not None)
    caveats = report.caveats
    doubts = [el("p", el("b", each.words)) for each in caveats.explanations]
    return join((el("h3", report.model), *doubts, remark(caveats.coverage), tiles(entries), *map(remark, report.notes)))


def _with_models(reports: Sequence[Report], head: Sequence[object], rows: Iterable[_Row]) -> Html:
    """A table, with a column of models where there are several."""
    several = len(reports) > 1
    whose = ["model"] if several else []
    lines = [[first, *([report.model] if several else []), *cells] for first, report, cells in rows]
    return table([["", *whose, *head], *lines], words=(0, 1) if several else (0,))


def _group_table(reports: Sequence[Report]) -> Html:
    columns = group_columns(reports)
    rows = (
        (group if i == 0 else "", report, [_cell(report, group, c, reports) for c in columns])
        for group in reports[0].joint_sets
        for i, report in enumerate(reports)
    )
    return _with_models(reports, [c.title for c in columns], rows)


def _cell(report: Report, group: str, column: Column, reports: Sequence[Report]) -> Html:
    """A number and its interval, bold where it is the best of several models."""
    values = [r.value(column.metric, column.space, group, column.threshold) for r in reports]
    mine = values[list(reports).index(report)]
    rivals = [v.value for v in values if v is not None]
    best = len(rivals) > 1 and mine is not None and mine.value == (max if column.up else min)(rivals)
    return with_small(el("b", number(mine)) if best else number(mine), interval(mine))


def _curves(reports: Sequence[Report]) -> str:
    """One model: a chart with a line for each group. Several: a chart for each group with a line for each model."""
    drawn = []
    models, groups = [r.model for r in reports], list(reports[0].joint_sets)
    for space, kind, label_of_x in _curve_kinds(reports):
        curves = {r.model: r.curves[space][kind] for r in reports if space in r.curves}
        title = f"{'PCKh' if kind == 'pckh' else 'Within a distance'}, {space.upper()}"
        lines = {m: {g: (c["grid"], c["lines"].get(g, ())) for g in groups} for m, c in curves.items()}
        if len(reports) == 1:
            plots = {title: lines[models[0]]}
        else:
            plots = {f"{g}: {title}": {m: lines[m][g] if m in lines else ((), ()) for m in models} for g in groups}
        drawn += [series_chart(t, label_of_x, plot, scale=_PER_CENT, size=_SIZE) for t, plot in plots.items()]
    return legend(groups if len(reports) == 1 else models) + charts(drawn, "two" if len(reports) == 1 else "")


def _curve_kinds(reports: Sequence[Report]) -> Iterable[tuple[str, str, str]]:
    true_head = reports[0].settings["head"] == "true"
    for space, size in (("2d", "26 px"), ("3d", "200 mm")):
        if any(space in r.curves for r in reports):
            yield space, "pckh", f"distance / {'true head-neck length' if true_head else f'head size ({size})'}"
            yield space, "error", f"distance, {_UNIT[space]}"


def box_charts(reports: Sequence[Report]) -> list[Html]:
    """Box plots of the errors by joint, a chart for each space and range of the error, the models side by side in each."""
    drawn = []
    for space in ("2d", "3d"):
        ranges = dict.fromkeys(name for r in reports for name in r.boxes.get(space, {}))
        for name in ranges:
            boxes = {r.model: r.boxes.get(space, {}).get(name, {}) for r in reports}
            if any(boxes.values()):
                title = f"Error, {space.upper()} ({_UNIT[space]}): {name}"
                drawn.append(box_chart(title, boxes, log=name == FOUND))
    return drawn


def _boxes(reports: Sequence[Report]) -> str:
    return (legend(r.model for r in reports) if len(reports) > 1 else "") + "".join(box_charts(reports))


def _confidence(reports: Sequence[Report]) -> str:
    """Presence against what is there, expected error against error, and the error of the joints that a model is surest of."""
    several = len(reports) > 1
    drawn = []
    for kind, what in (("in_image", "in the image"), ("within", "found within the threshold")):
        bins = {r.model: r.calibration["presence"][ALL][kind] for r in reports}
        lines = {m: ([100 * x for x in b["said"]], [100 * y for y in b["was"]]) for m, b in bins.items()}
        drawn.append(series_chart(f"Joints {what}, %", "presence, %", lines, scale=_PER_CENT, size=_SIZE, diagonal=True))
    expected = {r.model: r.calibration["expected_error"].get(ALL, {"said": (), "was": ()}) for r in reports}
    if any(len(bins["said"]) for bins in expected.values()):
        lines = {m: (b["said"], b["was"]) for m, b in expected.items()}
        drawn.append(series_chart("Mean error, cm", "expected error, cm", lines, size=_SIZE, diagonal=True))
    surest = []
    for space, unit in _UNIT.items():
        sets = {r.model: r.calibration["surest"].get(space, {}) for r in reports}
        if any(sets.values()):
            groups = {m: {g: (c["kept"], c["median"]) for g, c in by_group.items()} for m, by_group in sets.items()}
            lines = {m: by_group.get(ALL, ((), ())) for m, by_group in groups.items()} if several else groups[reports[0].model]
            surest.append(series_chart(f"Median error, {space.upper()}, {unit}", "surest joints, %", lines, size=_SIZE))
    names = [r.model for r in reports] if several else list(reports[0].joint_sets)
    return (legend(names) if several else "") + charts(drawn) + ("" if several else legend(names)) + charts(surest, "two")


def _visibility_table(reports: Sequence[Report]) -> Html:
    columns = [c for c in group_columns(reports) if c.metric != "median error"]
    rows: list[_Row] = []
    for state in ("visible", "self_occluded", "occluded", "outside_image"):
        for report in reports:
            values = [report.value(c.metric, c.space, ALL, c.threshold, visibility=state) for c in columns]
            joints = max((v.samples for v in values if v is not None), default=0)
            if joints:
                rows.append((state.replace("_", " "), report, [joints, *(with_small(number(v), interval(v)) for v in values)]))
    return _with_models(reports, ["joints", *(c.title for c in columns)], rows)


def _groupings(reports: Sequence[Report]) -> str:
    """The tables by labels of people, of each model in turn, with what can be said of the worst group."""
    columns, blocks = group_columns(reports), []
    for report in reports:
        for grouping in report.groupings:
            title = f"{report.model}: {grouping.by}" if len(reports) > 1 else grouping.by
            rows = grouping_rows(grouping, columns, lambda v: with_small(number(v), interval(v)))
            blocks.append(el("div", el("h3", title), table(rows), remark(worst_words(grouping))))
    return join(blocks)


def _frames(reports: Sequence[Report], by_model: Mapping[str, Sequence[Html]]) -> str:
    blocks = ""
    for report in reports:
        if figures := by_model.get(report.model):
            blocks += (el("h3", report.model) if len(reports) > 1 else "") + el("div", *figures, class_="frames")
    return blocks


def _number_table(reports: Sequence[Report]) -> Html:
    def cells(v: Value) -> list[object]:
        return [f"{number(v)} {v.unit}", interval(v), v.samples, f"{v.denominator}; {v.average}"]

    rows = [(name, report, cells(v)) for report in reports for name, v in people_rows(report)]
    return _with_models(reports, ["value", "95 % interval", "samples", "of what; how averaged"], rows)


def _settings(report: Report) -> Html:
    joints = {group: ", ".join(names) for group, names in report.joint_sets.items()}
    return table(list({**report.settings, **joints}.items()), words=(0, 1), head=False)
