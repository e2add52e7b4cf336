"""--splits FILE, --split NAME, --select NAME=VALUE and --where CONDITION: which frames of a dataset, for every command alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from cabinpose.app.cli.arguments import SelectsFrames
from cabinpose.core import ConfigError, DatasetError, unknown_name
from cabinpose.store import (
    COORDINATES,
    JointNames,
    Selection,
    dataset_id,
    frame_mask,
    frames_where,
    labels_of,
    open_dataset,
    parse_selection,
    query_columns,
    read_manifest,
    read_splits,
    with_labels,
)

_EXAMPLES = {
    "places": "write --places standing=driver",
    "joints": "write --joints itop.head=head lshoulder=lshoulder, or the name of a set: --joints itop",
}


def opened(folder: Path, labels: Path | None = None) -> xr.Dataset:
    """A dataset, with corrected labels where there are some. Raises DatasetError for labels of another dataset."""
    dataset = open_dataset(folder)
    return dataset if labels is None else with_labels(dataset, labels_of(labels, (dataset_id(read_manifest(folder)),)))


def selected(dataset: xr.Dataset, command: SelectsFrames) -> xr.Dataset:
    """The frames of the split, the --select and the --where of a command; ConfigError or DatasetError where there is none."""
    return frames_with(dataset, [*_split(command.splits, command.split), selection(command.select)], command.where)


def frames_with(dataset: xr.Dataset, selections: Sequence[Selection], where: str | None = None) -> xr.Dataset:
    """The frames that belong to all selections and for which a condition holds; DatasetError where there is none."""
    mask = np.ones(dataset.sizes["frame"], bool)
    for each in selections:
        mask &= frame_mask(dataset, each)
    if where is not None:
        mask &= frames_where(query_columns(dataset), where)
    if not mask.any():
        raise DatasetError("no frame has all that is selected", hint="`cabinpose info` counts the frames by coordinate")
    return dataset if mask.all() else dataset.isel(frame=np.flatnonzero(mask))


def new_names(words: Sequence[str], flag: str) -> dict[str, str]:
    """The names of words such as standing=driver, new by old; ConfigError for a word that is none, and for a name given twice."""
    found: dict[str, str] = {}
    for word in words:
        old, equals, new = word.partition("=")
        if not (old and equals and new) or old in found:
            raise ConfigError(f"--{flag}: '{word}' {'is named twice' if old in found else 'names nothing'}", hint=_EXAMPLES[flag])
        found[old] = new
    return found


def joint_names(words: Sequence[str]) -> JointNames:
    """The words after --joints: new names by old, or the one set that joints are taken of."""
    return words[0] if len(words) == 1 and "=" not in words[0] else new_names(words, "joints")


def selection(words: Sequence[str]) -> Selection:
    """The selection of the words after --select; ConfigError or DatasetError for a word that is not NAME=VALUE[,VALUE]."""
    found: dict[str, tuple[Any, ...]] = {}
    for word in words:
        name, equals, values = word.partition("=")
        if not equals or not values:
            raise ConfigError(f"'{word}' selects nothing", hint="write --select car=sedan,van subject=S01")
        coordinate, folds, _ = name.partition("/")
        if coordinate not in COORDINATES:
            raise unknown_name("coordinate", coordinate, COORDINATES)
        if name in found:
            raise ConfigError(f"--select: {name} is named twice", hint=f"write {name}={','.join(map(str, found[name]))},{values}")
        found[name] = chosen = tuple(values.split(","))
        if coordinate == "sequence" or folds:
            if not all(value.isdecimal() for value in chosen):
                what = "folds" if folds else "sequences"
                raise ConfigError(f"'{word}': {what} are numbers", hint=f"write --select {name}=1,2")
            found[name] = tuple(map(int, chosen))
    return parse_selection(found, "--select") if found else {}


def _split(file: Path | None, name: str | None) -> list[Selection]:
    if file is None and name is None:
        return []
    if file is None or name is None:
        raise ConfigError("a split needs its file and its name", hint="give both --splits FILE and --split NAME")
    return list(read_splits(file, [name]).values())
