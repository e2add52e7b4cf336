"""Takes as tables."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from cabinpose.app.cli.output import printable

if TYPE_CHECKING:  # needs the extra `record`, which commands ask for first
    from cabinpose.store.recording import TakeFile


def rows(files: Sequence[TakeFile]) -> list[list[str]]:
    """A head and a line for each file: file, when, subjects and seats, action, car, MB."""
    table = [["file", "recorded", "subjects", "action", "car", "MB"]]
    for file in files:
        if file.take is not None:
            who = ", ".join(f"{s.code} ({s.seat})" if s.seat else s.code for s in file.take.subjects)
            size = f"{file.bytes / 1e6:.1f}"
            table.append([str(file.path), when(file.started_ns), who, file.take.action, file.take.car, size])
    return table


def when(host_ns: int) -> str:
    """A host time for people, in UTC."""
    return datetime.fromtimestamp(host_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC") if host_ns else ""


def unknown_note(files: Sequence[TakeFile]) -> None:
    """Say on stderr of which files it cannot be told whom they show."""
    for file in files:
        print(f"look at this by hand: {printable(file.problem)}", file=sys.stderr)
