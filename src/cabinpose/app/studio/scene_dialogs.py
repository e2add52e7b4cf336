"""What the Scene tab asks before it acts: files that are opened and saved, a dataset that is made, what Accept lets go."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from cabinpose.app.studio.scene_session import SceneRoom
from cabinpose.core import CabinposeError

Do = Callable[[Callable[[], Any]], Awaitable[None]]
_WRONG = "color: var(--studio-wrong)"


def ask_accept(let_go: list[str], accept: Callable[[], Awaitable[None]]) -> None:
    """Say what of the configuration the scene that is shown takes the place of, and accept it then."""
    with ui.dialog() as dialog, ui.card().style("max-width: 560px"):
        ui.label("Accept writes this one scene out, in place of what it was drawn from:").style("font-weight: 600")
        with ui.column().style("gap: 2px; max-height: 50vh; overflow-y: auto").mark("let go"):
            for words in let_go:
                ui.label(words).style("font: 13px monospace; overflow-wrap: anywhere")
        ui.label("Undo brings it back.").style("font-size: 13px")

        async def take() -> None:
            dialog.close()
            await accept()

        with ui.row():
            ui.button("Accept it", on_click=take).props("no-caps autofocus")
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
    _opened(dialog)


def ask_open(room: SceneRoom, do: Do) -> None:
    """Choose one of the configurations of the folder."""
    with ui.dialog() as dialog, ui.card():
        ui.label(f"Configurations in {room.editor.folder}")

        async def load(name: str) -> None:
            dialog.close()
            await do(lambda: room.editor.load(name))

        for number, name in enumerate(room.editor.files()):
            button = ui.button(name, on_click=lambda name=name: load(name)).props("flat no-caps dense")
            button.props("autofocus" if number == 0 else "")
        ui.button("Close", on_click=dialog.close).props("flat no-caps")
    _opened(dialog)


def ask_save(room: SceneRoom) -> None:
    """Save under a name; what would be overwritten is said first."""
    editor = room.editor
    with ui.dialog() as dialog, ui.card():
        ui.label(f"Save in {editor.folder}")
        name = ui.input("file name", value=editor.file or "scene.yaml").props("dense outlined autofocus")
        over = ui.checkbox("overwrite it", value=False)
        over.set_visibility(False)
        lost = ui.label("Its comments, and the order and form of its keys, are lost then.").style(_WRONG)
        lost.set_visibility(False)

        def renamed() -> None:
            """What was said of the name before is not said of this one."""
            over.value, name.error = False, None
            over.set_visibility(False)
            lost.set_visibility(False)

        def save() -> None:
            try:
                path = editor.save(str(name.value), overwrite=bool(over.value))
            except CabinposeError as error:
                name.error = error.in_one_line()
                over.set_visibility("exists" in str(error))
                lost.set_visibility(over.visible and editor.has_comments(str(name.value)))
                return
            dialog.close()
            words = f"saved {path.name}; `cabinpose synth --config {path.name} --seed {editor.state.seed}` makes it"
            ui.notify(words, position="top")

        name.on_value_change(renamed)
        name.on("keydown.enter", save)
        with ui.row():
            ui.button("Save it", on_click=save).props("no-caps")
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
    _opened(dialog)


def ask_generate(room: SceneRoom, started: Callable[[], None]) -> None:
    """Make a dataset beside the scene."""
    with ui.dialog() as dialog, ui.card():
        ui.label(f"Generate in {room.editor.folder}")
        name = ui.input("folder", value="dataset").props("dense outlined autofocus")
        frames = ui.number("frames", value=100, min=1, step=1, precision=0).props("dense outlined")
        resume = ui.checkbox("go on with what is there", value=False)

        def start() -> None:
            try:
                room.generate(str(name.value), int(frames.value or 0), resume=bool(resume.value))
            except CabinposeError as error:
                name.error = error.in_one_line()
                return
            dialog.close()
            started()

        with ui.row():
            ui.button("Start", on_click=start).props("no-caps")
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
    _opened(dialog)


def _opened(dialog: ui.dialog) -> None:
    dialog.on("hide", dialog.delete)
    dialog.open()
