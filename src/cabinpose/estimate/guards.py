"""What a training run is held in: its folder for itself, quiet libraries, our errors for interrupts and too little memory."""

from __future__ import annotations

import logging
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lightning
import torch

from cabinpose.core import ConfigError, ModelError, lock

_NOISE = (
    ".*`IterableDataset` has `__len__` defined.*",
    ".*does not have many workers.*",
    ".*exists and is not empty.*",
    ".*The number of training batches .* is smaller than the logging interval.*",
    ".*isinstance\\(treespec, LeafSpec\\).*",
    "(?s).*Grad strides do not match bucket view strides.*",
)
_NO_MEMORY = re.compile("can't allocate memory|out of memory|bad_alloc|ALLOC_FAILED")


@contextmanager
def alone(out: Path, trainer: lightning.Trainer) -> Iterator[None]:
    """Hold a run's folder, which no other run goes on with meanwhile; the processes of this one share it."""
    held = lock(out, out, ModelError) if trainer.is_global_zero else None
    try:
        yield
    finally:
        if held is not None:
            os.close(held)


@contextmanager
def interruptible() -> Iterator[None]:
    """Ctrl-C within `fit` is a KeyboardInterrupt; Lightning ends the process with code 1."""
    try:
        yield
    except SystemExit as left:
        if isinstance(left.__context__, KeyboardInterrupt):
            raise left.__context__ from None
        raise


@contextmanager
def quiet() -> Iterator[None]:
    """Silences Lightning's advice and its list of devices; its errors stay."""
    loggers = [logging.getLogger(name) for name in ("lightning.pytorch", "lightning.fabric")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        for pattern in _NOISE:
            warnings.filterwarnings("ignore", pattern)
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


@contextmanager
def too_little_memory(batch: int, last: Path) -> Iterator[None]:
    """What torch, its devices and numpy raise for want of memory becomes a ConfigError that names the batch."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:  # torch's allocator on the CPU has no class of its own
        if not isinstance(error, MemoryError | torch.OutOfMemoryError) and _NO_MEMORY.search(str(error)) is None:
            raise
        hint = "set a smaller `batch` in the file of --config"
        if last.exists():
            hint = "free memory and go on with --resume, or start a run with a smaller `batch` in another folder"
        first = (str(error).splitlines() or ["no memory"])[0]
        raise ConfigError(f"too little memory for batches of {batch} frames: {first}", hint=hint) from error
