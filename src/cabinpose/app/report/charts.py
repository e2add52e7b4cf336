"""Charts as inline SVG: lines over a threshold, and boxes per joint. Sizes in px; colours by series."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

# Okabe and Ito (2008): told apart by people with any colour vision; the first is for "All" and the first model.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c7a00", "#6b6f76", "#222222")
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 14, 30, 40


def line_chart(
    title: str, x_label: str, grid: Sequence[float], lines: Mapping[str, Sequence[float]], *, width: int = 420, height: int = 260
) -> str:
    """Shares in per cent (0..100) over `grid`, a line each; one without points keeps its colour. The legend is `legend`'s."""
    x0, x1 = grid[0], grid[-1]

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            _LEFT + (x - x0) / (x1 - x0) * (width - _LEFT - _RIGHT),
            _TOP + (1 - y / 100) * (height - _TOP - _BOTTOM),
        )

    body = [_text(_LEFT, 18, title, "title")]
    for y in range(0, 101, 20):
        (left, level), (right, _) = at(x0, y), at(x1, y)
        body += [_line(left, level, right, level, "grid"), _text(left - 6, level + 4, str(y), "end")]
    for x in np.linspace(x0, x1, 6):
        column, base = at(float(x), 0)
        body += [_line(column, base, column, base + 4, "axis"), _text(column, base + 17, f"{x:g}", "middle")]
    body.append(_text((_LEFT + width - _RIGHT) / 2, height - 6, x_label, "middle soft"))
    for name, colour in reversed(list(zip(lines, _cycle(len(lines)), strict=True))):  # the first on top
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in (at(x, y) for x, y in zip(grid, lines[name], strict=False)))
        body.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"><title>{escape(name)}</title></polyline>'
        )
    return _svg(width, height, body)


def box_chart(title: str, boxes: Mapping[str, Mapping[str, Sequence[float]]], *, width: int = 1240, height: int = 320) -> str:
    """Boxes (5, 25, 50, 75, 95 % quantiles, a list of five or an empty one) by joint and model, side by side."""
    joints = list(dict.fromkeys(joint for by_joint in boxes.values() for joint in by_joint))
    models = list(boxes)
    top = max((max(box) for by_joint in boxes.values() for box in by_joint.values() if box), default=1.0)
    step = _nice_step(top / 5)
    ceiling = step * max(int(np.ceil(top / step)), 1)
    bottom = 64

    def level(value: float) -> float:
        return _TOP + (1 - value / ceiling) * (height - _TOP - bottom)

    body = [_text(_LEFT, 18, title, "title")]
    for value in np.arange(0, ceiling + step / 2, step):
        y = level(float(value))
        body += [_line(_LEFT, y, width - _RIGHT, y, "grid"), _text(_LEFT - 6, y + 4, f"{value:g}", "end")]
    slot = (width - _LEFT - _RIGHT) / len(joints)
    wide = min(slot * 0.7 / len(models), 26)
    for i, joint in enumerate(joints):
        middle = _LEFT + (i + 0.5) * slot
        body.append(
            f'<text transform="translate({middle + 4:.1f},{height - bottom + 14}) rotate(-35)" class="end">{escape(joint)}</text>'
        )
        for m, (model, colour) in enumerate(zip(models, _cycle(len(models)), strict=True)):
            if box := boxes[model].get(joint):
                body += _box(middle + (m - (len(models) - 1) / 2) * wide * 1.12, wide, [level(v) for v in box], colour, model)
    return _svg(width, height, body)


