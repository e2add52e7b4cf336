"""The Live tab: a camera, a recording or a dataset as it plays, and what detectors find in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import datetime
from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui

from cabinpose.app.live.choose import parsed_settings
from cabinpose.app.models import open_detectors
from cabinpose.app.studio.canvas import GREY, IMAGE_KEYS, FrameCanvas
from cabinpose.app.studio.clouds import person_colour
from cabinpose.app.studio.live_cloud import LiveCloud
from cabinpose.app.studio.live_keep import keep, write_kept
from cabinpose.app.studio.live_plot import LivePlot
from cabinpose.app.studio.live_session import PRESENT, LiveRoom, LiveSession, Shown, image_of
from cabinpose.app.studio.models import detectors
from cabinpose.app.studio.tab import Page, Tab
from cabinpose.app.studio.view3d import VIEW_KEYS
from cabinpose.app.studio.workspace import Workspace
from cabinpose.core import CabinposeError, ConfigError, Predictor, skeleton_of
from cabinpose.record.sources import SOURCES, cameras
from cabinpose.record.sources.tof import adjustable, described

_OF_SCENES = "synth"  # the kind of camera that sees what the generator makes
_PERIOD_S = 0.1  # between looks for a new frame
_LABELS = {
    "integration_us": "integration time, µs", "frame_rate_hz": "frame rate, Hz", "modulation_hz": "modulation frequency, Hz",
}  # fmt: skip


class LiveTab:
    """The tab of one browser; the run itself is the studio's, shared by all."""

    def __init__(self, workspace: Workspace, room: LiveRoom, label: Callable[[], None]) -> None:
        self._workspace, self._room, self._label = workspace, room, label
        self._drawn: Any = None
        self._told: LiveSession | None = None  # of which run the line below the images is
        with ui.row().classes("studio-tab no-wrap w-full"):
            with ui.column().classes("studio-side"):
                self._build_side()
            with ui.column().classes("studio-main"):
                with ui.row().classes("no-wrap w-full").style("flex: 1; min-height: 0; gap: 10px; align-items: stretch"):
                    self._images = ui.row().classes("no-wrap").style("flex: 1; min-width: 0; gap: 10px; align-items: stretch")
                    with self._images:
                        with ui.element("div").classes("studio-pane"):
                            self._depth = FrameCanvas(live=True, on_pressed={" ": self._toggle, "k": self._keep})
                        with ui.element("div").classes("studio-pane"):
                            self._amplitude = FrameCanvas(live=True)
                    self._space = ui.element("div").classes("studio-pane").bind_visibility_from(self._cloud, "value")
                plot = ui.row().classes("no-wrap w-full").style("height: 220px; flex: none; gap: 10px")
                with plot.bind_visibility_from(self._plot, "value"):
                    LivePlot(lambda: self._room.session, lambda: bool(self._plot.value) and self._room.frozen is None)
                self._rates = ui.label("Choose a source and a model, then start.").mark("rates")
                self._trouble = ui.label().classes("studio-trouble").mark("trouble")
        ui.timer(_PERIOD_S, self._look)

    def _build_side(self) -> None:
        opened = self._workspace.recording or self._workspace.folder
        sources = [*([str(opened)] if opened is not None else []), *cameras()]
        begin = _OF_SCENES if opened is None and self._workspace.scene is not None else sources[0]
        self._source = ui.select(sources, value=begin, label="source", on_change=self._prefill).props("dense outlined")
        self._source.classes("w-full").mark("source")
        self._numbers = {
            key: ui.number(label, min=0, format="%g").props("dense outlined clearable").classes("w-full").mark(key)
            for key, label in _LABELS.items()
        }
        for key, field in self._numbers.items():
            field.bind_visibility_from(self._source, "value", partial(_has, key))
        self._settings = ui.textarea("settings, KEY=VALUE a line", placeholder="use_case=MODE_9_5FPS_2000").props(
            "dense outlined autogrow"
        )
        self._settings.classes("w-full").mark("settings")
        self._prefilled = ""
        self._prefill()
        self._models = ui.select(detectors(), value=["in_car"], label="models", multiple=True, new_value_mode="add-unique").props(
            "dense outlined use-chips hint='or grpc://HOST:PORT/MODEL'"
        )
        self._models.classes("w-full")
        with ui.row().classes("w-full").style("gap: 0 6px"):
            self._cloud = ui.checkbox("cloud", on_change=self._show_cloud)
            self._plot = ui.checkbox("joints over time")
            self._recording = ui.checkbox("record what is seen")
            self._recording.tooltip("from the start: joints as lines of JSON, and of a camera all that it says as a recording")
        with ui.row().classes("no-wrap w-full").style("gap: 6px"):
            self._start = ui.button("Start", icon="play_arrow", on_click=self._begin).props("dense no-caps").style("flex: 1")
            ui.button("Stop", icon="stop", on_click=self._end).props("dense no-caps outline").style("flex: 1")
        self._freeze = ui.button("Freeze", icon="ac_unit", on_click=self._toggle).props("dense no-caps outline").classes("w-full")
        with ui.row().classes("no-wrap w-full").style("gap: 6px"):
            words = "Keep this frame, to be labelled later"
            ui.button("Keep", icon="bookmark_add", on_click=self._keep).props("dense no-caps outline").tooltip(words)
            self._to_label = ui.button("Label this frame", icon="edit", on_click=self._open).props("dense no-caps outline")
            self._to_label.style("flex: 1")
        self._setup = ui.label().style("font-size: 13px").mark("setup")
        self._joints = ui.column().classes("w-full").style("gap: 0; font-size: 13px")

    def _prefill(self) -> None:
        """What is open, as the setting of the source that takes it; what somebody typed stays."""
        if (self._settings.value or "") != self._prefilled:
            return
        thing = {_OF_SCENES: ("scenes", self._workspace.scene), "simulated": ("dataset", self._workspace.folder)}
        key, path = thing.get(str(self._source.value), ("", None))
        self._prefilled = f"{key}={json.dumps(str(path.resolve()), ensure_ascii=False)}" if path is not None else ""
        self._settings.value = self._prefilled

    async def _begin(self) -> None:
        """Start; a start that fails leaves no picture of the run before, and says why until the next one."""
        self._start.disable()
        room = self._room
        try:
            await run.io_bound(room.stop)
            settings = parsed_settings([line.strip() for line in str(self._settings.value or "").splitlines() if line.strip()])
            settings = _with_numbers(settings, {key: self._numbers[key].value for key in _keys_of(str(self._source.value))})
            names = list(self._models.value or ())
            models: list[Predictor] = await run.io_bound(open_detectors, names) or []
            record = self._workspace.root / f"live-{datetime.now():%Y%m%d-%H%M%S}" if self._recording.value else None  # noqa: DTZ005 - local
            room.session = LiveSession(str(self._source.value), settings, models, within=self._workspace.root, record=record)
        except CabinposeError as error:
            room.trouble = error.in_one_line()
        finally:
            self._start.enable()

    async def _end(self) -> None:
        await run.io_bound(self._room.stop)

    def _toggle(self) -> None:
        room = self._room
        room.frozen = None if room.frozen is not None else room.shown()
        self._tell_buttons()

    def _tell_buttons(self) -> None:
        """Say what the buttons do now; another browser may have frozen or kept a frame."""
        frozen, kept = self._room.frozen is not None, len(self._room.kept)
        self._freeze.text = "Go on" if frozen else "Freeze"
        this = "this and " if self._room.shown() is not None else ""
        self._to_label.text = f"Label {this}{kept} kept" if kept else "Label this frame"

    def _keep(self) -> bool:
        """Keep the frame that is shown; False where that cannot be."""
        shown = self._room.shown()
        if shown is None:
            ui.notify("there is no frame yet: start a run")
            return False
        try:
            keep(self._room.kept, shown)
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True)
            return False
        self._tell_buttons()
        return True

    async def _open(self) -> None:
        """Write the frame that is shown, with those that are kept, as a dataset, and open that to be labelled.

        Where it cannot be among them, or nothing is shown any more, those alone.
        """
        room, workspace = self._room, self._workspace
        if (room.shown() is not None or not room.kept) and not self._keep() and not room.kept:
            return
        kept, room.kept = room.kept, []
        try:
            written = await run.io_bound(write_kept, kept, workspace.root)
            if written is None:  # the studio is ending
                return
            workspace.open(*written)
        except (CabinposeError, OSError) as error:
            room.kept = [*kept, *room.kept]
            ui.notify(str(error), type="negative", multi_line=True, timeout=10_000)
            return
        self._label()

    def _show_cloud(self) -> None:
        self._images.style("flex-direction: column" if self._cloud.value else "flex-direction: row")
        if self._cloud.value and not self._space.default_slot.children:
            with self._space:
                LiveCloud(lambda: self._room.shown() if self._cloud.value else None)

    def _look(self) -> None:
        """Show the newest frame, and how the run does."""
        self._tell_buttons()
        session, shown = self._room.session, self._room.shown()
        self._trouble.text = session.error if session is not None else self._room.trouble
        if session is None and self._told is not None:  # how it ended
            self._tell(self._told)
        self._told = session
        if session is not None:
            self._tell(session)
        elif self._room.trouble:
            self._rates.text = self._setup.text = ""
        if shown is self._drawn:
            return
        self._drawn = shown
        if shown is None:
            for canvas in (self._depth, self._amplitude):
                canvas.show("", near=0.0, far=1.0)
                canvas.joints([], ())
            self._joints.clear()
            return
        frame = shown.frame
        depth = image_of(frame, "depth")
        valid = depth[np.isfinite(depth)]
        near, far = np.quantile(valid[::7], (0.01, 0.99)).tolist() if valid.size else (0.0, 1.0)
        people, limbs = _people(shown)
        self._depth.show(f"/live/{frame.host_ns}/depth", near=near, far=far)
        self._depth.joints(people, limbs)
        if "amplitude" in frame.batch:
            white = float(np.quantile(image_of(frame, "amplitude")[::7], 0.995)) or 1.0
            self._amplitude.show(f"/live/{frame.host_ns}/amplitude", near=0.0, far=white, palette=GREY)
            self._amplitude.joints(people, limbs)
        self._table(shown)

    def _tell(self, session: LiveSession) -> None:
        status = session.status()
        self._setup.text = f"camera: {', '.join(described(status.feed.setup))}" if status.feed.setup else ""
        late = f"{status.latency.p50:.0f} / {status.latency.p95:.0f} / {status.latency.p99:.0f} ms" if status.latency else "–"
        state = "" if session.running else "ended: "
        names = " and ".join(path.name for path in session.records)
        recorded = f"; {'recording to' if session.running else 'recorded in'} {names}" if names else ""
        trouble = f"; {status.feed.error}" if status.feed.error else ""
        self._rates.text = (
            f"{state}{status.frames} frames, {status.rate_hz:.1f} a second; arrival to joints p50 / p95 / p99 {late}; "
            f"{status.feed.passed_over} left out, {status.feed.counts.lost} lost{recorded}{trouble}"
        )

    def _table(self, shown: Shown) -> None:
        """How long each model took, and how many joints of whom it found."""
        self._joints.clear()
        with self._joints:
            for model, answer in shown.found:
                trouble = f"; {answer.error}" if answer.error else ""
                ui.label(f"{model.name}: {answer.ms:.1f} ms{trouble}").style("font-weight: 600")
                for p, person in enumerate(model.persons):
                    sure = answer.poses.presence[0, p]
                    count = int((sure >= PRESENT).sum())
                    if count:
                        least = int(np.argmin(np.where(sure >= PRESENT, sure, 2)))
                        ui.label(f"{person}: {count} joints, least sure {model.joints[least]} {sure[least]:.2f}")


