"""The curves of a training run as a picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from cabinpose.app.report.charts import ValueScale, series_chart
from cabinpose.app.report.html import Html
from cabinpose.app.report.raster import write_png

_LINES = {"train_loss": "training loss", "val_loss": "validation loss"}  # blue and red, as in the thesis' figure 6.22
_WIDE = 10.0  # losses that differ by more are drawn on a logarithmic axis


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
    partial = path.with_suffix(".tmp")
    write_png(partial, [curves_chart(rows, best, monitor, stops)], _LINES.values())
    partial.replace(path)
