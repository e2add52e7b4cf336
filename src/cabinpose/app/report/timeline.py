"""When samples arrived, as inline SVG: density over time with the silences marked, and the intervals between arrivals."""

from __future__ import annotations

import numpy as np

from cabinpose.app.report.charts import COLOURS, Axis, Margins, Plot, text
from cabinpose.app.report.html import Html, el
from cabinpose.store.recording import SourceSurvey, Survey

_ROW = 38
_BIN_PX = 2
_GAP_PX = 1.5  # least width of the mark of a silence


def timeline(found: Survey) -> Html:
    """A row for each source: samples in each stretch of time relative to the usual number, and its silences."""
    rows = len(found.sources)
    across, up = Axis(0, max(found.seconds, 1e-9)), Axis(0, max(rows, 1))
    plot = Plot("", (1240, _ROW * rows + 38), across, up, Margins(left=120, right=16, bottom=34))
    plot.columns(" s")
    for i, source in enumerate(found.sources):
        base = plot.at(0, rows - i)[1] + _ROW - 5
        plot.body.append(text(0, base - 9, source.name, "title"))
        plot.body += _density(plot, source, found.started_ns, base, COLOURS[i % len(COLOURS)])
        for start, end in source.gaps.tolist():
            x, y = plot.at(start, 0)[0], base - _ROW + 10
            told = el("title", f"{end - start:.3f} s without a sample, from {start:.3f} s")
            wide = max(plot.at(end, 0)[0] - x, _GAP_PX)
            plot.body.append(el("rect", told, x=x, y=y, width=wide, height=_ROW - 10, class_="gap"))
    return plot.svg()


def _density(plot: Plot, source: SourceSurvey, started_ns: int, base: float, colour: str) -> list[Html]:
    """An outline whose height is the number of samples in a stretch of time, full at the usual rate."""
    if source.samples < 2:
        return []
    wide, span = plot.right - plot.left, plot.x[1]
    usual = 1e9 / max(float(np.median(np.diff(source.arrival_ns))), 1.0)
    bins = int(np.clip(wide // _BIN_PX, 1, max(span * usual / 8, 1)))  # about eight samples each, or more
    counts, _ = np.histogram((source.arrival_ns - started_ns) / 1e9, bins=bins, range=(0, span))
    # One sample more or less is where a stretch begins, and no loss.
    share = np.where(counts == 0, 0, np.minimum((counts + 1) / (usual * span / bins), 1.0))
    xs = plot.left + np.arange(bins + 1).repeat(2)[1:-1] * wide / bins
    points = [f"{x:.1f},{base - value * (_ROW - 10):.1f}" for x, value in zip(xs, share.repeat(2), strict=True)]
    outline = f"{plot.left},{base:.1f} {' '.join(points)} {plot.right},{base:.1f}"
    return [el("polygon", points=outline, fill=colour, fill_opacity="0.75")]


def interval_chart(source: SourceSurvey, started_ns: int, seconds: float) -> Html:
    """Milliseconds between arrivals over the take: median, and from the shortest to the longest, on a logarithmic scale."""
    intervals = np.maximum(np.diff(source.arrival_ns) / 1e6, 1e-3)
    at, span = (source.arrival_ns[1:] - started_ns) / 1e9, max(seconds, 1e-9)
    bins = int(np.clip(len(intervals) // 8, 1, 180))  # some 3 px each
    which = np.minimum((at / span * bins).astype(int), bins - 1)
    stretches = [(k, intervals[which == k]) for k in np.unique(which)]
    low = int(np.floor(np.log10(intervals.min())))
    powers = range(low, max(int(np.ceil(np.log10(intervals.max()))), low + 1) + 1)
    y = Axis(10.0 ** powers[0], 10.0 ** powers[-1], log=True)
    plot = Plot(f"{source.name}, ms", (610, 190), Axis(0, span), y, Margins(left=52, right=10, bottom=30))
    plot.rows(10.0**power for power in powers)
    plot.columns(" s")
    xs = [(k + 0.5) / bins * span for k, _ in stretches]
    least, middle, most = ([float(f(v)) for _, v in stretches] for f in (np.min, np.median, np.max))
    plot.body += [
        el("path", d=plot.path(xs + xs[::-1], most + least[::-1]), class_="shade"),
        el("path", d=plot.path(xs, middle), class_="median"),
    ]
    return plot.svg()
