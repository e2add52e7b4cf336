"""From a dataset (or a scene configuration) to the training and validation frames of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.estimate.data import FrameSpec, GeneratedFrames, StoredFrames
from cabinpose.estimate.training import TrainConfig
from cabinpose.store.split import read_named_splits, split_dataset
from cabinpose.store.yaml_file import read_mapping, validated
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.sample import person_slots, preflight
from cabinpose.synth.write import FrameMaker

_HELD_OUT = 0.15  # share of the subjects that validate where no splits are given
_NAMES = 5  # of subjects in a message


def read_train_config(path: Path | None, method: str | None) -> TrainConfig:
    """The configuration in a YAML file, its method replaced by `method` if given. Raises ConfigError."""
    hint = "docs/training.md lists the keys"
    data = read_mapping(path, hint=hint) if path is not None else {}
    if method is not None:
        if data.get("method", method) != method:
            raise ConfigError(f"{path} is for {data['method']}, not {method}", hint="leave --method out, or give another file")
        data = {**data, "method": method}
    return validated(TrainConfig, data, path, hint=hint)


def training_split(dataset: xr.Dataset, splits: Path | None, train: str, validate: str) -> tuple[xr.Dataset, xr.Dataset]:
    """Frames to learn from and frames to validate on; nobody is in both.

    Without a file of splits, some of the subjects are held out: those last in the order of names, and every frame that
    shows one of them. Raises DatasetError where one side is empty, or the sides share people.
    """
    if splits is not None:
        chosen = split_dataset(dataset, read_named_splits(splits, (train, validate)))
        sides = chosen[train], chosen[validate]
    else:
        subjects = sorted(people_of(dataset))
        count = max(1, round(_HELD_OUT * len(subjects)))
        if len(subjects) < 2:
            raise DatasetError(
                f"{len(subjects)} subject cannot be split into training and validation",
                hint="generate more people, or name the splits with --splits",
            )
        held = np.isin(dataset["subject"].values, subjects[-count:])
        there = dataset["subject"].values != ""
        only_held = (held | ~there).all(axis=1) & there.any(axis=1)
        sides = dataset.isel(frame=np.flatnonzero(~held.any(axis=1))), dataset.isel(frame=np.flatnonzero(only_held))
    for name, side in zip((train, validate), sides, strict=True):
        if not side.sizes["frame"]:
            raise DatasetError(
                f"there is no frame in '{name}'", hint="`cabinpose info` counts frames by subject; name splits with --splits"
            )
    shared = sorted(people_of(sides[0]) & people_of(sides[1]))
    if shared:
        more = f" and {len(shared) - _NAMES} more" if len(shared) > _NAMES else ""
        raise DatasetError(
            f"'{train}' and '{validate}' share {', '.join(shared[:_NAMES])}{more}: a model would be judged on people it has seen",
            hint="split by subject",
        )
    return sides


def people_of(dataset: xr.Dataset) -> set[str]:
    """The subjects that appear in a dataset."""
    return {str(name) for name in np.unique(dataset["subject"].values.astype(str)) if name}


def stored_frames(
    dataset: xr.Dataset, spec: FrameSpec, splits: Path | None, train: str, validate: str
) -> tuple[StoredFrames, StoredFrames]:
    """Training and validation frames of a dataset."""
    sides = training_split(dataset, splits, train, validate)
    return StoredFrames(sides[0], spec), StoredFrames(sides[1], spec)


def generated_frames(config: SynthConfig, spec: FrameSpec, frames: int, seed: int) -> tuple[GeneratedFrames, GeneratedFrames]:
    """Frames made while training: `frames` new ones an epoch, and a tenth of that, always the same, to validate on.

    The frames that validate come from the next seed, and with it from other random people; named subjects are in both.
    """
    preflight(config, frames=frames)
    persons = person_slots(config)
    lacking = [slot for slot in spec.slots if slot not in persons]
    if lacking:
        raise ConfigError(f"the scenes have no place {', '.join(lacking)}", hint=f"set slots to some of: {', '.join(persons)}")
    training = GeneratedFrames(_Maker(config, seed), frames, spec, persons)
    return training, GeneratedFrames(_Maker(config, seed + 1), max(frames // 10, 1), spec, persons)


class _Maker:
    """Frames of the dataset standard by their number; each process that reads them makes its own bodies and cabins."""

    def __init__(self, config: SynthConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._maker: FrameMaker | None = None

    def __call__(self, index: int) -> dict[str, Any]:
        if self._maker is None:
            self._maker = FrameMaker(self._config, self._seed)
        return dict(self._maker.make(index)[0])

    def __getstate__(self) -> dict[str, Any]:
        return {"_config": self._config, "_seed": self._seed, "_maker": None}
