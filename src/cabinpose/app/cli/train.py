"""`cabinpose train`: train a detector on datasets, or on scenes generated during training."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import DatasetPath, Maybe, PrintsJson, refuse, several
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, Registry, check_output

if TYPE_CHECKING:
    from cabinpose.app.training_split import Sides
    from cabinpose.estimate import Frames, FrameSpec, TrainConfig


def _methods(_default: str) -> str:
    """The names of the methods, those of extensions too; the help alone asks for them, since it takes 40 ms."""
    return f"(one of: {', '.join(Registry('cabinpose.methods', 'method', object).names())})"


@dataclass(frozen=True, kw_only=True)
class Train(PrintsJson):
    """Train a detector on datasets, or on scenes generated during training; the best epoch is kept.

    Needs the extra `train`. --resume continues an interrupted run after its last complete epoch.
    """

    out: Path
    """Folder of the run: best.ckpt, last.ckpt, log/metrics.csv, curves.png."""
    datasets: Annotated[Positional[tuple[DatasetPath, ...]], several("[DATASET ...]")] = ()
    """Folders of the datasets to train on."""
    method: Annotated[Maybe[str], arg(help_behavior_hint=_methods)] = None
    """Method, if the configuration names none."""
    config: Maybe[Path] = None
    """Configuration of the run (YAML); every key has a default."""
    synth: Maybe[Path] = None
    """Scene configuration (YAML) from which frames are generated during training, in place of datasets."""
    frames: Maybe[int] = None
    """Frames per epoch with --synth; default: 2000."""
    splits: Maybe[Path] = None
    """YAML file of splits; without it, some subjects of each dataset are held out for validation."""
    val: Maybe[float] = None
    """Share of each dataset's frames that validate, 0 to 1, where there are no --splits: people are held out if they can be."""
    train: str = "train"
    """Name of the split to train on."""
    validate: str = "validate"
    """Name of the split to validate on."""
    devices: str = "auto"
    """Devices per machine, as Lightning understands them."""
    nodes: int = 1
    """Machines, started by Lightning's launchers."""
    logger: Annotated[tuple[str, ...], several("{tensorboard,mlflow,wandb} ...")] = ()
    """What else the figures are written to, in log; each is an extra."""
    export: Maybe[Path] = None
    """ONNX file to write the best epoch to as well, as `cabinpose export onnx` does."""
    init: Maybe[Path] = None
    """Checkpoint of an earlier run of the same network to start from, or such a model of `compact`: packaged, or an ONNX file."""
    resume: bool = False
    """Continue the run in the folder."""


COMMAND = Train
_FRAMES = 2000  # an epoch, with --synth
_RANKS = ("RANK", "LOCAL_RANK", "SLURM_PROCID")  # the launchers' name for a process; the first one alone speaks


