"""How far each joint of a model is off over the frames, as options of a chart: a heat map, and lines that its legend shows."""

from __future__ import annotations

from typing import Any

import numpy as np

from cabinpose.evaluate import FrameDistances

COLUMNS = 400  # stretches of frames at most
_MISSED = 1e6  # stands for a joint that was not found, beyond all distances
_FIRST = 3  # joints whose lines are shown at first: those that are farthest off
_SOFT = {"color": "#888"}


def height(d: FrameDistances) -> int:
    """Px of the chart."""
    return _map_height(d) + 330


def joint_chart(d: FrameDistances, title: dict[str, Any]) -> dict[str, Any]:
    """Options of an echart. d: of the stretches that are drawn · title: words and style."""
    frames, high = d.frames.tolist(), _map_height(d)
    across = {"type": "category", "data": frames}
    return {
        "title": title,
        "tooltip": {"trigger": "item"},
        "legend": {"top": high + 84, "textStyle": _SOFT, "data": list(d.joints), "selected": _selected(d)},
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
            "top": 24, "left": 70, "itemWidth": 12, "itemHeight": 12, "textStyle": _SOFT,
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
        {"gte": _MISSED, "color": "#000000", "label": "not found"},
    ]


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
        "markLine": {
            "silent": True, "symbol": "none", "lineStyle": {"color": "#999", "type": "dashed"},
            "data": [{"yAxis": d.threshold, "name": "Γt"}],
        },
    }  # fmt: skip
    return [*lines, ghost]


def _selected(d: FrameDistances) -> dict[str, bool]:
    finite = np.isfinite(d.by_joint)
    mean = np.where(finite, d.by_joint, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
    first = {d.joints[j] for j in np.argsort(-mean, kind="stable")[:_FIRST]}
    return {joint: joint in first for joint in d.joints}
