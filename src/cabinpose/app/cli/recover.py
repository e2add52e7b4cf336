"""`cabinpose recover`: a whole recording of what a crash left."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from cabinpose.app.cli.output import print_json, print_rows, progress
from cabinpose.app.cli.record_commands import Recover
from cabinpose.app.extras import require


def run(command: Recover) -> None:
    """Recover, and say what was saved and what was not."""
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", extra="record")
    from cabinpose.store.recording import recover

    with progress(max(_size(command.recording) // 1_000_000, 1), "MB") as report:
        result = recover(command.recording, command.out, progress=lambda done, _: report(done // 1_000_000))
    damage = result.damage
    if command.as_json:
        print_json({"recording": str(command.out), **dataclasses.asdict(result)})
        return
    seconds = (result.last_ns - result.first_ns) / 1e9
    rows = [
        ("recovered", f"{command.out}: {result.messages} messages over {seconds:.1f} s"),
        *((f"  {source}", f"{count} samples") for source, count in result.samples.items()),
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


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
