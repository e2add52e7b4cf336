"""`cabinpose info` of a recording, and of a folder of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cabinpose.app.cli.output import print_json, print_rows, print_table
from cabinpose.app.cli.takes import rows, unknown_note, when
from cabinpose.app.extras import require

if TYPE_CHECKING:  # needs the extra `record`, which is asked for first
    from cabinpose.store.recording import Survey

_EXTRA = ("mcap", "mcap_protobuf", "foxglove_schemas_protobuf")


def takes_of(folder: Path, subject: str, *, as_json: bool) -> None:
    """List the takes of a subject in a folder."""
    require(*_EXTRA, extra="record")
    from cabinpose.store.recording import takes_in

    files = takes_in(folder)
    shown = [file for file in files if file.shows(subject)]
    unknown = [file for file in files if file.take is None]
    if as_json:
        takes = [
            {"file": str(f.path), "started_ns": f.started_ns, "bytes": f.bytes, **f.take.model_dump(mode="json")}
            for f in shown
            if f.take is not None
        ]
        print_json({"subject": subject, "takes": takes, "unknown": [str(f.path) for f in unknown]})
        return
    if shown:
        print_table(rows(shown), words=(0, 1, 2, 3, 4))
    else:
        print(f"no take of {subject} in {folder}")
    unknown_note(unknown)


def recording_info(path: Path, *, as_json: bool) -> None:
    """Print what a recording holds."""
    require(*_EXTRA, extra="record")
    from cabinpose.app.recording.tables import source_rows, topic_rows
    from cabinpose.store.recording import survey

    found = survey(path)
    if as_json:
        print_json(as_data(found))
        return
    take, damage = found.take, found.damage
    who = ", ".join(
        f"{s.code}{f' ({s.seat})' if s.seat else ''}{f', consent {s.consent}' if s.consent else ''}" for s in take.subjects
    )
    state = "whole" if damage.whole else "without its end: `cabinpose recover` gives it one"
    hurt = (
        f"; {damage.chunks} damaged chunks, {damage.skipped_bytes} bytes skipped" if damage.chunks or damage.skipped_bytes else ""
    )
    print_rows(
        [
            ("recording", str(path)),
            ("recorded", f"{when(found.started_ns)}, {found.seconds:.1f} s"),
            ("size", f"{found.bytes / 1e6:.1f} MB, {found.bytes / 1e6 / max(found.seconds, 1e-9):.1f} MB/s"),
            ("take", ", ".join(filter(None, (take.action, take.car))) or "nothing is said of it"),
            ("subjects", who or "none named"),
            ("file", state + hurt),
        ]
    )
    print()
    print_table(source_rows(found))
    errors = [(s.name, s.status.error) for s in found.sources if s.status is not None and s.status.error]
    if errors:
        print()
        print_rows(errors)
    print()
    print_table(topic_rows(found), words=(0, 1))


def as_data(found: Survey) -> dict[str, Any]:
    """A survey as plain data, without the arrival of each sample."""
    return {
        "recording": str(found.path),
        "take": found.take.model_dump(mode="json"),
        "bytes": found.bytes,
        "started_ns": found.started_ns,
        "seconds": found.seconds,
        "damage": dataclasses.asdict(found.damage),
        "sources": {
            s.name: {
                **{key: getattr(s, key) for key in ("samples", "first_ns", "last_ns", "rate_hz", "jitter_ms", "missing")},
                "gaps_s": s.gaps.tolist(),
                "status": None if s.status is None else dataclasses.asdict(s.status),
            }
            for s in found.sources
        },
        "topics": [dataclasses.asdict(t) for t in found.topics],
    }