def run(command: Train) -> None:
    """Train with a progress bar, and print the best checkpoint."""
    require("train")
    if command.datasets and command.synth is not None:
        raise ConfigError("a detector learns from datasets or from generated scenes", hint="give DATASET or --synth, not both")
    if command.synth is not None:
        refuse({"--splits": command.splits, "--val": command.val}, "{} is of datasets, and --synth generates frames")
    elif command.datasets:
        refuse({"--frames": command.frames}, "{} is of --synth")
    if command.val is not None and (command.splits is not None or not 0 < command.val < 1):
        why = "--splits says who validates" if command.splits is not None else f"--val {command.val:g} is no share"
        raise ConfigError(why, hint="leave out --val, or give a number between 0 and 1 and no --splits")
    from cabinpose.estimate import METHODS, ArrayMethod, check_loggers, read_train_config

    config = read_train_config(command.config, command.method)  # what is wrong is told before torch is loaded
    check_loggers(command.logger)
    if config.data and command.synth is not None:
        raise ConfigError("`data` is of datasets, and --synth generates frames", hint="leave `data` out of the configuration")
    fitted = isinstance(METHODS[config.method], ArrayMethod)
    if command.export is not None:
        _check_export(command.export, config.method, fitted=fitted, replaced=command.resume)
    helps = any(os.environ.get(name, "0") != "0" for name in _RANKS)
    sides = None if command.synth is not None else _sides(command, config, helps=helps)
    with ExitStack() as stack:
        report, counted = stack.enter_context(progress(silent=helps)), False
        report.phase("loading torch")
        from cabinpose.app.report.raster import write_curves
        from cabinpose.estimate import Machines, Observers, Start, export_onnx, fit, frame_spec

        def show(done: int, total: int, note: str) -> None:
            nonlocal report, counted
            if total and not counted:
                stack.close()
                report, counted = stack.enter_context(progress(total, unit, start=done, silent=helps)), True
            if counted:
                report(done, note)
            else:
                report.phase(note)

        unit = "steps" if fitted else "batches"
        report.phase("opening datasets")
        training, validation = _frames(command, sides, frame_spec(config), config.seed)
        draw = partial(write_curves, command.out / "curves.png")
        devices = int(command.devices) if command.devices.isdigit() else command.devices
        best = fit(
            config, training, validation, command.out, start=Start(command.resume, command.init),
            machines=Machines(devices, command.nodes), observers=Observers(show, draw, loggers=command.logger),
        )  # fmt: skip
    if helps:
        return
    if command.export is not None:
        with progress() as report:
            report.phase("exporting and comparing with torch")
            export_onnx(best, command.export, name=command.export.stem, card={}, overwrite=command.resume)
    if command.as_json:
        print_json({"best": str(best)} | ({} if command.export is None else {"onnx": str(command.export)}))
        return
    print(best)
    if command.export is not None:
        print(command.export)
    elif fitted:
        print(f"it is the model: cabinpose models {best}", file=sys.stderr)
    else:
        print(f"export it with: cabinpose export onnx {best} --out {command.out / 'model.onnx'}", file=sys.stderr)


def _check_export(out: Path, method: str, *, fitted: bool, replaced: bool) -> None:
    """Raise ConfigError or OutputError where the best epoch of a run of this method cannot be exported to `out`."""
    if fitted:
        raise ConfigError(f"{method} has no network", hint="leave --export out: its run writes best.npz, which is the model")
    if out.exists() and not replaced:
        raise ConfigError(f"{out} already exists", hint="give another file with --export")
    check_output(out)


def _sides(command: Train, config: TrainConfig, *, helps: bool) -> Sides:
    """Who learns and who validates; warns of labels that are hardly right, unless it only helps."""
    from cabinpose.app.training_split import training_split
    from cabinpose.estimate import as_configured
    from cabinpose.store import open_dataset, warn_of_labels

    if not command.datasets:
        raise ConfigError("there is nothing to learn from", hint="give DATASET or --synth SCENE.yaml")
    datasets = {str(folder): open_dataset(folder) for folder in command.datasets}
    if len(datasets) < len(command.datasets):
        raise ConfigError("a dataset is named twice", hint="give each of them once")
    if not helps:
        for name, dataset in datasets.items():
            warn_of_labels(dataset, name)
    sides = training_split(datasets, command.splits, command.train, command.validate, share=command.val)
    if not config.data:
        return sides
    named = as_configured(config, datasets)  # people in places that go are in the images: who learns is known before
    learnt, judged = ({name: named[name].sel(frame=part["frame"].values) for name, part in side.items()} for side in sides)
    return learnt, judged


def _frames(command: Train, sides: Sides | None, spec: FrameSpec, seed: int) -> tuple[Frames, Frames]:
    """Training and validation frames: stored ones, or generated ones where there are no sides."""
    from cabinpose.app.training import generated_frames, stored_frames
    from cabinpose.synth import SynthConfig

    if sides is not None:
        return stored_frames(sides, spec)
    frames = _FRAMES if command.frames is None else command.frames
    return generated_frames(SynthConfig.load(command.synth), spec, frames, seed)
