"""Charts as inline SVG, in px; colours by series."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cabinpose.app.report.html import Html, el
from cabinpose.evaluate import Box

# Okabe and Ito (2008): told apart by people with any colour vision; the first is for "All" and the first model. Where there are
# many, Tol's muted ones follow (2021). The last is the colour of text, black or white with the page's theme.
COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c7a00", "#6b6f76", "#882255",
    "#44aa99", "#332288", "#999933", "#117733", "#aa4499", "#ddcc77", "currentColor",
)  # fmt: skip


class Axis(NamedTuple):
    """Values from the least to the greatest, on a linear or a logarithmic scale, or with stops as far from each other."""

    low: float
    high: float
    log: bool = False
    stops: tuple[float, ...] = ()

    def share(self, value: float) -> float:
        """Where a value is between the ends, 0 to 1."""
        if self.stops:
            return float(np.interp(value, self.stops, np.linspace(0.0, 1.0, len(self.stops))))
        low, at, high = (np.log10(v) if self.log else float(v) for v in (self.low, value, self.high))
        return float((at - low) / (high - low))


class Margins(NamedTuple):
    """Room for the numbers beside a chart, px."""

    left: int = 46
    right: int = 14
    bottom: int = 40


class ValueScale(NamedTuple):
    """How values are drawn: up to `top` (default: that of the lines); upwards on a logarithmic scale, which has no 0; with the xs
    of all lines as stops that are as far from each other, and dots at the points.
    """

    top: float | None = None
    log: bool = False
    stops: bool = False


_MARGINS, _LINEAR = Margins(), ValueScale()


class Plot:
    """A chart in the making: `at` gives the place of a value, `body` holds what was drawn."""

    def __init__(self, title: str, size: tuple[int, int], x: Axis, y: Axis, margins: Margins = _MARGINS) -> None:
        """size: width and height."""
        self.size, self.x, self.y = size, x, y
        self.left, self.right = margins.left, size[0] - margins.right
        self.top, self.bottom = 30 if title else 4, size[1] - margins.bottom
        self.body = [text(margins.left, 18, title, "title")] if title else []

    def at(self, x: float, y: float) -> tuple[float, float]:
        """The pixel (from left, from top) of a value."""
        wide, high = self.right - self.left, self.bottom - self.top
        return self.left + self.x.share(x) * wide, self.bottom - self.y.share(y) * high

    def rows(self, values: Iterable[float]) -> None:
        """Lines of the grid at values of y, with numbers."""
        for value in values:
            level = self.at(self.x[0], value)[1]
            self.body += [line(self.left, level, self.right, level, "grid"), text(self.left - 6, level + 4, f"{value:g}", "end")]

    def columns(self, unit: str = "") -> None:
        """Marks at the stops of x, or at about six round values, with numbers."""
        step = nice_step((self.x.high - self.x.low) / 6)
        round_values = np.arange(np.ceil(self.x.low / step - 1e-9) * step, self.x.high + step * 1e-9, step)
        for value in self.x.stops or round_values:
            x = self.at(float(value), self.y[0])[0]
            self.body += [
                line(x, self.bottom, x, self.bottom + 4, "axis"), text(x, self.bottom + 17, f"{value + 0.0:g}{unit}", "middle"),
            ]  # fmt: skip

    def path(self, xs: Iterable[float], ys: Iterable[float]) -> str:
        """The path of a line; it breaks where a value is not finite."""
        words, pen = [], "M"
        for x, y in zip(xs, ys, strict=False):
            if np.isfinite(y):
                u, v = self.at(x, y)
                words.append(f"{pen}{u:.1f},{v:.1f}")
            pen = "L" if np.isfinite(y) else "M"
        return "".join(words)

    def svg(self, x_label: str = "") -> Html:
        """The chart."""
        label = [text((self.left + self.right) / 2, self.size[1] - 6, x_label, "middle soft")] if x_label else []
        return svg(*self.size, [*self.body, *label])


def series_chart(
    title: str, x_label: str, lines: Mapping[str, tuple[Sequence[float], Sequence[float]]], *, scale: ValueScale = _LINEAR,
    size: tuple[int, int] = (420, 220), diagonal: bool = False, marks: Mapping[str, float] | None = None,
) -> Html:  # fmt: skip
    """Lines over x, for each its xs and ys, with 0 in view; one without points keeps its colour.

    A line breaks where a value is not finite. size: width and height · diagonal: with the line on which y is x · marks: upright
    lines at values of x, by the words beside them.
    """
    known = [(x, y) for xs, ys in lines.values() for x, y in zip(xs, ys, strict=False) if np.isfinite(y)]
    xs, ys = zip(*known, strict=True) if known else ((0.0, 1.0), (0.0, 1.0))
    low, high = min(*ys, 0.0), scale.top or max(ys)
    if scale.log:
        rows = _powers(min(ys), high)
    else:
        step = nice_step(max(high - low, 1e-9) / 5)
        rows = (np.arange(np.floor(low / step), max(np.ceil(high / step - 1e-9), 1) + 0.5) * step).tolist()
    y = Axis(rows[0], rows[-1], scale.log)
    at = tuple(sorted({*xs})) if scale.stops else ()
    plot = Plot(title, size, Axis(min(xs), max(xs) if max(xs) > min(xs) else min(xs) + 1.0, stops=at), y)
    plot.rows(rows)
    plot.columns()
    for i, (words, x) in enumerate((marks or {}).items()):
        u = plot.at(x, y[0])[0]
        right = u > size[0] / 2
        plot.body += [
            line(u, plot.top, u, plot.bottom, "axis"),
            text(u - 4 if right else u + 4, plot.top + 14 * (i + 1), words, "end" if right else "soft"),
        ]
    if diagonal:
        ends = max(plot.x[0], y[0]), min(plot.x[1], y[1])
        plot.body.append(line(*plot.at(ends[0], ends[0]), *plot.at(ends[1], ends[1]), "axis"))
    for name, colour in reversed(list(zip(lines, colours_of(lines), strict=True))):  # the first is drawn last, on top
        plot.body.append(el("path", el("title", name), d=plot.path(*lines[name]), fill="none", stroke=colour, stroke_width=1.8))
        for u, v in (plot.at(x, y) for x, y in zip(*lines[name], strict=False) if scale.stops and np.isfinite(y)):
            plot.body.append(el("circle", cx=f"{u:.1f}", cy=f"{v:.1f}", r=3, fill=colour))
    return plot.svg(x_label)


def box_chart(
    title: str, boxes: Mapping[str, Mapping[str, Box]], *, log: bool = False, width: int = 1240, height: int = 320
) -> Html:
    """Box plots by model and joint, the models' boxes side by side at each joint; log: the axis is logarithmic, from 0.1 on."""
    joints = list(dict.fromkeys(joint for by_joint in boxes.values() for joint in by_joint))
    ends = [end for by_joint in boxes.values() for box in by_joint.values() for end in (box.high, *box.outliers[-1:])]
    top = max(ends, default=1.0) or 1.0
    if log:
        rows = _powers(0.1, top)
    else:
        step = nice_step(top / 5)
        rows = np.arange(0, step * (max(int(np.ceil(top / step)), 1) + 0.5), step).tolist()
    plot = Plot(title, (width, height), Axis(0, max(len(joints), 1)), Axis(rows[0], rows[-1], log), Margins(bottom=64))
    plot.rows(rows)
    wide = min((plot.right - plot.left) / max(len(joints), 1) * 0.7 / len(boxes), 26)
    for i, joint in enumerate(joints):
        middle, base = plot.at(i + 0.5, rows[0])
        plot.body.append(el("text", joint, transform=f"translate({middle + 4:.1f},{base + 14:.1f}) rotate(-35)", class_="end"))
        for m, (model, colour) in enumerate(zip(boxes, colours_of(boxes), strict=True)):
            if box := boxes[model].get(joint):
                x = middle + (m - (len(boxes) - 1) / 2) * wide * 1.12
                plot.body += _box(plot, box, x, wide, rows[0], colour, f"{model}, {joint}: {box.samples}, {box.beyond} beyond")
    return plot.svg()


