"""The page of one evaluation: one HTML file without scripts, that needs no other file and no network."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cabinpose.app.mocap.figures import Section
from cabinpose.app.report.html import Html, document, el, remark, section, table, tiles, with_small
from cabinpose.evaluate.mocap import ALL, Judgement, Summary

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
    notes = "".join(map(remark, judgement.notes))
    sections = [
        section("At a glance", _glance(judgement) + notes, _interval_note(judgement)),
        *(section(title, body, note) for title, body, note in drawn),
        section("All numbers", _numbers(judgement)),
        section("Settings", table(list(judgement.settings.items()), words=(0, 1), head=False)),
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
        return "".join(el("h3", measure) + tiles(map(_tile, rows)) for measure, rows in by_measure.items())
    conditions = list(dict.fromkeys(s.condition for rows in by_measure.values() for s in rows))
    medians = [[measure, *(_with_unit(s) for s in rows)] for measure, rows in by_measure.items()]
    return remark("Medians.") + table([["", *conditions], *medians])


def _with_unit(s: Summary) -> Html:
    return with_small(f"{number(s.median)} {s.unit}", interval(s.median_low, s.median_high))


def _tile(s: Summary) -> tuple[str, str, str, tuple[str, ...], str]:
    lines = interval(s.median_low, s.median_high), f"mean {number(s.mean)}, σ {number(s.sd)}"
    return number(s.median), s.unit, f"median, {'all' if s.condition == ALL else s.condition}", lines, ""


def _interval_note(judgement: Judgement) -> str:
    lengths = [s.block_s for s in judgement.summaries if math.isfinite(s.block_s)]
    if not lengths:
        return "Without intervals."
    span = f"{min(lengths):.2f} s" if max(lengths) - min(lengths) < 0.005 else f"{min(lengths):.2f} to {max(lengths):.2f} s"
    return f"Small: 95 % intervals, blocks of {span} drawn with replacement {judgement.settings['resamples']} times."


def _numbers(judgement: Judgement) -> Html:
    rows: list[list[object]] = [["", "measure", "condition", "mean", "σ", "median", "95 %", "largest", "samples", "unit"]]
    for s in judgement.summaries:
        if s.samples:
            mean = with_small(number(s.mean), interval(s.mean_low, s.mean_high))
            median = with_small(number(s.median), interval(s.median_low, s.median_high))
            name = el("b", s.name) if s.name == ALL else s.name
            spread = number(s.p95), number(s.maximum), s.samples, s.unit
            rows.append([name, s.measure, s.condition, mean, number(s.sd), median, *spread])
    return table(rows, words=(0, 1, 2, 9))
