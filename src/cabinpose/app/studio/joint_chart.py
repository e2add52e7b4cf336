"""Options of the charts of Compare: how far each joint is off over the frames, over the places where it was, and altogether.

The theme gives the colours of all words and lines, see `page`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.studio.models import JointPlaces
from cabinpose.evaluate import FrameDistances

TITLE = {"fontSize": 13, "fontWeight": "normal"}
COLUMNS = 400  # stretches of frames at most
_MISSED = 1e6  # stands for a joint that was not found, beyond all distances
_FIRST = 3  # joints whose lines are shown at first: those that are farthest off
_NEAR_CM = 5.0  # of the thesis' three boxes a joint: all found, those nearer than this, those nearer than Γt
_ENDS = {
    "lineStyle": {"color": "#888", "type": "dashed"},
    "label": {"position": "insideEndTop", "formatter": "Γt", "color": "inherit"},
}


def height(d: FrameDistances) -> int:
    """Px of the chart."""
    return _map_height(d) + 330


def joint_chart(d: FrameDistances, title: str, chosen: str = "") -> dict[str, Any]:
    """A heat map, and lines that its legend shows. d: of the stretches that are drawn · chosen: a joint whose line is shown."""
    frames, high = d.frames.tolist(), _map_height(d)
    across = {"type": "category", "data": frames}
    return {
        "title": {"text": title, "textStyle": TITLE},
        "tooltip": {"trigger": "item"},
        "legend": {"top": high + 84, "data": list(d.joints), "selected": _selected(d, chosen)},
        "grid": [
            {"left": 76, "right": 16, "top": 52, "height": high},
            {"left": 76, "right": 16, "top": high + 140, "height": 150},
        ],
        "xAxis": [across, {**across, "gridIndex": 1}],
        "yAxis": [
            {"type": "category", "data": list(d.joints), "inverse": True, "axisLabel": {"interval": 0, "fontSize": 11}},
            {"type": "value", "gridIndex": 1},
        ],
        "visualMap": {
            "type": "piecewise", "pieces": _pieces(d.threshold), "seriesIndex": 0, "dimension": 2, "orient": "horizontal",
            "top": 24, "left": 70, "itemWidth": 12, "itemHeight": 12,
        },
        "series": [{"type": "heatmap", "name": "d", "data": _cells(d)}, *_lines(d)],
    }  # fmt: skip


def column(event: Any) -> int:
    """The column of a click: in the heat map the first of a cell's numbers, on a line the position of its point."""
    return int(event.value[0]) if isinstance(event.value, list | tuple) else int(event.data_index)


def _map_height(d: FrameDistances) -> int:
    return 16 * len(d.joints)


def _cells(d: FrameDistances) -> list[list[float]]:
    """Column, row and distance; none where a joint does not count."""
    known = zip(*np.nonzero(~np.isnan(d.by_joint)), strict=True)
    return [[int(t), int(j), round(min(float(d.by_joint[t, j]), _MISSED), 2)] for t, j in known]


def _pieces(threshold: float) -> list[dict[str, Any]]:
    return [
        {"lte": threshold / 2, "color": "#d6e6f4", "label": "up to half of Γt"},
        {"gt": threshold / 2, "lte": threshold, "color": "#4f97c9", "label": "up to Γt"},
        {"gt": threshold, "lte": 2 * threshold, "color": "#fdc98a", "label": "above"},
        {"gt": 2 * threshold, "lt": _MISSED, "color": "#a50010", "label": "above twice Γt"},
        {"gte": _MISSED, "color": "#8e44ad", "label": "not found"},
    ]


def threshold_line(threshold: float) -> dict[str, Any]:
    """Γt, with its word within the chart."""
    return {"silent": True, "symbol": "none", **_ENDS, "data": [{"yAxis": threshold}]}


def _lines(d: FrameDistances) -> list[dict[str, Any]]:
    """A line a joint, with gaps where it was not found, and the threshold."""
    lines: list[dict[str, Any]] = [
        {
            "name": joint, "type": "line", "showSymbol": False, "xAxisIndex": 1, "yAxisIndex": 1,
            "data": [round(float(x), 2) if np.isfinite(x) else None for x in values],
        }
        for joint, values in zip(d.joints, d.by_joint.T, strict=True)
    ]  # fmt: skip
    ghost = {  # unseen: it has the threshold's line, and keeps it in view
        "type": "line", "xAxisIndex": 1, "yAxisIndex": 1, "showSymbol": False, "silent": True, "data": [d.threshold],
        "markLine": threshold_line(d.threshold),
    }  # fmt: skip
    return [*lines, ghost]


