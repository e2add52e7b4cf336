"""Checkpoints of a run: they survive a full disk while they are written, and a folder that is moved between two runs."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.plugins import TorchCheckpointIO

from cabinpose.core import ModelError, write_whole


class MovedCheckpoint(ModelCheckpoint):
    """Checkpoints in a folder that may have been moved, of which Lightning's forget the best score there."""

    __qualname__ = ModelCheckpoint.__qualname__  # by which last.ckpt knows its state, that of runs of before too

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from the best epoch of a checkpoint, by its name in this folder if it came along."""

        def here(path: str) -> str:
            return str(Path(self.dirpath or "", Path(path).name)) if path else path

        if Path(here(state_dict["best_model_path"])).is_file():
            names = ("best_model_path", "kth_best_model_path", "last_model_path")
            state_dict = {
                **state_dict, **{name: here(state_dict[name]) for name in names}, "dirpath": self.dirpath,
                "best_k_models": {here(path): score for path, score in state_dict["best_k_models"].items()},
            }  # fmt: skip
        super().load_state_dict(state_dict)


class WholeCheckpoints(TorchCheckpointIO):
    """Checkpoints that take their name when they are whole and on disk; Lightning copies them from the temporary folder."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, *_: Any, **__: Any) -> None:
        """Write one. In memory first: torch hides a full disk from who asks."""
        buffer = BytesIO()
        torch.save(checkpoint, buffer)
        write_whole(Path(path), buffer.getvalue(), kind=ModelError)
