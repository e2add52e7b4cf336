"""`cabinpose forget`: erase the takes of a subject."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import PrintsJson
from cabinpose.app.cli.output import print_json, print_takes, print_unknown
from cabinpose.app.extras import require
from cabinpose.core import RecordingError


@dataclass(frozen=True, kw_only=True)
class Forget(PrintsJson):
    """Erase the takes of a subject, at their request: list them, and with --confirm delete them."""

    folder: Annotated[Positional[Path], arg(metavar="FOLDER")]
    """Folder of recordings; the folders within are searched too."""
    subject: str
    """Subject code."""
    confirm: bool = False
    """Delete; without this flag nothing is deleted."""
    shared: bool = False
    """Delete also the takes that show other people beside the subject."""


COMMAND = Forget


def run(command: Forget) -> None:
    """List what would be deleted; with `confirm`, delete it.

    Raises RecordingError where takes are left that show other people beside the subject.
    """
    require("record")
    from cabinpose.store.recording import erase, takes_in

    files = takes_in(command.folder)
    shown = [file for file in files if file.shows(command.subject)]
    unknown = [file for file in files if file.take is None]
    going = [file for file in shown if command.shared or not file.others(command.subject)]
    kept = [file for file in shown if file not in going]
    if command.confirm:
        erase(going)
    if command.as_json:
        lists = {"deleted" if command.confirm else "would_delete": going, "shared_kept": kept, "unknown": unknown}
        print_json({"subject": command.subject, **{name: [str(f.path) for f in some] for name, some in lists.items()}})
    else:
        if going:
            print("deleted:" if command.confirm else "would be deleted:")
            print_takes(going)
        if kept:
            print(f"kept, since others than {command.subject} were recorded as well:")
            print_takes(kept)
        if not shown:
            print(f"no take of {command.subject} in {command.folder}")
        print_unknown(unknown)
    if going and not command.confirm:
        print("nothing was deleted; --confirm deletes for good", file=sys.stderr)
    if kept and command.confirm:
        raise RecordingError(
            f"{len(kept)} takes that show {command.subject} are left",
            hint="--shared deletes these as well, for all who are in them",
        )
