"""The live panel of a take: a line for each source, and the disk."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from cabinpose.record import LaneStatus, RecorderStatus

_LOG_EVERY_S = 10.0  # between lines where stderr is no terminal
_COLUMNS = (
    "source", "state", "rate/s", "jitter ms", "to file ms", "queue", "samples", "lost", "late", "bad", "dropped", "restarts",
)  # fmt: skip
_BAR = 8  # characters of a queue's bar
_STYLES = {"recording": "green", "waiting": "yellow", "retrying": "bold red", "failed": "bold red", "connecting": "yellow"}
_TIGHT_S = 600.0  # a disk that is full sooner is shown in red


@contextmanager
def panel(out: Path, duration: float | None) -> Iterator[Callable[[RecorderStatus], None]]:
    """A function to call with the current state: it draws on a terminal, elsewhere it prints a line every ten seconds."""
    console = Console(stderr=True)
    if console.is_terminal:
        with Live(console=console, auto_refresh=False, transient=True) as live:
            yield lambda status: live.update(drawn(status, out, duration), refresh=True)
        return
    logged = time.monotonic()

    def log(status: RecorderStatus) -> None:
        nonlocal logged
        if time.monotonic() - logged >= _LOG_EVERY_S:
            logged = time.monotonic()
            print(line(status), file=sys.stderr)

    yield log


def line(status: RecorderStatus) -> str:
    """The state in one line of text."""
    lanes = (
        f"{lane.counts.source} {lane.rate_hz:.0f}/s, {lane.counts.lost} lost, {lane.counts.dropped} dropped"
        for lane in status.lanes
    )
    return f"{status.elapsed_s:.0f} s, {status.bytes_written / 1e6:.0f} MB; " + "; ".join(lanes)


def drawn(status: RecorderStatus, out: Path, duration: float | None) -> Panel:
    """The state as rich draws it."""
    table = Table(box=None, expand=True, pad_edge=False, header_style="dim")
    for title in _COLUMNS:
        table.add_column(title, justify="left" if title in ("source", "state", "queue") else "right", no_wrap=True)
    for lane in status.lanes:
        table.add_row(*_row(lane))
    errors = ((lane.counts.source, lane.counts.error) for lane in status.lanes if lane.counts.error)
    problems = [Text.assemble((f"{source}: ", "dim"), (error, "red")) for source, error in errors]
    return Panel(
        Group(_disk(status), Text(), table, *([Text(), *problems] if problems else [])),
        title=f"[bold]{out.name}[/]  {_clock(status.elapsed_s)}" + (f" of {_clock(duration)}" if duration else ""),
        title_align="left",
        subtitle="Ctrl-C ends the take",
        subtitle_align="right",
        border_style="red" if any(lane.counts.dropped for lane in status.lanes) else "blue",
    )


def _row(lane: LaneStatus) -> list[Text]:
    counts = lane.counts
    filled = min(round(lane.queue * _BAR), _BAR)
    style = "red" if lane.queue > 0.8 else "yellow" if lane.queue > 0.4 else "green"
    bar = Text.assemble(("█" * filled, style), ("░" * (_BAR - filled), "dim"), f" {100 * lane.queue:3.0f} %")
    return [
        Text.assemble((counts.source, "bold"), (f" {counts.kind}", "dim")),
        Text(counts.state, _STYLES.get(counts.state, "dim")),
        Text(f"{lane.rate_hz:.1f}"),
        Text(f"{lane.jitter_ms:.2f}"),
        Text(f"{lane.latency_ms:.0f}", "yellow" if lane.latency_ms > 1000 else ""),
        bar,
        Text(str(counts.written)),
        _count(counts.lost, "yellow"),
        _count(counts.reordered + counts.duplicate, "yellow"),
        _count(counts.malformed + counts.refused, "yellow"),
        _count(counts.dropped, "bold red"),
        _count(counts.restarts, "red"),
    ]


def _count(number: int, style: str) -> Text:
    return Text(str(number), style if number else "dim")


def _disk(status: RecorderStatus) -> Text:
    left = status.free_bytes / status.bytes_per_s if status.bytes_per_s > 0 else float("inf")
    room = f"{status.free_bytes / 1e9:.1f} GB free" + (f", full in {_clock(left)}" if left < 360_000 else "")
    return Text.assemble(
        (f"{status.bytes_written / 1e6:,.0f} MB", "bold"),
        f"  {status.bytes_per_s / 1e6:.1f} MB/s  ",
        (room, "red" if left < _TIGHT_S else "dim"),
    )


def _clock(seconds: float) -> str:
    whole = int(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"
