"""The canvas component: a frame in colours, with joints that can be dragged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nicegui.element import Element
from nicegui.events import GenericEventArguments

from cabinpose.app.view.draw import colour_map

GREY = [[value, value, value] for value in range(256)]  # a palette: black to white


class FrameCanvas(Element, component="canvas.js"):
    """An image of a frame and the joints of its people; zoomed by the wheel, moved with Shift or the middle button."""

    def __init__(
        self,
        *,
        editable: bool = False,
        live: bool = False,
        on_pick: Callable[[int, int], Any] | None = None,
        on_place: Callable[[Mapping[str, Any]], Any] | None = None,
        on_key: Callable[[Mapping[str, Any]], Any] | None = None,
        on_loaded: Callable[[], Any] | None = None,
    ) -> None:
        """live: an image that cannot be had any more leaves the one before.

        on_pick: person and joint · on_place: u, v, `dragged`, and the person and joint where one was dragged · on_key: key ·
        on_loaded: the browser has an image, or knows that it cannot be had.
        """
        super().__init__()
        self.classes("w-full h-full")
        self._props |= {"url": "", "near": 0.0, "far": 2.0, "people": [], "editable": editable, "live": live, "selected": None}
        self._props["limbs"], self._props["palette"] = [], colour_map().tolist()
        if on_pick is not None:
            self._listen("pick", lambda arguments: on_pick(int(arguments["person"]), int(arguments["joint"])))
        for event, handler in (("place", on_place), ("key", on_key)):
            if handler is not None:
                self._listen(event, handler)
        if on_loaded is not None:
            self.on("loaded", lambda _: on_loaded(), args=[])

    def _listen(self, event: str, handler: Callable[[Mapping[str, Any]], Any]) -> None:
        """Hand on what was done to the image that is shown now; what was done to the one before must not touch this one."""

        def heard(e: GenericEventArguments) -> Any:
            return handler(e.args) if e.args["url"] == self._props["url"] else None

        self.on(event, heard)

    def show(self, url: str, *, near: float, far: float, palette: Sequence[Sequence[int]] | None = None) -> None:
        """Show the image behind a URL of `pictures`, coloured from `near` to `far` in its unit."""
        self._props |= {"url": url, "near": near, "far": far, "palette": palette or colour_map().tolist()}
        self.update()

    def set_editable(self, editable: bool) -> None:
        """Whether joints can be dragged."""
        self._props["editable"] = editable
        self.update()

    def joints(
        self, people: Sequence[Mapping[str, Any]], limbs: Sequence[Sequence[int]], selected: tuple[int, int] | None = None
    ) -> None:
        """Draw people: `colour`, `joints` (each `name`, `u`, `v` or None, maybe `colour`, `doubt`), maybe `dashed`, `fixed`."""
        self._props |= {"people": list(people), "limbs": [list(limb) for limb in limbs], "selected": selected}
        self.update()
