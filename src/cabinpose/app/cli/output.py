"""What commands print: plain data as JSON, aligned columns for people, and progress on stderr."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any

from cabinpose.app.finite import finite

if TYPE_CHECKING:
    from rich.progress import Progress

    from cabinpose.store.recording import TakeFile

QUIET_S = 2.0  # shorter work shows no progress
LOG_EVERY_S = 10.0  # between lines where stderr is no terminal
_BEAT_S = 0.5  # between checks whether a line is due
_LEAST_SHARE = 0.02  # of the work, before the time left is estimated


def printable(text: object) -> str:
    """The text of something, with its lines, without control characters: in names from files they could control the terminal."""
    return "\n".join("".join(filter(str.isprintable, line)) for line in str(text).split("\n"))


TOLD: list[str] = []
"""The warnings of the command that runs."""


def print_json(data: Mapping[str, Any]) -> None:
    """One JSON object on one line, with the `warnings` of the command if there were any; NaN becomes null."""
    told = {"warnings": [*data.get("warnings", ()), *TOLD]} if TOLD else {}
    print(json.dumps(finite({**data, **told}), allow_nan=False))


def print_rows(rows: Iterable[tuple[str, str]]) -> None:
    """Names and values in two columns."""
    listed = [(_cell(name), _cell(value)) for name, value in rows]
    width = max((len(name) for name, _ in listed), default=0)
    for name, value in listed:
        print(f"{name:<{width}}  {value}")


def print_table(rows: Sequence[Sequence[str]], words: Sequence[int] = (0,)) -> None:
    """Aligned columns: words to the left, numbers to the right."""
    rows = [[_cell(cell) for cell in row] for row in rows]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = (c.ljust(w) if i in words else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        print("  ".join(cells).rstrip())


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


def tell_failed(model: object) -> None:
    """Say on stderr how many frames a detector elsewhere gave no answer for."""
    if failed := getattr(model, "failed", 0):
        print(f"{printable(getattr(model, 'name', model))}: {failed} frames without an answer", file=sys.stderr)


def _cell(text: str) -> str:
    return printable(text).replace("\n", " ")


def listed(counts: Mapping[str, int], most: int | None = None) -> str:
    """Names with their counts, the first `most` of them."""
    names = list(counts)[:most]
    more = f", and {len(counts) - len(names)} more" if len(counts) > len(names) else ""
    return ", ".join(f"{name} {counts[name]}" for name in names) + more


class ProgressReport:
    """Progress of `total` items on stderr: a bar on a terminal, a line every ten seconds elsewhere, nothing for short work."""

    def __init__(self, bar: Progress | None, total: int, unit: str, start: int, *, first: float | None = None) -> None:
        """first: seconds until the first line; default: `QUIET_S`."""
        self._bar = bar
        self._task = bar.add_task("", total=total or None, completed=start, rate="", note="") if bar is not None else None
        self._total, self._unit, self._start = total, unit, start
        self._done, self._note = start, ""
        self._began = time.monotonic()
        self._seen = [(self._began, start)]
        self._logged = self._began - LOG_EVERY_S + (QUIET_S if first is None else first)
        self._lock = Lock()

    def __call__(self, done: int, note: str = "") -> None:
        """Set the number of finished items; `note` is shown beside the rate of this run."""
        with self._lock:
            if self._bar is None:
                self._seen.append((time.monotonic(), done))
            self._done, self._note = done, note
        self.tell()

    def phase(self, name: str) -> None:
        """Name what is being done before the first item, after the last, or where nothing is counted."""
        with self._lock:
            self._note = name
        self.tell()

    def tell(self) -> None:
        """Show the state: on the bar at once, elsewhere as a line if the last line is old enough."""
        with self._lock:
            now = time.monotonic()
            rate = (self._done - self._start) / max(now - self._began, 1e-9)
            speed = f"{rate:.1f} {self._unit}/s" if rate >= 1 else f"{1 / rate:.1f} s each" if rate > 0 else ""
            if self._bar is not None and self._task is not None:
                self._bar.update(self._task, completed=self._done, rate=speed, note=self._note)
            elif now - self._logged >= LOG_EVERY_S:
                count = f"{self._done}/{self._total} {self._unit}" if self._total else ""
                left = self._left(now, self._done) if rate > 0 and self._total else f"{now - self._began:.0f} s"
                print(", ".join(filter(None, (count, speed, left, self._note))), file=sys.stderr)
                self._logged = now

    def _left(self, now: float, done: int) -> str:
        """The time left, from the rate over the second half of the elapsed time (the first half includes preparation).

        Nothing where nothing was finished in that half.
        """
        if done - self._start < _LEAST_SHARE * (self._total - self._start):
            return ""
        middle = (self._began + now) / 2
        then, before = max((seen for seen in self._seen if seen[0] <= middle), key=lambda seen: seen[0])
        self._seen = [seen for seen in self._seen if seen[0] >= then]
        return f"{(self._total - done) * (now - then) / (done - before):.0f} s left" if done > before else ""


@contextmanager
def every(seconds: float, call: Callable[[], None]) -> Iterator[None]:
    """Call something again and again while the block runs, beside it."""
    over = Event()

    def beat() -> None:
        while not over.wait(seconds):
            call()

    thread = Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def progress(total: int = 0, unit: str = "", *, start: int = 0, silent: bool = False) -> Iterator[ProgressReport]:
    """A `ProgressReport` of `total` items, of which `start` exist already; its bar disappears when the block ends.

    A total of 0 is for work in which nothing is counted: it shows the phases. `silent`: it shows nothing.
    """
    if silent:
        yield ProgressReport(None, total, unit, start, first=math.inf)
        return
    if not sys.stderr.isatty():
        report = ProgressReport(None, total, unit, start)
        with every(_BEAT_S, report.tell):
            yield report
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        BarColumn(),
        *((MofNCompleteColumn(),) if total else ()),
        TextColumn("{task.fields[rate]}"),
        TextColumn("{task.fields[note]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield ProgressReport(bar, total, unit, start)
