"""`cabinpose forget`: the erasure of a subject's takes."""

from __future__ import annotations

import sys

from cabinpose.app.cli.output import print_json, print_table
from cabinpose.app.cli.record_commands import Forget
from cabinpose.app.cli.takes import rows, unknown_note
from cabinpose.app.extras import require
from cabinpose.core.errors import RecordingError


def run(command: Forget) -> None:
    """List what would go; with `confirm`, delete it and say so.

    Raises RecordingError where takes are left that show others beside the subject.
    """
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", extra="record")
    from cabinpose.store.recording import erase, takes_in

    files = takes_in(command.folder)
    shown = [file for file in files if file.shows(command.subject)]
    unknown = [file for file in files if file.take is None]
    going = [file for file in shown if command.shared or not file.others(command.subject)]
    kept = [file for file in shown if file not in going]
    if command.confirm:
        erase(going)
    if command.as_json:
        print_json(
            {
                "subject": command.subject, "deleted" if command.confirm else "would_delete": [str(f.path) for f in going],
                "shared_kept": [str(f.path) for f in kept], "unknown": [str(f.path) for f in unknown],
            }
        )  # fmt: skip
    else:
        if going:
            print(f"{'deleted' if command.confirm else 'would be deleted'}:")
            print_table(rows(going), words=(0, 1, 2, 3, 4))
        if kept:
            print(f"kept, since others than {command.subject} were recorded as well:")
            print_table(rows(kept), words=(0, 1, 2, 3, 4))
        if not shown:
            print(f"no take of {command.subject} in {command.folder}")
        unknown_note(unknown)
    if going and not command.confirm:
        print("nothing was deleted; --confirm deletes for good", file=sys.stderr)
    if kept and command.confirm:
        raise RecordingError(
            f"{len(kept)} takes that show {command.subject} are left",
            hint="--shared deletes these as well, for all who are in them",
        )
