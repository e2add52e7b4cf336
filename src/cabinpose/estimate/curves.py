"""The curves of a training run: a table, written after each epoch, and the epoch at which to stop.

The numbers of all epochs are part of the checkpoint, so that a run that was killed goes on with whole curves.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import lightning
from lightning.pytorch.callbacks import Callback

from cabinpose.core import whole_file

Row = dict[str, float]
Draw = Callable[[Sequence[Row], int | None, str, bool], None]  # of all epochs, the best one, the deciding figure, the stop


class Curves(Callback):
    """Writes log/metrics.csv after each epoch, has it drawn, and ends a run that has not become better for a while."""

    def __init__(self, out: Path, monitor: str, mode: str, patience: int, draw: Draw | None = None) -> None:
        """monitor, mode: the figure whose greatest ("max") or least ("min") value is the best. patience: epochs, 0 = endless."""
        self._draw = draw
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
        """Add the epoch's numbers; decide whether it was the last, unless another callback has."""
        known = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith(("train_", "val_"))}
        self._rows.append({"epoch": trainer.current_epoch, "step": trainer.global_step, **known})
        trainer.should_stop = trainer.should_stop or self.stops
        if trainer.is_global_zero:
            self._write()

    @property
    def best(self) -> int | None:
        """The row of the best epoch, the first of equals; None where no epoch has the deciding figure."""
        known = {
            i: self._sign * row[self._monitor]
            for i, row in enumerate(self._rows)
            if math.isfinite(row.get(self._monitor, math.nan))
        }
        return max(known, key=lambda i: known[i]) if known else None

    @property
    def stops(self) -> bool:
        """Whether the run ends, because no epoch has been better for as long as its patience lasts."""
        return bool(self._patience) and self.best is not None and len(self._rows) - 1 - self.best >= self._patience

    def _write(self) -> None:
        table = self._out / "log" / "metrics.csv"
        table.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(table) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(dict.fromkeys(name for row in self._rows for name in row)))
            writer.writeheader()
            writer.writerows(self._rows)
        if self._draw is not None:
            self._draw(self._rows, self.best, self._monitor, self.stops)
