"""When samples came, as inline SVG: density over time with the silences marked, and the intervals between arrivals."""

from __future__ import annotations

from html import escape

import numpy as np

from cabinpose.app.report.charts import COLOURS
from cabinpose.store.recording import SourceSurvey, Survey

_WIDTH, _LABEL, _RIGHT, _ROW = 1240, 120, 16, 38
_BIN_PX = 2
_GAP_PX = 1.5  # narrowest mark of a silence


def timeline(found: Survey) -> str:
    """A row for each source: samples in each stretch of time against the usual number, and its silences."""
    span = max(found.seconds, 1e-9)
    wide = _WIDTH - _LABEL - _RIGHT
    height = _ROW * len(found.sources) + 34
    body = []
    for tick in _ticks(span):
        x = _LABEL + tick / span * wide
        body.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="4" y2="{height - 26}" class="grid"/>')
        body.append(f'<text x="{x:.1f}" y="{height - 10}" class="middle">{tick:g} s</text>')
    for i, source in enumerate(found.sources):
        top = i * _ROW + 6
        body.append(f'<text x="0" y="{top + 19}" class="title">{escape(source.name)}</text>')
        body += _density(source, found.started_ns, span, wide, top, COLOURS[i % len(COLOURS)])
        for start, end in source.gaps:
            x, w = _LABEL + start / span * wide, max((end - start) / span * wide, _GAP_PX)
            body.append(
                f'<rect x="{x:.1f}" y="{top}" width="{w:.1f}" height="{_ROW - 10}" class="gap">'
                f"<title>{end - start:.3f} s without a sample, from {start:.3f} s</title></rect>"
            )
    return f'<svg viewBox="0 0 {_WIDTH} {height}" class="chart" role="img">{"".join(body)}</svg>'


def _density(source: SourceSurvey, started_ns: int, span: float, wide: int, top: int, colour: str) -> list[str]:
    """An outline whose height is the number of samples in a stretch, full at the usual rate."""
    if source.samples < 2:
        return []
    usual = 1e9 / max(float(np.median(np.diff(source.arrival_ns))), 1.0)
    bins = int(np.clip(wide // _BIN_PX, 1, max(span * usual / 8, 1)))  # about eight samples each, or more
    counts, _ = np.histogram((source.arrival_ns - started_ns) / 1e9, bins=bins, range=(0, span))
    share = np.minimum((counts + 1) / (usual * span / bins), 1.0)  # one more or less is where a stretch begins
    share[counts == 0] = 0
    base, tall = top + _ROW - 10, _ROW - 10
    points = [f"{_LABEL},{base}"]
    for k, value in enumerate(share):
        y = base - value * tall
        points += [f"{_LABEL + k * wide / bins:.1f},{y:.1f}", f"{_LABEL + (k + 1) * wide / bins:.1f},{y:.1f}"]
    points.append(f"{_LABEL + wide},{base}")
    return [f'<polygon points="{" ".join(points)}" fill="{colour}" fill-opacity="0.75"/>']


def interval_chart(source: SourceSurvey, started_ns: int, seconds: float, *, width: int = 610, height: int = 190) -> str:
    """Milliseconds between arrivals over the take: median, and from the shortest to the longest, on a logarithmic scale."""
    left, right, top, bottom = 52, 10, 30, 30
    intervals = np.maximum(np.diff(source.arrival_ns) / 1e6, 1e-3)
    at = (source.arrival_ns[1:] - started_ns) / 1e9
    span = max(seconds, 1e-9)
    bins = int(np.clip(len(intervals) // 8, 1, (width - left - right) // 3))
    which = np.minimum((at / span * bins).astype(int), bins - 1)
    rows = [(k, intervals[which == k]) for k in range(bins)]
    stats = [(k, float(v.min()), float(np.median(v)), float(v.max())) for k, v in rows if len(v)]
    low = np.floor(np.log10(min(s[1] for s in stats)))
    high = max(np.ceil(np.log10(max(s[3] for s in stats))), low + 1)

    def place(k: float, value: float) -> str:
        x = left + (k + 0.5) / bins * (width - left - right)
        y = top + (1 - (np.log10(value) - low) / (high - low)) * (height - top - bottom)
        return f"{x:.1f},{y:.1f}"

    body = [f'<text x="{left}" y="18" class="title">{escape(source.name)}, ms</text>']
    for power in range(int(low), int(high) + 1):
        y = top + (1 - (power - low) / (high - low)) * (height - top - bottom)
        body.append(f'<line x1="{left}" x2="{width - right}" y1="{y:.1f}" y2="{y:.1f}" class="grid"/>')
        body.append(f'<text x="{left - 6}" y="{y + 4:.1f}" class="end">{10.0**power:g}</text>')
    for tick in _ticks(span):
        x = left + tick / span * (width - left - right)
        body.append(f'<text x="{x:.1f}" y="{height - 10}" class="middle">{tick:g} s</text>')
    shade = [place(k, top_) for k, _, _, top_ in stats] + [place(k, least) for k, least, _, _ in reversed(stats)]
    body.append(f'<polygon points="{" ".join(shade)}" class="shade"/>')
    body.append(f'<polyline points="{" ".join(place(k, middle) for k, _, middle, _ in stats)}" class="median"/>')
    return f'<svg viewBox="0 0 {width} {height}" class="chart" role="img">{"".join(body)}</svg>'


def _ticks(span: float) -> list[float]:
    """About six round numbers of seconds."""
    power = 10.0 ** np.floor(np.log10(max(span / 6, 1e-6)))
    step = next(power * k for k in (1, 2, 5, 10) if span / (power * k) <= 8)
    return [float(round(i * step, 9)) for i in range(int(span / step + 1e-9) + 1)]
