"""The charts of the pages, and the curves of a training run, as one PNG: what `charts` draws, painted with Pillow on white."""

from __future__ import annotations

import base64
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

from PIL import Image, ImageColor, ImageDraw, ImageFont

from cabinpose.app.report.charts import ValueScale, colours_of, series_chart, text
from cabinpose.app.report.html import Html, el
from cabinpose.core import whole_file, write_whole

_INK, _SOFT, _LINE = "#1d2129", "#626b79", "#dde1e7"  # the colours of the pages by day
_SHARP, _FINER = 2, 2  # px of the picture a px of the chart, and how many times larger it is painted
_GAP = 6  # px between frames of a sheet
_STYLE = (
    f"text{{font:11px sans-serif;fill:{_INK}}}.title{{font-size:13px}}.end,.middle,.soft{{fill:{_SOFT}}}.end{{text-anchor:end}}"
    f".middle{{text-anchor:middle}}.grid{{stroke:{_LINE}}}.axis{{stroke:{_SOFT}}}"
)
_NUMBER = re.compile(r"-?[\d.]+")
_ANCHORS = {"end": "rs", "middle": "ms"}
_LINES = {"train_loss": "training loss", "val_loss": "validation loss"}  # blue and red, as in the thesis' figure 6.22
_INDENT, _LEGEND = 46.0, 660.0  # px of a chart
_WIDE = 10.0  # losses that differ by more are drawn on a logarithmic axis


