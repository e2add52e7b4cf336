"""The curves of a training run: a table and a picture, written after each epoch, and the epoch at which to stop.

The numbers of all epochs are part of the checkpoint, so that a run that was killed goes on with whole curves.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import lightning
from lightning.pytorch.callbacks import Callback
from PIL import Image, ImageDraw, ImageFont

_SIZE, _LEFT, _TOP, _BOTTOM = (960, 540), 80, 50, 480  # px
_INK, _GRID = (40, 40, 40), (222, 222, 222)
_COLOURS = {"train_loss": (0, 114, 178), "val_loss": (213, 94, 0)}  # blue and red, as in the thesis' figure 6.22

_WIDE = 10.0  # losses that differ by more are drawn on a logarithmic axis

Row = dict[str, float]


class Curves(Callback):
    """Writes log/metrics.csv and curves.png after each epoch, and ends a run that has not become better for a while."""

    def __init__(self, out: Path, monitor: str, mode: str, patience: int) -> None:
        """monitor, mode: the figure whose greatest ("max") or least ("min") value is the best. patience: epochs, 0 = endless."""
        self._out, self._monitor, self._sign, self._patience = out, monitor, 1 if mode == "max" else -1, patience
        self._rows: list[Row] = []

    def state_dict(self) -> dict[str, Any]:
        """The numbers of the epochs so far."""
        return {"rows": self._rows}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from the numbers of a checkpoint."""
        self._rows = state_dict["rows"]

    def on_fit_start(self, trainer: lightning.Trainer, *_: Any) -> None:
        """Leave a run that has stopped as it is."""
        trainer.should_stop = self.stops

    def on_train_epoch_end(self, trainer: lightning.Trainer, *_: Any) -> None:
        """Add the epoch's numbers; decide whether it was the last."""
        known = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith(("train_", "val_"))}
        self._rows.append({"epoch": trainer.current_epoch, "step": trainer.global_step, **known})
        trainer.should_stop = self.stops
        if trainer.is_global_zero:
            self._write()

    @property
    def best(self) -> int | None:
        """The row of the best epoch, the first of equals; None where no epoch has the deciding figure."""
        known = {i: self._sign * row[self._monitor] for i, row in enumerate(self._rows) if _finite(row, self._monitor)}
        return max(known, key=lambda i: known[i]) if known else None

    @property
    def stops(self) -> bool:
        """Whether the run ends, because no epoch has been better for as long as its patience lasts."""
        return bool(self._patience) and self.best is not None and len(self._rows) - 1 - self.best >= self._patience

    def _write(self) -> None:
        table = self._out / "log" / "metrics.csv"
        table.parent.mkdir(exist_ok=True)
        partial = table.with_name("metrics.tmp")
        with partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(dict.fromkeys(name for row in self._rows for name in row)))
            writer.writeheader()
            writer.writerows(self._rows)
        partial.replace(table)
        partial = self._out / "curves.tmp"
        self.picture().save(partial, "PNG")
        partial.replace(self._out / "curves.png")

    def picture(self) -> Image.Image:
        """Training and validation loss over the epochs, with the best epoch and, where the run was ended early, the stop."""
        image = Image.new("RGB", _SIZE, "white")
        draw, font, right = ImageDraw.Draw(image), ImageFont.load_default(15), _SIZE[0] - 30
        losses = [row[name] for row in self._rows for name in _COLOURS if _finite(row, name)] or [0.0]
        levels = _levels(min(losses), max(losses))
        scale = math.log10 if levels[0] > 0 and levels[-1] > _WIDE * levels[0] else float
        low, high = scale(levels[0]), scale(levels[-1])
        last = len(self._rows)

        def x(epoch: float) -> float:
            return _LEFT + (right - _LEFT) * (epoch - 1) / max(last - 1, 1)

        def y(loss: float) -> float:
            return _BOTTOM - (_BOTTOM - _TOP) * (scale(loss) - low) / (high - low)

        for level in levels:
            draw.line([(_LEFT, y(level)), (right, y(level))], _GRID)
            draw.text((_LEFT - 8, y(level)), f"{level:.5g}", _INK, font, anchor="rm")
        every = max(1, int(_round_step(last / 8)))
        for epoch in range(every, last + 1, every):
            draw.line([(x(epoch), _BOTTOM), (x(epoch), _BOTTOM + 5)], _INK)
            draw.text((x(epoch), _BOTTOM + 8), str(epoch), _INK, font, anchor="ma")
        draw.text(((_LEFT + right) / 2, _BOTTOM + 32), "epoch", _INK, font, anchor="ma")
        self._mark(draw, font, x)
        for (name, colour), word, at in zip(_COLOURS.items(), ("training", "validation"), (_LEFT, _LEFT + 180), strict=True):
            line = [(x(i + 1), y(row[name])) for i, row in enumerate(self._rows) if _finite(row, name)]
            draw.line(line, colour, 2)
            for u, v in line:
                draw.ellipse((u - 2, v - 2, u + 2, v + 2), colour)
            draw.line([(at, 24), (at + 26, 24)], colour, 3)
            draw.text((at + 34, 24), f"{word} loss", _INK, font, anchor="lm")
        return image

    def _mark(self, draw: ImageDraw.ImageDraw, font: Any, x: Any) -> None:
        """Upright lines at the best epoch and at the stop, with their names."""
        marks = {} if self.best is None else {self.best: f"best: {self._monitor} {self._rows[self.best][self._monitor]:.4g}"}
        if self.stops:
            marks[len(self._rows) - 1] = "stop"
        for line, (row, words) in enumerate(marks.items()):
            draw.line([(x(row + 1), _TOP), (x(row + 1), _BOTTOM)], _INK)
            side, anchor = (-4, "ra") if x(row + 1) > _SIZE[0] / 2 else (4, "la")
            draw.text((x(row + 1) + side, _TOP + 4 + 20 * line), words, _INK, font, anchor=anchor)


def _finite(row: Row, name: str) -> bool:
    return math.isfinite(row.get(name, math.nan))


def _levels(least: float, greatest: float) -> list[float]:
    """Round values around `least` and `greatest`: equally far apart, or 1, 2 and 5 times powers of ten over a wide range."""
    if least > 0 and greatest > _WIDE * least:
        powers = range(math.floor(math.log10(least)), math.ceil(math.log10(greatest)) + 1)
        values = [m * 10.0**power for power in powers for m in (1, 2, 5)]
        first = max(i for i, value in enumerate(values) if value <= least)
        return values[first : 1 + next(i for i, value in enumerate(values) if value >= greatest)]
    step = _round_step((greatest - least) / 6)
    return [step * i for i in range(math.floor(least / step), math.floor(greatest / step) + 2)]


def _round_step(span: float) -> float:
    """The least of 1, 2 and 5 times a power of ten that is not below a positive span; 1 for none."""
    if not span > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(span))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= span * (1 - 1e-9))
