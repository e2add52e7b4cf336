"""What a tab says where it has nothing to show."""

from __future__ import annotations

from nicegui import ui


def empty_state(title: str, words: str, command: str = "") -> None:
    """A title, what to do, and the command that does it."""
    with ui.column().classes("studio-empty items-center"):
        ui.label(title).style("font-size: 20px")
        ui.label(words)
        if command:
            ui.label(command).classes("studio-key").style("font-family: monospace")
