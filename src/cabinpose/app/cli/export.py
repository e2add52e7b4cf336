"""`cabinpose export`: a dataset, one of its splits or a recording in another format; a trained model as ONNX."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import xarray as xr

from cabinpose.app.cli.exchange_commands import Export
from cabinpose.app.cli.output import listed, print_json, progress
from cabinpose.app.cli.recording_exchange import export_recording
from cabinpose.app.cli.selection import frames_with, selected, selection
from cabinpose.app.extras import require
from cabinpose.core.errors import ConfigError
from cabinpose.store import open_dataset
from cabinpose.store.convert import IMAGE_KINDS, check_export, export_parts, write_parts
from cabinpose.store.split import Splits, read_splits
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
    check_export(command.format, command.images)
    dataset, splits = _frames(command, command.dataset, command.format)
    parts = export_parts(dataset, command.format, splits)
    counts = {name: part.sizes["frame"] for name, part in parts.items()}
    frames = sum(counts.values())
    with progress(frames, "frames") as report:
        folder = write_parts(
            parts, command.format, command.out, images=command.images, overwrite=command.overwrite, report=report
        )
    by_split = {} if "" in counts else {"splits": counts}
    if command.as_json:
        print_json({"out": str(folder), "format": command.format, "frames": frames} | by_split)
        return
    print(f"{folder}: {frames} frames as {command.format}" + (f": {listed(counts)}" if by_split else ""))
    left = dataset.sizes["frame"] - frames
    if left and command.split is None:
        print(f"{left} frames belong to no split and are left out", file=sys.stderr)


def _frames(command: Export, folder: Path, name: str) -> tuple[xr.Dataset, Splits]:
    """The frames to export, and the splits to write them by: one that is named or all, where the format can tell splits apart."""
    dataset = open_dataset(folder)
    if command.splits is None or name not in IMAGE_KINDS:
        return selected(dataset, command), {}
    splits = read_splits(command.splits, None if command.split is None else [command.split])
    return frames_with(dataset, [selection(command.select)]), splits


def _export_model(command: Export, checkpoint: Path) -> None:
    if command.dataset is not None or command.format is not None:
        raise ConfigError("a dataset or a model is exported, not both", hint="give DATASET and --format, or --onnx CHECKPOINT")
    require("torch", "onnx", extra="train")
    from cabinpose.estimate.export import export_onnx

    name = command.name or command.out.stem
    with progress() as report:
        report.phase("exporting and comparing with torch")
        difference = export_onnx(
            checkpoint, command.out, name=name, card=_card(command.card), mirrored=command.mirrored, overwrite=command.overwrite
        )
    if command.as_json:
        print_json({"out": str(command.out), "format": "onnx", "difference": difference})
    else:
        print(f"{command.out}: differs from torch by at most {difference:.1e}")


def _card(path: Path | None) -> dict[str, Any]:
    return {} if path is None else read_mapping(path, hint="give a YAML file of `key: value` lines with --card")
