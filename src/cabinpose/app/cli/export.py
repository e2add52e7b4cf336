"""`cabinpose export`: a dataset, or one of its splits, in another format."""

from __future__ import annotations

from cabinpose.app.cli.commands import Export
from cabinpose.app.cli.output import print_json, progress
from cabinpose.core.errors import ConfigError, unknown_name
from cabinpose.store import open_dataset
from cabinpose.store.convert import export_dataset
from cabinpose.store.split import read_splits, split_dataset


def run(command: Export) -> None:
    """Export with a progress bar and name the folder."""
    if (command.splits is None) != (command.split is None):
        raise ConfigError("a split needs its file and its name", hint="give both --splits FILE and --split NAME")
    dataset = open_dataset(command.dataset)
    if command.splits is not None and command.split is not None:
        splits = read_splits(command.splits)
        if command.split not in splits:
            raise unknown_name("split", command.split, list(splits))
        dataset = split_dataset(dataset, {command.split: splits[command.split]})[command.split]
    frames = dataset.sizes["frame"]
    with progress(frames, "frames") as report:
        folder = export_dataset(dataset, command.format, command.out, overwrite=command.overwrite, report=report)
    if command.as_json:
        print_json({"out": str(folder), "format": command.format, "frames": frames})
    else:
        print(f"{folder}: {frames} frames as {command.format}")
