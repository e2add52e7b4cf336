"""`cabinpose record`: a take, or the check before it."""

from __future__ import annotations

import dataclasses
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cabinpose.app.cli.output import print_json, print_rows
from cabinpose.app.cli.record_commands import Record
from cabinpose.app.extras import require
from cabinpose.core.clock import HostClock
from cabinpose.core.errors import ConfigError, RecordingError

if TYPE_CHECKING:  # these need the extra `record`, which is asked for first
    from cabinpose.record.config import Rig
    from cabinpose.store.recording import SourceStatus

_REFRESH_S = 0.25


def run(command: Record) -> None:
    """Check, or record until Ctrl-C, the end of the duration, or of all sources."""
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", extra="record")
    from cabinpose.record.config import load_rig, load_take

    rig = load_rig(command.config)
    if command.take is not None:
        rig = dataclasses.replace(rig, take=load_take(command.take))
    if command.check:
        _check(command, rig)
        return
    if command.out is None:
        raise ConfigError("where to record is not said", hint="--out FILE.mcap, or --check to record nothing")
    if command.duration is not None and command.duration <= 0:
        raise ConfigError(f"a take of {command.duration:g} s is none", hint="give --duration more than 0")
    _record(command, rig, command.out)


def _check(command: Record, rig: Rig) -> None:
    from cabinpose.record.check import check

    findings = check(rig, command.out, HostClock())
    missing = sum(bool(finding.problems) for finding in findings)
    if command.as_json:
        print_json({"ready": not missing, "findings": {f.subject: list(f.problems) for f in findings}})
    else:
        print_rows((f.subject, line) for f in findings for line in f.problems or ("ready",))
    if missing:
        raise RecordingError(f"{missing} of {len(findings)} are not ready", hint="mend what is listed, then check again")


def _record(command: Record, rig: Rig, out: Path) -> None:
    from cabinpose.app.cli.panel import panel
    from cabinpose.record.session import begin

    recorder = begin(rig, out, HostClock())
    until = time.monotonic() + (command.duration or float("inf"))
    with _asked_to_stop() as asked, panel(out, command.duration) as show:
        try:
            while recorder.running and time.monotonic() < until and not asked():
                show(recorder.status())
                time.sleep(_REFRESH_S)
        finally:
            outcome = recorder.stop()
    totals = {s.source: dataclasses.asdict(s) for s in outcome.sources}
    if command.as_json:
        print_json({"recording": str(out), "seconds": outcome.seconds, "bytes": outcome.bytes_written, "sources": totals})
    else:
        print(f"{out}: {outcome.seconds:.1f} s, {outcome.bytes_written / 1e6:.1f} MB")
        print_rows((s.source, _counts(s)) for s in outcome.sources)
    if outcome.error is not None:
        raise outcome.error


def _counts(status: SourceStatus) -> str:
    """Samples in the file, and what else came of what was sent, where there is any."""
    others = {
        name: getattr(status, name)
        for name in ("lost", "dropped", "reordered", "duplicate", "malformed", "refused", "restarts")
        if getattr(status, name)
    }
    return f"{status.written} samples" + "".join(f", {count} {name}" for name, count in others.items())


@contextmanager
def _asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed, or the process asked to end, since the block began: the take then ends as it should."""
    asked = False

    def note(*_: object) -> None:
        nonlocal asked
        if asked:
            print("ending the recording", file=sys.stderr)
        asked = True

    before = {kind: signal.signal(kind, note) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
