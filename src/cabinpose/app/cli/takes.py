"""Takes of a folder as a table, for `info --subject` and `forget`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from cabinpose.app.cli.output import print_table, printable

if TYPE_CHECKING:
    from cabinpose.store.recording import TakeFile


def print_takes(files: Sequence[TakeFile]) -> None:
    """Print a line for each file: name, time, subjects and seats, action, car, MB."""
    table = [["file", "recorded", "subjects", "action", "car", "MB"]]
    for file in files:
        if file.take is not None:
            who = ", ".join(f"{s.code} ({s.seat})" if s.seat else s.code for s in file.take.subjects)
            size = f"{file.bytes / 1e6:.1f}"
            table.append([str(file.path), when(file.started_ns), who, file.take.action, file.take.car, size])
    print_table(table, words=(0, 1, 2, 3, 4))


def when(host_ns: int) -> str:
    """A host time as text, in UTC; empty for 0."""
    return datetime.fromtimestamp(host_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC") if host_ns else ""


def print_unknown(files: Sequence[TakeFile]) -> None:
    """Print on stderr the files whose subjects cannot be read."""
    for file in files:
        print(f"look at this by hand: {printable(file.problem)}", file=sys.stderr)
