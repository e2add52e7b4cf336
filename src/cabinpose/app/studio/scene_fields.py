"""The fields of a scene's configuration in the browser, in groups that open, or found by words."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from nicegui import ui

from cabinpose.app.studio.scene_edit import SceneEditor
from cabinpose.app.studio.scene_form import Field, Path, form, with_changed_preset
from cabinpose.scene.cabin import PRESETS

_TYPED_MS = 60  # without a key before a number that is typed counts
_MOST_FOUND = 60
_FOCUS_AGAIN = "studioFocusAgain()"
# The field that had the keyboard has it again where the form was built anew; a field is given it by its key.
FOCUS_SCRIPT = """
if (!window.studioFocusKey) {
  let last = "", top = 0;
  const place = (key) => [...document.querySelectorAll("[data-key]")].find((e) => e.dataset.key === key);
  document.addEventListener("focusin", ({ target }) => { last = target.closest("[data-key]")?.dataset.key || ""; });
  const scrolled = ({ target }) => { if (target.classList?.contains("studio-keys")) top = target.scrollTop; };
  document.addEventListener("scroll", scrolled, true);
  const give = (element) => (element.querySelector("input, [tabindex='0'], button, [role=button]") || element).focus();
  window.studioFocusKey = (key, tries = 10) => {
    const element = place(key);
    if (!element) { if (tries) setTimeout(() => studioFocusKey(key, tries - 1), 50); return; }
    element.scrollIntoView({ block: "center" });
    give(element);
  };
  window.studioFocusAgain = () => {
    const key = last, at = top;
    setTimeout(() => {
      const panel = document.querySelector(".studio-keys");
      if (panel) panel.scrollTop = at;
      const element = key && document.activeElement === document.body && place(key);
      if (element) give(element);
    }, 100);
  };
}
"""
Changed = Callable[[], Awaitable[None]]


class SceneFields:
    """The form of one browser. `changed` is called after each change, and what is wrong shown where it is.

    focused: is told the key of the field that has the keyboard.
    """

    def __init__(
        self, editor: SceneEditor, starts: Callable[[], dict[str, Any]], changed: Changed, focused: Callable[[Path], object]
    ) -> None:
        self._editor, self._starts, self._changed, self._focused = editor, starts, changed, focused
        self._client = ui.context.client  # what a handler's element belonged to may be gone when it ends
        self._open: set[Path] = {("scene",)}
        self._shown: dict[Path, Any] = {}
        self._groups: dict[Path, ui.label] = {}
        self._conflicts: tuple[tuple[Path, str], ...] = ()
        self._built: Any = None
        self._quiet = False
        self._words = ui.input(placeholder="find a key", on_change=self.rebuild).props("dense outlined clearable debounce=200")
        self._words.classes("w-full studio-find").mark("find").props("aria-label='find a key'")
        self._body = ui.column().classes("w-full").style("gap: 2px")
        self.rebuild()

    def refresh(self) -> None:
        """Show what is edited now: in place where the same fields are there, so that groups, place and focus stay."""
        root = self._form()
        if self._form_of(root) != self._built:
            self.rebuild()
            self._client.run_javascript(_FOCUS_AGAIN)
            return
        self._quiet = True
        for field in root.walk():
            widget = self._shown.get(field.path)
            if widget is not None:
                widget.value = _on_screen(field)
        self._quiet = False
        self.show_conflicts()

    def rebuild(self) -> None:
        """Build the form anew from what is edited now."""
        self._body.clear()
        self._shown, self._groups = {}, {}
        root = self._form()
        self._built = self._form_of(root)
        words = str(self._words.value or "").lower().split()
        with self._body:
            if words:
                found = [f for f in root.walk() if f.path and (not f.children or f.kind == "names") and _matches(f, words)]
                for each in found[:_MOST_FOUND]:
                    key = ".".join(map(str, each.path))
                    self._build(each, f"{key} · {each.words}" if each.code else key)
                if len(found) != len(found[:_MOST_FOUND]) or not found:
                    ui.label(f"{len(found)} keys" if found else "no key is called so").style("opacity: .8")
            else:
                for child in root.children:
                    self._build(child, child.words)
        self.show_conflicts()

    def reveal(self, path: Path) -> None:
        """Open the groups down to a field, or to what there is of its path, and give it the keyboard."""
        self._open |= {path[:depth] for depth in range(1, len(path) + 1)}
        if self._words.value:
            self._words.value = ""  # which builds the form
        else:
            self.rebuild()
        places = self._shown.keys() | self._groups.keys()
        at = next((path[:depth] for depth in range(len(path), 0, -1) if path[:depth] in places), ())
        if at:
            self._client.run_javascript(f"studioFocusKey({json.dumps('.'.join(map(str, at)))})")

    def show_conflicts(self, conflicts: Iterable[tuple[Path, str]] | None = None) -> None:
        """Show what is wrong at its field, or at the group that hides it; conflicts: of the scene, None for those told last."""
        self._conflicts = self._conflicts if conflicts is None else tuple(conflicts)
        told: dict[Path, str] = {}
        places = self._shown.keys() | self._groups.keys()
        for path, words in (*self._editor.errors.items(), *self._conflicts):
            at = next((path[:depth] for depth in range(len(path), 0, -1) if path[:depth] in places), None)
            if at is not None:
                told.setdefault(at, ": ".join((*map(str, path[len(at) :][-1:]), words)))
        for path, widget in self._shown.items():
            if hasattr(widget, "error"):
                widget.error = told.get(path)
        for path, label in self._groups.items():
            label.text = told.get(path, "")
            label.set_visibility(path in told)

    def _form(self) -> Field:
        return form(self._editor.state.data, starts=self._starts(), cars=self._editor.car_files())

    def _form_of(self, root: Field) -> Any:
        """What of a form needs other elements where it differs."""
        return [(f.path, f.kind, f.option, f.options, f.choices, self._is_entry(f.path)) for f in root.walk()]

    def _set(self, path: Path, value: Any, *, rebuild: bool = False) -> Awaitable[None] | None:
        """Take what somebody gave; what is shown by `refresh` is nobody's."""
        return None if self._quiet else self._given(path, value, rebuild=rebuild)

    async def _given(self, path: Path, value: Any, *, rebuild: bool) -> None:
        self._editor.set(path, value)
        await self._done(rebuild=rebuild)

    async def _remove(self, path: Path) -> None:
        self._editor.remove(path)
        await self._done(rebuild=True)

    async def _done(self, *, rebuild: bool) -> None:
        if rebuild:
            self.rebuild()
            self._client.run_javascript(_FOCUS_AGAIN)
        else:
            self._built = self._form_of(self._form())
            self.show_conflicts()
        await self._changed()

    def _build(self, field: Field, title: str) -> None:
        if field.kind in ("group", "mapping", "list") or field.options:
            if field.kind == "group" and not field.options and field.children and isinstance(field.children[0].path[-1], int):
                self._vector(field, title)
            else:
                self._group(field, title)
        else:
            self._leaf(field, title)
            for child in field.children:
                self._build(child, f"{child.words} · dimensions")
            if field.path == ("scene", "cars"):
                self._change_preset(field)

    def _change_preset(self, field: Field) -> None:
        """Where a preset is made a car of one's own."""
        preset = (
            ui.select(list(PRESETS), label="change the dimensions of").props("dense outlined options-dense").classes("w-full")
        )

        async def change() -> None:
            cars, at = with_changed_preset(self._now(field), str(preset.value))
            self._open.add((*field.path, at))
            await self._given(field.path, cars, rebuild=True)

        preset.on_value_change(change)

    def _group(self, field: Field, title: str) -> None:
        """A group that opens; what is in it is built when it does."""
        removable = len(field.path) > 1 and isinstance(self._holder(field.path), (dict, list)) and self._is_entry(field.path)
        group = ui.expansion(value=field.path in self._open).props("dense dense-toggle").classes("w-full studio-group")
        group.props["data-key"] = ".".join(map(str, field.path))
        header = group.add_slot("header")
        with header, ui.row().classes("items-center w-full").style("gap: 0 6px; flex-wrap: wrap"):
            label = ui.label(title).style("font-weight: 600; flex: 1; font-size: 13px; overflow: hidden; text-overflow: ellipsis")
            if field.description:
                label.tooltip(field.description)
            if field.options:
                plain = isinstance(field.value, (str, int, float))
                ui.label(str(field.value) if plain else field.option).style("opacity: .7; font-size: 12px")
            if removable:
                ui.button(icon="close").props("flat round dense size=xs aria-label='take it out'").on(
                    "click.stop", lambda: self._remove(field.path)
                ).on("keydown.enter.stop", lambda: self._remove(field.path)).tooltip("take it out")
            wrong = ui.label().style("color: var(--studio-wrong); font-size: 12px; width: 100%")
            wrong.set_visibility(False)
            self._groups[field.path] = wrong
        with group:
            inside = ui.column().classes("w-full").style("gap: 2px; padding-left: 8px; border-left: 2px solid #8884")

        def fill() -> None:
            (self._open.add if group.value else self._open.discard)(field.path)
            if group.value and not inside.default_slot.children:
                with inside:
                    self._inside(field)
                self.show_conflicts()

        group.on_value_change(fill)
        if group.value:
            with inside:
                self._inside(field)

    def _inside(self, field: Field) -> None:
        if field.options:
            choice = ui.select(list(field.options), value=field.option, label="is").props("dense outlined").classes("w-full")
            fresh = field.fresh or {}
            choice.on_value_change(lambda event: self._set(field.path, fresh[event.value], rebuild=True))
        if field.kind == "group":
            for child in field.children:
                self._build(child, child.words)
        elif field.kind == "mapping":
            self._mapping(field)
        elif field.kind == "list":
            for child in field.children:
                self._build(child, child.words)
            ui.button("add", icon="add", on_click=lambda: self._set(field.path, [*field.value, field.entry], rebuild=True)).props(
                "flat dense no-caps size=sm"
            )
        elif field.kind != "nothing":
            self._leaf(field, field.words)

    def _mapping(self, field: Field) -> None:
        for child in field.children:
            self._build(child, child.words)
        left = [key for key in field.choices if key not in (field.value or {})]
        key = ui.select(left, label="add", with_input=True, new_value_mode="add-unique").props("dense outlined").classes("w-full")

        async def add() -> None:
            if key.value:
                self._open.add((*field.path, str(key.value)))
                await self._given((*field.path, str(key.value)), field.entry, rebuild=True)

        key.on_value_change(add)

    def _vector(self, field: Field, title: str) -> None:
        """Numbers in a row; a matrix has rows of them."""
        unit = f" ({field.unit})" if field.unit else ""
        ui.label(f"{title}{unit}").style("font-size: 12px; opacity: .8").tooltip(field.description or title)
        with ui.row().classes("no-wrap w-full").style("gap: 4px"):
            for child in field.children:
                self._number(child, child.words).style("flex: 1; min-width: 0")

    def _leaf(self, field: Field, title: str) -> None:
        with ui.row().classes("no-wrap items-center w-full").style("gap: 2px") as row:
            row.props["data-key"] = ".".join(map(str, field.path))
            row.on("focusin", lambda: self._focused(field.path), args=[])
            make = {"number": self._number, "integer": self._number, "flag": self._flag, "choice": self._choice}
            widget = make.get(field.kind, self._names if field.kind == "names" else self._text)(field, title)
            widget.style("flex: 1; min-width: 0")
            if self._is_entry(field.path):
                words = "as in the preset" if field.path[:2] == ("scene", "cars") else "take it out"
                out = ui.button(icon="close", on_click=lambda: self._remove(field.path)).props("flat round dense size=xs")
                out.props(f"aria-label='{words}'").tooltip(words)
        self._shown[field.path] = widget
        widget.mark(".".join(map(str, field.path)))
        if field.description:
            widget.tooltip(field.description)

    def _number(self, field: Field, title: str) -> ui.number:
        whole = field.kind == "integer"

        def given(event: Any) -> Awaitable[None] | None:
            value = event.value
            if value is None and not field.optional:
                return None
            return self._set(field.path, int(value) if whole and value is not None and value == int(value) else value)

        step = 1 if whole else _step(field)
        value = _on_screen(field)
        words = f"{title} · {field.range_words}" if field.range_words and isinstance(field.path[-1], str) else title
        number = ui.number(words, value=value, step=step, on_change=given)
        number.props(f"dense outlined debounce={_TYPED_MS}" + (" clearable" if field.optional else "")).classes("w-full")
        if field.optional:
            number.props["placeholder"] = "left out"
        self._shown[field.path] = number
        return number

    def _flag(self, field: Field, title: str) -> Any:
        if not field.optional:
            box = ui.checkbox(title, value=_on_screen(field)).props("dense").style("padding: 4px 0; font-size: 13px")
            return box.on_value_change(lambda event: self._set(field.path, event.value))
        words = {None: "left out", True: "yes", False: "no"}
        return self._select(ui.select(words, value=_on_screen(field), label=title), field)

    def _choice(self, field: Field, title: str) -> Any:
        options: dict[Any, str] = ({None: "left out"} if field.optional else {}) | {name: name for name in field.choices}
        return self._select(ui.select(options, value=_on_screen(field), label=title), field)

    def _text(self, field: Field, title: str) -> Any:
        if not field.choices:
            text = ui.input(title, value=_on_screen(field)).props("dense outlined debounce=400").classes("w-full")
            return text.on_value_change(lambda event: self._set(field.path, event.value or (None if field.optional else "")))
        options = list(dict.fromkeys((*field.choices, *([field.value] if field.value else []))))
        chosen = ui.select(options, value=_on_screen(field), label=title, with_input=True, new_value_mode="add-unique")
        return self._select(chosen.props("clearable" if field.optional else ""), field)

    def _names(self, field: Field, title: str) -> Any:
        names = _on_screen(field)
        options = list(dict.fromkeys((*field.choices, *names)))
        chosen = ui.select(options, value=names, label=title, multiple=True, with_input=True, new_value_mode="add-unique").props(
            "use-chips"
        )

        def kept(chosen: list[str]) -> list[Any]:
            """With the entries that are no names, everything in the order that it had."""
            held = self._now(field)
            return [e for e in held if not isinstance(e, str) or e in chosen] + [name for name in chosen if name not in held]

        return self._select(chosen, field, kept)

    def _select(self, chosen: ui.select, field: Field, value: Callable[[Any], Any] = lambda now: now) -> ui.select:
        chosen.props("dense outlined options-dense").classes("w-full")
        rebuild = bool(field.children) or field.path[-1] == "preset"  # others show what follows from it
        chosen.on_value_change(lambda event: self._set(field.path, value(event.value), rebuild=rebuild))
        return chosen

    def _holder(self, path: Path) -> Any:
        at: Any = self._editor.state.data
        for part in path[:-1]:
            at = at.get(part) if isinstance(at, dict) else at[part] if isinstance(at, list) and isinstance(part, int) else None
        return at

    def _now(self, field: Field) -> Any:
        """The value that a field of a mapping has now; changes of what is within build no new field."""
        return (self._holder(field.path) or {}).get(field.path[-1], field.value)

    def _is_entry(self, path: Path) -> bool:
        """Whether this is an entry of a mapping or list, or a changed dimension, which can be taken out again."""
        if path[:2] == ("scene", "cars") and len(path) == 4:
            return path[3] not in ("preset", "name") and path[3] in (self._holder(path) or ())
        return len(path) > 1 and (str(path[-2]) in _MAPPINGS or (path[:2] == ("scene", "motion") and len(path) == 4))


_MAPPINGS = (
    "cars", "occupants", "occupancy", "motion", "views", "own", "axes", "initial_pose_deg", "angles_rad", "ranges",
    "frequencies_hz", "units",
)  # fmt: skip


def _on_screen(field: Field) -> Any:
    """The value of a field as its element has it."""
    value = field.value
    if field.kind in ("number", "integer"):
        return value if isinstance(value, (int, float)) else None
    if field.kind == "flag":
        return value if field.optional else bool(value)
    if field.kind == "choice":
        return value if value in field.choices else None
    if field.kind == "names":
        return [each for each in value if isinstance(each, str)] if isinstance(value, (list, tuple)) else []
    return value or (None if field.choices else "")


def _matches(field: Field, words: list[str]) -> bool:
    text = f"{'.'.join(map(str, field.path))} {field.words} {field.description}".lower()
    return all(word in text for word in words)


def _step(field: Field) -> float:
    """A step of the arrows: some hundredth of the range."""
    if field.low is not None and field.high is not None:
        return float(f"{max((field.high - field.low) / 100, 1e-4):.0e}")
    return {"m": 0.01, "rad": 0.01, "°": 1.0, "Hz": 1e6, "px": 1.0}.get(field.unit, 0.1)
