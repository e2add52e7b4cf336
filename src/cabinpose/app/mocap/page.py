"""The page of one evaluation: one HTML file without scripts, that needs no other file and no network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from cabinpose.app.mocap.figures import Section
from cabinpose.app.report.detectors import document, section
from cabinpose.evaluate.mocap.result import ALL, Judgement, Summary

_FEW = 3  # measures that have tiles
_TITLES = {
    "sse": "Static evaluation of a sensor",
    "sfe": "Static evaluation of the full body",
    "dse": "Dynamic evaluation of the sensors",
    "dfe": "Dynamic evaluation of the full body",
}


def page_html(judgement: Judgement, drawn: Sequence[Section], told: str) -> str:
    """The page: tiles, what was drawn, all numbers, settings. told: the takes, in a line."""
    heading = f"{_TITLES[judgement.kind]} ({judgement.kind.upper()})"
    notes = "".join(f"<p class=note>{escape(note)}</p>" for note in judgement.notes)
    sections = [
        section("At a glance", _glance(judgement) + notes, _interval_note(judgement)),
        *(section(title, body, note) for title, body, note in drawn),
        section("All numbers", _table(judgement)),
        section("Settings", _settings(judgement)),
    ]
    return document(f"{judgement.kind.upper()}: {told}", heading, told, sections)


def summary_rows(judgement: Judgement) -> list[list[str]]:
    """A head and a line for every measure and condition, over all names: for the terminal."""
    rows = [["", "median", "95 % interval", "mean", "σ", "95 %", "samples"]]
    for s in judgement.summaries:
        if s.name == ALL:
            what = s.measure if s.condition == ALL else f"  {s.condition}"
            median, span = f"{number(s.median)} {s.unit}", interval(s.median_low, s.median_high)
            rows.append([what, median, span, *map(number, (s.mean, s.sd, s.p95)), str(s.samples)])
    return rows


def number(value: float) -> str:
    """Three digits and more, a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.1f}" if abs(value) >= 100 else f"{value:.2f}"


def interval(low: float, high: float) -> str:
    """Such as 1.20 to 1.40; empty where there is none."""
    return f"{number(low)} to {number(high)}" if math.isfinite(low) else ""


def _glance(judgement: Judgement) -> str:
    """Medians over all names: tiles of few measures; of many a table with a column a condition, side by side."""
    by_measure: dict[str, list[Summary]] = {}
    for s in judgement.summaries:
        if s.name == ALL and s.samples:
            by_measure.setdefault(s.measure, []).append(s)
    if len(by_measure) <= _FEW:
        return "".join(
            f"<h3>{escape(m)}</h3><div class=tiles>{''.join(map(_tile, rows))}</div>" for m, rows in by_measure.items()
        )
    conditions = list(dict.fromkeys(s.condition for rows in by_measure.values() for s in rows))
    head = "".join(f"<th>{escape(c)}</th>" for c in conditions)
    lines = []
    for measure, rows in by_measure.items():
        cells = "".join(
            f"<td>{number(s.median)} {escape(s.unit)}<small>{interval(s.median_low, s.median_high)}</small></td>" for s in rows
        )
        lines.append(f"<tr><th>{escape(measure)}</th>{cells}</tr>")
    return f"<p class=note>Medians.</p><div class=scroll><table><tr><th></th>{head}</tr>{''.join(lines)}</table></div>"


def _tile(s: Summary) -> str:
    return (
        f'<div class="tile"><b>{number(s.median)}<small> {escape(s.unit)}</small></b>'
        f"<span>median, {escape('all' if s.condition == ALL else s.condition)}</span>"
        f"<em>{interval(s.median_low, s.median_high)}</em><em>mean {number(s.mean)}, σ {number(s.sd)}</em></div>"
    )


def _interval_note(judgement: Judgement) -> str:
    lengths = [s.block_s for s in judgement.summaries if math.isfinite(s.block_s)]
    if not lengths:
        return "Without intervals."
    span = f"{min(lengths):.2f} s" if max(lengths) - min(lengths) < 0.005 else f"{min(lengths):.2f} to {max(lengths):.2f} s"
    return f"Small: 95 % intervals, blocks of {span} drawn with replacement {judgement.settings['resamples']} times."


def _table(judgement: Judgement) -> str:
    rows = []
    for s in judgement.summaries:
        if not s.samples:
            continue
        cells = (
            f"<td>{number(s.mean)}<small>{interval(s.mean_low, s.mean_high)}</small></td><td>{number(s.sd)}</td>"
            f"<td>{number(s.median)}<small>{interval(s.median_low, s.median_high)}</small></td>"
            f"<td>{number(s.p95)}</td><td>{number(s.maximum)}</td><td>{s.samples}</td>"
        )
        name = f"<b>{escape(s.name)}</b>" if s.name == ALL else escape(s.name)
        rows.append(
            f"<tr><th>{name}</th><td class=name>{escape(s.measure)}</td><td class=name>{escape(s.condition)}</td>{cells}"
            f"<td class=name>{escape(s.unit)}</td></tr>"
        )
    head = (
        "<tr><th></th><th class=name>measure</th><th class=name>condition</th><th>mean</th><th>σ</th><th>median</th><th>95 %</th>"
        "<th>largest</th><th>samples</th><th class=name>unit</th></tr>"
    )
    return f"<div class=scroll><table>{head}{''.join(rows)}</table></div>"


def _settings(judgement: Judgement) -> str:
    rows = (f"<tr><th>{escape(str(k))}</th><td class=name>{escape(str(v))}</td></tr>" for k, v in judgement.settings.items())
    return f"<div class=scroll><table>{''.join(rows)}</table></div>"
