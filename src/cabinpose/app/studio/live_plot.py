"""Joints of a live run over time: three coordinates of the joints of a person that are chosen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from nicegui import ui

from cabinpose.app.live.run import Found
from cabinpose.app.studio.live_session import PRESENT, LiveSession

_PERIOD_S = 0.5
_SPAN_S = 20.0
_AXES = ("x to the right", "y down", "z away")  # of the camera's frame
_MOST = 4  # joints at a time
_Lines = dict[str, list[list[list[float | None]]]]  # of each joint, by axis, times and places


class LivePlot:
    """A chart, and what it is of. Nothing is drawn while it is not seen, nor while the run stands still."""

    def __init__(self, session: Callable[[], LiveSession | None], seen: Callable[[], bool]) -> None:
        """session: gives the run · seen: whether the chart is."""
        self._session, self._seen = session, seen
        self._drawn: tuple[Any, ...] = ()
        with ui.column().classes("no-wrap").style("width: 200px; flex: none; gap: 8px"):
            self._who = ui.select([], label="person", on_change=self._people_changed).props("dense outlined").classes("w-full")
            self._joints = ui.select([], label="joints", multiple=True).props(f"dense outlined max-values={_MOST}")
            self._joints.classes("w-full").mark("plotted")
        self._chart = ui.echart(self._options({})).style("flex: 1; min-width: 0; height: 100%").mark("plot")
        ui.timer(_PERIOD_S, self._draw)

    def _people_changed(self) -> None:
        session = self._session()
        model = None if session is None else next((m for m in session.models if m.name == self._model()), None)
        names = list(model.joints) if model is not None else []
        chosen = [name for name in self._joints.value or [] if name in names]
        first = [name for name in ("lwrist", "rwrist") if name in names] or names[:1]
        self._joints.set_options(names, value=chosen or first)

    def _model(self) -> str:
        return str(self._who.value or "").rpartition(": ")[0]

    def _draw(self) -> None:
        session = self._session()
        if session is None and self._drawn:
            self._show((), {})
        if session is None or not self._seen():
            return
        people = [f"{model.name}: {person}" for model in session.models for person in model.persons]
        if people != self._who.options:
            self._who.set_options(people, value=self._who.value if self._who.value in people else next(iter(people), None))
            self._people_changed()
        trail = list(session.trail)
        now = (id(session), trail[-1][0] if trail else 0, self._who.value, tuple(self._joints.value or ()))
        if not trail or now == self._drawn:
            return
        self._show(now, self._lines(session, trail))

    def _show(self, now: tuple[Any, ...], lines: _Lines) -> None:
        self._drawn = now
        self._chart.options.clear()
        self._chart.options.update(self._options(lines))
        self._chart.update()

    def _lines(self, session: LiveSession, trail: Sequence[tuple[int, tuple[Found, ...]]]) -> _Lines:
        """Of each chosen joint, by axis, times (s, up to 0) and places (m); None where it was not found."""
        number = next((i for i, model in enumerate(session.models) if model.name == self._model()), None)
        if number is None:
            return {}
        model, last = session.models[number], trail[-1][0]
        p = list(model.persons).index(str(self._who.value).rpartition(": ")[2])
        recent = [(1e-9 * (ns - last), found[number].poses) for ns, found in trail if last - ns <= 1e9 * _SPAN_S]
        lines = {}
        for joint in list(self._joints.value or ())[:_MOST]:
            j = list(model.joints).index(joint)
            places = np.array([np.where(b.presence[0, p, j] >= PRESENT, b.joints_3d[0, p, j], np.nan) for _, b in recent])
            lines[joint] = [
                [
                    [round(t, 3), round(float(x), 4) if np.isfinite(x) else None]
                    for (t, _), x in zip(recent, places[:, axis], strict=True)
                ]
                for axis in range(3)
            ]
        return lines

    def _options(self, lines: _Lines) -> dict[str, Any]:
        """Three plots side by side, each of one axis, with a line a joint in the same colour."""
        colours = ("#e08214", "#2f8fd8", "#d6604d", "#5aae61")
        series = [
            {
                "name": joint, "type": "line", "showSymbol": False, "xAxisIndex": axis, "yAxisIndex": axis, "color": colour,
                "data": data,
            }
            for (joint, axes), colour in zip(lines.items(), colours, strict=False)
            for axis, data in enumerate(axes)
        ]  # fmt: skip
        titles = [{"text": f"{name}, m", "left": f"{33 * i + 4}%", "textStyle": {"fontSize": 12}} for i, name in enumerate(_AXES)]
        across = {"type": "value", "min": -_SPAN_S, "max": 0, "axisLabel": {"formatter": "{value} s"}}
        return {
            "animation": False,
            "title": titles,
            "legend": {"bottom": 0, "data": list(lines)},
            "grid": [{"left": f"{33 * i + 4}%", "width": "27%", "top": 26, "bottom": 48} for i in range(3)],
            "tooltip": {"trigger": "axis"},
            "xAxis": [across | {"gridIndex": i} for i in range(3)],
            "yAxis": [{"type": "value", "gridIndex": i, "scale": True} for i in range(3)],
            "series": series,
        }