def series_chart(
    title: str, x_label: str, lines: Mapping[str, tuple[Sequence[float], Sequence[float]]], *, width: int = 420, height: int = 220
) -> str:
    """Values of any size, 0 included, over x (for each line its xs and ys); a line breaks where a value is not finite."""
    finite = [(x, y) for xs, ys in lines.values() for x, y in zip(xs, ys, strict=True) if np.isfinite(y)]
    x0, x1 = min((x for x, _ in finite), default=0.0), max((x for x, _ in finite), default=1.0)
    x1 = x1 if x1 > x0 else x0 + 1.0
    low, high = min(min((y for _, y in finite), default=0.0), 0.0), max((y for _, y in finite), default=1.0)
    step = _nice_step(max(high - low, 1e-9) / 5)
    floor, ceiling = step * np.floor(low / step), step * max(np.ceil(high / step), 1)

    def at(x: float, y: float) -> tuple[float, float]:
        across, up = (x - x0) / (x1 - x0), (y - floor) / (ceiling - floor)
        return _LEFT + across * (width - _LEFT - _RIGHT), _TOP + (1 - up) * (height - _TOP - _BOTTOM)

    body = [_text(_LEFT, 18, title, "title")]
    for y in np.arange(floor, ceiling + step / 2, step):
        (left, level), (right, _) = at(x0, float(y)), at(x1, float(y))
        body += [_line(left, level, right, level, "grid"), _text(left - 6, level + 4, f"{y:g}", "end")]
    across = _nice_step((x1 - x0) / 6)
    for x in np.arange(np.ceil(x0 / across - 1e-9) * across, x1 + across * 1e-9, across):
        column, base = at(float(x), floor)
        body += [_line(column, base, column, base + 4, "axis"), _text(column, base + 17, f"{x + 0.0:g}", "middle")]
    body.append(_text((_LEFT + width - _RIGHT) / 2, height - 6, x_label, "middle soft"))
    for name, colour in reversed(list(zip(lines, _cycle(len(lines)), strict=True))):  # the first on top
        points = [at(x, y) if np.isfinite(y) else None for x, y in zip(*lines[name], strict=True)]
        body.append(
            f'<path d="{_path(points)}" fill="none" stroke="{colour}" stroke-width="1.4"><title>{escape(name)}</title></path>'
        )
    return _svg(width, height, body)


def _path(points: Sequence[tuple[float, float] | None]) -> str:
    """An SVG path that is taken up again after each point that is missing."""
    words, pen = [], "M"
    for point in points:
        if point is not None:
            words.append(f"{pen}{point[0]:.1f},{point[1]:.1f}")
        pen = "L" if point is not None else "M"
    return "".join(words)


def _box(x: float, wide: float, levels: Sequence[float], colour: str, model: str) -> list[str]:
    low, quarter, half, three, high = levels
    stroke = f'stroke="{colour}" stroke-width="1.4"'
    left, right, tall = x - wide / 2, x + wide / 2, max(quarter - three, 0.5)
    size = f'x="{left:.1f}" y="{three:.1f}" width="{wide:.1f}" height="{tall:.1f}"'
    return [
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{low:.1f}" y2="{high:.1f}" {stroke}/>',
        f'<rect {size} fill="{colour}" fill-opacity="0.25" {stroke}><title>{escape(model)}</title></rect>',
        f'<line x1="{left:.1f}" x2="{right:.1f}" y1="{half:.1f}" y2="{half:.1f}" stroke="{colour}" stroke-width="2.4"/>',
    ]


def legend(names: Sequence[str]) -> str:
    """The names of lines or boxes beside their colours."""
    items = (f'<li><i style="background:{c}"></i>{escape(n)}</li>' for n, c in zip(names, _cycle(len(names)), strict=True))
    return f'<ul class="legend">{"".join(items)}</ul>'


def _cycle(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def _nice_step(step: float) -> float:
    """The least of 1, 2, 5 x 10^n that is at least `step`."""
    power = 10.0 ** np.floor(np.log10(max(step, 1e-9)))
    return float(next(power * k for k in (1, 2, 5, 10) if power * k >= step * (1 - 1e-9)))


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="{kind}"/>'


def _text(x: float, y: float, words: str, kind: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}">{escape(words)}</text>'


def _svg(width: int, height: int, body: Sequence[str]) -> str:
    return f'<svg viewBox="0 0 {width} {height}" class="chart" role="img">{"".join(body)}</svg>'
