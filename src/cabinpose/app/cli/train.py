"""`cabinpose train`: a detector from datasets, or from scenes generated meanwhile."""

from __future__ import annotations

import sys
from contextlib import ExitStack

from cabinpose.app.cli.commands import Train
from cabinpose.app.cli.output import ProgressReport, print_json, progress
from cabinpose.app.extras import require
from cabinpose.core.errors import ConfigError
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig


def run(command: Train) -> None:
    """Train, tell how far it is, and name the best checkpoint."""
    require("torch", "lightning", extra="train")
    from cabinpose.app.training import generated_frames, read_train_config, stored_frames
    from cabinpose.estimate.data import Frames
    from cabinpose.estimate.training import fit, frame_spec

    if command.datasets and command.synth is not None:
        raise ConfigError("a detector learns from datasets or from generated scenes", hint="give DATASET or --synth, not both")
    config = read_train_config(command.config, command.method)
    spec = frame_spec(config)
    training: Frames
    validation: Frames
    if command.datasets:
        datasets = {str(folder): open_dataset(folder) for folder in command.datasets}
        if len(datasets) < len(command.datasets):
            raise ConfigError("a dataset is named twice", hint="give each of them once")
        training, validation = stored_frames(datasets, spec, command.splits, command.train, command.validate)
    elif command.synth is not None:
        training, validation = generated_frames(SynthConfig.load(command.synth), spec, command.frames, config.seed)
    else:
        raise ConfigError("there is nothing to learn from", hint="give DATASET or --synth SCENE.yaml")
    with ExitStack() as stack:
        shown: list[ProgressReport] = []

        def tell(done: int, total: int, note: str) -> None:
            if not shown:
                shown.append(stack.enter_context(progress(total, "batches", start=done - 1)))
            shown[0](done, note)

        best = fit(
            config,
            training,
            validation,
            command.out,
            resume=command.resume,
            init=command.init,
            devices=_devices(command.devices),
            nodes=command.nodes,
            progress=tell,
        )
    if command.as_json:
        print_json({"best": str(best)})
    else:
        print(best)
        print(f"export it with: cabinpose export --onnx {best} --out {command.out / 'model.onnx'}", file=sys.stderr)


def _devices(words: str) -> int | str:
    return int(words) if words.isdigit() else words
