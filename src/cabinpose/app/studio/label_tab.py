"""The Label tab: a model proposes, the person corrects, and everything is on the disk at once."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui

from cabinpose.app.label.labelling import Labelling, Shown, Undone
from cabinpose.app.studio.canvas import GREY, IMAGE_KEYS, FrameCanvas, Input
from cabinpose.app.studio.clouds import person_colour
from cabinpose.app.studio.exchange import Exchange, Passing
from cabinpose.app.studio.label_history import history_dialog
from cabinpose.app.studio.models import choices, first_choice, frame_errors, load_choice, worst_first
from cabinpose.app.studio.pictures import DEPTHS, GREYS
from cabinpose.app.studio.tab import Page, Tab, empty_state, no_dataset
from cabinpose.app.studio.workspace import depth_range
from cabinpose.app.view.draw import VISIBILITY_COLOUR
from cabinpose.core import CabinposeError, Visibility, skeleton_with

_COLOUR = {state: "#{:02x}{:02x}{:02x}".format(*rgb) for state, rgb in VISIBILITY_COLOUR.items()}
_STATE_KEYS = {
    "v": Visibility.VISIBLE, "s": Visibility.SELF_OCCLUDED, "h": Visibility.OCCLUDED, "o": Visibility.OUTSIDE_IMAGE,
    "x": Visibility.ABSENT,
}  # fmt: skip
_STATE_WORDS = {
    Visibility.VISIBLE: "visible", Visibility.SELF_OCCLUDED: "self-occluded", Visibility.OCCLUDED: "hidden",
    Visibility.OUTSIDE_IMAGE: "outside", Visibility.ABSENT: "absent",
}  # fmt: skip
_HIDDEN = (Visibility.SELF_OCCLUDED, Visibility.OCCLUDED)
_NUDGE = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowUp": (0, -1), "ArrowDown": (0, 1)}
_KEYS = (
    ("click", "place the chosen joint, and go to the next"), ("drag", "move a joint"),
    ("Tab", "next joint; Shift: the one before"),
    ("v s h o x", "visible, self-occluded, hidden (its place is guessed), outside, absent"),
    ("arrows", "move it by 1 px; Shift: 5 px"),
    ("Enter", "accept all that is shown, and go to the next frame"), ("c", "copy from the last labelled frame"),
    ("i", "interpolate up to the next labelled frame"), ("z", "undo"), ("f b", "next frame, the one before"),
    ("Esc", "leave the image: Tab goes through the page"),
    IMAGE_KEYS,
)  # fmt: skip
_ORDERS = {"order": "in order", "unsure": "unsure first", "open": "not labelled yet"}
_WORST = "worst:"  # and the name of predictions
_REFUSED = object()  # of a change that could not be kept
_REDRAW_S = 0.15  # between two drawings while changes come faster: what is drawn takes thirty times as long as a change


class LabelTab:
    """The tab of one browser."""

    def __init__(self, page: Page, labelling: Labelling) -> None:
        self._page, self._workspace, self._labelling = page, page.workspace, labelling
        self._dataset = labelling.dataset
        self._person = labelling.persons[0]
        self._chosen = 0
        self._queue = list(range(len(labelling.numbers)))
        self._position = 0
        self._orderings = 0  # that were asked for: the last one holds
        self._changes_seen = len(labelling.labels.history)
        self._drawn_at = 0.0
        self._redraw: asyncio.TimerHandle | None = None
        self._refusal = self._told = ""  # why what was asked for last could not be done; what a message said
        self._rows: list[_JointRow] = []
        self._remembered: dict[str, object] = {}  # what stands in the address
        with ui.row().classes("studio-tab no-wrap w-full"):
            with ui.column().classes("studio-side"):
                self._build_side()
            with ui.column().classes("studio-main"):
                self._trouble = ui.label().classes("studio-news w-full").mark("trouble")
                self._trouble.visible = False
                with ui.element("div").classes("studio-pane w-full"):
                    self._canvas = FrameCanvas(editable=True, keeps="label.zoom", on_input=self._input)
                with ui.row().classes("no-wrap items-center w-full").style("gap: 10px; padding: 0 4px"):
                    ui.button(icon="chevron_left", on_click=lambda: self._go(-1)).props(
                        "flat round dense aria-label='the frame before'"
                    ).tooltip("b")
                    self._slider = ui.slider(min=0, max=max(len(self._queue) - 1, 1), value=0, on_change=self._slid)
                    self._slider.style("flex: 1")
                    ui.button(icon="chevron_right", on_click=lambda: self._go(1)).props(
                        "flat round dense aria-label='next frame'"
                    ).tooltip("f")
                    self._number = ui.label().style("min-width: 230px; text-align: right; font-variant-numeric: tabular-nums")
        ui.timer(0.0, self._go_on, once=True)
        ui.timer(1.0, self._look_for_others)

    async def _go_on(self) -> None:
        """Show the frame, in the order of frames, that stand in the address."""
        number = self._page.remembered("label.frame", self._labelling.numbers.tolist())
        await self._reorder(self._row if number is None else self._labelling.row(number))

    @property
    def _row(self) -> int:
        return self._queue[self._position]

    def _build_side(self) -> None:
        labelling = self._labelling
        begin = self._page.remembered("label.proposals", choices(self._workspace)) or first_choice(self._workspace)
        labelling.use(load_choice(self._workspace, begin))
        self._model = ui.select(choices(self._workspace), value=begin, label="proposals from", on_change=self._use_model)
        self._model.props("dense outlined").classes("w-full").mark("proposals")
        persons = list(labelling.persons)
        self._person = self._page.remembered("label.person", persons) or self._person
        self._people = ui.select(persons, value=self._person, label="person", on_change=self._set_person)
        self._people.props("dense outlined").classes("w-full").mark("person")
        sets = list(labelling.sets)
        joints = self._page.remembered("label.joints", sets) or sets[0]
        labelling.joints = labelling.sets[joints]
        self._joints = ui.select(sets, value=joints, label="joints", on_change=self._set_joints).props("dense outlined")
        self._joints.classes("w-full").mark("joint set")
        order = self._page.remembered("label.order", self._orders()) or "order"
        self._order = ui.select(self._orders(), value=order, label="frames", on_change=self._new_order).props("dense outlined")
        self._order.classes("w-full").mark("order")
        images = [name for name in (*DEPTHS, *GREYS) if name in self._dataset]
        self._image = ui.select(images, value="depth", label="image", on_change=self._chose_image).props("dense outlined")
        self._image.classes("w-full")
        with ui.row().classes("no-wrap w-full items-center").style("gap: 14px; padding: 0 14px 0 2px"):
            ui.label("colours").style("font-size: 13px; opacity: .8")
            self._contrast = ui.range(min=0.0, max=1.0, step=0.01, value={"min": 0.0, "max": 1.0}, on_change=self._show)
            self._contrast.style("flex: 1").tooltip("from the nearest to the farthest depth that is coloured").mark("colours")
        self._list = ui.column().classes("w-full").style("gap: 0")
        with ui.row().classes("no-wrap w-full").style("gap: 6px"):
            self._changing = [
                ui.button(words, on_click=lambda key=key: self._press(key))
                .props("dense outline no-caps")
                .style("flex: 1; font-size: 12px")
                .tooltip(key)
                for words, key in (("Accept", "Enter"), ("Copy", "c"), ("Interpolate", "i"), ("Undo", "z"))
            ]
        with ui.row().classes("no-wrap w-full items-center"):
            self._saved = ui.label().style("font-size: 12px; opacity: .7; flex: 1")
            Exchange(self._workspace, self._labelling, self._page.of_studio(Passing), self._show)
            ui.button(icon="history", on_click=self._history).props("flat round dense").tooltip("who labelled what, and when")

    # ------------------------------------------------------------------------------------------------ what is asked for

    def _input(self, given: Input) -> str:
        """Do what was done to the image; why it could not be, or ""."""
        self._refusal = ""
        if given.event == "pick":
            self._pick(given.person, given.joint)
        elif given.event == "place":
            self._place(given)
        else:
            self._key(given.key, shift=given.shift)
        return self._refusal

    def _pick(self, person: int, joint: int) -> None:
        if person == 0:
            self._chosen = joint % len(self._labelling.joints)
            self._show_soon()

    def _place(self, where: Input) -> None:
        if where.dragged:
            self._chosen = where.joint % len(self._labelling.joints)
        if not np.isfinite([where.u, where.v]).all():
            return
        joint = self._labelling.joints[self._chosen]
        kept = self._do(lambda: self._labelling.place(self._row, self._person, joint, where.u, where.v)) is not _REFUSED
        if kept and not where.dragged:
            self._next_joint()
        self._show_soon()

    def _press(self, key: str) -> None:
        self._key(key)
        self._canvas.focus()

    def _chose_image(self) -> None:
        self._show()
        self._canvas.focus()

    def _key(self, key: str, *, shift: bool = False) -> None:
        labelling, joint = self._labelling, self._labelling.joints[self._chosen]
        if key == "Enter":
            if self._do(lambda: labelling.accept(self._row, self._person)) is not _REFUSED:
                self._go(1)
            return
        if key in ("f", "b"):
            self._go(1 if key == "f" else -1)
            return
        if key == "Tab":
            self._next_joint(-1 if shift else 1)
        elif key in _STATE_KEYS:
            if self._do(lambda: labelling.mark(self._row, self._person, joint, _STATE_KEYS[key])) is not _REFUSED:
                self._next_joint()
        elif key in _NUDGE:
            self._nudge(joint, *_NUDGE[key], 5 if shift else 1)
        elif key == "c" and not self._do(lambda: labelling.copy(self._row, self._person)):
            ui.notify("no frame before this one is labelled whole")
        elif key == "i" and not self._do(lambda: labelling.interpolate(self._row, self._person)):
            ui.notify("interpolating needs a labelled frame before this one and one after, of one sequence, person, car and view")
        elif key == "z":
            self._undo()
        self._show_soon()

    def _undo(self) -> None:
        undone = self._do(self._labelling.undo)
        if undone is None:
            ui.notify("nothing to undo")
        elif isinstance(undone, Undone) and undone.kept:
            ui.notify(
                f"{undone.joints} joints undone; {undone.kept} stay: they were set in another window since",
                type="warning", timeout=10_000,
            )  # fmt: skip

    def _look_for_trouble(self) -> None:
        """Where dataset or journal are gone, or others: say so and take nothing; once they are back, go on."""
        try:
            self._labelling.check()
            words = ""
        except CabinposeError as error:
            words = f"Nothing more is taken: {error.in_one_line()}"
        if words != self._trouble.text:
            self._trouble.text, self._trouble.visible = words, bool(words)
            self._canvas.set_editable(not words)
            for button in self._changing:
                button.set_enabled(not words)

    def _do(self, change: Callable[[], Any]) -> Any:
        """Make a change, and give what it gives; one that cannot be kept is told, and `_REFUSED`."""
        try:
            given = change()
        except CabinposeError as error:
            self._refusal = error.in_one_line()
            if self._refusal != self._told:  # not for each of a burst
                ui.notify(self._refusal, type="negative", multi_line=True, timeout=10_000)
                self._look_for_trouble()
            self._told = self._refusal
            return _REFUSED
        self._told = ""
        return given

    def _nudge(self, joint: str, du: int, dv: int, step: int) -> None:
        label = next(s.label for s in self._labelling.shown(self._row, self._person) if s.joint == joint)
        if label is not None and np.isfinite(label.uv).all():
            u, v = label.uv
            self._do(lambda: self._labelling.place(self._row, self._person, joint, u + step * du, v + step * dv))

    def _next_joint(self, step: int = 1) -> None:
        self._chosen = (self._chosen + step) % len(self._labelling.joints)

    async def _set_person(self, event: Any) -> None:
        if str(event.value) == self._person:
            return  # with the frame that was asked for
        self._person, self._chosen = str(event.value), 0
        await self._reorder(self._row)

    async def _set_joints(self, event: Any) -> None:
        self._labelling.joints, self._chosen = self._labelling.sets[str(event.value)], 0
        self._labelling.use(self._labelling.model)  # proposals of these joints
        await self._reorder(self._row)

    def _history(self) -> None:
        history_dialog(self._labelling, self._row, self._person)

    async def _use_model(self) -> None:
        value = self._model.value
        try:
            model = await run.io_bound(load_choice, self._workspace, value)
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True)
            if value == self._model.value:
                self._model.value = ""
            return
        if value != self._model.value:
            return  # another one was chosen meanwhile
        if model is not None and not set(model.persons) & set(self._labelling.persons):
            whom, here = (", ".join(persons) for persons in (model.persons, self._labelling.persons))
            ui.notify(f"it proposes nothing: it knows {whom}; here are {here}", type="warning", multi_line=True, timeout=10_000)
        self._labelling.use(model)
        await self._reorder(self._row)

    async def _new_order(self) -> None:
        await self._reorder()

    async def _reorder(self, at: int | None = None) -> None:
        """Bring the frames into the order that is asked for, and show the first, or the one of a row if it is among them.

        Unsure ones first needs the model on all of them. What is known at once is shown at once: keys and drags that come
        meanwhile are for the person and the joints that are seen.
        """
        self._orderings = asked = self._orderings + 1
        self._show()
        begin = self._row
        rows = list(range(len(self._labelling.numbers)))
        if self._order.value == "unsure":
            rows = await self._unsure(rows)
        elif self._order.value == "open":
            rows = [row for row in rows if not self._labelling.done(row, self._person)]
            if not rows:
                ui.notify(f"all frames of {self._person} are labelled: here they are in order", type="positive")
                rows = list(range(len(self._labelling.numbers)))
        elif str(self._order.value).startswith(_WORST):
            rows = await self._worst(str(self._order.value).removeprefix(_WORST)) or rows
        if asked != self._orderings:
            return  # another order, of another person or by another model, was asked for meanwhile
        at = self._row if self._row != begin else at  # where somebody went meanwhile
        self._queue = rows
        self._position = self._queue.index(at) if at in self._queue else 0
        self._show()
        self._canvas.focus()

    async def _unsure(self, rows: list[int]) -> list[int]:
        """The rows, the one first of which the model is least sure; as they are where it cannot look at them."""
        if self._labelling.model is None:
            ui.notify("choose what proposals come from: its doubts give the order")
            return rows
        looking = ui.notification("looking at all frames", spinner=True, timeout=None)
        try:
            return await run.io_bound(self._labelling.unsure, rows) or rows
        except (CabinposeError, OSError) as error:
            ui.notify(f"frames cannot be read: {self._workspace.trouble() or error}", type="negative", multi_line=True)
            return rows
        finally:
            looking.dismiss()

    async def _worst(self, predictions: str) -> list[int]:
        """All rows, the one first in which these predictions of the person are worst; none where they cannot be judged."""
        try:
            errors = await run.io_bound(frame_errors, self._workspace, self._dataset, predictions, self._person)
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True)
            return []
        return [] if errors is None else worst_first(errors.d).tolist()

    def _orders(self) -> dict[str, str]:
        return _ORDERS | {_WORST + name: f"worst of {name} first" for name in self._workspace.predictions}

    def show_frame(self, number: int) -> None:
        """Show the frame of this number, where it stands in the order of frames; here, where it does not.

        Of somebody who is there, where the person that is labelled is not.
        """
        row = self._labelling.row(number)
        there = self._labelling.people(row)
        if there and self._person not in there:
            self._person = there[0]
            self._people.value = there[0]
        if row not in self._queue:
            self._queue.insert(self._position, row)
        self._position, self._chosen = self._queue.index(row), 0
        self._show()

    def _slid(self, event: Any) -> None:
        if int(event.value) != self._position:
            self._position = min(int(event.value), len(self._queue) - 1)
            self._chosen = 0
            self._show()

    def _go(self, step: int) -> None:
        self._position = min(max(self._position + step, 0), len(self._queue) - 1)
        self._chosen = 0
        self._show()

    def _look_for_others(self) -> None:
        """Show what another tab has changed, and offer the predictions that it opened; say where changes cannot be kept."""
        self._look_for_trouble()
        if (orders := self._orders()) != self._order.options:
            self._order.set_options(orders)
            self._model.set_options(choices(self._workspace))
        if len(self._labelling.labels.history) != self._changes_seen:
            self._show()

    # ------------------------------------------------------------------------------------------------ what is shown

    def _show_soon(self) -> None:
        """Show what has changed within one frame: at once, unless it was shown just now."""
        wait = self._drawn_at + _REDRAW_S - time.monotonic()
        if wait <= 0:
            self._show()
        elif self._redraw is None:
            self._redraw = asyncio.get_running_loop().call_later(wait, self._show_now)

    def _show_now(self) -> None:
        if not self._canvas.is_deleted:
            with self._canvas:
                self._show()

    def _show(self) -> None:
        if self._redraw is not None:
            self._redraw.cancel()
            self._redraw = None
        try:
            self._show_frame()
        except (CabinposeError, OSError) as error:
            ui.notify(f"this frame cannot be read: {self._workspace.trouble() or error}", type="negative", multi_line=True)

    def _show_frame(self) -> None:
        self._drawn_at = time.monotonic()
        labelling, row = self._labelling, self._row
        self._remember()
        self._changes_seen = len(labelling.labels.history)
        shown = labelling.shown(row, self._person)
        limbs = skeleton_with(labelling.joints).limbs
        colour = person_colour(labelling.persons.index(self._person))
        whole = {"colour": colour, "joints": [_drawn(s) for s in shown], "dashed": not all(s.origin == "label" for s in shown)}
        self._canvas.joints([whole], limbs, (0, self._chosen))
        self._show_image(row)
        done = labelling.done(row, self._person)
        self._slider.props(f"max={max(len(self._queue) - 1, 1)}")
        self._slider.value = self._position
        place = f"frame {labelling.numbers[row]}, {self._position + 1} of {len(self._queue)}"
        self._number.text = place + (", done" if done else "")
        self._show_joints(shown)
        whole_frames = len(labelling.key_frames(self._person))
        self._saved.text = (
            f"{whole_frames} of {len(labelling.numbers)} frames done; {len(labelling.labels.history)} changes in "
            f"{labelling.labels.path.name}"
        )

    def _remember(self) -> None:
        """Put what is shown into the address, where it is not what one begins with."""
        controls = {"proposals": self._model, "person": self._people, "joints": self._joints, "order": self._order}
        words = {name: select.value for name, select in controls.items()} | {"frame": self._labelling.numbers[self._row]}
        if words != self._remembered:
            self._remembered = words
            self._page.remember({f"label.{name}": word for name, word in words.items()})

    def _show_joints(self, shown: Sequence[Shown]) -> None:
        if [each.joint for each in self._rows] != [each.joint for each in shown]:
            self._list.clear()
            with self._list:
                self._rows = [_JointRow(each.joint, partial(self._pick, 0, index)) for index, each in enumerate(shown)]
        for index, (row, each) in enumerate(zip(self._rows, shown, strict=True)):
            row.show(each, chosen=index == self._chosen)

    def _show_image(self, row: int) -> None:
        name, chosen = self._image.value, self._contrast.value
        if name in DEPTHS:
            low, high = depth_range(self._dataset, row)
        else:
            low, high = 0.0, float(np.quantile(self._dataset[name][row].values, 0.995)) or 1.0
        near, far = low + chosen["min"] * (high - low), low + chosen["max"] * (high - low)
        url = self._workspace.url(int(self._labelling.numbers[row]), str(name))
        self._canvas.show(url, near=near, far=far, palette=GREY if name in GREYS else None)


class _JointRow:
    """A joint in the list. Only what is another is sent: while somebody labels, most of twenty rows stay as they are."""

    def __init__(self, joint: str, on_click: Callable[[], Any]) -> None:
        self.joint = joint
        self._now: tuple[Any, ...] | None = None
        self._row = ui.row().classes("studio-joint no-wrap items-center w-full").on("click", on_click, args=[])
        with self._row:
            self._dot = ui.element("div").style("width: 10px; height: 10px; border-radius: 5px")
            ui.label(joint).style("flex: 1")
            with ui.icon("warning", color="pink") as self._warning:
                self._doubt = ui.tooltip()
            self._state = ui.label().style("font-size: 12px; opacity: .8")
            self._origin = ui.label().style("opacity: .7; font-size: 12px; min-width: 52px; text-align: right")

    def show(self, shown: Shown, *, chosen: bool) -> None:
        """shown: of this joint."""
        state = shown.label.visibility if shown.label is not None else Visibility.ABSENT
        if (now := (state, shown.doubt, shown.origin, chosen)) == self._now:
            return
        self._now = now
        self._dot.style(f"background: {_COLOUR.get(state, '#0000')}")
        self._warning.visible, self._doubt.text = bool(shown.doubt), shown.doubt
        self._state.text = _STATE_WORDS[state] if shown.label is not None else ""
        self._origin.text = {"label": "", "none": "to place"}.get(shown.origin, shown.origin)
        self._row.style("background: " + ("#2f6f9f44" if chosen else "#0000"))


def _drawn(shown: Shown) -> dict[str, Any]:
    label = shown.label
    there = label is not None and np.isfinite(label.uv).all()
    return {
        "name": shown.joint,
        "u": float(label.uv[0]) if label is not None and there else None,
        "v": float(label.uv[1]) if label is not None and there else None,
        "colour": _COLOUR.get(label.visibility, "#808080") if label is not None else "#808080",
        "doubt": bool(shown.doubt),
        "hidden": label is not None and label.visibility in _HIDDEN,
    }


def _build(page: Page) -> None:
    workspace, page.show_frame = page.workspace, None
    if workspace.dataset is None:
        no_dataset(workspace.recording, "Open the dataset whose joints are to be labelled:", "cabinpose studio DATASET")
        return
    try:
        labelling = Labelling(workspace.dataset, workspace.labels, workspace.role, workspace.new_frames, page.window)
    except CabinposeError as error:
        empty_state("The labels cannot be opened", str(error), error.hint or "")
        return
    page.show_frame = LabelTab(page, labelling).show_frame


TAB = Tab("Label", _build, _KEYS, of_dataset=True, shared=Passing)
