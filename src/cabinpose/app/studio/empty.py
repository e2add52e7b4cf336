"""What a tab says where it has nothing to show."""

from __future__ import annotations

from pathlib import Path

from nicegui import ui


def empty_state(title: str, words: str, command: str = "") -> None:
    """A title, what to do, and the command that does it."""
    with ui.column().classes("studio-empty items-center"):
        ui.label(title).style("font-size: 20px")
        ui.label(words)
        if command:
            ui.label(command).classes("studio-key").style("font-family: monospace")


def no_dataset(recording: Path | None, words: str, command: str) -> None:
    """What to do in a tab that shows a dataset while none is open; of a recording, how it becomes one."""
    if recording is None:
        empty_state("No dataset is open", words, command)
        return
    empty_state(
        f"{recording.name} is a recording",
        "The tab Live plays it, and opens frames that you keep as a dataset. With a suit and a calibration it becomes one whole:",
        f"cabinpose align {recording.name} --calibration CALIBRATION.yaml --out DATASET",
    )
