"""The page: one HTML file without scripts, that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from types import MappingProxyType

from cabinpose.app.report.charts import box_chart, legend, line_chart
from cabinpose.app.report.frames import ERROR, PREDICTION, TRUTH
from cabinpose.app.report.numbers import Column, group_columns, interval, label, number, people_rows
from cabinpose.evaluate.report import ALL, PEOPLE, Report, Value

_SPACE = MappingProxyType({"2d": "2D", "3d": "3D"})
_UNIT = MappingProxyType({"2d": "px", "3d": "cm"})
_TILES = (
    ("PCKh", "2d", ALL, None), ("AUC of PCKh", "2d", ALL, None), ("mean error", "2d", ALL, None), ("AP", "2d", PEOPLE, None),
    ("PCKh", "3d", ALL, None), ("AUC of PCKh", "3d", ALL, None), ("MPJPE", "3d", ALL, None), ("PCK", "3d", ALL, 10.0),
)  # fmt: skip


def page_html(reports: Sequence[Report], typical: Mapping[str, Sequence[str]], worst: Mapping[str, Sequence[str]]) -> str:
    """The page on one or more models on one dataset; typical, worst: figures of such frames by model."""
    legend = f"{_dot(TRUTH)} truth {_dot(PREDICTION)} prediction {_dot(ERROR)} error"
    first = reports[0]
    sections = [
        section("At a glance", "".join(_tiles(r) for r in reports)),
        section("By joint group", _group_table(reports), _interval_note(first)),
        section("Curves", _curves(reports), "Share of the true joints that count, in per cent; one that was not found is wrong."),
        section("Error by joint", _boxes(reports), "Joints found. Box: quartiles and median; line: 5 % to 95 %."),
        section("By visibility", _visibility_table(reports)),
        section("Typical frames", _frames(reports, typical), f"Those nearest to the median frame's error. {legend}"),
        section("Worst frames", _frames(reports, worst), legend),
        section("All numbers", _number_table(reports)),
        section("Settings", _settings(first)),
    ]
    names = ", ".join(r.model for r in reports)
    told = f"on {first.dataset}: {first.frames} frames, {first.people} people, {len(first.joint_sets[ALL])} joints"
    return document(f"{names} on {first.dataset}", names, told, sections)


def document(title: str, heading: str, told: str, sections: Sequence[str]) -> str:
    """The whole page: its title, what stands at its head and in the line below, and its sections (HTML)."""
    style = (files("cabinpose.app.report") / "assets" / "report.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{style}</style></head><body>"
        f"<header><h1>{escape(heading)}</h1><p>{escape(told)}</p></header><main>{''.join(sections)}</main></body></html>\n"
    )


def section(title: str, body: str, note: str = "") -> str:
    """A section of a page; nothing where its body is empty."""
    return f"<section><h2>{title}</h2>{f'<p class=note>{note}</p>' if note else ''}{body}</section>" if body else ""


def _dot(colour: str) -> str:
    return f'<i class="dot" style="background:{colour}"></i>'


def _interval_note(report: Report) -> str:
    draws = report.settings["resamples"]
    return f"Small: 95 % interval, frames drawn with replacement {draws} times." if draws else "Without intervals."


def _tiles(report: Report) -> str:
    values = [report.value(metric, space, joints, threshold) for metric, space, joints, threshold in _TILES]
    tiles = "".join(
        f'<div class="tile"><b>{number(v)}<small> {escape(v.unit)}</small></b><span>{escape(label(v))}</span>'
        f"<em>{interval(v)}</em></div>"
        for v in values
        if v is not None
    )
    notes = "".join(f"<p class=note>{escape(note)}</p>" for note in report.notes)
    return f"<h3>{escape(report.model)}</h3><div class=tiles>{tiles}</div>{notes}"


def _group_table(reports: Sequence[Report]) -> str:
    columns = group_columns(reports)
    head = "".join(f"<th>{escape(c.title)}</th>" for c in columns)
    model = "<th>model</th>" if len(reports) > 1 else ""
    rows = []
    for group in reports[0].joint_sets:
        for i, report in enumerate(reports):
            cells = "".join(_cell(report, group, c, reports) for c in columns)
            name = f'<th rowspan="{len(reports)}">{escape(group)}</th>' if i == 0 else ""
            whose = f"<td class=name>{escape(report.model)}</td>" if len(reports) > 1 else ""
            rows.append(f"<tr{' class=first' if i == 0 else ''}>{name}{whose}{cells}</tr>")
    return f"<div class=scroll><table><tr><th></th>{model}{head}</tr>{''.join(rows)}</table></div>"


def _cell(report: Report, group: str, column: Column, reports: Sequence[Report]) -> str:
    """A number and its interval, bold where it is the best of several models."""
    value = report.value(column.metric, column.space, group, column.threshold)
    rivals = [v.value for r in reports if (v := r.value(column.metric, column.space, group, column.threshold)) is not None]
    best = len(rivals) > 1 and value is not None and value.value == (max if column.up else min)(rivals)
    return f"<td>{f'<b>{number(value)}</b>' if best else number(value)}<small>{interval(value)}</small></td>"


def _curves(reports: Sequence[Report]) -> str:
    """One model: a chart with a line each group. Several: a chart each group with a line each model that answers."""
    charts = []
    models = [r.model for r in reports]
    for space, kind, label_of_x in _curve_kinds(reports):
        drawn = {r.model: r.curves[space][kind] for r in reports if space in r.curves}
        grid = next(iter(drawn.values()))["grid"]
        title = f"{'PCKh' if kind == 'pckh' else 'Within a distance'}, {_SPACE[space]}"
        if len(reports) == 1:
            charts.append(line_chart(title, label_of_x, grid, drawn[models[0]]["lines"]))
        else:
            lines_of = {g: {m: drawn[m]["lines"][g] if m in drawn else () for m in models} for g in reports[0].joint_sets}
            charts += [line_chart(f"{g}: {title}", label_of_x, grid, lines) for g, lines in lines_of.items()]
    names = list(reports[0].joint_sets) if len(reports) == 1 else models
    wide = "two" if len(reports) == 1 else "three"
    return legend(names) + f'<div class="charts {wide}">{"".join(charts)}</div>'


def _curve_kinds(reports: Sequence[Report]) -> Iterable[tuple[str, str, str]]:
    true_head = reports[0].settings["head"] == "true"
    for space, size in (("2d", "26 px"), ("3d", "200 mm")):
        if any(space in r.curves for r in reports):
            yield space, "pckh", f"distance / {'true head-neck length' if true_head else f'head size ({size})'}"
            yield space, "error", f"distance, {_UNIT[space]}"


def _boxes(reports: Sequence[Report]) -> str:
    charts = []
    for space in ("2d", "3d"):
        boxes = {r.model: r.boxes.get(space, {}) for r in reports}
        if any(boxes.values()):
            charts.append(box_chart(f"Error, {_SPACE[space]} ({_UNIT[space]})", boxes))
    return (legend([r.model for r in reports]) if len(reports) > 1 else "") + "".join(charts)


def _visibility_table(reports: Sequence[Report]) -> str:
    columns = [c for c in group_columns(reports) if c.metric != "median error"]
    head = "".join(f"<th>{escape(c.title)}</th>" for c in columns)
    rows = []
    for state in ("visible", "self_occluded", "occluded", "outside_image"):
        for report in reports:
            cells: list[Value | None] = [report.value(c.metric, c.space, ALL, c.threshold, visibility=state) for c in columns]
            joints = max((v.samples for v in cells if v is not None), default=0)
            if joints:
                numbers = "".join(f"<td>{number(v)}<small>{interval(v)}</small></td>" for v in cells)
                name = state.replace("_", " ") + (f", {report.model}" if len(reports) > 1 else "")
                rows.append(f"<tr><th>{escape(name)}</th><td>{joints}</td>{numbers}</tr>")
    return f"<div class=scroll><table><tr><th></th><th>joints</th>{head}</tr>{''.join(rows)}</table></div>"


def _frames(reports: Sequence[Report], by_model: Mapping[str, Sequence[str]]) -> str:
    blocks = []
    for report in reports:
        if figures := by_model.get(report.model):
            title = f"<h3>{escape(report.model)}</h3>" if len(reports) > 1 else ""
            blocks.append(f"{title}<div class=frames>{''.join(figures)}</div>")
    return "".join(blocks)


def _number_table(reports: Sequence[Report]) -> str:
    rows = [
        f"<tr><th>{escape(name)}</th>{f'<td class=name>{escape(report.model)}</td>' if len(reports) > 1 else ''}<td>{number(v)} "
        f"{escape(v.unit)}</td><td>{interval(v)}</td><td>{v.samples}</td>"
        f"<td class=name>{escape(v.denominator)}; {escape(v.average)}</td></tr>"
        for report in reports
        for name, v in people_rows(report)
    ]
    model = "<th>model</th>" if len(reports) > 1 else ""
    head = (
        f"<tr><th></th>{model}<th>value</th><th>95 % interval</th><th>samples</th><th class=name>of what; how averaged</th></tr>"
    )
    return f"<div class=scroll><table>{head}{''.join(rows)}</table></div>"


def _settings(report: Report) -> str:
    rows = "".join(f"<tr><th>{escape(str(k))}</th><td class=name>{escape(str(v))}</td></tr>" for k, v in report.settings.items())
    groups = "".join(
        f"<tr><th>{escape(g)}</th><td class=name>{escape(', '.join(j))}</td></tr>" for g, j in report.joint_sets.items()
    )
    return f"<div class=scroll><table>{rows}{groups}</table></div>"