def _keys_of(source: str) -> tuple[str, ...]:
    """What can be set of a source by number; nothing of a file."""
    return adjustable(SOURCES[source]) if source in SOURCES.names() else ()


def _has(key: str, source: str) -> bool:
    return key in _keys_of(source)


def _with_numbers(settings: dict[str, Any], numbers: dict[str, float | None]) -> dict[str, Any]:
    """Settings with the numbers that were given. Raises ConfigError where one stands in both."""
    given = {key: value for key, value in numbers.items() if value is not None}
    if twice := sorted(given.keys() & settings.keys()):
        raise ConfigError(f"{', '.join(twice)} is given twice", hint="as a number, or among the settings")
    return settings | given


def _people(shown: Shown) -> tuple[list[dict[str, Any]], tuple[tuple[int, int], ...]]:
    people: list[dict[str, Any]] = []
    limbs: tuple[tuple[int, int], ...] = ()
    for number, (model, answer) in enumerate(shown.found):
        names = list(model.joints)
        limbs = skeleton_of(model).limbs
        for p in range(len(model.persons)):
            there = answer.poses.presence[0, p] >= PRESENT
            places = answer.poses.joints_2d[0, p]
            seen = there & np.isfinite(places).all(axis=1)
            joints = [
                {"name": name, "u": float(u) if ok else None, "v": float(v) if ok else None}
                for name, (u, v), ok in zip(names, places, seen, strict=True)
            ]
            people.append({"colour": person_colour(p + 2 * number), "joints": joints, "limbs": limbs, "fixed": True})
    return people, limbs


def _build(page: Page) -> None:
    LiveTab(page.workspace, page.of_studio(LiveRoom), lambda: page.renew("Label"))


_KEYS = (("Space", "freeze, go on"), ("k", "keep the frame, to be labelled later"), *VIEW_KEYS, IMAGE_KEYS)
TAB = Tab("Live", _build, _KEYS, shared=lambda _: LiveRoom())
