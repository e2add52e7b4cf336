"""Fine-tuning to the user's camera: generated frames as it would see them, and answers on its own that stand for labels."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import xarray as xr

from cabinpose.app.adapt.facts import CameraFacts, facts_of
from cabinpose.app.adapt.scenes import in_their_light
from cabinpose.app.training import stored_frames
from cabinpose.app.training_split import Sides, training_split
from cabinpose.core import ConfigError
from cabinpose.estimate import (
    AugmentConfig,
    JointPredictor,
    Machines,
    Observers,
    Start,
    TrainConfig,
    export_onnx,
    fit,
    frame_spec,
)
from cabinpose.store import open_dataset
from cabinpose.synth import SynthConfig, generate

Learn = Literal["both", "generated", "pseudo-labels"]
METHOD = "compact"  # whose exported models can be gone on with
FEWEST_FRAMES = 10  # of pseudo-labels, one in ten of which validates where nothing else does
_VALIDATES = 0.1


@dataclass(frozen=True)
class Budget:
    """What adaptation may cost.

    frames: generated · epochs, learning_rate, batch: of the fine-tuning; the rate is a fifth of the recipe's of `in_car` · learn:
    which frames · threads: of torch; None: those that it takes.
    """

    frames: int = 600
    epochs: int = 4
    learning_rate: float = 3e-4
    batch: int = 16
    learn: Learn = "both"
    seed: int = 1
    threads: int | None = None


def check_tunable(model: JointPredictor) -> None:
    """ConfigError for a model that cannot be gone on with."""
    if model.model.method.name != METHOD or model.skeleton != "cabinpose":
        raise ConfigError(
            f"{model.name} is a model of {model.model.method.name} for the joints of {model.skeleton}, which is not gone on with",
            hint=f"leave out --train, or give a model of {METHOD} (in_car, five_seats)",
        )


def generated(
    config: SynthConfig, budget: Budget, out: Path, theirs: CameraFacts, *, resume: bool, show: Callable[[int], None]
) -> xr.Dataset:
    """Generated frames in a folder, with the amplitudes in the unit of the user's camera."""
    with warnings.catch_warnings():  # what the user's camera sees of a car, the user knows
        warnings.filterwarnings("ignore", "view '")
        generate(
            config, budget.frames, out, seed=budget.seed, existing="resume" if resume and out.exists() else "refuse",
            workers=budget.threads, progress=lambda state: show(state.frames_done),
        )  # fmt: skip
    dataset = open_dataset(out)
    return in_their_light(dataset, theirs, facts_of(dataset)) if "amplitude" in dataset else dataset


def tuned(
    model: JointPredictor, init: Path, frames: tuple[xr.Dataset | None, xr.Dataset | None], out: Path, budget: Budget, *,
    resume: bool = False, observers: Observers | None = None,
) -> Path:  # fmt: skip
    """Fine-tune a model and export it as `adapted.onnx`.

    Parameters
    ----------
    model, init
        The model, and its name or file.
    frames
        Generated ones, and those of the user's camera with answers for labels; None for either that is not learnt from.
    out
        Folder: run/ with the checkpoints, adapted.onnx.
    budget
        Epochs and the like.
    resume
        Go on with the run in the folder.
    observers
        Who is told how it goes.

    Raises
    ------
    ConfigError
        For too few pseudo-labels, and as `fit` does.
    """
    settings = {**model.model.metadata["config"]}
    config = TrainConfig(
        method=METHOD, settings=settings, epochs=budget.epochs, batch=budget.batch, learning_rate=budget.learning_rate,
        seed=budget.seed, augment=AugmentConfig(shift=0.6, shift_m=0.06, noise_m=0.006, lost=0.02, occluder=0.1),
    )  # fmt: skip
    training, validation = stored_frames(_sides(*frames), frame_spec(config))
    best = fit(
        config, training, validation, out / "run", start=Start(resume, init), machines=Machines(1, threads=budget.threads),
        observers=observers,
    )  # fmt: skip
    card = {"summary": f"{model.name} adapted to the frames of one camera", "learnt from": budget.learn}
    adapted = out / "adapted.onnx"
    export_onnx(
        best,
        adapted,
        name=f"{model.name}_adapted",
        card=card,
        mirrored=bool(model.model.metadata.get("mirrored")),
        overwrite=resume,
    )
    return adapted


def held_out_of(made: xr.Dataset) -> xr.Dataset:
    """The generated frames that validate: nobody in them is learnt from."""
    return training_split({"generated": made}, None, "train", "validate")[1]["generated"]


def _sides(made: xr.Dataset | None, theirs: xr.Dataset | None) -> Sides:
    """Who learns and who validates. Generated people validate; where there are none, the last of the pseudo-labels do."""
    if theirs is not None and theirs.sizes["frame"] < FEWEST_FRAMES:
        raise ConfigError(
            f"{theirs.sizes['frame']} frames are sure enough to learn from, at least {FEWEST_FRAMES} are needed",
            hint="give more frames, or --learn generated",
        )
    if made is not None:
        training, validation = training_split({"generated": made}, None, "train", "validate")
        return training | ({"theirs": theirs} if theirs is not None else {}), validation
    assert theirs is not None
    last = max(int(_VALIDATES * theirs.sizes["frame"]), 1)
    return {"theirs": theirs.isel(frame=slice(None, -last))}, {"theirs": theirs.isel(frame=slice(-last, None))}
