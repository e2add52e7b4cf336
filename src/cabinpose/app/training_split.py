"""Who of datasets learns and who validates: looked at before torch is loaded, which takes seconds."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr

from cabinpose.core import DatasetError
from cabinpose.store import held_out, read_splits, split_datasets

Sides = tuple[dict[str, xr.Dataset], dict[str, xr.Dataset]]
"""Frames to learn from and frames to validate on, by the name of the dataset that they are of."""
_NAMES = 5  # of subjects in a message
_RANDOM_PERSON = re.compile(r"R\d{4,}")  # the names of random people


def training_split(
    datasets: Mapping[str, xr.Dataset], splits: Path | None, train: str, validate: str, *, share: float | None = None
) -> Sides:
    """Frames to learn from and frames to validate on, by the name of the dataset that they are of; nobody is in both.

    Without a file of splits, some of the subjects of each dataset are held out, see `held_out`, about a `share` of its frames;
    where that cannot be, a warning says that the two share people. With one, a dataset may be on one side alone. Raises
    DatasetError where a dataset is on no side, a side is empty, or the sides share people, whichever datasets these are in.
    """
    told: set[tuple[str, int | None]] = set()
    if splits is not None:
        parts = split_datasets(list(datasets.values()), read_splits(splits, (train, validate)))
        pairs = list(zip(parts[train], parts[validate], strict=True))
    else:
        pairs = []
        for name, dataset in datasets.items():
            with said_of(name):
                cut = held_out(dataset, share)
            if cut.words:
                warnings.warn(f"{name}: {cut.words}", stacklevel=2)
                told |= individuals(dataset)
            pairs.append((cut.train, cut.validate))
    sides: Sides = {}, {}
    for name, pair in zip(datasets, pairs, strict=True):
        for side, part in zip(sides, pair, strict=True):
            if part.sizes["frame"]:
                side[name] = part
        if all(name not in side for side in sides):
            raise DatasetError(
                f"{name}: no frame belongs to '{train}' or '{validate}'",
                hint="leave this dataset out, or mend the file of --splits",
            )
    learnt, judged = (set().union(*map(individuals, side.values())) for side in sides)
    shared = sorted({name for name, _ in (learnt & judged) - told})
    if shared:
        more = f" and {len(shared) - _NAMES} more" if len(shared) > _NAMES else ""
        raise DatasetError(
            f"'{train}' and '{validate}' share {', '.join(shared[:_NAMES])}{more}: a model would be judged on people it has seen",
            hint="split by subject" if len(datasets) == 1 else "name the same people of every dataset with --splits, by subject",
        )
    return sides


def individuals(dataset: xr.Dataset) -> set[tuple[str, int | None]]:
    """Who appears in a dataset, such that equal ones are the same people whichever dataset they are in.

    Random people have the same names with every seed, so the frames' seed identifies them; for named people it is None.
    """
    names = dataset["subject"].values.astype(str)
    seeds = np.broadcast_to(dataset["seed"].values[:, None], names.shape)
    pairs = set(zip(names.ravel().tolist(), seeds.ravel().tolist(), strict=True))
    return {(name, int(seed) if _RANDOM_PERSON.fullmatch(name) else None) for name, seed in pairs if name}


@contextmanager
def said_of(name: str) -> Iterator[None]:
    """Add the name of the dataset to errors about it."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(f"{name}: {error}", hint=error.hint) from error
