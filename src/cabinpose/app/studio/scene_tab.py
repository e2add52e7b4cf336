"""The Scene tab: a cabin, its people and the camera in 3D, every key as a field, and what the camera would deliver."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from cabinpose.app.studio.canvas import GREY, FrameCanvas
from cabinpose.app.studio.scene_edit import Posed, Shown, camera_of
from cabinpose.app.studio.scene_fields import SceneFields
from cabinpose.app.studio.scene_session import OpenedScene, SceneRoom
from cabinpose.app.studio.tab import Page, Tab, empty_state
from cabinpose.app.studio.view3d import VIEW_KEYS, Marks, SceneBodies, view_3d
from cabinpose.core import CabinposeError
from cabinpose.scene import RGB
from cabinpose.scene.body import DOFS
from cabinpose.synth import Verdict, dof_scale, limits_deg

_LABELS = [[RGB.get(i, 0) >> 16 & 255, RGB.get(i, 0) >> 8 & 255, RGB.get(i, 0) & 255] for i in range(256)]
_FADE_S = 0.5  # that an old shape stays until the browser has the new one
_LOOK_S = 0.4
_STYLE = """
.studio-images { transition: opacity .1s; } .studio-images.studio-stale { opacity: .35; transition: opacity .15s .2s; }
.studio-dimension { color: #fff; background: #000b; padding: 1px 6px; border-radius: 4px; font: 13px system-ui, sans-serif; }
"""
_BUTTON = "dense no-caps outline size=sm"


class SceneTab:
    """The tab of one browser; the scene is the studio's, shared by all."""

    def __init__(self, room: SceneRoom) -> None:
        self._room, self._editor = room, room.editor
        self._cloud: tuple[str, Any] = ("", None)
        self._handles: dict[str, Any] = {}
        self._state = self._editor.state
        self._seen: Posed | None = None
        self._coming: set[str] = set()  # images that the browser does not have yet
        self._looked = False
        ui.add_css(_STYLE)
        with ui.row().classes("studio-tab no-wrap w-full"):
            side = ui.column().classes("studio-side no-wrap").style("width: 330px; min-width: 330px; overflow: hidden")
            with side.style("height: 100%"):
                self._build_side()
            with ui.column().classes("studio-main"):
                self._build_main()
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
                ("Sample", "casino", "another draw of all that is not given: the next frame", editor.sample_again),
                ("Accept", "check", "keep the scene that is shown: its poses can be changed then", self._accept),
                ("Undo", "undo", "one step back", editor.undo),
                ("Redo", "redo", "one step forward", editor.redo),
            ):
                button = ui.button(words, icon=icon, on_click=lambda change=change: self._do(change)).props(_BUTTON)
                button.style("flex: 1; padding: 2px 4px").tooltip(tip)
        with ui.row().classes("no-wrap w-full").style("gap: 4px"):
            for words, icon, open_dialog in (
                ("Open", "folder_open", self._open_dialog),
                ("Save", "save", self._save_dialog),
                ("Generate", "movie", self._generate_dialog),
            ):
                ui.button(words, icon=icon, on_click=open_dialog).props(_BUTTON).style("flex: 1; padding: 2px 4px")
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
        with ui.tabs().props("dense no-caps align=justify").classes("w-full") as bar:
            ui.tab("Keys")
            ui.tab("People")
        panels = ui.tab_panels(bar, value="Keys", keep_alive=True).classes("w-full")
        with panels.style("flex: 1; min-height: 0; background: none"):
            with ui.tab_panel("Keys").style("overflow-y: auto; height: 100%; padding: 6px 4px"):
                self._fields = SceneFields(editor, lambda: editor.starts(self._room.posed), self._changed_by_field)
            with ui.tab_panel("People").style("overflow-y: auto; height: 100%; padding: 6px 4px"):
                self._people = ui.column().classes("w-full").style("gap: 2px")
        self._build_people()

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
                        self._canvases[name] = FrameCanvas(on_loaded=partial(self._image_is_there, name))
                        ui.label(name).style(
                            "position: absolute; top: 4px; left: 8px; font-size: 12px; color: #eee; text-shadow: 0 0 3px #000"
                        )
        with ui.row().classes("no-wrap items-center w-full").style("gap: 10px; min-height: 24px"):
            self._verdict = ui.label("drawing …").style("flex: 1; font-size: 13px").mark("verdict")
            self._facts = ui.label().style("font-size: 12px; opacity: .7; white-space: nowrap").mark("facts")

    def _build_people(self) -> None:
        """Sliders for the seats and joint axes of people who have a whole pose."""
        self._people.clear()
        given = self._editor.given if self._room.posed is not None else ()
        with self._people:
            if not given:
                ui.label("Accept a scene: then every joint axis of its people is a slider here, and their hands can be dragged.")
            for slot in given:
                subject = self._editor.config.scene.occupants[slot].subject  # type: ignore[union-attr]
                with ui.expansion(f"{slot}: {subject}").props("dense").classes("w-full studio-group") as group:
                    inside = ui.column().classes("w-full").style("gap: 0")
                group.on_value_change(lambda _, slot=slot, inside=inside: self._fill_person(slot, inside))

    def _fill_person(self, slot: str, inside: ui.column) -> None:
        shown, scene = self._room.posed, self._editor.config.scene
        if inside.default_slot.children or shown is None or scene.kind != "cabin" or shown.scene.cabin is None:
            return
        pose = scene.occupants[slot].pose
        if pose is None or slot not in shown.scene.settings:
            return
        low, high = shown.scene.cabin.seats[slot].ranges
        with inside:
            for key, name in (("fore_aft_m", "fore_aft_m"), ("height_m", "height_m"), ("torso_angle_rad", "torso_angle")):
                scale = math.radians(1.0) if key.endswith("_rad") else 1.0
                words, unit = ("torso angle", "°") if key.endswith("_rad") else (f"seat {key.removesuffix('_m')}", "m")
                ends = float(getattr(low, name)) / scale, float(getattr(high, name)) / scale
                self._slider(words, ends, getattr(pose, key) / scale, unit, self._seat_setter(slot, key, scale))
            for dof in DOFS:
                scale = dof_scale(dof.name)
                value = pose.angles_rad.get(dof.name, 0.0) / scale
                unit = "" if scale == 1.0 else "°"
                self._slider(dof.name, limits_deg(dof.name), value, unit, self._joint_setter(slot, dof.name))

    def _slider(self, name: str, ends: tuple[float, float], value: float, unit: str, put: Callable[[float], None]) -> None:
        low, high = ends
        step, digits = (0.01, 2) if high - low <= 2.0 else (0.5, 1)
        with ui.row().classes("no-wrap items-center w-full").style("gap: 6px; font-size: 12px; height: 26px"):
            ui.label(name).style("width: 118px; white-space: nowrap; overflow: hidden").tooltip(f"{low:.4g} to {high:.4g}{unit}")
            number = ui.label(f"{value:.{digits}f} {unit}")
            number.style("width: 52px; text-align: right; font-variant-numeric: tabular-nums")

            last = value

            async def moved(event: Any) -> None:
                nonlocal last
                chosen = min(max(float(event.value), low), high)
                if chosen == last:  # the browser tells a place twice
                    return
                last = chosen
                number.text = f"{chosen:.{digits}f} {unit}"
                await self._do(lambda: put(chosen), rebuild=False)

            slider = ui.slider(min=low, max=high, step=step, value=value).props("dense").style("flex: 1")
            slider.on_value_change(moved)
            slider.mark(name)

    def _seat_setter(self, slot: str, key: str, scale: float) -> Callable[[float], None]:
        def put(value: float) -> None:
            if self._room.posed is not None:
                self._editor.set_seat(self._room.posed, slot, key, value * scale)

        return put

    def _joint_setter(self, slot: str, axis: str) -> Callable[[float], None]:
        def put(value: float) -> None:
            if self._room.posed is not None:
                self._editor.turn_joint(self._room.posed, slot, axis, value * dof_scale(axis))

        return put

    # ------------------------------------------------------------------------------------------------ what is asked for

    async def _do(self, change: Callable[[], Any], *, rebuild: bool = True) -> None:
        """Make a change, and draw what comes of it."""
        try:
            if change() is False:
                ui.notify("there is nothing more to undo or redo")
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True, timeout=10_000)
        if not rebuild:
            self._state = self._editor.state
        await self._room.redraw()

    async def _changed_by_field(self) -> None:
        self._state = self._editor.state
        await self._room.redraw()

    def _accept(self) -> None:
        if self._room.posed is not None:
            self._editor.accept(self._room.posed)

    async def _frame_changed(self) -> None:
        seed, index = int(self._seed.value or 0), int(self._index.value or 0)
        if (seed, index) != (self._editor.state.seed, self._editor.state.index):
            await self._do(lambda: self._editor.look_at(seed, index), rebuild=False)

    async def _dragged(self, event: Any) -> None:
        shown, place = self._room.posed, (event.x, event.y, event.z)
        kind, _, rest = str(event.object_name).partition(":")
        if shown is None:
            return
        if kind == "hand":
            slot, _, side = rest.partition(":")
            missed: list[float] = []
            await self._do(lambda: missed.append(self._editor.move_hand(shown, slot, side, place)))
            if missed and missed[0] > 0.01:
                ui.notify(f"the hand ends {100 * missed[0]:.0f} cm before that place")
        elif kind == "camera":
            await self._do(lambda: self._editor.move_camera(shown, position=place))
        elif kind == "target":
            await self._do(lambda: self._editor.move_camera(shown, target=place))

    # ------------------------------------------------------------------------------------------------------- dialogs

    def _open_dialog(self) -> None:
        with ui.dialog() as dialog, ui.card():
            ui.label(f"Configurations in {self._editor.folder}")
            for name in self._editor.files():
                ui.button(name, on_click=lambda name=name: self._loaded(dialog, name)).props("flat no-caps dense")
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
        dialog.open()

    async def _loaded(self, dialog: ui.dialog, name: str) -> None:
        dialog.close()
        await self._do(lambda: self._editor.load(name))

    def _save_dialog(self) -> None:
        with ui.dialog() as dialog, ui.card():
            ui.label(f"Save in {self._editor.folder}")
            name = ui.input("file name", value=self._editor.file or "scene.yaml").props("dense outlined autofocus")
            over = ui.checkbox("overwrite it", value=False)
            over.set_visibility(False)
            lost = ui.label("Its comments, and the order and form of its keys, are lost then.").style("color: #d33")
            lost.set_visibility(False)

            def save() -> None:
                try:
                    path = self._editor.save(str(name.value), overwrite=bool(over.value))
                except CabinposeError as error:
                    name.error = error.in_one_line()
                    over.set_visibility("exists" in str(error))
                    lost.set_visibility(over.visible and self._editor.has_comments(str(name.value)))
                    return
                dialog.close()
                ui.notify(f"saved {path.name}; `cabinpose synth --config {path.name} --seed {self._editor.state.seed}` makes it")

            with ui.row():
                ui.button("Save it", on_click=save).props("no-caps")
                ui.button("Close", on_click=dialog.close).props("flat no-caps")
        dialog.open()

    def _generate_dialog(self) -> None:
        with ui.dialog() as dialog, ui.card():
            ui.label(f"Generate in {self._editor.folder}")
            name = ui.input("folder", value="dataset").props("dense outlined")
            frames = ui.number("frames", value=100, min=1, step=1, precision=0).props("dense outlined")
            resume = ui.checkbox("go on with what is there", value=False)

            def start() -> None:
                try:
                    self._room.generate(str(name.value), int(frames.value or 0), resume=bool(resume.value))
                except CabinposeError as error:
                    name.error = error.in_one_line()
                    return
                dialog.close()
                self._look_at_generation()

            with ui.row():
                ui.button("Start", on_click=start).props("no-caps")
                ui.button("Close", on_click=dialog.close).props("flat no-caps")
        dialog.open()

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
        room, editor, posed = self._room, self._editor, self._room.posed
        if editor.state is not self._state or (posed is not None and self._seen is None):
            self._state = editor.state
            self._fields.rebuild()
            self._build_people()
        self._seed.value, self._index.value = editor.state.seed, editor.state.index
        wrong = [f"{'.'.join(map(str, key)) or 'configuration'}: {words}" for key, words in editor.errors.items()]
        self._tell(posed, wrong + ([room.error] if room.error else []))
        self._fields.show_errors()
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

    def _tell(self, shown: Posed | None, wrong: list[str]) -> None:
        collisions = [_words(verdict) for verdict in shown.verdicts] if shown is not None else []
        doubts = [f"camera: {'; '.join(shown.doubts)}"] if isinstance(shown, Shown) and shown.doubts else []
        self._verdict.text = "; ".join((*wrong, *collisions, *doubts)) or "holds: nothing collides"
        self._verdict.style(f"color: {'#d33' if wrong or collisions else '#c77700' if doubts else '#2a9d5c'}")
        if shown is not None:
            who = ", ".join(f"{p.slot} {p.subject} ({p.action})" for p in shown.scene.people)
            took = 1000 * sum(shown.seconds.values())
            self._facts.text = f"{shown.scene.place}, view {shown.scene.pov}; {who}; {took:.0f} ms"

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
        return Marks(lines, balls)

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


def _words(verdict: Verdict) -> str:
    where = "" if verdict.where is None else " at " + ", ".join(f"{x:.2f}" for x in verdict.where) + " m"
    depth = f", {1000 * verdict.depth_m:.0f} mm deep" if verdict.depth_m else ""
    return f"{verdict.rejection}{depth}{where}"


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
        _open(scene)
        return
    begin = ui.column().classes("w-full items-center")
    with begin:
        empty_state("No scene is open", "Open a configuration of `cabinpose synth`:", "cabinpose studio SCENE.yaml")
        ui.button("Begin a new one here", icon="add", on_click=lambda: _begin(begin, scene)).props("no-caps outline")


def _begin(place: ui.column, scene: OpenedScene) -> None:
    place.clear()
    with place:
        _open(scene)


def _open(scene: OpenedScene) -> None:
    try:
        room = scene.room()
    except CabinposeError as error:
        empty_state("The scene cannot be opened", str(error), error.hint or "")
        return
    SceneTab(room)


TAB = Tab("Scene", _build, VIEW_KEYS, shared=lambda workspace: OpenedScene(workspace.scene))
