"""The canvas component: a frame in colours, with joints that can be dragged."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal
from weakref import WeakValueDictionary

from fastapi import APIRouter, HTTPException
from nicegui import app
from nicegui.element import Element
from pydantic import BaseModel, Field

from cabinpose.app.view.draw import colour_map

GREY = [[value, value, value] for value in range(256)]  # a palette: black to white
IMAGE_KEYS = "wheel", "zoom; Shift and drag: move; double click: all"  # of every image
MOST_INPUTS = 100  # of a browser in one request


class Input(BaseModel):
    """What somebody did to the image behind `url`: picked a joint, placed one at u, v (px), or pressed a key.

    n: counts what was done in this window · person, joint: what was picked or dragged.
    """

    n: int
    event: Literal["pick", "place", "key"]
    url: str
    person: int = 0
    joint: int = 0
    u: float = 0.0
    v: float = 0.0
    dragged: bool = False
    key: str = ""
    shift: bool = False


class Inputs(BaseModel):
    """Inputs in their order. window: another word for each window that shows the canvas."""

    window: str
    inputs: Annotated[list[Input], Field(max_length=MOST_INPUTS)]


class FrameCanvas(Element, component="canvas.js"):
    """An image of a frame and the joints of its people; zoomed by the wheel, moved with Shift or the middle button.

    What is done to it comes by requests, one at a time, which are answered once it is done: what waits is shown in the window,
    and none is lost without a word however fast they come. Over the page's WebSocket nobody would know.
    """

    def __init__(
        self,
        *,
        editable: bool = False,
        live: bool = False,
        keeps: str = "",
        on_input: Callable[[Input], str] | None = None,
        on_pressed: Mapping[str, Callable[[], Any]] | None = None,
        on_loaded: Callable[[], Any] | None = None,
    ) -> None:
        """live: an image that cannot be had any more leaves the one before · keeps: under which name zoom stands in the address.

        on_input: does what was asked for, and gives why it could not be, or "" · on_pressed: what keys do, by their names in
        browsers, which the image takes wherever on the page nothing else wants them · on_loaded: the browser has an image, or
        knows that it cannot be had.
        """
        super().__init__()
        self.classes("w-full h-full")
        self._props |= {"url": "", "near": 0.0, "far": 2.0, "people": [], "editable": editable, "live": live, "selected": None}
        self._props["keeps"] = keeps
        self._props |= {"limbs": [], "palette": colour_map().tolist(), "inputs": "", "most": MOST_INPUTS}
        self._on_input, self._window, self._taken = on_input, "", 0
        if on_input is not None:
            key = secrets.token_urlsafe()
            self._props["inputs"] = f"/inputs/{key}"
            _LISTENING[key] = self
        if on_pressed is not None:
            self._props["taken"] = list(on_pressed)
            self.on("pressed", lambda event: on_pressed.get(event.args, lambda: None)())
        if on_loaded is not None:
            self.on("loaded", lambda _: on_loaded(), args=[])

    def take(self, given: Inputs) -> dict[str, Any]:
        """Do what is asked for, in order, each once however often it is sent.

        Returns
        -------
        dict
            taken: the number of the last one that is done · missed: how many were meant for the image before, which must not
            touch this one · refused: how many could not be done · why: the last one.
        """
        if given.window != self._window:
            self._window, self._taken = given.window, 0
        missed, refused, why = 0, 0, ""
        for each in given.inputs:
            if each.n <= self._taken:
                continue
            self._taken = each.n
            if each.url != self._props["url"]:
                missed += 1
                continue
            if words := self._done(each):
                refused, why = refused + 1, words
        return {"taken": self._taken, "missed": missed, "refused": refused, "why": why}

    def _done(self, each: Input) -> str:
        assert self._on_input is not None
        try:
            with self:
                return self._on_input(each)
        except Exception as error:  # noqa: BLE001 - a defect of ours: told as NiceGUI tells those of its own events
            app.handle_exception(error)
            return "something went wrong in the studio, which its terminal says"

    def show(
        self,
        url: str,
        *,
        near: float,
        far: float,
        palette: Sequence[Sequence[int]] | None = None,
        ahead: Sequence[str] | None = None,
    ) -> None:
        """Show the image behind a URL of `pictures`, coloured from `near` to `far` in its unit; ahead: those that may be next."""
        self._props |= {"url": url, "near": near, "far": far, "palette": palette or colour_map().tolist()}
        if ahead is not None:
            self._props["ahead"] = list(ahead)
        self.update()

    def set_editable(self, editable: bool) -> None:
        """Whether joints can be dragged."""
        self._props["editable"] = editable
        self.update()

    def focus(self) -> None:
        """Give the image the keyboard."""
        self.run_method("focus")

    def joints(
        self, people: Sequence[Mapping[str, Any]], limbs: Sequence[Sequence[int]], selected: tuple[int, int] | None = None
    ) -> None:
        """Draw people: `colour`, `joints` (each `name`, `u`, `v` or None, maybe `colour`, `doubt`), maybe `dashed`, `fixed`."""
        self._props |= {"people": list(people), "limbs": [list(limb) for limb in limbs], "selected": selected}
        self.update()


_LISTENING: WeakValueDictionary[str, FrameCanvas] = WeakValueDictionary()


def input_routes() -> APIRouter:
    """`/inputs/{key}`: what is done to the canvas of this key."""
    router = APIRouter()

    @router.post("/inputs/{key}")
    async def take(key: str, given: Inputs) -> dict[str, Any]:
        canvas = _LISTENING.get(key)
        if canvas is None or canvas.is_deleted:
            raise HTTPException(404, "this page is closed")
        return canvas.take(given)

    return router
