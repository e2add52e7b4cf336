"""The CPU time to expect of an experiment, from a few frames and a few steps of training of each distinct recipe."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cabinpose.app.experiment.cells import TrainCell
from cabinpose.app.experiment.frames import SelectedFrames, draw, opened
from cabinpose.app.experiment.pieces import DatasetPiece
from cabinpose.app.experiment.plan import FRAME_S, RECORDED_S, ExperimentPlan
from cabinpose.store import MANIFEST_NAME, open_dataset
from cabinpose.synth import CabinScene, SynthConfig, generate

_FRAMES = 16  # that are generated at least, so that what a run does once counts little; of sequences a whole one at least
_STEPS = 1, 4  # batches of two trainings: what they differ by is the time of a batch, without that of the start


def measured_s(plan: ExperimentPlan, told: Callable[[str], None] = lambda _: None) -> dict[str, float]:
    """CPU seconds of each cell, by key: those of its recipe here and now, times its frames or samples.

    Data that are there are not made again; whatever else a training needs is generated, in a folder that goes. Models that are
    fitted at once keep what the file says, and tests what is usual.

    Parameters
    ----------
    plan
        The cells.
    told
        Called with what is being measured.
    """
    result = {cell.key: cell.expected_s for cell in plan.cells}
    with TemporaryDirectory() as folder:
        some = _Samples(Path(folder), told)
        for made in plan.made:
            result[made.key] = made.frame_count * some.of(made.piece)[0]
        by_recipe: dict[str, float] = {}
        for cell in (cell for cell in plan.cells if isinstance(cell, TrainCell)):
            recipe = json.dumps(_recipe(cell), sort_keys=True)
            if recipe not in by_recipe:
                told(cell.name)
                by_recipe[recipe] = _sample_s(cell, some, Path(folder) / f"training-{len(by_recipe)}") or plan.scale.sample_s
            result[cell.key] = cell.expected_s * by_recipe[recipe] / plan.scale.sample_s
    return result


def _recipe(cell: TrainCell) -> Mapping[str, Any]:
    """What decides on the time of a sample: the recipe but what says how many there are, and which."""
    return {key: value for key, value in cell.recipe.items() if key not in ("epochs", "epoch_steps", "seed", "patience")}


class _Samples:
    """A few frames of datasets: of what is in them, each once."""

    def __init__(self, folder: Path, told: Callable[[str], None]) -> None:
        self._folder, self._told = folder, told
        self._made: dict[str, tuple[float, Path]] = {}

    def of(self, piece: DatasetPiece) -> tuple[float, Path]:
        """CPU seconds of a frame, and a dataset of a few."""
        config, frame_s = _scenes(piece)
        # Subjects differ in who is seen alone.
        recipe = config.model_copy(update={"people": config.people.model_copy(update={"subjects": (), "own": {}})})
        known = recipe.model_dump_json()
        if known not in self._made:
            sequence = config.scene.sequence if isinstance(config.scene, CabinScene) else None
            self._told(f"data {piece.name}")
            out = self._folder / f"data-{len(self._made)}"
            frames = max(_FRAMES, sequence.frames if sequence else 0)
            report = generate(config, frames, out, seed=piece.seed, workers=1)
            self._made[known] = sum(report.stages_ms.values()) / 1000, out
        seconds, out = self._made[known]
        return seconds * frame_s / FRAME_S, out


def _scenes(piece: DatasetPiece) -> tuple[SynthConfig, float]:
    """The scenes of a stand-in, of a recorded one those of its first subject, and what a frame is expected to take."""
    if not piece.recorded:
        return SynthConfig.model_validate_json(piece.config), FRAME_S
    first = next(iter(json.loads(piece.config)["subjects"].values()))
    return SynthConfig.model_validate(first["scenes"]), RECORDED_S


def _sample_s(cell: TrainCell, some: _Samples, folder: Path) -> float | None:
    """CPU seconds of a sample of a training; None of a method that is fitted at once."""
    from cabinpose.app.training import stored_frames  # noqa: PLC0415 - the same as below
    from cabinpose.estimate import Machines, TrainConfig, fit, frame_spec  # noqa: PLC0415 - torch

    config = TrainConfig.model_validate(cell.recipe)
    source = cell.train[0]
    piece = source.pieces[0]
    there = not piece.config or (piece.folder / MANIFEST_NAME).exists()
    place = piece.folder if there else some.of(piece)[1]
    shown = DatasetPiece(piece.name, place, piece.key, piece.frames, piece.people, piece.cars)
    if piece.config:
        at = np.arange(open_dataset(place).sizes["frame"])
    else:
        ((_, at),) = draw(SelectedFrames(source.part, (piece,)), [], cell.name)
    part = opened(source.part, [(shown, at[: max(_FRAMES, config.batch)])], cell.settings)
    spent = []
    for steps in _STEPS:
        few = config.model_copy(update={"epochs": 1, "epoch_steps": steps})
        training, validation = stored_frames((part, part), frame_spec(few))
        begun = time.process_time()
        if fit(few, training, validation, folder / str(steps), machines=Machines(threads=1)).suffix != ".ckpt":
            return None
        spent.append(time.process_time() - begun)
    return max(spent[1] - spent[0], 0.0) / ((_STEPS[1] - _STEPS[0]) * config.batch)