def _box(plot: Plot, box: Box, x: float, wide: float, least: float, colour: str, told: str) -> Iterable[Html]:
    """One box about x (px), `wide` px wide, with its whiskers and outliers; numbers below `least` are drawn there."""

    def level(value: float) -> float:
        return plot.at(0, max(value, least))[1]

    left, high, upper = x - wide / 2, level(box.high), level(box.upper)
    size = {"x": left, "y": upper, "width": wide, "height": max(level(box.lower) - upper, 0.5)}
    yield from (el("circle", cx=x, cy=level(value), r=1.6, fill=colour, fill_opacity="0.45") for value in box.outliers)
    yield line(x, level(box.low), x, level(box.lower), stroke=colour, stroke_width=1.4)
    yield line(x, upper, x, high, stroke=colour, stroke_width=1.4)
    yield from (line(x - wide / 4, y, x + wide / 4, y, stroke=colour, stroke_width=1.4) for y in (level(box.low), high))
    yield el("rect", el("title", told), **size, fill=colour, fill_opacity="0.25", stroke=colour, stroke_width=1.4)
    yield line(left, level(box.median), left + wide, level(box.median), stroke=colour, stroke_width=2.4)


def legend(names: Iterable[str]) -> Html:
    """The names of lines or boxes beside their colours."""
    names = list(names)
    items = (el("li", el("i", style=f"background:{c}"), n) for n, c in zip(names, colours_of(names), strict=True))
    return el("ul", *items, class_="legend")


