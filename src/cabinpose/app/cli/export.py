"""`cabinpose export`: write a dataset or a recording in another format, or a model as ONNX."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, Suppress, arg

from cabinpose.app.cli.arguments import DatasetArgument, Maybe, PrintsJson, SelectsFrames, is_recording, several
from cabinpose.app.cli.formats import choices, modern, names_of
from cabinpose.app.cli.output import listed, print_json, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, DatasetError

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.store.convert import DatasetFormat


@dataclass(frozen=True, kw_only=True)
class _Export(PrintsJson):
    """Flags of every format."""

    form: ClassVar[Any]
    format: ClassVar[str]
    settings: Annotated[Any, Suppress] = None
    overwrite: bool = False
    """Replace existing files."""


@dataclass(frozen=True, kw_only=True)
class ExportDataset(_Export, SelectsFrames):
    """Flags of formats of datasets. Where the format tells splits apart, --splits without --split writes all, each by itself."""

    dataset: DatasetArgument
    out: Path
    """Folder to write; it appears when the export is complete."""
    labels: Maybe[Path] = None
    """Corrected labels, as the studio writes them (.labels.jsonl)."""


@dataclass(frozen=True, kw_only=True)
class ExportRecording(_Export):
    """Flags of formats of recordings."""

    recording: Annotated[Positional[Path], arg(metavar="RECORDING", help="A recording (.mcap).")]
    out: Path
    """File to write (csv: folder); it appears when the export is complete."""
    source: Annotated[tuple[str, ...], several("NAME [NAME ...]")] = ()
    """Sources to export; default: all, or the only one that has what the format holds."""
    span: Annotated[tuple[float, float] | None, several("FROM TO")] = None
    """Seconds from the start of the take."""


@dataclass(frozen=True, kw_only=True)
class ExportModel(_Export):
    """Flags of formats of models."""

    checkpoint: Annotated[
        Positional[Path], arg(metavar="CHECKPOINT", help="Checkpoint of `cabinpose train`; for --int8 and --whole a model, too.")
    ]
    out: Path
    """File to write."""


COMMAND = choices("write", {"datasets": ExportDataset, "recordings": ExportRecording, "models": ExportModel})
modernised = partial(modern, "export")


def run(command: ExportDataset | ExportRecording | ExportModel) -> None:
    """Export, and name what was written."""
    if isinstance(command, ExportDataset):
        _export_dataset(command)
    elif isinstance(command, ExportRecording):
        _export_recording(command)
    else:
        _export_model(command)


def _export_dataset(command: ExportDataset) -> None:
    from cabinpose.store.convert import write_parts

    if is_recording(command.dataset):
        raise ConfigError(
            f"{command.format} is a format of datasets, and {command.dataset} is no dataset",
            hint=f"recordings go to {', '.join(names_of('write', 'recordings'))}",
        )
    form: DatasetFormat = command.form
    parts, chosen = _parts(command, form)
    counts = {name: part.sizes["frame"] for name, part in parts.items()}
    frames = sum(counts.values())
    with progress(frames, "frames") as report:
        folder = write_parts(form, parts, command.out, command.settings, overwrite=command.overwrite, report=report)
    by_split = {} if "" in counts else {"splits": counts}
    if command.as_json:
        print_json({"out": str(folder), "format": command.format, "frames": frames} | by_split)
        return
    print(f"{folder}: {frames} frames as {command.format}" + (f": {listed(counts)}" if by_split else ""))
    left = chosen - frames
    if left and command.split is None:
        print(f"{left} frames belong to no split and are left out", file=sys.stderr)


def _parts(command: ExportDataset, form: DatasetFormat) -> tuple[dict[str, xr.Dataset], int]:
    """The frames to export, and how many are chosen: by split, one that is named or all, where the format tells splits apart.

    Splits are of the whole dataset, so that its folds are the same ones whatever else is chosen.
    """
    import numpy as np

    from cabinpose.app.cli.selection import frames_with, opened, selected, selection
    from cabinpose.store import read_splits
    from cabinpose.store.convert import CHOSEN_BY

    dataset = opened(command.dataset, command.labels).assign_attrs({CHOSEN_BY: _choice(command)})
    if command.splits is None or not form.tells_splits:
        some = selected(dataset, command)
        return form.parts(some, {}), some.sizes["frame"]
    parts = form.parts(dataset, read_splits(command.splits, None if command.split is None else [command.split]))
    chosen = frames_with(dataset, [selection(command.select)], command.where)["frame"]
    parts = {name: part.isel(frame=np.flatnonzero(np.isin(part["frame"], chosen))) for name, part in parts.items()}
    if empty := [name for name, part in parts.items() if not part.sizes["frame"]]:
        raise DatasetError(f"no frame of split '{empty[0]}' has all that is selected", hint="select more, or give --split NAME")
    return parts, len(chosen)


def _choice(command: ExportDataset) -> str:
    """The flags that choose frames and labels, as they were given, without the folders of their files."""
    files = [f"--{name} {getattr(command, name).name}" for name in ("labels", "splits") if getattr(command, name) is not None]
    words = [f"--{name} {getattr(command, name)}" for name in ("split", "where") if getattr(command, name) is not None]
    return " ".join([*files, *([f"--select {' '.join(command.select)}"] if command.select else []), *words])


def _export_recording(command: ExportRecording) -> None:
    path = command.recording
    if not is_recording(path):
        raise ConfigError(
            f"{command.format} is a format of recordings, and {path} is no recording",
            hint=f"datasets go to {', '.join(names_of('write', 'datasets'))}",
        )
    if command.out.resolve() == path.resolve():
        raise ConfigError(f"{path} is the recording itself", hint="give another file with --out")
    require("record")
    from cabinpose.store.convert import export_recording

    options = vars(command.settings)
    paths = export_recording(
        path, command.format, command.out, sources=command.source, span_s=command.span, overwrite=command.overwrite, **options
    )
    if command.as_json:
        print_json({"out": str(command.out), "format": command.format, "files": [str(each) for each in paths]})
    else:
        for each in paths:
            print(f"{each}: {each.stat().st_size / 1e6:.1f} MB")


def _export_model(command: ExportModel) -> None:
    if command.checkpoint.suffix == ".npz":
        raise ConfigError(f"{command.checkpoint} holds no network", hint="it is the model already: give it to --model")
    if command.out.resolve() == command.checkpoint.resolve():
        raise ConfigError(f"{command.checkpoint} is the model itself", hint="give another file with --out")
    require("train")
    with progress() as report:
        report.phase("exporting and comparing")
        difference = command.form.write(command.checkpoint, command.out, command.settings, overwrite=command.overwrite)
    compared = difference == difference  # NaN where a model has only lost bits
    if command.as_json:
        print_json({"out": str(command.out), "format": command.format, "difference": difference if compared else None})
    elif compared:
        print(f"{command.out}: differs from what it was made of by at most {difference:.1e}")
    else:
        print(f"{command.out}: `cabinpose evaluate` with both models tells what eight bits lose")
