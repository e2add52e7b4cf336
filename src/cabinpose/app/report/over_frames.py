"""The section of a page on how far joints are off over the frames: d(t), and d(t, j) as a heat map and as lines to tick."""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cabinpose.app.report.charts import COLOURS, Axis, Margins, Plot, legend, line, nice_step, text
from cabinpose.app.report.html import Html, el, join
from cabinpose.core import whole_file
from cabinpose.evaluate import FrameDistances

OverFrames = Mapping[str, Mapping[str, FrameDistances]]  # by model, then by space
NOTE = (
    "Distance of the joints found to the truth, over the people of a frame on average. Heat map: each joint's d(t, j), blue up "
    "to the threshold (--hit-m, --hit-px), red above it, black where a joint that counts was not found, empty where it does not "
    "count. Lines: the joints that are ticked, at first the three that are farthest off; they break where a joint was not found."
)
_WIDE, _ROW, _COLUMNS = 1240, 15, 600  # px, px, stretches of frames that are drawn at most
_MARGINS = Margins(left=76)
_SCALE = ((0.0, 0xD6, 0xE6, 0xF4), (0.5, 0x4F, 0x97, 0xC9), (0.5, 0xFD, 0xC9, 0x8A), (1.0, 0xA5, 0x00, 0x10))  # of 2 thresholds
_MISSED = (0x11, 0x11, 0x14)
_FIRST = 3  # joints whose lines are shown at first


def over_frames_html(models: OverFrames) -> str:
    """The section's body; nothing for no models."""
    spaces = list(dict.fromkeys(space for by_space in models.values() for space in by_space))
    several, blocks = len(models) > 1, []
    for space in spaces:
        each = {name: by_space[space].binned(_COLUMNS) for name, by_space in models.items() if space in by_space}
        if several:
            blocks += [legend(models), _means(space, {name: each.get(name) for name in models})]
        for number, (name, distances) in enumerate(each.items()):
            whole = models[name][space]
            blocks.append(_heat_map(f"{f'{name}: ' if several else ''}{_title('d(t, j)', distances, whole)}", distances))
            blocks.append(_lines(f"lines-{space}-{number}", _title("d(t) and d(t, j)", distances, whole), distances))
    most = 1 + max((len(d.joints) for by_space in models.values() for d in by_space.values()), default=0)
    hides = (f".pick input:nth-of-type({i + 1}):not(:checked)~svg .line{i}{{display:none}}" for i in range(most))
    return join([el("style", Html("".join(hides))), _key(), *blocks]) if blocks else ""


def write_distances(path: Path, models: OverFrames) -> None:
    """Write the distances as CSV: a row for each model, space and frame, with the mean d(t) and d(t, j) of each joint.

    A field is `inf` where what counts was not found, and empty where nothing counts.
    """
    joints = next(d.joints for by_space in models.values() for d in by_space.values())
    with whole_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["model", "space", "unit", "frame", "mean", *joints])
        for name, by_space in models.items():
            for space, d in by_space.items():
                for frame, mean, row in zip(d.frames.tolist(), d.mean.tolist(), d.by_joint.tolist(), strict=True):
                    writer.writerow([name, space, d.unit, frame, *("" if x != x else f"{x:.4g}" for x in (mean, *row))])


