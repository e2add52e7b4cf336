"""The dialog of the Label tab that tells who labelled what, when and how."""

from __future__ import annotations

from nicegui import ui

from cabinpose.app.label.agreement import work_of
from cabinpose.app.label.labelling import Labelling


def history_dialog(labelling: Labelling, row: int, person: str) -> None:
    """Show what was done to a person in a frame, newest first, and who did what in all frames."""
    number, history = int(labelling.numbers[row]), labelling.labels.history
    changes = [c for c in history if (c.frame, c.person) == (number, person)][::-1]
    with ui.dialog() as dialog, ui.card().style("max-width: 760px"):
        ui.label(f"frame {number}, {person}").style("font-weight: 600")
        if not changes:
            ui.label("nothing was changed here")
        rows = [{"time, UTC": c.time[:19], "role": c.role, "how": c.how, "joint": c.joint} for c in changes[:500]]
        if rows:
            ui.table(rows=rows).props("dense flat")
        ui.label("all frames").style("font-weight: 600")
        works = [
            {
                "role": work.role, "frames": work.frames, "joints": work.joints, "first, UTC": work.first[:16],
                "last, UTC": work.last[:16], "how": ", ".join(f"{count} {how}" for how, count in work.how.items()),
            }
            for work in work_of(history)
        ]  # fmt: skip
        if works:
            ui.table(rows=works).props("dense flat wrap-cells").mark("works")
        else:
            ui.label("nobody has labelled yet")
    dialog.on("hide", dialog.delete)
    dialog.open()