def write_svg(path: Path, drawn: Html, names: Iterable[str] = ()) -> None:
    """Write a chart as an SVG file that needs no style sheet, below the names of what its colours stand for."""
    parts, top, wide = [], 0.0, 0.0
    for chart in [*([_legend(list(names))] if names else []), drawn]:
        _, _, width, height = map(float, fromstring(chart).attrib["viewBox"].split())
        parts.append(el("svg", Html(chart), x=0.0, y=top, width=width, height=height))
        top, wide = top + height, max(wide, width)
    whole = el("svg", el("style", Html(_STYLE)), *parts, xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {wide:.0f} {top:.0f}")
    write_whole(path, f"{whole}\n")


def write_grid(path: Path, drawn: Sequence[Html], columns: int) -> None:
    """Write drawings of frames as a contact sheet, row by row, px by px."""
    parts = [_painted(fromstring(each), 1) for each in drawn]
    wide, high = max(p.width for p in parts) + _GAP, max(p.height for p in parts) + _GAP
    whole = Image.new("RGB", (min(columns, len(parts)) * wide - _GAP, -(-len(parts) // columns) * high - _GAP), "white")
    for number, part in enumerate(parts):
        whole.paste(part, (number % columns * wide, number // columns * high))
    with whole_file(path) as partial:
        whole.save(partial, "png")


def write_png(path: Path, drawn: Sequence[Html], names: Iterable[str] = ()) -> None:
    """Write charts below each other, below the names of what their colours stand for where there are several."""
    names = list(names)
    parts = [_painted(fromstring(chart)) for chart in ([_legend(names)] if len(names) > 1 else []) + list(drawn)]
    whole = Image.new("RGB", (max(p.width for p in parts), sum(p.height for p in parts)), "white")
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height
    with whole_file(path) as partial:
        whole.save(partial, "png")


def _legend(names: Sequence[str]) -> Html:
    """Names beside their colours, in lines as wide as a chart is."""
    body, x, y, wide = [], _INDENT, 12.0, 0.0
    for name, colour in zip(names, colours_of(names), strict=True):
        width = 44 + 7 * len(name)
        if x > _INDENT and x + width > _LEGEND:
            x, y = _INDENT, y + 18
        body += [el("rect", x=x, y=y, width=14.0, height=5.0, fill=colour, stroke=colour), text(x + 20, y + 6, name, "")]
        x += width
        wide = max(wide, x)
    return el("svg", *body, viewBox=f"0 0 {wide:.0f} {y + 16:.0f}")


def _painted(chart: Element, sharp: int = _SHARP) -> Image.Image:
    """A chart of lines, paths of straight lines, rectangles, circles, pictures and words; sharp: px of a px of the chart."""
    _, _, width, height = map(float, chart.attrib["viewBox"].split())
    scale = sharp * _FINER
    image = Image.new("RGB", (round(width * scale), round(height * scale)), "white")
    draw = ImageDraw.Draw(image, "RGBA")
    for part in chart:
        at = {name: float(value) * scale for name, value in part.attrib.items() if _NUMBER.fullmatch(value)}
        kind = part.get("class", "")
        ink = part.get("stroke", {"grid": _LINE, "axis": _SOFT}.get(kind, _INK)).replace("currentColor", _INK)
        wide = round(at.get("stroke-width", scale))
        if part.tag == "line":
            draw.line([at["x1"], at["y1"], at["x2"], at["y2"]], ink, wide)
        elif part.tag == "path":
            for piece in part.attrib["d"].split("M")[1:]:
                draw.line([float(n) * scale for n in _NUMBER.findall(piece)], ink, wide, joint="curve")
        elif part.tag == "rect":
            corners = [at["x"], at["y"], at["x"] + at["width"], at["y"] + at["height"]]
            draw.rectangle(corners, _tint(part), ink, wide)
        elif part.tag == "circle":
            x, y, r = at["cx"], at["cy"], at["r"]
            draw.ellipse([x - r, y - r, x + r, y + r], _tint(part))
        elif part.tag == "image":
            picture = Image.open(io.BytesIO(base64.b64decode(part.attrib["href"].partition(",")[2])))
            image.paste(picture.resize((round(at["width"]), round(at["height"]))))
        elif part.tag == "text":
            _write(image, part, kind, at, scale)
    return image.reduce(_FINER)


def _tint(part: Element) -> tuple[int, ...]:
    colour = ImageColor.getrgb(part.attrib["fill"].replace("currentColor", _INK))
    return (*colour[:3], round(255 * float(part.get("fill-opacity", "1"))))


def _write(image: Image.Image, part: Element, kind: str, at: dict[str, float], scale: int) -> None:
    """Words at their place, turned where they are."""
    anchor = next((_ANCHORS[word] for word in kind.split() if word in _ANCHORS), "ls")
    ink = _SOFT if {"soft", "end", "middle"} & set(kind.split()) else _INK
    font = ImageFont.load_default((13 if kind == "title" else 11) * scale)
    words = part.text or ""
    if "transform" not in part.attrib:
        ImageDraw.Draw(image).text((at["x"], at["y"]), words, ink, font, anchor)
        return
    x, y, degrees = map(float, _NUMBER.findall(part.attrib["transform"]))
    half = round(font.getlength(words)) + 4
    layer = Image.new("L", (2 * half, 2 * half))
    ImageDraw.Draw(layer).text((half, half), words, 255, font, anchor)
    image.paste(ink, (round(x * scale) - half, round(y * scale) - half), layer.rotate(-degrees, Image.Resampling.BICUBIC))


def curves_chart(rows: Sequence[Mapping[str, float]], best: int | None, monitor: str, stops: bool) -> Html:
    """Training and validation loss over the epochs, with the best epoch and, where the run was ended early, the stop.

    rows: the figures of each epoch by name · best: its row, decided by the figure `monitor`.
    """
    epochs = [float(i + 1) for i in range(len(rows))]
    lines = {_LINES[name]: (epochs, [row.get(name, math.nan) for row in rows]) for name in _LINES}
    known = [y for _, ys in lines.values() for y in ys if math.isfinite(y)]
    log = bool(known) and min(known) > 0 and max(known) > _WIDE * min(known)
    marks = {} if best is None else {f"best: {monitor} {rows[best][monitor]:.4g}": float(best + 1)}
    if stops:
        marks["stop"] = float(len(rows))
    return series_chart("", "epoch", lines, scale=ValueScale(log=log), size=(480, 260), marks=marks)


def write_curves(path: Path, rows: Sequence[Mapping[str, float]], best: int | None, monitor: str, stops: bool) -> None:
    """Write the picture; the file is replaced when it is whole."""
    write_png(path, [curves_chart(rows, best, monitor, stops)], _LINES.values())
