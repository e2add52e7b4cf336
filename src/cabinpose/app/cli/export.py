"""`cabinpose export`: a dataset, one of its splits or a recording in another format; a trained model as ONNX."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cabinpose.app.cli.exchange_commands import Export
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.cli.recording_exchange import export_recording
from cabinpose.app.cli.splits import chosen_split
from cabinpose.app.extras import require
from cabinpose.core.errors import ConfigError, unknown_name
from cabinpose.store import open_dataset
from cabinpose.store.convert import FORMATS, RECORDING_EXPORTS, export_dataset
from cabinpose.store.split import split_dataset
from cabinpose.store.yaml_file import read_mapping


def run(command: Export) -> None:
    """Export with a progress bar and name what was written."""
    if command.onnx is not None:
        _export_model(command, command.onnx)
        return
    if command.dataset is None or command.format is None:
        raise ConfigError("there is nothing to export", hint="give DATASET or RECORDING and --format, or --onnx CHECKPOINT")
    if export_recording(command, command.dataset, command.format):
        return
    if command.format not in FORMATS:
        raise unknown_name("format", command.format, (*FORMATS, *RECORDING_EXPORTS))
    split = chosen_split(command.splits, command.split)
    dataset = open_dataset(command.dataset)
    for chosen in split_dataset(dataset, split).values():
        dataset = chosen
    frames = dataset.sizes["frame"]
    with progress(frames, "frames") as report:
        folder = export_dataset(dataset, command.format, command.out, overwrite=command.overwrite, report=report)
    if command.as_json:
        print_json({"out": str(folder), "format": command.format, "frames": frames})
    else:
        print(f"{folder}: {frames} frames as {command.format}")


def _export_model(command: Export, checkpoint: Path) -> None:
    if command.dataset is not None or command.format is not None:
        raise ConfigError("a dataset or a model is exported, not both", hint="give DATASET and --format, or --onnx CHECKPOINT")
    require("torch", "onnx", extra="train")
    from cabinpose.estimate.export import export_onnx

    name = command.name or command.out.stem
    difference = export_onnx(
        checkpoint, command.out, name=name, card=_card(command.card), mirrored=command.mirrored, overwrite=command.overwrite
    )
    if command.as_json:
        print_json({"out": str(command.out), "format": "onnx", "difference": difference})
    else:
        print(f"{command.out}: differs from torch by at most {difference:.1e}")


def _card(path: Path | None) -> dict[str, Any]:
    return {} if path is None else read_mapping(path, hint="give a YAML file of `key: value` lines with --card")