def _selected(d: FrameDistances, chosen: str) -> dict[str, bool]:
    if chosen:
        return {joint: joint == chosen for joint in d.joints}
    finite = np.isfinite(d.by_joint)
    mean = np.where(finite, d.by_joint, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
    first = {d.joints[j] for j in np.argsort(-mean, kind="stable")[:_FIRST]}
    return {joint: joint in first for joint in d.joints}


def curve_chart(
    frames: Sequence[int], lines: Sequence[tuple[str, str, NDArray[np.float64]]], unit: str, threshold: float
) -> dict[str, Any]:
    """The mean distance of each frame. lines: name, colour and values (F,) of each model."""
    series: list[dict[str, Any]] = [
        {
            "name": name, "type": "line", "showSymbol": len(frames) < 400, "symbolSize": 5, "color": colour,
            "data": [round(float(x), 3) if np.isfinite(x) else None for x in values],
        }
        for name, colour, values in lines
    ]  # fmt: skip
    series[0]["markLine"] = threshold_line(threshold)
    return {
        "title": {"text": f"mean distance d by frame, {unit}; a click shows the frame", "textStyle": TITLE},
        "legend": {"top": 20, "data": [name for name, *_ in lines]},
        "grid": {"left": 48, "right": 16, "top": 50, "bottom": 30},
        "tooltip": {"trigger": "axis"},
        "xAxis": {"type": "category", "data": list(frames)},
        "yAxis": {"type": "value"},
        "series": series,
    }


def box_chart(joints: Sequence[str], error: NDArray[np.floating], title: str, unit: str, threshold: float) -> dict[str, Any]:
    """For each joint, boxes of the distances (S, J) of all that were found, of those below 5 cm and of those below Γt."""
    limits = {"all found": np.inf, f"< {_NEAR_CM:g} {unit}": _NEAR_CM, f"< {threshold:g} {unit}": threshold}
    series: list[dict[str, Any]] = []
    for words, limit in limits.items():
        kept = [column[np.isfinite(column) & (column < limit)] for column in error.T]
        series.append({"name": words, "type": "boxplot", "data": [_box(values) for values in kept]})
    outliers = [
        [joint, round(float(x), 2)] for joint, values in enumerate(error.T) for x in _outliers(values[np.isfinite(values)])
    ]
    series.append({"name": "outliers of all found", "type": "scatter", "symbolSize": 4, "data": outliers, "color": "#d66"})
    return {
        "title": {"text": title, "textStyle": TITLE},
        "legend": {"top": 24},
        "grid": {"left": 48, "right": 16, "top": 56, "bottom": 56},
        "tooltip": {"trigger": "item"},
        "xAxis": {"type": "category", "data": list(joints), "axisLabel": {"rotate": 40}},
        "yAxis": {"type": "value"},
        "series": series,
    }


def places_chart(places: JointPlaces, title: str, threshold: float) -> dict[str, Any]:
    """Where a joint was, from above and from the side, or in the image, each place in the colour of the error there."""
    views = [(0, 1), (0, 2)] if places.axes == "xyz" else [(0, 1)]
    each = 100 / len(views)
    spans = [np.nanmin(places.where, axis=0), np.nanmax(places.where, axis=0)] if len(places.where) else [np.zeros(3), np.ones(3)]
    error = np.where(np.isinf(places.error), _MISSED, places.error)
    series, grids = [], []
    across: list[dict[str, Any]] = []
    up: list[dict[str, Any]] = []
    for number, (a, b) in enumerate(views):
        rows = np.column_stack((places.where[:, (a, b)], error)).round(3).tolist()
        series.append({
            "type": "scatter", "name": "d", "symbolSize": 8, "xAxisIndex": number, "yAxisIndex": number,
            "itemStyle": {"borderColor": "#444", "borderWidth": 0.5}, "data": rows,
        })  # fmt: skip
        grids.append({"left": f"{each * number + 6}%", "width": f"{each - 8}%", "top": 56, "bottom": 40})
        for axes, axis in ((across, a), (up, b)):
            name = f"{places.axes[axis]}, {'m' if places.axes == 'xyz' else 'px'}"
            low, high = spans[0][axis], spans[1][axis]
            axes.append({
                "type": "value", "gridIndex": number, "name": name, "nameLocation": "middle",
                "nameGap": 26 if axes is across else 38,
                "min": round(float(low - 0.05 * (high - low)), 2), "max": round(float(high + 0.05 * (high - low)), 2),
                "inverse": places.axes == "uv" and axis == 1,
            })  # fmt: skip
    return {
        "title": {"text": title, "textStyle": TITLE},
        "tooltip": {"trigger": "item"},
        "visualMap": {
            "type": "piecewise", "pieces": _pieces(threshold), "dimension": 2, "orient": "horizontal", "top": 24, "left": 40,
            "itemWidth": 12, "itemHeight": 12,
        },
        "grid": grids, "xAxis": across, "yAxis": up, "series": series,
    }  # fmt: skip


def _box(values: NDArray[np.floating]) -> list[float]:
    """Lowest, quartiles and highest without outliers (Tukey's 1.5 interquartile ranges)."""
    if not values.size:
        return []
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    reach = 1.5 * (high - low)
    inside = values[(values >= low - reach) & (values <= high + reach)]
    return [round(float(x), 3) for x in (inside.min(), low, middle, high, inside.max())]


def _outliers(values: NDArray[np.floating]) -> list[float]:
    if not values.size:
        return []
    low, high = np.quantile(values, (0.25, 0.75))
    return [float(x) for x in values[(values < low - 1.5 * (high - low)) | (values > high + 1.5 * (high - low))]]