def _title(what: str, drawn: FrameDistances, whole: FrameDistances) -> str:
    step = -(-len(whole.frames) // len(drawn.frames))
    stretches = f", stretches of {step} frames: the worst of each joint, the mean of d(t)" if step > 1 else ""
    return f"{what}, {drawn.space.upper()}, {drawn.unit}{stretches}"


def _key() -> Html:
    """What the heat map's colours mean."""
    swatches = {
        "0": _colour(0.0), "up to the threshold": _colour(0.4999), "above": _colour(0.5), "twice and more": _colour(1.0),
        "not found": _MISSED,
    }  # fmt: skip
    items = (
        el("li", el("i", style="background:#{:02x}{:02x}{:02x}; height:12px".format(*rgb)), n) for n, rgb in swatches.items()
    )
    return el("ul", *items, class_="legend")


def _colour(share: float) -> tuple[int, ...]:
    return tuple(int(x) for x in _colours(np.array([share]))[0, :3])


def _colours(shares: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(..., 4) RGBA of distances in shares of twice the threshold."""
    at = np.array([stop for stop, *_ in _SCALE])
    at[1] -= 1e-6  # a step of colour at the threshold
    clear = np.isnan(shares)
    values = np.clip(np.nan_to_num(shares, nan=0.0, posinf=1.0), 0, 1)
    channels = [np.interp(values, at, [stop[i] for stop in _SCALE]) for i in (1, 2, 3)]
    rgba = np.stack([*channels, np.where(clear, 0.0, 255.0)], axis=-1)
    rgba[np.isinf(shares)] = (*_MISSED, 255)
    return rgba.round().astype(np.uint8)


def _frame_marks(plot: Plot, frames: NDArray[np.int64]) -> None:
    """Numbers of some frames below a chart whose x is their position."""
    step = max(int(nice_step(len(frames) / 12)), 1)
    for position in range(0, len(frames), step):
        x = plot.at(position + 0.5, plot.y.low)[0]
        plot.body += [
            line(x, plot.bottom, x, plot.bottom + 4, "axis"), text(x, plot.bottom + 17, str(int(frames[position])), "middle"),
        ]  # fmt: skip


def _heat_map(title: str, d: FrameDistances) -> Html:
    """A row for each joint, a column for each frame."""
    count = len(d.joints)
    size = (_WIDE, 30 + _ROW * count + 40)
    plot = Plot(title, size, Axis(0, len(d.frames)), Axis(0, count), _MARGINS)
    buffer = io.BytesIO()
    Image.fromarray(_colours(d.by_joint.T / (2 * d.threshold))).save(buffer, "png")
    uri = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    area = {"x": plot.left, "y": plot.top, "width": plot.right - plot.left, "height": plot.bottom - plot.top}
    plot.body.append(el("image", href=uri, preserveAspectRatio="none", style="image-rendering:pixelated", **area))
    plot.body += [text(plot.left - 6, plot.top + (i + 0.75) * _ROW, joint, "end") for i, joint in enumerate(d.joints)]
    plot.body += [line(plot.left, y, plot.right, y, "axis") for y in (plot.top, plot.bottom)]
    _frame_marks(plot, d.frames)
    return plot.svg("frame")


def _plot(title: str, d: FrameDistances, top: float) -> Plot:
    """A chart over the frames with the threshold in it."""
    step = nice_step(top / 5)
    rows = (np.arange(int(np.ceil(top / step - 1e-9)) + 1) * step).tolist()
    plot = Plot(title, (_WIDE, 260), Axis(0, len(d.frames)), Axis(rows[0], rows[-1]), _MARGINS)
    plot.rows(rows)
    level = plot.at(0, d.threshold)[1]
    dashed = line(plot.left, level, plot.right, level, "axis", stroke_dasharray="6 4")
    plot.body += [dashed, text(plot.right - 4, level - 5, f"threshold {d.threshold:g} {d.unit}", "end")]
    _frame_marks(plot, d.frames)
    return plot


def _top(d: FrameDistances, values: NDArray[np.float64]) -> float:
    """What a chart reaches up to: 98 of 100 of the values, and the threshold."""
    known = values[np.isfinite(values)]
    return max(1.2 * d.threshold, 1.1 * float(np.quantile(known, 0.98))) if known.size else 1.2 * d.threshold


def _path(plot: Plot, values: NDArray[np.float64], **style: object) -> Html:
    """A line over the frames' positions, cut off at the chart's top; frames alone are dots."""
    xs = np.arange(len(values)) + 0.5
    ys = np.where(np.isfinite(values), np.minimum(values, plot.y.high), np.nan)
    there = np.concatenate(([False], np.isfinite(ys), [False]))
    alone = np.flatnonzero(there[1:-1] & ~there[:-2] & ~there[2:])
    dots = "".join("M{:.1f},{:.1f}l0.01,0".format(*plot.at(xs[i], ys[i])) for i in alone)
    return el("path", d=plot.path(xs, ys) + dots, fill="none", stroke_linecap="round", stroke_linejoin="round", **style)


def _means(space: str, each: Mapping[str, FrameDistances | None]) -> Html:
    """d(t) of several models in one chart."""
    known = [d for d in each.values() if d is not None]
    plot = _plot(f"d(t), {space.upper()}, {known[0].unit}", known[0], max(_top(d, d.mean) for d in known))
    for i, d in enumerate(each.values()):
        if d is not None:
            plot.body.append(_path(plot, d.mean, stroke=COLOURS[i % len(COLOURS)], stroke_width=1.6))
    return plot.svg("frame")


def _lines(name: str, title: str, d: FrameDistances) -> Html:
    """d(t) and a line for each joint, with boxes to tick; without a script: the page's style sheet hides what is not ticked."""
    finite = np.isfinite(d.by_joint)
    sums = np.where(finite, d.by_joint, 0.0).sum(axis=0)
    worst = np.argsort(-np.divide(sums, finite.sum(axis=0), out=np.zeros(len(d.joints)), where=finite.any(axis=0)), kind="stable")
    shown = {"mean d(t)", *(d.joints[i] for i in worst[:_FIRST])}
    plot = _plot(title, d, max(_top(d, d.mean), *(_top(d, d.by_joint[:, i]) for i in worst[:_FIRST])))
    lines = {"mean d(t)": d.mean} | {joint: d.by_joint[:, i] for i, joint in enumerate(d.joints)}
    boxes: list[Html] = []
    drawn: list[Html] = []
    for i, (words, values) in enumerate(lines.items()):
        colour = "currentColor" if i == 0 else COLOURS[(i - 1) % (len(COLOURS) - 1)]
        mark = el("i", style=f"background:{colour}")
        ticked = "checked" if words in shown else None
        boxes += [
            el("input", type="checkbox", id=f"{name}-{i}", checked=ticked, autocomplete="off"),
            el("label", mark, words, for_=f"{name}-{i}"),
        ]  # fmt: skip
        path = _path(plot, values, stroke=colour, stroke_width=2.2 if i == 0 else 1.3)
        drawn.append(el("g", el("title", words), path, class_=f"line{i}"))
    plot.body += drawn[::-1]  # the mean on top
    return el("div", *boxes, plot.svg("frame"), class_="pick")
