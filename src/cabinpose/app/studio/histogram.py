"""How often frames have which values of a coordinate: bars that are conditions."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from nicegui import ui
from numpy.typing import NDArray

from cabinpose.app.studio.workspace import Workspace
from cabinpose.app.view.summary import BIN_M, summarise

MOST_BARS = 40  # of words; the most frequent
_BINS = 12  # of numbers, about


class Bar(NamedTuple):
    """A value or a range of values, in how many frames it is, and the condition that chooses them; "" where there is none."""

    words: str
    frames: int
    condition: str


def bars_of(name: str, column: NDArray[Any]) -> list[Bar]:
    """The bars of a column of `query_columns` for some frames: (F,), or (F, P), where a frame counts once for each value."""
    if column.dtype.kind not in "iuf":
        return _of_words(name, column)
    each = column if column.ndim == 2 else column[:, None]
    rows = np.nonzero(np.isfinite(each))[0]
    nowhere = int(np.isinf(each).any(axis=1).sum())
    bars = _of_numbers(name, rows, each[np.isfinite(each)])
    return [*bars, Bar("nobody found", nowhere, f"{name} > {1e9:.0f}")] if nowhere else bars


def _of_words(name: str, column: NDArray[Any]) -> list[Bar]:
    rows = column.tolist()
    each = (set(row) for row in rows) if column.ndim == 2 else ((word,) for word in rows)
    counts = Counter(word for words in each for word in words if word)
    first = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    bars = [Bar(word, count, f"{name} == {json.dumps(word, ensure_ascii=False)}") for word, count in first[:MOST_BARS]]
    return [*bars, Bar(f"{len(first) - MOST_BARS} more", 0, "")] if len(first) > MOST_BARS else bars


def _of_numbers(name: str, rows: NDArray[np.int64], values: NDArray[Any]) -> list[Bar]:
    """Each of a few whole numbers, or ranges between round ones; rows: the frame of each value."""
    if not values.size:
        return []
    low, high = values.min().item(), values.max().item()
    whole = values.dtype.kind in "iu"
    if whole and high - low < _BINS:
        numbers, of = np.unique(values, return_inverse=True)
        return [Bar(str(v), n, f"{name} == {v}") for v, n in zip(numbers, _frames(rows, of, len(numbers)), strict=True)]
    apart = 0.0 if whole else 2 * np.spacing(np.abs(values).max()).item()  # so that edges are numbers that the column can have
    step, digits = _round_step(max((high - low) / _BINS or 1.0, apart))
    first, last = (int(np.floor_divide(each, step)) for each in (low, high))
    words = [_word(k, step, digits) for k in range(first - 1, last + 3)]
    edges = np.array([int(word) if whole else values.dtype.type(word) for word in words])  # as a condition compares them
    counts = _frames(rows, np.searchsorted(edges, values, side="right") - 1, len(words) - 1)
    ranges = zip(words, words[1:], counts, strict=False)
    bars = [Bar(f"{a} to {b}", count, f"{name} >= {a} and {name} < {b}") for a, b, count in ranges]
    there = np.flatnonzero(counts)
    return bars[there[0] : there[-1] + 1]


def _frames(rows: NDArray[np.int64], of: NDArray[np.intp], count: int) -> list[int]:
    """In how many frames each of some values or ranges is. of: which of them each value is."""
    counts: list[int] = np.bincount(np.unique(np.stack((rows, of)), axis=1)[1], minlength=count).tolist()
    return counts


def _round_step(least: float) -> tuple[int | float, int]:
    """The next of 1, 2, 5, 10, 20 … that is not smaller, and how many decimals it has."""
    power = math.floor(math.log10(least))
    factor = next(each for each in (1, 2, 5, 10) if each * 10.0**power >= least * (1 - 1e-9))
    return (factor * 10**power, 0) if power >= 0 else (factor * 10.0**power, -power)


def _word(number: int, step: float, digits: int) -> str:
    return f"{number * step:.{digits}f}" if digits else str(number * step)


class HistogramPanel:
    """A list of coordinates, and the bars of the one that is chosen; a bar narrows the condition."""

    def __init__(
        self, columns: Callable[[], Mapping[str, NDArray[Any]]], narrow: Callable[[str], Any],
        remember: Callable[[Mapping[str, object]], Any],
    ) -> None:  # fmt: skip
        """columns: of all frames · narrow: is given the condition of a bar · remember: as of `Page`."""
        self._columns, self._narrow, self._remember = columns, narrow, remember
        self._rows: NDArray[np.int64] = np.arange(0)
        self._name = ui.select([], label="histogram of", clearable=True, on_change=self._chosen).props("dense outlined")
        self._name.classes("w-full").mark("histogram")
        self._bars = ui.column().classes("studio-bars w-full").style("gap: 1px")

    def offer(self, names: list[str], chosen: str | None = None) -> None:
        """What may be chosen; chosen: the first choice."""
        self._name.set_options(
            names, value=chosen if chosen in names else self._name.value if self._name.value in names else None
        )

    def show(self, rows: NDArray[np.int64]) -> None:
        """Count the frames of these rows."""
        self._rows = rows
        self._bars.clear()
        name = self._name.value
        if name is None or name not in (columns := self._columns()):
            return
        bars = bars_of(name, columns[name][rows])
        most = max((bar.frames for bar in bars), default=1) or 1
        with self._bars:
            if not bars:
                ui.label("no frame has one").style("opacity: .7; font-size: 13px")
            for bar in bars:
                self._bar(bar, bar.frames / most)

    def open(self) -> None:
        """Give the list the keyboard, opened."""
        self._name.run_method("showPopup")

    def _chosen(self) -> None:
        self._remember({"dataset.histogram": self._name.value or ""})
        self.show(self._rows)

    def _bar(self, bar: Bar, share: float) -> None:
        row = ui.item(on_click=(lambda: self._narrow(bar.condition)) if bar.condition and bar.frames else None)
        row.props("dense").style(f"--share: {100 * share:.1f}%")
        with row:
            ui.label(bar.words)
            ui.label(str(bar.frames) if bar.condition else "")


def statistics_dialog(workspace: Workspace, dataset: xr.Dataset, rows: NDArray[np.int64]) -> None:
    """Show what there is of what in the frames of one or more rows."""
    assert workspace.manifest is not None
    assert workspace.folder is not None
    summary = summarise(dataset, workspace.manifest, workspace.folder, dataset.isel(frame=rows))
    with ui.dialog().props("maximized") as dialog, ui.card().style("width: 100%"):
        with ui.row().classes("items-center w-full"):
            ui.label(f"{summary.selected} of {summary.frames} frames").style("font-size: 18px; flex: 1")
            ui.button(icon="close", on_click=dialog.close).props("flat round dense")
        with ui.row().classes("w-full").style("gap: 12px"):
            for title in ("by_car", "by_pov", "by_seat", "by_people", "by_subject", "by_action", "visibility"):
                counts: dict[str, int] = getattr(summary, title)
                _bars(title.replace("by_", "").replace("pov", "view"), list(counts), list(counts.values()))
            bins = [f"{i * BIN_M:.2f}" for i in range(len(summary.depth_histogram))]
            _bars("depth, m (share of pixels)", bins, list(summary.depth_histogram))
    dialog.on("hide", dialog.delete)
    dialog.open()


def _bars(title: str, names: list[str], values: list[Any]) -> None:
    ui.echart(
        {
            "title": {"text": title, "textStyle": {"fontSize": 13}},
            "grid": {"left": 48, "right": 12, "top": 34, "bottom": 60},
            "tooltip": {"trigger": "axis"},
            "xAxis": {"type": "category", "data": names, "axisLabel": {"rotate": 40}},
            "yAxis": {"type": "value"},
            "series": [{"type": "bar", "data": values, "color": "#3b82c4"}],
        }
    ).style("width: 400px; height: 260px")
