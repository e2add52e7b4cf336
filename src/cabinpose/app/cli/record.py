"""`cabinpose record`: record the devices of a rig, or check that they are ready."""

from __future__ import annotations

import dataclasses
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import Maybe, PrintsJson, placed, recording_name
from cabinpose.app.cli.interrupt import asked_to_stop
from cabinpose.app.cli.output import print_json, print_rows
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, RecordingError, check_output

if TYPE_CHECKING:  # these need the extra `record`, which is asked for first
    from cabinpose.record import Outcome, Recorder, Rig, Storage
    from cabinpose.store.recording import SourceStatus

_REFRESH_S = 0.25
_FIRST_DATA_S = 2.0  # a source that has sent nothing for so long at the start is told of


@dataclass(frozen=True, kw_only=True)
class Record(PrintsJson):
    """Record the data of a rig's devices in one file (MCAP), until Ctrl-C.

    Only connections that the rig names are opened. A device that disappears is connected again; losses are counted.
    """

    config: Annotated[Positional[Path], arg(metavar="RIG")]
    """The rig (YAML): its sources, how to write, and the take."""
    out: Maybe[Path] = None
    """Recording to write (.mcap)."""
    take: Maybe[Path] = None
    """YAML file of the take (subjects, action, car), in place of the rig's."""
    check: bool = False
    """Check the disk and each source, and record nothing."""
    duration: Maybe[float] = None
    """Stop after so many seconds."""
    split_every: Annotated[Maybe[str], arg(metavar="10min|2GB")] = None
    """Go on in a new file after so long (s, min, h) or so much (MB, GB): FILE.mcap, FILE-001.mcap; in place of the rig's."""


COMMAND = Record
modernised = partial(placed, flag="--config")


def run(command: Record) -> int:
    """Check, or record until Ctrl-C, the end of the duration, or of all sources; 1 where one that is needed fell silent."""
    require("record")
    from cabinpose.record import load_rig, load_take

    rig = load_rig(command.config)
    if command.take is not None:
        rig = dataclasses.replace(rig, take=load_take(command.take))
    if command.split_every is not None:
        rig = dataclasses.replace(rig, storage=_split(rig.storage, command.split_every))
    if command.out is not None:
        recording_name("--out", command.out)
    if command.check:
        _check(command, rig)
        return 0
    if command.out is None:
        raise ConfigError("where to record is not said", hint="--out FILE.mcap, or --check to record nothing")
    if command.duration is not None and not command.duration > 0:
        raise ConfigError(f"a take of {command.duration:g} s is none", hint="give --duration more than 0")
    check_output(command.out, RecordingError, parents=False)
    return _record(command, rig, command.out)


def _split(storage: Storage, text: str) -> Storage:
    """How the recording is written, with another limit of its files."""
    from cabinpose.record import Limit

    try:
        Limit.of(text)
    except ValueError as error:
        raise ConfigError(f"--split-every {text} is no limit of a file", hint=str(error)) from error
    return storage.model_copy(update={"split_every": text})


def _check(command: Record, rig: Rig) -> None:
    from cabinpose.record import check
    from cabinpose.signals import HostClock

    findings = check(rig, command.out, HostClock())
    missing = sum(bool(finding.problems) and finding.required for finding in findings)
    if command.as_json:
        print_json({"ready": not missing, "findings": {f.subject: list(f.problems) for f in findings}})
    else:
        print_rows((f.subject, line) for f in findings for line in f.problems or ("ready",))
    if missing:
        raise RecordingError(f"{missing} of {len(findings)} are not ready", hint="mend what is listed, then check again")


def _record(command: Record, rig: Rig, out: Path) -> int:
    from cabinpose.app.cli.panel import panel
    from cabinpose.record import begin
    from cabinpose.signals import HostClock

    clock = HostClock()
    recorder = begin(rig, out, clock)
    began = clock.now_s()
    until, warned = began + (command.duration or float("inf")), False
    doubted: set[tuple[str, str]] = set()
    with asked_to_stop("ending the recording") as asked, panel(out, command.duration) as show:
        try:
            while recorder.running and clock.now_s() < until and not asked():
                status = recorder.status()
                show(status)
                _warn_of_doubts({lane.counts.source: lane.doubts for lane in status.lanes}, doubted)
                if not warned and clock.now_s() - began > _FIRST_DATA_S:
                    warned = True
                    _warn_of_silence(recorder)
                clock.sleep(min(_REFRESH_S, until - clock.now_s()))
        finally:
            outcome = recorder.stop()
    _warn_of_doubts(outcome.doubts, doubted)
    totals = {s.source: dataclasses.asdict(s) for s in outcome.sources}
    if command.as_json:
        files = [str(file) for file in outcome.files]
        told = {"recording": str(out), "files": files, "seconds": outcome.seconds, "bytes": outcome.bytes_written}
        print_json({**told, "sources": totals})
    else:
        several = f" in {len(outcome.files)} files" if len(outcome.files) > 1 else ""
        print(f"{out}: {outcome.seconds:.1f} s, {outcome.bytes_written / 1e6:.1f} MB{several}")
        print_rows((s.source, _counts(s, outcome.started_ns)) for s in outcome.sources)
    if outcome.error is not None:
        raise outcome.error
    return _told_of_silence(outcome, {plan.name for plan in rig.sources if plan.required})


def _warn_of_silence(recorder: Recorder) -> None:
    for lane in recorder.status().lanes:
        if lane.counts.first_ns is None and lane.counts.state != "ended":
            warnings.warn(f"{lane.counts.source} has sent no data since the take began", stacklevel=2)


def _warn_of_doubts(doubts: Mapping[str, tuple[str, ...]], told: set[tuple[str, str]]) -> None:
    """Warn of what sources are doubted for, each once; they are recorded all the same."""
    for source, words in ((source, each) for source, of_it in doubts.items() for each in of_it):
        if (source, words) not in told:
            told.add((source, words))
            warnings.warn(f"{source}: {words}", stacklevel=2)


def _told_of_silence(outcome: Outcome, required: set[str]) -> int:
    """The exit code of a take that was written: 1 where a source that it needs was silent at its end, which is told."""
    silent = [status.source for status in outcome.sources if status.silent and status.source in required]
    if not silent:
        return 0
    print(f"error: silent at the end of the take: {', '.join(silent)}", file=sys.stderr)
    print("hint: the file is whole; look at the device, or say `required: false` of it in the rig", file=sys.stderr)
    return 1


def _counts(status: SourceStatus, started_ns: int) -> str:
    """Samples in the file, when its data came, and what else came of what was sent, where there is any."""
    others = {
        name: getattr(status, name)
        for name in ("lost", "dropped", "reordered", "duplicate", "malformed", "refused", "restarts")
        if getattr(status, name)
    }
    counts = f"{status.written} samples" + "".join(f", {count} {name}" for name, count in others.items())
    if status.first_ns is not None and status.last_ns is not None:
        counts += f", from {(status.first_ns - started_ns) / 1e9:.2f} s to {(status.last_ns - started_ns) / 1e9:.2f} s"
    return counts + (f"; {status.error}" if status.error else "")
