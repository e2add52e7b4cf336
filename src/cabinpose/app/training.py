"""From datasets (or a scene configuration) to the training and validation frames of a run."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from cabinpose.core import ConfigError, DatasetError
from cabinpose.estimate import Frames, FrameSpec, GeneratedFrames, StoredFrames, fits_memory, joined
from cabinpose.store import dataset_skeleton, held_out, read_splits, split_datasets
from cabinpose.synth import FrameMaker, SynthConfig, build_manifest, person_slots, preflight

_NAMES = 5  # of subjects in a message
_RANDOM_PERSON = re.compile(r"R\d{4,}")  # the names of random people


def training_split(
    datasets: Mapping[str, xr.Dataset], splits: Path | None, train: str, validate: str, *, share: float | None = None
) -> tuple[dict[str, xr.Dataset], dict[str, xr.Dataset]]:
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
            with _said_of(name):
                cut = held_out(dataset, share)
            if cut.words:
                warnings.warn(f"{name}: {cut.words}", stacklevel=2)
                told |= individuals(dataset)
            pairs.append((cut.train, cut.validate))
    sides: tuple[dict[str, xr.Dataset], dict[str, xr.Dataset]] = {}, {}
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


def stored_frames(
    datasets: Mapping[str, xr.Dataset], spec: FrameSpec, splits: Path | None, train: str, validate: str, *,
    share: float | None = None,
) -> tuple[Frames, Frames]:  # fmt: skip
    """Training and validation frames of datasets by their names, one dataset after the other; share: as of `training_split`.

    Frames are kept in memory all together or not at all. Joints that different sources placed, of the same names, are learnt
    together with a warning. Raises DatasetError as `training_split` and `StoredFrames` do.
    """
    sides = training_split(datasets, splits, train, validate, share=share)
    keep = fits_memory(sum(part.sizes["frame"] for side in sides for part in side.values()), spec)
    training, validation = (_joined(side, spec, keep=keep) for side in sides)
    whose = {name: dataset_skeleton(dataset, spec.skeleton).definition for name, dataset in datasets.items()}
    if len(set(whose.values())) > 1:
        told = "; ".join(f"in {name} {definition}" for name, definition in whose.items())
        warnings.warn(f"joints of the set {spec.skeleton} are placed differently: {told}", stacklevel=2)
    return training, validation


def _joined(side: Mapping[str, xr.Dataset], spec: FrameSpec, *, keep: bool) -> Frames:
    frames = []
    for name, part in side.items():
        with _said_of(name):
            frames.append(StoredFrames(part, spec, keep=keep))
    return joined(frames)


@contextmanager
def _said_of(name: str) -> Iterator[None]:
    """Add the name of the dataset to errors about it."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(f"{name}: {error}", hint=error.hint) from error


def generated_frames(config: SynthConfig, spec: FrameSpec, frames: int, seed: int) -> tuple[GeneratedFrames, GeneratedFrames]:
    """Frames made while training: `frames` new ones an epoch, and a tenth of that, always the same, to validate on.

    The frames that validate come from the next seed, and with it from other random people; named subjects are in both.
    """
    preflight(config, frames=frames)
    persons = person_slots(config)
    lacking = [slot for slot in spec.slots if slot not in persons]
    if lacking:
        raise ConfigError(f"the scenes have no place {', '.join(lacking)}", hint=f"set slots to some of: {', '.join(persons)}")
    if spec.rgb and (config.images is None or "rgb" not in config.images.variables):
        raise ConfigError("the scenes have no rgb", hint="add images: {variables: [rgb]} to the file of --synth")
    same = build_manifest(config, frames, seed).parts_belong_to  # of a dataset of these scenes
    training = GeneratedFrames(_Maker(config, seed, pictures=spec.rgb), frames, spec, persons, same)
    return training, GeneratedFrames(_Maker(config, seed + 1, pictures=spec.rgb), max(frames // 10, 1), spec, persons)


class _Maker:
    """Frames of the dataset standard by their number; each process that reads them makes its own bodies and cabins."""

    def __init__(self, config: SynthConfig, seed: int, *, pictures: bool) -> None:
        self._config, self._seed, self._pictures = config, seed, pictures
        self._maker: FrameMaker | None = None

    def __call__(self, index: int) -> dict[str, Any]:
        if self._maker is None:
            self._maker = FrameMaker(self._config, self._seed, pictures=self._pictures)
        return dict(self._maker.make(index)[0])

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_maker": None}
