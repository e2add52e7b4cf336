"""`cabinpose view`: a contact sheet and a page."""

from __future__ import annotations

from pathlib import Path

from cabinpose.app.cli.arguments import is_recording, refuse_selection
from cabinpose.app.cli.commands import View
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.extras import require
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.store.part import disk_errors


def run(command: View) -> None:
    """Draw, and name what was written."""
    if command.frames < 1 or command.rows < 1:
        raise ConfigError("a view shows at least one frame", hint="give --frames and --rows of 1 or more")
    recording = is_recording(command.dataset)
    if not recording and command.out.resolve().is_relative_to(command.dataset.resolve()):
        raise ConfigError("the pictures would lie in the dataset", hint="give another folder with --out")
    sheet, page = command.out / "contact_sheet.png", command.out / "index.html"
    there = [path.name for path in (sheet, page) if path.exists()]
    if there and not command.overwrite:
        raise DatasetError(f"{command.out} already has {' and '.join(there)}", hint="--overwrite replaces them")
    if recording:
        refuse_selection(command, "{} is of datasets, and this is a recording")
        _view_recording(command, sheet, page)
    else:
        _view_dataset(command, sheet, page)
    if command.as_json:
        print_json({"contact_sheet": str(sheet), "page": str(page)})
    else:
        print(f"{sheet}\n{page}")


def _view_dataset(command: View, sheet: Path, page: Path) -> None:
    from cabinpose.app.cli.selection import selected
    from cabinpose.app.view.page import write_view
    from cabinpose.store import open_dataset, read_manifest

    manifest = read_manifest(command.dataset)
    dataset = selected(open_dataset(command.dataset), command)
    with disk_errors(command.out), progress(command.frames + command.rows, "frames") as report:
        command.out.mkdir(parents=True, exist_ok=True)
        write_view(dataset, manifest, command.dataset, sheet, page, frames=command.frames, rows=command.rows, report=report)


def _view_recording(command: View, sheet: Path, page: Path) -> None:
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", extra="record")
    from cabinpose.app.recording.page import write_recording_view

    with disk_errors(command.out), progress(command.frames, "moments") as report:
        write_recording_view(command.dataset, sheet, page, frames=command.frames, rows=command.rows, report=report)