def charts(drawn: Iterable[str], columns: str = "") -> Html:
    """Charts side by side: three to a row, or "two"."""
    return el("div", Html("".join(drawn)), class_=f"charts {columns}".strip())


def colours_of(names: Iterable[str]) -> list[str]:
    """The colour of each of some lines or boxes."""
    return [COLOURS[i % len(COLOURS)] for i, _ in enumerate(names)]


def _powers(least: float, greatest: float) -> list[float]:
    """1, 2 and 5 times powers of ten, from the last that is not above `least` to the first not below `greatest`; at least two."""
    first, last = (int(np.floor(np.log10(value))) for value in (least, max(greatest, least)))
    rows = [k * 10.0**n for n in range(first, last + 2) for k in (1, 2, 5)]
    start = max(i for i, value in enumerate(rows) if value <= least * (1 + 1e-9))
    end = next(i for i, value in enumerate(rows) if value >= greatest * (1 - 1e-9) and i > start)
    return rows[start : end + 1]


def nice_step(step: float) -> float:
    """The least of 1, 2, 5 x 10^n that is at least `step`."""
    power = 10.0 ** np.floor(np.log10(max(step, 1e-9)))
    return float(next(power * k for k in (1, 2, 5, 10) if power * k >= step * (1 - 1e-9)))


def line(x1: float, y1: float, x2: float, y2: float, kind: str | None = None, **style: object) -> Html:
    """A straight line."""
    return el("line", x1=float(x1), y1=float(y1), x2=float(x2), y2=float(y2), class_=kind, **style)


def text(x: float, y: float, words: str, kind: str) -> Html:
    """Words at a place."""
    return el("text", words, x=float(x), y=float(y), class_=kind)


def svg(width: float, height: float, body: Iterable[Html], *, left: float = 0, kind: str = "chart") -> Html:
    """A drawing of a size; it is as wide as the page lets it be."""
    return el("svg", *body, viewBox=f"{left:.0f} 0 {width:.0f} {height:.0f}", class_=kind, role="img")
