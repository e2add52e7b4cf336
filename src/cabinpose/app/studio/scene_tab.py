"""The Scene tab: a cabin, its people and the camera in 3D, every key as a field, and what the camera would deliver."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from cabinpose.app.studio.canvas import GREY, FrameCanvas
from cabinpose.app.studio.scene_dialogs import ask_accept, ask_generate, ask_open, ask_save
from cabinpose.app.studio.scene_dimensions import Line, dimension_lines
from cabinpose.app.studio.scene_fields import FOCUS_SCRIPT, SceneFields
from cabinpose.app.studio.scene_form import Path, form
from cabinpose.app.studio.scene_people import SLIDER_KEYS, ScenePeople
from cabinpose.app.studio.scene_preview import Posed, Shown, camera_of
from cabinpose.app.studio.scene_session import OpenedScene, SceneRoom
from cabinpose.app.studio.tab import Page, Tab, empty_state
from cabinpose.app.studio.view3d import VIEW_KEYS, Marks, SceneBodies, view_3d
from cabinpose.core import CabinposeError
from cabinpose.scene import RGB

_LABELS = [[RGB.get(i, 0) >> 16 & 255, RGB.get(i, 0) >> 8 & 255, RGB.get(i, 0) & 255] for i in range(256)]
_FADE_S = 0.5  # that an old shape stays until the browser has the new one
_LOOK_S = 0.4
_STYLE = """
.studio-images canvas { transition: opacity .1s; } .studio-stale canvas { opacity: .35; transition: opacity .15s .2s; }
:root { --studio-wrong: #b3261e; --studio-doubt: #8a5200; --studio-right: #1b6e45; }
.body--dark { --studio-wrong: #ff8a80; --studio-doubt: #ffb74d; --studio-right: #6fd39e; }
.studio-conflicts { gap: 0; max-height: 22vh; overflow-y: auto; flex-wrap: nowrap; } .studio-conflicts:empty { display: none; }
.studio-conflicts .q-btn { width: 100%; color: var(--studio-wrong) !important; }
.studio-conflicts .q-btn__content { flex-wrap: nowrap; text-align: left; }
.studio-view:focus-visible { outline: 2px solid #4f9fd8; outline-offset: -2px; }
.studio-hand .q-field__control { padding: 0 6px; } .studio-hand input { appearance: textfield; -moz-appearance: textfield; }
.studio-hand input::-webkit-inner-spin-button { display: none; }
.studio-dimension { color: #fff; background: #000b; padding: 1px 6px; border-radius: 4px; font: 13px system-ui, sans-serif; }
"""
KEYS = (
    ("Ctrl Z, Ctrl Y", "undo, redo"),
    ("Ctrl S, Ctrl O", "save, open a configuration"),
    ("s, a, g", "sample, accept, generate"),
    ("/", "find a key"),
    *SLIDER_KEYS,
    *VIEW_KEYS,
)
# Keys of the tab, wherever the keyboard is in it; letters only where nothing is typed.
_KEYS = """(() => {
  const tab = getHtmlElement(%d);
  const told = { z: "z", y: "y", Z: "Z", s: "s", o: "o" }, letters = { s: "S", a: "A", g: "G", "/": "/" };
  document.addEventListener("keydown", (event) => {
    if (!tab.isConnected || !tab.offsetParent || event.altKey) return;
    if (document.querySelector(".q-dialog__inner:not([class*='-leave-'])")) return; // one that fades takes no keys any more
    const typed = event.target.closest?.("input, textarea, select, [contenteditable]");
    const key = event.ctrlKey || event.metaKey ? told[event.key] : typed ? undefined : letters[event.key];
    if (!key) return;
    event.preventDefault();
    if (key === "/") { // at once: what is typed next is for it
      const seen = (element) => element.matches("input") && element.offsetParent;
      const find = () => [...tab.querySelectorAll(".studio-find, .studio-find input")].find(seen);
      if (find()) { find().focus(); return; }
      tab.querySelector(".studio-side [role=tab]").click();
      setTimeout(() => find()?.focus(), 400); // once the panel has slid in
      return;
    }
    tab.dispatchEvent(new CustomEvent("scene-key", { detail: key }));
  });
})()"""
_BUTTON = "dense no-caps outline size=sm"


class SceneTab:
    """The tab of one browser; the scene is the studio's, shared by all."""

    def __init__(self, room: SceneRoom, front: Callable[[], bool]) -> None:
        """front: whether the tab is in front, and takes keys."""
        self._room, self._editor = room, room.editor
        self._cloud: tuple[str, Any] = ("", None)
        self._handles: dict[str, Any] = {}
        self._state = self._editor.state
        self._seen: Posed | None = None
        self._front = front
        self._told: list[tuple[Path, str]] | None = None
        self._measured: Path = ()
        self._drawn_dimension = ""
        self._coming: set[str] = set()  # images that the browser does not have yet
        self._looked = False
        ui.add_css(_STYLE)
        ui.run_javascript(FOCUS_SCRIPT)
        with ui.row().classes("studio-tab no-wrap w-full") as tab:
            side = ui.column().classes("studio-side no-wrap").style("width: 330px; min-width: 330px; overflow: hidden")
            with side.style("height: 100%"):
                self._build_side()
            with ui.column().classes("studio-main"):
                self._build_main()
        ui.run_javascript(_KEYS % tab.id)
        tab.on("scene-key", self._key, js_handler="(event) => emit(event.detail)")
        room.listeners.append(self._refresh)
        ui.context.client.on_delete(lambda: room.listeners.remove(self._refresh))
        ui.timer(_LOOK_S, self._look_at_generation)
        if room.posed is not None:
            self._refresh()
        else:
            ui.timer(0.01, room.redraw, once=True)

    # -------------------------------------------------------------------------------------------------------- building

    def _build_side(self) -> None:
        editor = self._editor
        with ui.row().classes("no-wrap w-full").style("gap: 4px"):
            for words, icon, tip, change in (
                ("Sample", "casino", "another draw of all that is not given: the next frame (s)", self._sample),
                ("Accept", "check", "keep the scene that is shown: its poses can be changed then (a)", self._accept),
                ("Undo", "undo", "one step back (Ctrl Z)", self._undo),
                ("Redo", "redo", "one step forward (Ctrl Y)", self._redo),
            ):
                button = ui.button(words, icon=icon, on_click=change).props(_BUTTON)
                button.style("flex: 1; padding: 2px 4px").tooltip(tip)
        with ui.row().classes("no-wrap w-full").style("gap: 4px"):
            for words, icon, tip, ask in (
                ("Open", "folder_open", "a configuration of the folder (Ctrl O)", self._ask_open),
                ("Save", "save", "as a configuration that `synth` takes (Ctrl S)", self._ask_save),
                ("Generate", "movie", "a dataset beside the scene (g)", self._ask_generate),
            ):
                ui.button(words, icon=icon, on_click=ask).props(_BUTTON).style("flex: 1; padding: 2px 4px").tooltip(tip)
        with ui.row().classes("no-wrap w-full items-center").style("gap: 4px"):
            self._seed = ui.number("seed", value=editor.state.seed, min=0, step=1, precision=0, on_change=self._frame_changed)
            self._index = ui.number("frame", value=editor.state.index, min=0, step=1, precision=0, on_change=self._frame_changed)
            for number in (self._seed, self._index):
                number.props("dense outlined debounce=60").style("flex: 1; min-width: 0")
        self._running = ui.column().classes("w-full").style("gap: 2px")
        with self._running:
            self._progress = ui.linear_progress(value=0.0, show_value=False).props("instant-feedback")
            with ui.row().classes("no-wrap items-center w-full"):
                self._run_words = ui.label().style("flex: 1; font-size: 12px").mark("generation")
                self._cancel = ui.button("Cancel", on_click=self._cancel_generation).props("dense flat no-caps size=sm")
        self._running.set_visibility(False)
        self._conflicts = ui.column().classes("w-full studio-conflicts").props("role=group aria-label='what is wrong'")
        with ui.tabs().props("dense no-caps align=justify").classes("w-full") as bar:
            ui.tab("Keys")
            ui.tab("People")
        self._panels = ui.tab_panels(bar, value="Keys", keep_alive=True, on_change=self._refresh).classes("w-full")
        with self._panels.style("flex: 1; min-height: 0; background: none"):
            with ui.tab_panel("Keys").classes("studio-keys").style("overflow-y: auto; height: 100%; padding: 6px 4px"):
                self._fields = SceneFields(editor, lambda: editor.starts(self._room.posed), self._changed_by_field, self._measure)
            with ui.tab_panel("People").style("overflow-y: auto; height: 100%; padding: 6px 4px"):
                self._people = ScenePeople(self._room, self._do_in_place)

    def _build_main(self) -> None:
        with ui.row().classes("no-wrap w-full").style("flex: 1; min-height: 0; gap: 10px; align-items: stretch"):
            with ui.element("div").classes("studio-pane").style("flex: 1.7; position: relative"):
                self._scene = view_3d(on_drag_end=self._dragged)
                with self._scene:
                    self._bodies = SceneBodies()
                with ui.row().style("position: absolute; top: 6px; left: 8px; gap: 10px; color: #ccc; font-size: 12px"):
                    self._show_cabin = ui.checkbox("cabin", value=True, on_change=self._show_bodies).props("dense dark size=xs")
                    self._show_cloud = ui.checkbox("cloud", value=False, on_change=self._show_bodies).props("dense dark size=xs")
                    self._handles_box = ui.checkbox("handles", value=True, on_change=self._show_bodies).props(
                        "dense dark size=xs"
                    )
            self._images = ui.column().classes("no-wrap studio-images").style("flex: 1; min-width: 0; gap: 8px; height: 100%")
            with self._images:
                self._canvases = {}
                for name in ("depth", "amplitude", "labels"):
                    with ui.element("div").classes("studio-pane w-full").style("position: relative"):
                        canvas = self._canvases[name] = FrameCanvas(on_loaded=partial(self._image_is_there, name))
                        canvas.props(f"role=img aria-label='{name}, as the camera delivers it'")
                        ui.label(name).style(
                            "position: absolute; top: 4px; left: 8px; font-size: 12px; color: #eee; text-shadow: 0 0 3px #000"
                        )
        with ui.row().classes("no-wrap items-center w-full").style("gap: 10px; min-height: 24px"):
            self._verdict = ui.label("drawing …").style("flex: 1; font-size: 13px").mark("verdict").props("role=status")
            self._facts = ui.label().style("font-size: 12px; opacity: .7; white-space: nowrap").mark("facts")

    # ------------------------------------------------------------------------------------------------ what is asked for

    async def _do(self, change: Callable[[], Any]) -> None:
        """Make a change, and draw what comes of it."""
        try:
            if change() is False:
                ui.notify("there is nothing more to undo or redo", position="top")
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True, timeout=10_000, position="top")
        await self._room.redraw()

    async def _do_in_place(self, change: Callable[[], Any]) -> None:
        """The same of a change that is seen already where it was made."""
        before = self._editor.state
        await self._do(change)
        if self._editor.state is before:
            self._people.show()

    async def _sample(self) -> None:
        await self._do(self._editor.sample_again)

    async def _undo(self) -> None:
        await self._do(self._editor.undo)

    async def _redo(self) -> None:
        await self._do(self._editor.redo)

    async def _changed_by_field(self) -> None:
        self._state = self._editor.state
        await self._room.redraw()

    async def _accept(self) -> None:
        """Accept the scene that is shown, after what it takes the place of was said."""
        posed = self._room.posed
        if posed is None:
            return
        try:
            let_go = self._editor.let_go(posed)
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True, timeout=10_000, position="top")
            return
        if let_go:
            ask_accept(let_go, lambda: self._do(lambda: self._editor.accept(posed)))
        else:
            await self._do(lambda: self._editor.accept(posed))

    def _ask_open(self) -> None:
        ask_open(self._room, self._do)

    def _ask_save(self) -> None:
        ask_save(self._room)

    def _ask_generate(self) -> None:
        ask_generate(self._room, self._look_at_generation)

    async def _key(self, event: Any) -> None:
        """A key that belongs to the tab, not to what has the keyboard in it."""
        acts: dict[str, Callable[[], Any]] = {
            "z": self._undo, "y": self._redo, "Z": self._redo, "s": self._ask_save, "o": self._ask_open, "S": self._sample,
            "A": self._accept, "G": self._ask_generate,
        }  # fmt: skip
        if self._front():
            done = acts[str(event.args)]()
            if done is not None:
                await done

    async def _frame_changed(self) -> None:
        seed, index = int(self._seed.value or 0), int(self._index.value or 0)
        if (seed, index) != (self._editor.state.seed, self._editor.state.index):
            await self._do(lambda: self._editor.look_at(seed, index))

    async def _dragged(self, event: Any) -> None:
        shown, place = self._room.posed, (event.x, event.y, event.z)
        kind, _, rest = str(event.object_name).partition(":")
        if shown is None:
            return
        if kind == "hand":
            slot, _, side = rest.partition(":")
            await self._do(lambda: self._people.move_hand(slot, side, list(place)))
        elif kind == "camera":
            await self._do(lambda: self._editor.move_camera(shown, position=place))
        elif kind == "target":
            await self._do(lambda: self._editor.move_camera(shown, target=place))

    def _cancel_generation(self) -> None:
        if self._room.generation is not None:
            self._room.generation.cancel()

    def _look_at_generation(self) -> None:
        run = self._room.generation
        self._running.set_visibility(run is not None)
        if run is not None:
            self._progress.value = run.done / max(run.frames, 1)
            self._run_words.text = run.error or run.words
            self._cancel.set_visibility(run.running)

    # -------------------------------------------------------------------------------------------------------- showing

    def _refresh(self) -> None:
        """Show what was posed or drawn last, and the form where somebody else changed what it shows."""
        editor, posed = self._editor, self._room.posed
        if self._panels.value == "Keys" and (editor.state is not self._state or (posed is not None and self._seen is None)):
            self._state = editor.state
            self._fields.refresh()
        self._people.show()
        self._seed.value, self._index.value = editor.state.seed, editor.state.index
        self._tell(posed)
        if posed is None:
            return
        if posed is not self._seen:
            self._seen = posed
            self._show_bodies()
            if isinstance(posed, Shown):
                self._show_images(posed)
            else:
                self._images.classes(add="studio-stale")

    def _image_is_there(self, name: str) -> None:
        """Images that belong to what the 3D view shows are bright."""
        self._coming.discard(name)
        if not self._coming and isinstance(self._seen, Shown):
            self._images.classes(remove="studio-stale")

    def _show_bodies(self) -> None:
        """Cabin, people and things with marks, all at once; and the cloud, which comes with the images."""
        posed, shown = self._seen, self._room.shown
        if posed is None:
            return
        bodies = dict(self._room.bodies(posed))
        if not self._show_cabin.value:
            del bodies["cabin"]
        self._bodies.show(posed.number, bodies, self._marks(posed))
        self._show_handles(posed)
        cloud = f"/scene/{shown.number}/cloud.glb" if shown is not None and self._show_cloud.value else ""
        if cloud != self._cloud[0]:
            old, self._cloud = self._cloud[1], (cloud, None)
            if cloud:
                with self._scene:
                    self._cloud = cloud, self._scene.gltf(cloud)
            if old is not None:
                with self._verdict:
                    ui.timer(_FADE_S, old.delete, once=True)
        if not self._looked:
            self._looked = True
            self._look(posed)

    def _tell(self, posed: Posed | None) -> None:
        """Say what is wrong: in the status line, in a list whose lines lead to the fields, and at these."""
        found = self._editor.conflicts(posed, self._room.error)
        self._fields.show_conflicts(found)
        if found != self._told:
            self._told = found
            self._conflicts.clear()
            with self._conflicts:
                for key, words in found:
                    line = ui.button(f"{'.'.join(map(str, key))}: {words}", icon="error", on_click=partial(self._reveal, key))
                    line.props("flat dense no-caps align=left size=sm role=listitem").style(
                        "color: var(--studio-wrong) !important"
                    )
        doubts = isinstance(posed, Shown) and len(posed.doubts) == len(found)
        wrong = [words if key[:1] != ("camera",) else f"camera: {words}" for key, words in found]
        typed = {words: f"{'.'.join(map(str, key)) or 'configuration'}: {words}" for key, words in self._editor.errors.items()}
        self._verdict.text = "; ".join(typed.get(words, words) for words in wrong) or "holds: nothing collides"
        colour = "doubt" if found and doubts else "wrong" if found else "right"
        self._verdict.style(f"color: var(--studio-{colour})")
        if posed is not None:
            who = ", ".join(f"{p.slot} {p.subject} ({p.action})" for p in posed.scene.people)
            took = 1000 * sum(posed.seconds.values())
            self._facts.text = f"{posed.scene.place}, view {posed.scene.pov}; {who}; {took:.0f} ms"

    def _reveal(self, key: Path) -> None:
        self._panels.value = "Keys"
        self._fields.reveal(key)

    def _measure(self, key: Path) -> None:
        """Draw the dimension of the field that has the keyboard."""
        self._measured = key
        self._show_dimension()

    def _show_dimension(self) -> None:
        if self._dimension(self._seen)[0] != self._drawn_dimension:
            self._show_bodies()

    def _dimension(self, posed: Posed | None) -> tuple[str, list[Line]]:
        """The dimension's words and lines, where the car that is shown has it."""
        cars = self._editor.state.data.get("scene", {}).get("cars")
        if posed is None or posed.scene.cabin is None or self._measured[:2] != ("scene", "cars") or len(self._measured) != 4:
            return "", []
        at, name = self._measured[2:]
        car = cars[at] if isinstance(cars, list) and isinstance(at, int) and at < len(cars) else None
        if not isinstance(car, dict) or car.get("name") != posed.scene.place:
            return "", []
        field = next((f for f in form(self._editor.state.data).walk() if f.path == self._measured), None)
        if field is None or not isinstance(field.value, (int, float)):
            return "", []
        words = f"{field.code or field.words}: {field.value:g} {field.unit}"
        return words, dimension_lines(posed.scene.cabin, str(name), float(field.value))

    def _show_images(self, shown: Shown) -> None:
        depth = shown.frame["depth"]
        valid = depth[np.isfinite(depth) & (depth > 0)]
        near, far = np.quantile(valid[::5], (0.01, 0.99)).tolist() if valid.size else (0.0, 1.0)
        white = float(np.quantile(shown.frame["amplitude"][::3], 0.995)) or 1.0
        url = f"/scene/{shown.number}/"
        self._coming = set(self._canvases)
        self._canvases["depth"].show(url + "depth", near=near, far=far)
        self._canvases["amplitude"].show(url + "amplitude", near=0.0, far=white, palette=GREY)
        self._canvases["labels"].show(url + "labels", near=0.0, far=255.0, palette=_LABELS)

    def _marks(self, posed: Posed) -> Marks:
        """The camera's field of view, and where something collides."""
        eye, target, _ = camera_of(posed)
        lines = [("#ff70d0", eye, corner) for corner in _corners(posed)]
        if self._handles_box.value:
            lines.append(("#ffd166", eye, target))
        balls = [("#ff2020", 0.06, v.where.tolist()) for v in posed.verdicts if v.where is not None]
        self._drawn_dimension, measured = self._dimension(posed)
        measures = [(start.tolist(), end.tolist()) for start, end in measured]
        at = np.mean(measured[0], axis=0) if len(measured) == 1 else measured[1][1] if measured else None
        return Marks(lines, balls, measures, [] if at is None else [(self._drawn_dimension, at.tolist())])

    def _show_handles(self, posed: Posed) -> None:
        """What can be dragged: the camera, what it looks at, and hands of whole poses."""
        wanted: dict[str, tuple[list[float], float, str]] = {}
        if self._handles_box.value:
            eye, target, _ = camera_of(posed)
            wanted |= {"camera": (eye, 0.045, "#ff70d0"), "target": (target, 0.045, "#ffd166")}
            for person in posed.scene.people:
                for side in ("l", "r") if person.slot in self._editor.given else ():
                    place = person.posed.palms[side][:3, 3].tolist()
                    wanted[f"hand:{person.slot}:{side}"] = place, 0.055, "#80ed99"
        for name in self._handles.keys() - wanted.keys():
            self._handles.pop(name).delete()
        for name, (place, radius, colour) in wanted.items():
            if name not in self._handles:
                with self._scene:
                    handle = self._scene.sphere(radius).material(colour, 0.6 if name.startswith("hand") else 1.0).with_name(name)
                self._handles[name] = handle.draggable() if posed.scene.cabin is not None else handle
            self._handles[name].move(*place)

    def _look(self, shown: Posed) -> None:
        """Look into the scene from its front, above the camera."""
        people = [person.posed.joints.mean(axis=0) for person in shown.scene.people]
        target = np.mean(people, axis=0) if people else shown.scene.backdrop.vertices.mean(axis=0)
        (x, y, z), (look_x, look_y, look_z) = (target + (1.1, -1.4, 1.15)).tolist(), target.tolist()
        self._scene.move_camera(x, y, z, look_x, look_y, look_z, 0, 0, 1, duration=0)


def _corners(shown: Posed) -> list[list[float]]:
    """The ends of lines along the corners of the camera's image, 0.5 m long."""
    camera, pose = shown.config.camera.sensor_model.camera, shown.scene.world_from_camera
    uv = np.array([(0, 0), (camera.width - 1, 0), (0, camera.height - 1), (camera.width - 1, camera.height - 1)], np.float64)
    rays = camera.unproject(uv, np.ones(4))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    ends: list[list[float]] = (pose[:3, 3] + 0.5 * rays @ pose[:3, :3].T).tolist()
    return ends


def _build(page: Page) -> None:
    """The scene that was named; where none was, one is begun when somebody asks for it."""
    scene = page.of_studio(OpenedScene)
    if page.workspace.scene is not None:
        _open(page, scene)
        return
    begin = ui.column().classes("w-full items-center")
    with begin:
        empty_state("No scene is open", "Open a configuration of `cabinpose synth`:", "cabinpose studio SCENE.yaml")
        ui.button("Begin a new one here", icon="add", on_click=lambda: _begin(begin, page, scene)).props("no-caps outline")


def _begin(place: ui.column, page: Page, scene: OpenedScene) -> None:
    place.clear()
    with place:
        _open(page, scene)


def _open(page: Page, scene: OpenedScene) -> None:
    try:
        room = scene.room()
    except CabinposeError as error:
        empty_state("The scene cannot be opened", str(error), error.hint or "")
        return
    SceneTab(room, lambda: page.front() == "Scene")


TAB = Tab("Scene", _build, KEYS, shared=lambda workspace: OpenedScene(workspace.scene))
