"""The Dataset tab: any dataset, filtered, frame by frame, on every image and in the cloud, with its statistics."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property, partial
from html import escape
from typing import Any

import numpy as np
from nicegui import run, ui
from numpy.typing import NDArray

from cabinpose.app.studio.canvas import GREY, IMAGE_KEYS, FrameCanvas
from cabinpose.app.studio.choice import Choice, ChoiceDialog
from cabinpose.app.studio.clouds import person_colour
from cabinpose.app.studio.histogram import HistogramPanel, statistics_dialog
from cabinpose.app.studio.models import FrameErrors, PredictedPeople, found_in, frame_errors
from cabinpose.app.studio.pictures import CLASSES, DEPTHS, GREYS, IMAGES
from cabinpose.app.studio.tab import Page, Tab, no_dataset
from cabinpose.app.studio.thumbs import INSTANCES, FrameGrid
from cabinpose.app.studio.view3d import FramePoints, look_through, skeleton_lines, view_3d
from cabinpose.app.studio.workspace import depth_range
from cabinpose.app.view.draw import VISIBILITY_COLOUR
from cabinpose.core import CabinposeError, ConfigError, Visibility, apply
from cabinpose.store import completions, dataset_skeleton, frames_where, label_colours, query_columns

_FILTERS = ("subject", "action", "car", "pov")
_PAGE = 20  # frames
_ANSWER_S = 2.0  # a browser that has not shown a frame by then is sent the next one all the same
_STATES = {int(state): state.name.lower().replace("_", " ") for state in Visibility if state in VISIBILITY_COLOUR}
_FOUND = "#ff4fd8"  # predictions: no person and no joint is drawn so
_LEGEND = f'<span style="background: {_FOUND}"></span> predicted <span style="background: {person_colour(0)}"></span> truth'


class DatasetTab:
    """The tab of one browser: which frames are chosen, and which one is shown."""

    def __init__(self, page: Page) -> None:
        workspace = page.workspace
        assert workspace.dataset is not None
        self._page, self._workspace, self._dataset = page, workspace, workspace.dataset
        self._coordinates = {name: self._dataset[name].values for name in _FILTERS if name in self._dataset.coords}
        self._joints = [str(name) for name in self._dataset["joint"].values]
        self._limbs = dataset_skeleton(self._dataset).limbs
        self._rows: NDArray[np.int64] = np.arange(self._dataset.sizes["frame"])
        self._position = 0
        self._shown_at: float | None = None  # when the frame was sent that the browser has not shown yet
        self._url, self._before, self._next = "", 0, list[int]()
        self._answers = self._behind = False  # whether it says that it has · whether another frame is due then
        self._errors: FrameErrors | None = None  # of the predictions that are chosen
        self._condition, self._chosen_by = page.address.get("dataset.where", ""), ""
        self._begin = page.remembered("dataset.frame", self._dataset["frame"].values.tolist())
        with ui.row().classes("studio-tab no-wrap w-full"):
            with ui.column().classes("studio-side"):
                self._build_side()
            with ui.column().classes("studio-main"):
                self._build_main()
        self._offer_histograms(page.address.get("dataset.histogram"))
        self._filter()
        self._go_back()
        self._predictions.value = page.remembered("dataset.errors", list(self._workspace.predictions))
        ui.keyboard(on_key=self._key, repeating=False, ignore=["input", "select", "textarea"])
        ui.timer(1.0, self._look)

    def _build_side(self) -> None:
        with (
            ui.column().classes("w-full").style("gap: 4px; padding: 6px; border-radius: 4px; background: #c9820033") as self._news
        ):
            self._told = ui.label().style("font-size: 13px")
            self._again = ui.button("Show them", icon="refresh", on_click=self._reopen).props("outline dense no-caps")
        self._news.visible = False
        self._query = (
            ui.input("frames where", value=self._condition, placeholder='car == "suv" and people > 1', on_change=self._typed)
            .props("dense outlined clearable stack-label")
            .classes("w-full")
            .mark("where")
            .on("keydown.enter", self._ask)
            .on("keydown.escape", js_handler="(event) => event.target.blur()")
            .on("clear", self._ask)
            .on("blur", self._ask)
        )
        self._filters = {}
        for name, values in self._coordinates.items():
            options = sorted(filter(None, map(str, set(values.ravel().tolist()))))
            self._filters[name] = (
                ui.select(options, label="view" if name == "pov" else name, multiple=True, clearable=True, on_change=self._filter)
                .props("dense outlined use-chips")
                .style("width: 100%")
            )
        with ui.row().classes("no-wrap items-center w-full"):
            self._joint = ui.select(self._joints, label="joint", clearable=True, on_change=self._filter).props("dense outlined")
            self._joint.style("flex: 1; min-width: 0")
            self._state = ui.select(_STATES, label="seen", clearable=True, on_change=self._filter).props("dense outlined")
            self._state.style("flex: 1; min-width: 0")
        self._predictions = (
            ui.select(list(self._workspace.predictions), label="error of", clearable=True, on_change=self._judge)
            .props("dense outlined")
            .classes("w-full")
            .mark("error of")
        )
        with ui.row().classes("no-wrap items-center w-full") as self._by_error:
            self._over = ui.number("over, cm", min=0, on_change=self._filter).props("dense outlined")
            self._worst = ui.number("the worst", min=1, precision=0, on_change=self._filter).props("dense outlined")
            for field in (self._over, self._worst):
                field.style("flex: 1; min-width: 0")
            self._sorted = ui.checkbox("sort", value=True, on_change=self._filter)
        with ui.row().classes("no-wrap items-center w-full") as self._with_found:
            self._drawn = ui.checkbox("predictions", value=True, on_change=self._show).mark("predictions drawn")
            ui.html(_LEGEND, sanitize=False).classes("studio-legend")
        self._by_error.visible = self._with_found.visible = False
        self._histogram = HistogramPanel(self._columns, self._narrow, self._page.remember)
        self._count = ui.label()
        ui.separator()
        names = [name for name in IMAGES if name in self._dataset]
        image = self._page.remembered("dataset.image", names) or "depth"
        self._image = ui.select(names, value=image, label="image", on_change=self._look_anew).props("dense outlined")
        self._image.style("width: 100%")
        with ui.row().classes("no-wrap items-center w-full"):
            self._skeleton = ui.checkbox("skeletons", value=True, on_change=self._show)
            self._auto = ui.checkbox("colours by frame", value=True, on_change=self._look_anew)
        near, far = depth_range(self._dataset, 0)
        self._range = ui.range(min=0.0, max=round(max(4.0, far), 2), step=0.01, value={"min": near, "max": far}).props("label")
        self._range.on_value_change(self._look_anew)
        ui.separator()
        self._facts = ui.html(sanitize=False).classes("studio-facts w-full").mark("frame facts")
        ui.button("Label this frame", icon="edit", on_click=self._label_this).props("outline dense no-caps").classes("w-full")
        self._dialog = ChoiceDialog(self._workspace, self._choice)
        ui.button("Take these frames out", icon="output", on_click=self._dialog.open).props("outline dense no-caps").classes(
            "w-full"
        )
        ui.button("Statistics", icon="bar_chart", on_click=self._statistics).props("outline dense no-caps").classes("w-full")

    def _build_main(self) -> None:
        with ui.row().classes("no-wrap w-full").style("flex: 1; min-height: 0; gap: 10px; align-items: stretch") as self._panes:
            with ui.element("div").classes("studio-pane"):
                self._canvas = FrameCanvas(on_pressed=self._steps(), on_loaded=self._loaded).mark("frame")
            with ui.element("div").classes("studio-pane") as pane:
                self._scene = view_3d()
                with self._scene:
                    self._points = FramePoints()
                pane.on("resize", self._scene.update)
        with ui.element("div").classes("w-full").style("flex: 1; min-height: 0") as self._many:
            size = self._dataset.sizes["x"], self._dataset.sizes["y"]
            self._grid = FrameGrid(size, self._go, self._toggle_grid).mark("grid")
        self._many.visible = self._page.address.get("dataset.view") == "grid"
        self._panes.visible = not self._many.visible
        with ui.row().classes("no-wrap items-center w-full").style("gap: 10px; padding: 0 4px"):
            grid = ui.button(icon="grid_view", on_click=self._toggle_grid).props("flat round dense aria-label=grid")
            grid.tooltip("All in a grid, or one frame: g")
            ui.button(icon="chevron_left", on_click=lambda: self._go(self._position - 1)).props("flat round dense")
            self._slider = ui.slider(min=0, max=1, value=0, on_change=lambda e: self._go(int(e.value))).mark("frames")
            self._slider.style("flex: 1")
            ui.button(icon="chevron_right", on_click=lambda: self._go(self._position + 1)).props("flat round dense")
            self._number = ui.label().style("min-width: 150px; text-align: right; font-variant-numeric: tabular-nums")
            self._number.mark("frame number")
        self._camera_set = False

    def _steps(self) -> dict[str, Callable[[], None]]:
        """What keys do while the image is seen."""
        by = {"ArrowLeft": -1, "ArrowRight": 1, "PageUp": -_PAGE, "PageDown": _PAGE}
        ends = {"Home": lambda: self._go(0), "End": lambda: self._go(len(self._rows) - 1)}
        return {**{key: partial(self._step, step) for key, step in by.items()}, **ends}

    def _step(self, step: int) -> None:
        self._go(self._position + step)

    def _go_back(self) -> None:
        """Show the frame that stood in the address, where it is among those that are chosen."""
        if self._begin is not None and (places := np.flatnonzero(self._dataset["frame"].values[self._rows] == self._begin)).size:
            self._go(int(places[0]))

    async def _judge(self) -> None:
        """Find how far the chosen predictions are off, which is asked for again after each change of labels by choosing anew."""
        name, self._errors, errors = self._predictions.value, None, None
        if name is not None:
            try:
                errors = await run.io_bound(frame_errors, self._workspace, self._dataset, str(name))
            except CabinposeError as error:
                ui.notify(error.in_one_line(), type="negative", multi_line=True)
        if name != self._predictions.value:
            return  # others were chosen meanwhile
        self._errors = errors
        self._by_error.visible = self._with_found.visible = self._errors is not None
        self._page.remember({"dataset.errors": name or ""})
        self._offer_histograms()
        if self._errors is not None:
            self._over.props(f'label="over, {self._errors.unit}"')
        self._filter()
        if name == self._page.address.get("dataset.errors"):  # after a reload
            self._go_back()
        self._begin = None

    @cached_property
    def _stored(self) -> dict[str, NDArray[Any]]:
        """What a condition can ask of the dataset, read once: every key that is typed asks again."""
        return query_columns(self._dataset)

    def _columns(self) -> dict[str, NDArray[Any]]:
        """What a condition can ask: with the error of the predictions that are chosen."""
        errors = self._errors
        return self._stored if errors is None else {**self._stored, f"error_{errors.unit}": errors.d}

    def _offer_histograms(self, chosen: str | None = None) -> None:
        self._histogram.offer([name for name in self._columns() if name != "pov"], chosen)

    def _typed(self) -> None:
        self._query.set_autocomplete(completions(self._columns(), self._query.value or ""))

    def _ask(self) -> None:
        if (condition := (self._query.value or "").strip()) != self._condition:
            self._condition = condition
            self._page.remember({"dataset.where": condition})
            self._filter()

    def _narrow(self, condition: str) -> None:
        """Ask for one thing more."""
        old = self._condition
        self._query.value = condition if not old else f"({old}) and {condition}" if " or " in old else f"{old} and {condition}"
        self._ask()

    def _choice(self) -> Choice:
        """The frames that are chosen, and by what; those of before where what is asked for is no condition."""
        return Choice(self._dataset["frame"].values[self._rows], self._chosen_by)

    def _asked_for(self) -> str:
        words = [self._condition] if self._condition else []
        words += [f"{name} in {select.value}" for name, select in self._filters.items() if select.value]
        if self._state.value is not None:
            words.append(f"{self._joint.value or 'a joint'} {_STATES[self._state.value]}")
        if self._errors is not None and (self._over.value is not None or self._worst.value is not None):
            over = "" if self._over.value is None else f" over {self._over.value:g} {self._errors.unit}"
            worst = "" if self._worst.value is None else f", the {max(int(self._worst.value), 1)} worst"
            words.append(f"error of {self._predictions.value}{over}{worst}")
        return "; ".join(words)

    def _key(self, event: Any) -> None:
        """What letters do, wherever on the page, unless they are written into a field."""
        does = {
            "g": self._toggle_grid,
            "p": self._toggle_found,
            "/": self._to_query,
            "h": self._histogram.open,
            "e": self._dialog.open,
        }
        held = event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta
        if self._page.front() == TAB.name and event.action.keydown and not held and str(event.key) in does:
            does[str(event.key)]()

    def _to_query(self) -> None:
        self._query.run_method("focus")

    def _toggle_found(self) -> None:
        self._drawn.value = not self._drawn.value

    def _toggle_grid(self) -> None:
        """Show all frames that are chosen in a grid, or the one in front large."""
        grid = not self._many.visible
        self._many.visible, self._panes.visible = grid, not grid
        self._page.remember({"dataset.view": "grid" if grid else ""})
        self._shown_at = None
        self._show()
        if grid:
            self._fill_grid()
            self._grid.focus()

    def _look_anew(self) -> None:
        """Another image, or other colours."""
        self._page.remember({"dataset.image": self._image.value})
        self._fill_grid()
        self._show()

    def _fill_grid(self) -> None:
        if not self._many.visible:
            return
        limits = "" if self._auto.value else f"?near={self._range.value['min']:.2f}&far={self._range.value['max']:.2f}"
        notes = [] if self._errors is None else [self._errors.words(row) for row in self._rows.tolist()]
        url = self._workspace.thumbs_url(str(self._image.value))
        self._grid.show(url, limits, self._dataset["frame"].values[self._rows], notes)

    def _filter(self) -> None:
        """Choose the frames that fit; those of before stay where the condition is none."""
        chosen = np.ones(self._dataset.sizes["frame"], bool)
        self._query.error = None
        if self._condition:
            try:
                chosen &= frames_where(self._columns(), self._condition)
            except ConfigError as error:
                self._query.error = error.in_one_line()
                return
        for name, select in self._filters.items():
            if select.value:
                values = self._coordinates[name].astype(str)
                hit = np.isin(values, select.value)
                chosen &= hit.any(axis=1) if hit.ndim == 2 else hit
        if self._state.value is not None:
            columns = slice(None) if self._joint.value is None else [self._joints.index(self._joint.value)]
            chosen &= (self._dataset["visibility"].values[:, :, columns] == self._state.value).any(axis=(1, 2))
        self._rows = np.flatnonzero(chosen)
        if self._errors is not None:
            self._rows = self._errors.choose(self._rows, self._over.value, self._worst.value, by_error=self._sorted.value)
        self._chosen_by = self._asked_for()
        self._slider.props(f"max={max(len(self._rows) - 1, 1)}")
        self._histogram.show(self._rows)
        self._fill_grid()
        self._go(0)

    def _go(self, position: int) -> None:
        self._position = min(max(position, 0), max(len(self._rows) - 1, 0))
        self._show()

    def _loaded(self) -> None:
        """The browser shows the frame that it was sent: the newest of those asked for meanwhile is next."""
        self._answers, self._shown_at = True, None
        if self._behind:
            self._show()

    def _label_this(self) -> None:
        if len(self._rows):
            self._page.label(int(self._dataset["frame"].values[self._rows[self._position]]))

    def _look(self) -> None:
        """Offer the frames that have come since, and the predictions that Compare has opened or run; say if the data are gone."""
        if self._behind:
            self._show()
        assert self._workspace.dataset is not None
        try:
            new = self._workspace.new_frames() + self._workspace.dataset.sizes["frame"] - self._dataset.sizes["frame"]
            self._told.text = f"{new} frames have come since this was opened"
            self._again.visible = self._news.visible = new > 0
        except CabinposeError as error:
            self._told.text = error.in_one_line()
            self._again.visible, self._news.visible = False, True
        if (names := list(self._workspace.predictions)) != self._predictions.options:
            self._predictions.set_options(names)

    def _reopen(self) -> None:
        try:
            if self._workspace.new_frames():
                self._workspace.reopen()
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True)
            return
        ui.navigate.reload()

    def _show(self) -> None:
        """Show the frame; while the browser is busy with the one before, once it is not: a held key piles nothing up."""
        self._behind = self._shown_at is not None and time.monotonic() - self._shown_at < _ANSWER_S
        if self._behind:
            return
        try:
            self._show_frame()
        except (CabinposeError, OSError) as error:
            ui.notify(f"this frame cannot be read: {self._workspace.trouble() or error}", type="negative", multi_line=True)

    @cached_property
    def _small(self) -> Any:
        """The dataset without its images."""
        return self._dataset[[str(name) for name in self._dataset.data_vars if "y" not in self._dataset[name].dims]]

    def _show_frame(self) -> None:
        count = len(self._rows)
        self._count.text = f"{count} of {self._dataset.sizes['frame']} frames"
        self._slider.value = self._position
        if not count:
            self._number.text = "no frame fits"
            self._canvas.show("", near=0, far=1)
            self._canvas.joints([], [])
            self._points.show("", [])
            self._facts.content = ""
            return
        row = int(self._rows[self._position])
        frame = self._small.isel(frame=row).load()
        self._number.text = f"frame {int(frame['frame'])}"
        self._page.remember({"dataset.frame": int(frame["frame"])})
        self._grid.choose(self._position)
        if not self._many.visible:
            self._next = self._ahead()
            found = self._found(int(frame["frame"]))
            self._show_image(row)
            people = people_of(frame) if self._skeleton.value else []
            self._canvas.joints(people + ([] if found is None else found.drawn(_FOUND, dashed=True)), self._limbs)
            self._show_cloud(frame, found)
        error = [] if self._errors is None else [("error", self._errors.words(row))]
        self._facts.content = "".join(
            f"<div><span>{escape(name)}</span><span>{escape(value)}</span></div>" for name, value in (*error, *_facts(frame))
        )

    def _found(self, number: int) -> PredictedPeople | None:
        """Whom the predictions find whose error is chosen, while they are to be drawn."""
        name = self._predictions.value
        return found_in(self._workspace.predictions[name], number) if self._errors is not None and self._drawn.value else None

    def _ahead(self) -> list[int]:
        """Numbers of the frames that arrow keys come to next, that of the way which was gone first."""
        step = 1 if self._position >= self._before else -1
        self._before = self._position
        places = [place for place in (self._position + step, self._position - step) if 0 <= place < len(self._rows)]
        return self._dataset["frame"].values[self._rows[places]].tolist()

    def _show_image(self, row: int) -> None:
        name = self._image.value
        if name in DEPTHS:
            chosen = self._range.value
            near, far = depth_range(self._dataset, row) if self._auto.value else (chosen["min"], chosen["max"])
            palette = None
        elif name in GREYS:
            near, far, palette = 0.0, float(np.quantile(self._dataset[name][row].values, 0.995)) or 1.0, GREY
        else:
            near, far = 0.0, 255.0
            palette = label_colours(self._dataset).tolist() if name == CLASSES[0] else INSTANCES
        url = self._workspace.url(int(self._dataset["frame"].values[row]), str(name))
        if self._answers and url != self._url:
            self._shown_at = time.monotonic()
        self._url = url
        ahead = [self._workspace.url(number, str(name)) for number in self._next]
        self._canvas.show(url, near=near, far=far, palette=palette, ahead=ahead)

    def _show_cloud(self, frame: Any, found: PredictedPeople | None) -> None:
        depth = self._image.value if self._image.value in DEPTHS else "depth"
        vehicle_from_camera = frame["vehicle_from_camera"].values
        places = apply(vehicle_from_camera, frame["joints_3d"].values.astype(np.float64))
        people = [skeleton_lines(person, self._limbs, person_colour(index)) for index, person in enumerate(places)]
        if found is not None:
            people += [skeleton_lines(person, found.limbs, _FOUND) for person in apply(vehicle_from_camera, found.xyz)]
        url = self._workspace.cloud_url
        self._points.show(url(int(frame["frame"]), depth), people, [url(number, depth) for number in self._next[:1]])
        if not self._camera_set:
            self._camera_set = True
            look_through(self._scene, vehicle_from_camera)

    def _statistics(self) -> None:
        if len(self._rows):
            statistics_dialog(self._workspace, self._dataset, self._rows)
        else:
            ui.notify("no frame fits")


def people_of(frame: Any) -> list[dict[str, Any]]:
    """The people of a frame (in memory) as `FrameCanvas.joints` draws them; joints coloured by how they are seen."""
    people = []
    for index, slot in enumerate(frame["person"].values):
        uv, states = frame["joints_2d"].values[index], frame["visibility"].values[index]
        joints = [
            {
                "name": str(name),
                "u": float(u) if state > Visibility.ABSENT and np.isfinite(u) else None,
                "v": float(v) if state > Visibility.ABSENT and np.isfinite(v) else None,
                "colour": "#{:02x}{:02x}{:02x}".format(*VISIBILITY_COLOUR.get(Visibility(int(state)), (128, 128, 128))),
            }
            for name, (u, v), state in zip(frame["joint"].values, uv, states, strict=True)
        ]
        people.append({"slot": str(slot), "colour": person_colour(index), "joints": joints})
    return people


def _facts(frame: Any) -> list[tuple[str, str]]:
    rows = [("car", str(frame["car"].values)), ("view", str(frame["pov"].values)), ("sequence", str(frame["sequence"].values))]
    for index, slot in enumerate(frame["person"].values):
        subject = str(frame["subject"].values[index])
        if subject:
            rows.append((str(slot), f"{subject}, {frame['action'].values[index]}"))
    return rows


def _build(page: Page) -> None:
    if page.workspace.dataset is None:
        no_dataset(page.workspace.recording, "Open one that was generated, recorded or imported:", "cabinpose studio DATASET")
    else:
        DatasetTab(page)


_KEYS = (
    ("← →", "the frame before, the next one"), ("Page Up, Page Down", f"{_PAGE} frames back, on"),
    ("Home, End", "the first, the last"),
    ("g", "all frames in a grid, or one large"), ("↑ ↓, Enter", "in the grid: a row up, down; show the frame"),
    ("/, Esc", "write a condition; leave it"), ("h", "a histogram, whose bars narrow the condition"),
    ("p", "draw the predictions, or not"), ("e", "take the frames out, as a dataset or a split"),
    ("Enter", "in the condition: the frames for which it holds"),
    ("Tab", "in the condition: take what it completes"), IMAGE_KEYS,
)  # fmt: skip
TAB = Tab("Dataset", _build, _KEYS, of_dataset=True)
