"""`cabinpose recover`: make a whole recording of one that a crash cut short."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import PrintsJson, recording_name
from cabinpose.app.cli.output import print_json, print_rows, progress
from cabinpose.app.extras import require


@dataclass(frozen=True, kw_only=True)
class Recover(PrintsJson):
    """Make a whole recording of one that a crash cut short, or that is damaged."""

    recording: Annotated[Positional[Path], arg(metavar="RECORDING")]
    """The damaged recording; it is not changed."""
    out: Path
    """Recording to write."""


COMMAND = Recover


def run(command: Recover) -> None:
    """Recover, and print what was saved and what was not."""
    require("record")
    from cabinpose.store.recording import recover

    recording_name("--out", command.out)
    source = command.recording
    size = source.stat().st_size if source.exists() else 0
    with progress(max(size // 1_000_000, 1), "MB") as report:
        result = recover(source, command.out, progress=lambda done, _: report(done // 1_000_000))
    damage = result.damage
    if command.as_json:
        print_json({"recording": str(command.out), **dataclasses.asdict(result)})
        return
    seconds = (result.last_ns - result.first_ns) / 1e9
    rows = [
        ("recovered", f"{command.out}: {result.messages} messages over {seconds:.1f} s"),
        *((f"  {name}", f"{count} samples") for name, count in result.samples.items()),
        ("end of file", "was there" if damage.whole else "was missing"),
        ("damaged chunks", str(damage.chunks)),
        ("bytes skipped", str(damage.skipped_bytes)),
    ]
    if damage.unverified:
        rows.append(("unverified", f"{damage.unverified} messages of a chunk that the end of the file cuts"))
    if damage.unfinished:
        rows.append(("unfinished", f"{damage.unfinished} sample at the cut, left out: some of its messages may be missing"))
    if damage.orphans or damage.records:
        rows.append(("left out", f"{damage.orphans} messages of unknown channels, {damage.records} damaged records"))
    print_rows(rows)
