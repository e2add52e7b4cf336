"""The frames that are chosen, taken out of the studio: as a dataset, or as a split."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from nicegui import run, ui
from numpy.typing import NDArray

from cabinpose.app.studio.workspace import Workspace
from cabinpose.core import CabinposeError, ConfigError, write_whole
from cabinpose.store import open_dataset, told_apart
from cabinpose.store.convert import CHOSEN_BY, export_dataset

_NAME = re.compile(r"\w[\w .-]*")


class Choice(NamedTuple):
    """numbers: (F,) of the frames that are chosen · words: what chose them."""

    numbers: NDArray[np.int64]
    words: str


class ChoiceDialog:
    """A dialog that writes the frames that are chosen beside the dataset; nothing is replaced."""

    def __init__(self, workspace: Workspace, choice: Callable[[], Choice]) -> None:
        assert workspace.folder is not None
        self._workspace, self._choice, self._done = workspace, choice, 0
        with ui.dialog() as self._dialog, ui.card().style("width: 440px"):
            self._told = ui.label().style("font-weight: 600")
            self._by = ui.label().style("font-size: 13px; opacity: .8; overflow-wrap: anywhere")
            self._name = ui.input("name", value=f"{workspace.folder.resolve().name}-chosen").props("outlined dense autofocus")
            self._name.classes("w-full").mark("choice name").on("keydown.enter", self._as_dataset)
            self._labels = ui.checkbox("with the labels that were corrected")
            with ui.row().classes("w-full").style("gap: 8px"):
                self._buttons = [
                    ui.button("As a dataset", icon="save", on_click=self._as_dataset).props("no-caps unelevated"),
                    ui.button("As a split", icon="call_split", on_click=self._as_split).props("no-caps outline"),
                ]
            ui.label("A split has these frames in test and the others in train, for train and evaluate --splits.").style(
                "font-size: 13px; opacity: .8"
            )
            self._progress = ui.linear_progress(value=0, show_value=False)
        self._progress.visible = False

    def open(self) -> None:
        """Say what is chosen, and ask for a name."""
        choice = self._choice()
        self._told.text = f"Chosen frames: {len(choice.numbers)}"
        self._by.text = choice.words or "all of them"
        self._dialog.open()

    async def _as_dataset(self) -> None:
        if self._progress.visible:
            return  # Enter, again
        choice = self._choice()
        self._done, self._progress.visible = 0, True
        for button in self._buttons:
            button.disable()
        watch = ui.timer(0.3, lambda: self._progress.set_value(self._done / max(len(choice.numbers), 1)))
        try:
            path = new_path(self._workspace, str(self._name.value or ""))
            labels = bool(self._labels.value)
            if (
                await run.io_bound(partial(as_dataset, self._workspace, choice, path, labels=labels, report=self._report))
                is not None
            ):
                self._say(f"{path.name}: {len(choice.numbers)} frames; cabinpose studio {path.name} opens it")
        except (CabinposeError, OSError) as error:
            _refuse(error)
        finally:
            watch.cancel()
            self._progress.visible = False
            for button in self._buttons:
                button.enable()

    def _report(self, done: int) -> None:
        self._done = done

    def _as_split(self) -> None:
        try:
            path = new_path(self._workspace, f"{(self._name.value or '').removesuffix('.yaml')}.yaml")
            told = as_split(self._workspace, self._choice(), path)
        except (CabinposeError, OSError) as error:
            _refuse(error)
            return
        self._say(f"{path.name}: {told}")

    def _say(self, words: str) -> None:
        self._dialog.close()
        ui.notify(words, type="positive", multi_line=True, timeout=10_000)


def new_path(workspace: Workspace, name: str) -> Path:
    """A path beside what is open at which there is nothing. Raises ConfigError."""
    if not _NAME.fullmatch(name):
        raise ConfigError(f"'{name}' is no name", hint="give letters, digits, - and _")
    path = workspace.root / name
    if path.exists():
        raise ConfigError(f"{name} is there already", hint="give another name")
    return path


def as_dataset(
    workspace: Workspace, choice: Choice, path: Path, *, labels: bool, report: Callable[[int], None] = lambda _: None
) -> Path:
    """Write frames as they are on the disk, since what is open was filled in for the eye; labels: with those that were corrected.

    Raises DatasetError; ConfigError for no frames.
    """
    assert workspace.folder is not None
    workspace.check()
    stored = open_dataset(workspace.folder, missing="ignore")
    words = f"{choice.words} --labels".strip() if labels else choice.words
    dataset = (workspace.corrected(stored) if labels else stored).assign_attrs({CHOSEN_BY: words})
    rows = np.flatnonzero(np.isin(stored["frame"].values, choice.numbers))
    if not rows.size:
        raise ConfigError("no frame is chosen", hint="choose some")
    return export_dataset(dataset.isel(frame=rows), "dataset", path, report=report)


def as_split(workspace: Workspace, choice: Choice, path: Path) -> str:
    """Write splits whose `test` are these frames, `train` the others; how they are told apart. Raises DatasetError."""
    assert workspace.dataset is not None
    splits, left_out = told_apart(workspace.dataset, np.isin(workspace.dataset["frame"].values, choice.numbers))
    plain = {name: {key: list(values) for key, values in split.items()} for name, split in splits.items()}
    write_whole(path, yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, allow_unicode=True))
    left = f", {left_out} frames belong to neither" if left_out else ""
    return f"test and train, told apart by {next(iter(splits['test']))}{left}"


def _refuse(error: Exception) -> None:
    words = error.in_one_line() if isinstance(error, CabinposeError) else str(error)
    ui.notify(words, type="negative", multi_line=True, timeout=10_000)
