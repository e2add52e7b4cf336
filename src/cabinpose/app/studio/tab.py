"""What a tab of the page is, what it shares with the others, and what it says where it has nothing to show."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from fastapi import APIRouter
from nicegui import ui

from cabinpose.app.studio.workspace import Workspace


class Shared(Protocol):
    """What all browsers share of a tab, and where their images of it come from."""

    def routes(self) -> APIRouter:
        """Addresses of the web application."""

    def stop(self) -> None:
        """The studio ends."""


T = TypeVar("T")


@dataclass
class Page:
    """The page of one browser, as its tabs see it.

    show: brings a tab to the front · renew: the same, after the tabs of the dataset are built anew where another one was opened ·
    front: the name of the tab in front, which alone takes keys · address: what stood in the address when the page was loaded,
    words that anybody may have typed · window: tells the browser's windows apart, the same after a reload · remember: puts words
    into the address, so that a reload finds them; "" takes one away · show_frame: shows a frame, by its number, in the tab Label;
    None while there is nothing to label.
    """

    workspace: Workspace
    shared: Sequence[Shared]
    show: Callable[[str], object]
    renew: Callable[[str], None]
    front: Callable[[], object]
    address: Mapping[str, str]
    window: str
    remember: Callable[[Mapping[str, object]], object]
    show_frame: Callable[[int], None] | None = None

    def of_studio(self, kind: type[T]) -> T:
        """What the browsers share of this type."""
        return next(each for each in self.shared if isinstance(each, kind))

    def remembered(self, name: str, among: Collection[T]) -> T | None:
        """The one of some things whose word stands in the address under a name, None where none does."""
        word = self.address.get(name)
        return None if word is None else next((each for each in among if str(each) == word), None)

    def label(self, number: int) -> None:
        """Open a frame, by its number, to be labelled."""
        self.show("Label")
        if self.show_frame is not None:
            self.show_frame(number)


@dataclass(frozen=True)
class Tab:
    """A tab: its name in the bar, and what builds it on a page.

    keys: what each does there · of_dataset: it is built anew when another dataset is opened · shared: makes what its browsers
    share, once a studio.
    """

    name: str
    build: Callable[[Page], None]
    keys: Sequence[tuple[str, str]] = ()
    of_dataset: bool = False
    shared: Callable[[Workspace], Shared] | None = None


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
