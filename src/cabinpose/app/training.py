"""From datasets (or a scene configuration) to the training and validation frames of a run."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from typing import Any

import xarray as xr

from cabinpose.app.training_split import Sides, said_of
from cabinpose.core import ConfigError
from cabinpose.estimate import Frames, FrameSpec, GeneratedFrames, StoredFrames, fits_memory, joined
from cabinpose.store import dataset_skeleton, labelled_joints
from cabinpose.synth import FrameMaker, SynthConfig, build_manifest, person_slots, preflight

_NAMES = 5  # of people in a message


def stored_frames(sides: Sides, spec: FrameSpec) -> tuple[Frames, Frames]:
    """The frames of `training_split`'s two sides, one dataset after the other.

    Frames are kept in memory all together or not at all. Joints that different sources placed, of the same names, are learnt
    together with a warning. A joint that nobody in one dataset has is not labelled there where another one teaches it. Raises
    DatasetError as `StoredFrames` does.
    """
    keep = fits_memory(sum(part.sizes["frame"] for side in sides for part in side.values()), spec)
    taught = {joint for part in sides[0].values() for joint in labelled_joints(part, spec.skeleton)}
    training, validation = (_joined(side, spec, taught, keep=keep) for side in sides)
    datasets = {name: part for side in sides for name, part in side.items()}
    whose = {name: dataset_skeleton(part, spec.skeleton).definition for name, part in datasets.items()}
    if len(set(whose.values())) > 1:
        told = "; ".join(f"in {name} {definition}" for name, definition in whose.items())
        warnings.warn(f"joints of the set {spec.skeleton} are placed differently: {told}", stacklevel=2)
    return training, validation


def _joined(side: Mapping[str, xr.Dataset], spec: FrameSpec, taught: Collection[str], *, keep: bool) -> Frames:
    frames = []
    for name, part in side.items():
        with said_of(name):
            frames.append(StoredFrames(part, spec, keep=keep, taught=taught))
    return joined(frames)


def generated_frames(config: SynthConfig, spec: FrameSpec, frames: int, seed: int) -> tuple[GeneratedFrames, GeneratedFrames]:
    """Frames made while training: `frames` new ones an epoch, and a tenth of that, always the same, to validate on.

    The frames that validate come from the next seed, and with it from other random people; named subjects are in both, with a
    warning.
    """
    preflight(config, frames=frames)
    persons = person_slots(config)
    lacking = [slot for slot in spec.slots if slot not in persons]
    if lacking:
        raise ConfigError(f"the scenes have no place {', '.join(lacking)}", hint=f"set slots to some of: {', '.join(persons)}")
    if spec.rgb and (config.images is None or "rgb" not in config.images.variables):
        raise ConfigError("the scenes have no rgb", hint="add images: {variables: [rgb]} to the file of --synth")
    if spec.depth_image == "depth_styled" and config.style is None:
        raise ConfigError("the scenes have no depth_styled", hint="add style: {by: MODEL} to the file of --synth")
    if named := (*config.people.subjects, *config.people.own):
        more = f" and {len(named) - _NAMES} more" if len(named) > _NAMES else ""
        warnings.warn(
            f"{', '.join(named[:_NAMES])}{more} are learnt from and validate, so that figures are better than on people nobody"
            " has seen; people: {subjects: [], random: {count: 300}} in the file of --synth draws others",
            stacklevel=2,
        )
    pictures = spec.rgb or spec.depth_image == "depth_styled"
    same = build_manifest(config, frames, seed).parts_belong_to  # of a dataset of these scenes
    training = GeneratedFrames(_Maker(config, seed, pictures=pictures), frames, spec, persons, same)
    return training, GeneratedFrames(_Maker(config, seed + 1, pictures=pictures), max(frames // 10, 1), spec, persons)


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
