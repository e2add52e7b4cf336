"""The Compare tab: truth and any number of predictions, by the numbers of `evaluate`, down to the frames that are worst."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import run, ui

from cabinpose.app.report.numbers import number
from cabinpose.app.studio.canvas import IMAGE_KEYS, FrameCanvas
from cabinpose.app.studio.dataset_tab import people_of
from cabinpose.app.studio.joint_chart import COLUMNS, box_chart, column, curve_chart, height, joint_chart, places_chart
from cabinpose.app.studio.models import Judged, detectors, error_words, found_in, joint_places, judged, load_choice, worst_first
from cabinpose.app.studio.tab import Page, Tab, empty_state, no_dataset
from cabinpose.app.studio.view3d import VIEW_KEYS, FramePoints, look_through, skeleton_lines, view_3d
from cabinpose.app.studio.workspace import Workspace, depth_range
from cabinpose.core import CabinposeError, PredictionsError, apply
from cabinpose.evaluate import PEOPLE, EvaluationOptions, common_joints, joint_distances, predict_dataset, shared_places
from cabinpose.store import Predictions, dataset_id, dataset_skeleton

COLOURS = ("#ff9f1c", "#35a7ff", "#ff5964", "#9bde7e", "#c792ea", "#f6f740")
_METRICS = ("mAD", "mAD@d", "mAP@d (literal)", "mAR@d (literal)", "PCKh", "AUC of PCKh", "left-right swaps")
_ELSEWHERE = "people found in another's place"
_FEWEST_WORST = 12  # frames in the list


class CompareTab:
    """The tab of one browser."""

    def __init__(self, workspace: Workspace, label: Callable[[int], None]) -> None:
        assert workspace.dataset is not None
        self._workspace, self._dataset, self._label = workspace, workspace.dataset, label
        self._judged: dict[str, Judged] = {}
        self._joint_name = ""  # whose places and lines are shown
        self._frame = self._row = 0  # number and row of the one that is shown
        self._share = 0.0  # of the frames that a model has looked at
        with ui.row().classes("studio-tab no-wrap w-full"):
            with ui.column().classes("studio-side"):
                self._build_side()
            with ui.column().classes("studio-main").style("overflow-y: auto"):
                self._main = ui.column().classes("w-full").style("gap: 10px")
        self._refresh()

    def _build_side(self) -> None:
        ui.label("Predictions").style("font-weight: 600")
        self._list = ui.column().classes("w-full").style("gap: 2px")
        with ui.row().classes("no-wrap w-full items-center"):
            self._model = (
                ui.select(detectors(), value="in_car", label="model", new_value_mode="add-unique")
                .props("dense outlined hint='or grpc://HOST:PORT/MODEL'")
                .style("flex: 1; min-width: 0")
            )
            self._run = ui.button("Run", on_click=self._run_model).props("dense no-caps")
        self._progress = ui.linear_progress(value=0, show_value=False).classes("w-full")
        self._progress.visible = False
        ui.timer(0.3, lambda: self._progress.set_value(self._share))
        files = {str(path): path.name for path in self._workspace.found_predictions()}
        if files:
            with ui.row().classes("no-wrap w-full items-center"):
                self._file = ui.select(files, label="file beside the dataset").props("dense outlined")
                self._file.style("flex: 1; min-width: 0")
                ui.button("Open", on_click=self._open).props("dense no-caps outline")
        ui.separator()
        ui.label("Γt: up to this distance a joint is a hit")
        self._space = ui.toggle({"3d": "3D, cm", "2d": "2D, px"}, value="3d", on_change=self._space_changed)
        self._space.props("dense no-caps")
        self._threshold = (
            ui.slider(min=1.0, max=30.0, step=0.5, value=10.0).props("label-always").on("change", lambda _: self._refresh())
        )
        self._threshold.style("margin-top: 18px").mark("threshold")
        self._corrected = ui.checkbox("against the corrected labels", value=True, on_change=self._refresh)
        ui.label("Numbers are those of `cabinpose evaluate` with the same thresholds.").style("font-size: 12px; opacity: .7")

    def _space_changed(self) -> None:
        self._threshold.props(f"max={30 if self._space.value == '3d' else 60}")
        self._threshold.value = 10.0 if self._space.value == "3d" else 13.0
        self._refresh()

    def _open(self) -> None:
        if not self._file.value:
            return
        try:
            self._workspace.add_predictions(Path(str(self._file.value)))
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True)
        self._refresh()

    async def _run_model(self) -> None:
        """Run a model over the dataset, as `predict` does."""
        workspace, name = self._workspace, str(self._model.value)
        key, client = workspace.key, ui.context.client  # the tab is built anew where another dataset is opened
        self._run.disable()
        self._share, self._progress.visible = 0.0, True
        try:
            found = await run.io_bound(self._predict, name)
            if workspace.key != key:
                raise PredictionsError("another dataset was opened meanwhile", hint="what was found in the other is not kept")
            if found is not None:
                workspace.add_run(found)
        except CabinposeError as error:
            with client:
                ui.notify(error.in_one_line(), type="negative", multi_line=True)
        finally:
            self._run.enable()
            self._progress.visible = False
        if workspace.key == key:
            self._refresh()

    def _predict(self, name: str) -> Predictions:
        workspace = self._workspace
        assert workspace.manifest is not None
        workspace.check()
        model = load_choice(workspace, name)
        assert model is not None
        assert not isinstance(model, Predictions)
        count = self._dataset.sizes["frame"]

        def done(frames: int) -> None:
            self._share = frames / count  # the bar itself belongs to the browser's own thread

        return predict_dataset(self._dataset, model, dataset_id=dataset_id(workspace.manifest), progress=done)

    # ------------------------------------------------------------------------------------------------ what is shown

    def _options(self) -> EvaluationOptions:
        threshold = float(self._threshold.value)
        return (
            EvaluationOptions(hit_m=threshold / 100, resamples=0)
            if self._space.value == "3d"
            else EvaluationOptions(hit_px=threshold, resamples=0)
        )

    def _refresh(self) -> None:
        workspace = self._workspace
        models = list(workspace.predictions.values())
        self._list.clear()
        with self._list:
            for index, name in enumerate(workspace.predictions):
                _key(_colour(index), name)
            if not models:
                ui.label("none yet").style("opacity: .6")
        self._main.clear()
        if not models:
            with self._main:
                empty_state("Nothing to compare yet", "Run a model on the left, or open a predictions file beside the dataset.")
            return
        try:
            small = self._small()
            joints, persons = common_joints(small, models), shared_places(small, models)
            options, space = self._options(), str(self._space.value)
            each = workspace.predictions.items()
            self._judged = {name: judged(small, model, options, space, joints, persons) for name, model in each}
        except CabinposeError as error:
            with self._main:
                empty_state("These cannot be compared", str(error), error.hint or "")
            return
        with self._main:
            self._caveats()
            self._numbers()
            self._curve()
            self._frame_panes()
            self._joints()

    def _worst(self) -> list[int]:
        """Rows, worst first by the model whose mean distance is greatest there."""
        return worst_first(np.fmax.reduce([each.d for each in self._judged.values()])).tolist()

    def _caveats(self) -> None:
        """What `evaluate` says before and beside the numbers: what would explain the errors, coverage, notes."""
        with ui.column().classes("w-full").style("gap: 4px").mark("caveats"):
            for index, (name, each) in enumerate(self._judged.items()):
                known = each.report.caveats
                for explanation in known.explanations:
                    words = f"{name}: {explanation.words} (the numbers below are of the answers as they are)"
                    ui.label(words).classes("studio-news w-full").style("font-weight: 600")
                style = f"font-size: 13px; border-left: 3px solid {_colour(index)}; padding-left: 8px"
                for words in filter(None, (known.coverage, *known.notes)):
                    ui.label(f"{name}: {words}").style(style)

    def _numbers(self) -> None:
        space = str(self._space.value)
        rows = []
        for name, each in self._judged.items():
            value = each.report.value
            told = {metric: number(value(metric, space)) for metric in _METRICS} | {
                _ELSEWHERE: number(value(_ELSEWHERE, "image", PEOPLE))
            }
            rows.append({"model": name} | told)
        unit = "cm" if space == "3d" else "px"
        titles = {
            "model": "model", "mAD": f"mAD, {unit}", "mAD@d": f"mAD@Γt, {unit}", "mAP@d (literal)": "mAP@Γt, %",
            "mAR@d (literal)": "mAR@Γt, %", "PCKh": "PCKh@0.5, %", "AUC of PCKh": "AUC of PCKh, %",
            "left-right swaps": "left for right, %", _ELSEWHERE: "in another's seat, %",
        }  # fmt: skip
        columns = [
            {"name": key, "label": title, "field": key, "align": "left" if key == "model" else "right"}
            for key, title in titles.items()
        ]
        ui.table(rows=rows, columns=columns).props("dense flat bordered wrap-cells").classes("w-full").mark("numbers")

    def _curve(self) -> None:
        first = next(iter(self._judged.values()))
        lines = [(name, _colour(index), each.d) for index, (name, each) in enumerate(self._judged.items())]
        options = curve_chart(first.samples.frames.tolist(), lines, self._unit, float(self._threshold.value))
        chart = ui.echart(options, on_point_click=lambda event: self._show(int(event.data_index)))
        chart.classes("w-full").style("height: 250px; flex: none").mark("curve")

    @property
    def _unit(self) -> str:
        return "cm" if self._space.value == "3d" else "px"

    def _joints(self) -> None:
        """What is known of single joints: over the frames, over the places where one was, and altogether."""
        first = next(iter(self._judged.values()))
        with ui.row().classes("items-center w-full").style("gap: 12px"):
            ui.label("Joints").style("font-weight: 600")
            names = {name: name or "the three that are farthest off" for name in ("", *first.samples.skeleton.joints)}
            begin = self._joint_name if self._joint_name in names else ""
            self._joint = ui.select(names, value=begin, label="shown", on_change=self._draw_joints)
            self._joint.props("dense outlined").style("min-width: 280px").mark("joint")
        self._of_joints = ui.column().classes("w-full").style("gap: 10px")
        self._draw_joints()

    def _draw_joints(self) -> None:
        self._joint_name = str(self._joint.value)
        self._of_joints.clear()
        with self._of_joints:
            if self._joint_name:
                self._places()
            self._joints_over_frames()
            self._boxes()

    def _places(self) -> None:
        """The chosen joint's error over the cloud of its places, for each model; a click shows the frame."""
        dataset = self._small()
        models = list(self._workspace.predictions.values())
        persons = shared_places(dataset, models)
        for name, model in self._workspace.predictions.items():
            if not set(persons) <= set(model.persons):
                ui.label(f"{name}: its people have no seats, so that no place is one of theirs")
                continue
            places = joint_places(dataset, model, self._joint_name, persons, self._options())
            how = "in the vehicle's frame, from above and from the left" if places.axes == "xyz" else "in the image"
            threshold = float(self._threshold.value) if (places.axes == "xyz") == (self._space.value == "3d") else None
            usual = EvaluationOptions()
            threshold = threshold or (100 * usual.hit_m if places.axes == "xyz" else usual.hit_px)
            chart = ui.echart(
                places_chart(places, f"{name}: error of {self._joint_name} where it was, {how}", threshold),
                on_point_click=lambda event, rows=places.rows: self._show(int(rows[event.data_index])),
            )
            chart.classes("w-full").style("height: 300px; flex: none").mark("places")

    def _joints_over_frames(self) -> None:
        """d(t, j) of each model; a click shows the frame, of a stretch of frames the first."""
        for name, each in self._judged.items():
            whole = each.over_frames
            d, step = whole.binned(COLUMNS), -(-len(whole.frames) // COLUMNS)
            words = f"{name}: d by joint and frame, {d.unit}{f', the worst of {step} frames each' if step > 1 else ''}"
            chart = ui.echart(
                joint_chart(d, words, self._joint_name),
                on_point_click=lambda event, step=step: self._show(column(event) * step),
            )
            chart.classes("w-full").style(f"height: {height(d)}px; flex: none").mark("joints")

    def _frame_panes(self) -> None:
        with ui.row().classes("no-wrap w-full").style("gap: 10px; height: 420px; flex: none; align-items: stretch"):
            with ui.element("div").classes("studio-pane"):
                self._canvas = FrameCanvas(
                    on_pressed={"ArrowLeft": partial(self._step, -1), "ArrowRight": partial(self._step, 1)}
                )
            with ui.element("div").classes("studio-pane") as pane:
                self._cloud = view_3d()
                with self._cloud:
                    self._points = FramePoints()
                pane.on("resize", self._cloud.update)
                self._eye_set = False
            with ui.column().classes("no-wrap").style("width: 270px; gap: 4px; overflow-y: auto"):
                self._title = ui.label().style("font-weight: 600")
                for colour, words in [("#ffffff", "truth"), *((_colour(i), name) for i, name in enumerate(self._judged))]:
                    _key(colour, words)
                there = ui.button("Label this frame", icon="edit", on_click=lambda: self._label(self._frame))
                there.props("outline dense no-caps")
                self._which = ui.select(self._orders(), value="", label="frames", on_change=self._list_worst)
                self._which.props("dense outlined").classes("w-full").mark("worst of")
                self._worst_list = ui.column().classes("w-full studio-frames").style("gap: 0")
        self._list_worst()

    def _orders(self) -> dict[str, str]:
        """What the list of frames can be of."""
        names = list(self._judged)
        orders = {"": "worst of all"}
        if len(names) > 1:
            orders |= {f"worst:{name}": f"worst of {name}" for name in names}
            orders |= {f"better:{a}|{b}": f"{a} better than {b}" for a in names for b in names if a != b}
        return orders | {f"seats:{name}": f"{name}: in another's seat" for name in names}

    def _rows_of(self, order: str) -> list[int]:
        """Rows of the list of frames, the first ones first."""
        what, _, names = order.partition(":")
        if what == "seats":
            samples = self._judged[names].samples
            return sorted(set(samples.at[samples.elsewhere].tolist()))
        if what == "worst":
            return worst_first(self._judged[names].d).tolist()
        if what == "better":
            a, b = next((self._judged[a].d, self._judged[b].d) for a in self._judged for b in self._judged if f"{a}|{b}" == names)
            with np.errstate(invalid="ignore"):  # nobody found by both
                ahead = np.nan_to_num(b - a, nan=0.0)
            return [row for row in np.argsort(-ahead, kind="stable").tolist() if ahead[row] > 0]
        return self._worst()

    def _list_worst(self) -> None:
        """List the frames that are asked for, and show the first."""
        rows = self._rows_of(str(self._which.value))
        frames = next(iter(self._judged.values())).samples.frames
        self._worst_list.clear()
        with self._worst_list:
            if not rows:
                ui.label("there are none")
            for row in rows[:_FEWEST_WORST]:
                told = [error_words(each.d[row]) + self._unit_of(each.d[row]) for each in self._judged.values()]
                words = told[0] if len(told) == 1 else ", ".join(f"{n} {x}" for n, x in zip(self._judged, told, strict=True))
                button = ui.button(f"frame {frames[row]}: {words}", on_click=lambda row=row: self._show(row))
                button.props("flat dense no-caps align=left").style(
                    "width: 100%; line-height: 1.2; font-size: 13px; padding: 3px 0"
                )
        if rows:
            self._show(rows[0])

    def _unit_of(self, error: float) -> str:
        return f" {self._unit}" if np.isfinite(error) else ""

    def _step(self, step: int) -> None:
        count = len(next(iter(self._judged.values())).samples.frames)
        self._show(min(max(self._row + step, 0), count - 1))

    def _boxes(self) -> None:
        for name, each in self._judged.items():
            error = joint_distances(each.samples, str(self._space.value))
            title, joints = f"{name}: d by joint, {self._unit}", each.samples.skeleton.joints
            chart = ui.echart(box_chart(joints, error, title, self._unit, float(self._threshold.value)))
            chart.classes("w-full").style("height: 300px; flex: none")

    def _small(self) -> Any:
        """The dataset as it is judged, without its images."""
        dataset = self._workspace.corrected(self._dataset) if self._corrected.value else self._dataset
        return dataset[[str(n) for n in dataset.data_vars if "y" not in dataset[n].dims]]

    def _show(self, row: int) -> None:
        try:
            self._show_frame(row)
        except (CabinposeError, OSError) as error:
            ui.notify(f"this frame cannot be read: {self._workspace.trouble() or error}", type="negative", multi_line=True)

    def _show_frame(self, row: int) -> None:
        workspace = self._workspace
        frame = self._small().isel(frame=row).load()
        number_ = int(frame["frame"])
        limbs = dataset_skeleton(frame).limbs
        people: list[dict[str, Any]] = [{**person, "colour": "#ffffff", "fixed": True} for person in people_of(frame)]
        for person in people:
            for joint in person["joints"]:
                joint["colour"] = "#ffffff"
        for index, model in enumerate(workspace.predictions.values()):
            people += found_in(model, number_).drawn(_colour(index))
        near, far = depth_range(self._dataset, row)
        self._canvas.show(workspace.url(number_, "depth"), near=near, far=far)
        self._canvas.joints(people, limbs)
        self._frame, self._row, self._title.text = number_, row, f"frame {number_}"
        self._show_cloud(frame)

    def _show_cloud(self, frame: Any) -> None:
        """The frame's cloud with truth in white and each model's answers in its colour."""
        workspace, vehicle_from_camera = self._workspace, frame["vehicle_from_camera"].values
        places = apply(vehicle_from_camera, frame["joints_3d"].values.astype(np.float64))
        people = [skeleton_lines(person, dataset_skeleton(frame).limbs, "#ffffff") for person in places]
        for index, model in enumerate(workspace.predictions.values()):
            found = found_in(model, int(frame["frame"]))
            people += [skeleton_lines(person, found.limbs, _colour(index)) for person in apply(vehicle_from_camera, found.xyz)]
        url = workspace.cloud_url(int(frame["frame"]), "depth") if "depth" in self._dataset else ""
        self._points.show(url, people)
        if not self._eye_set:
            self._eye_set = True
            look_through(self._cloud, vehicle_from_camera)


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


def _key(colour: str, words: str) -> None:
    """A colour and what it stands for."""
    with ui.row().classes("no-wrap items-center").style("gap: 8px; font-size: 13px"):
        ui.element("div").style(
            f"width: 12px; height: 12px; flex: none; border: 1px solid var(--edge); border-radius: 3px; background: {colour}"
        )
        ui.label(words)


def _build(page: Page) -> None:
    if page.workspace.dataset is None:
        no_dataset(
            page.workspace.recording, "Open a dataset with its truth, and predictions to hold against it:",
            "cabinpose studio DATASET --predictions FILE",
        )  # fmt: skip
    else:
        CompareTab(page.workspace, page.label)


_KEYS = (("← →", "the frame before, the next one"), *VIEW_KEYS, IMAGE_KEYS)
TAB = Tab("Compare", _build, _KEYS, of_dataset=True)
