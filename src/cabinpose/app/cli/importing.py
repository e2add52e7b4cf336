"""`cabinpose import`: a dataset of the standard from one in another format, or a recording from another tool's file."""

from __future__ import annotations

import sys

from cabinpose.app.cli.exchange_commands import Import
from cabinpose.app.cli.output import print_json, printable, progress
from cabinpose.app.cli.recording_exchange import import_recording
from cabinpose.core.errors import ConfigError, unknown_name
from cabinpose.store.convert import IMPORTS, RECORDING_IMPORTS, open_source
from cabinpose.store.convert.reading import ImportOptions
from cabinpose.store.source import check_new_dataset, import_source


def run(command: Import) -> None:
    """Import with a progress bar and name what was written."""
    if import_recording(command):
        return
    if command.format not in IMPORTS:
        raise unknown_name("format", command.format, (*IMPORTS, *RECORDING_IMPORTS))
    for flag, given, name in (("--images", command.images is not None, "coco"), ("--keep-invalid", command.keep_invalid, "itop")):
        if given and command.format != name:
            raise ConfigError(f"{flag} is of the format {name}, not {command.format}", hint=f"leave out {flag}")
    check_new_dataset(command.out, overwrite=command.overwrite)
    options = ImportOptions(command.keep_invalid, command.intrinsics, command.images, command.licence)
    source = open_source(command.source, command.format, options)
    if source.note:
        print(printable(source.note), file=sys.stderr)
    frames = source.manifest.frames
    with progress(frames, "frames") as report:
        folder = import_source(source, command.out, overwrite=command.overwrite, report=report)
    if command.as_json:
        variables = list(source.manifest.variables)
        print_json({"out": str(folder), "format": command.format, "frames": frames, "variables": variables})
    else:
        print(f"{folder}: {frames} frames of {command.format}")
        print(f"see what it holds with: cabinpose info {folder}", file=sys.stderr)
