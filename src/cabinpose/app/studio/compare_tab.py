"""The Compare tab: truth and any number of predictions, by the numbers of `evaluate`, down to the frames that are worst."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import run, ui
from numpy.typing import NDArray

from cabinpose.app.report.numbers import number
from cabinpose.app.studio.canvas import FrameCanvas
from cabinpose.app.studio.dataset_tab import people_of
from cabinpose.app.studio.joint_chart import COLUMNS, column, height, joint_chart
from cabinpose.app.studio.models import Judged, detectors, error_words, judged, load_choice, worst_first
from cabinpose.app.studio.tab import Page, Tab, empty_state, no_dataset
from cabinpose.app.studio.view3d import FramePoints, look_through, skeleton_lines, view_3d
from cabinpose.app.studio.workspace import Workspace, depth_range
from cabinpose.core import CabinposeError, PoseBatch, apply, skeleton_of
from cabinpose.evaluate import EvaluationOptions, common_joints, joint_distances, predict_dataset, shared_places
from cabinpose.store import Predictions, dataset_id, dataset_skeleton

COLOURS = ("#ff9f1c", "#35a7ff", "#ff5964", "#9bde7e", "#c792ea", "#f6f740")
_NEAR_CM = 5.0  # of the thesis' three boxes a joint: all found, those nearer than this, those nearer than Γt
_METRICS = ("mAD", "mAD@d", "mAP@d (literal)", "mAR@d (literal)")


class CompareTab:
    """The tab of one browser."""

    def __init__(self, workspace: Workspace, label: Callable[[int], None]) -> None:
        assert workspace.dataset is not None
        self._workspace, self._dataset, self._label = workspace, workspace.dataset, label
        self._judged: dict[str, Judged] = {}
        self._frame = 0  # number of the one that is shown
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
                ui.select(detectors(), value="in_car", label="model, or grpc://HOST:PORT/MODEL", new_value_mode="add-unique")
                .props("dense outlined")
                .style("flex: 1")
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
        ui.label("Γt, the distance up to which a joint is a hit")
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
        self._run.disable()
        self._progress.visible = True
        try:
            found = await run.io_bound(self._predict, name)
            if found is not None:
                workspace.predictions[found.model] = found
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True)
        finally:
            self._run.enable()
            self._progress.visible = False
        self._refresh()

    def _predict(self, name: str) -> Predictions:
        workspace = self._workspace
        assert workspace.manifest is not None
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
                with ui.row().classes("no-wrap items-center").style("gap: 8px"):
                    ui.element("div").style(f"width: 12px; height: 12px; border-radius: 3px; background: {_colour(index)}")
                    ui.label(name)
            if not models:
                ui.label("none yet").style("opacity: .6")
        self._main.clear()
        if not models:
            with self._main:
                empty_state("Nothing to compare yet", "Run a model on the left, or open a predictions file beside the dataset.")
            return
        dataset = workspace.corrected(self._dataset) if self._corrected.value else self._dataset
        small = dataset[[str(n) for n in dataset.data_vars if "y" not in dataset[n].dims]]
        try:
            joints, persons = common_joints(dataset, models), shared_places(dataset, models)
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
            self._joints_over_frames()
            self._boxes()
        self._show(self._worst()[0])

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
            rows.append(
                {"model": name}
                | {metric: number(value(metric, space)) for metric in _METRICS}
                | {"PCKh": number(value("PCKh", space)), "AUC": number(value("AUC of PCKh", space))}
            )
        unit = "cm" if space == "3d" else "px"
        titles = {"model": "model"} | {
            "mAD": f"mAD {unit}", "mAD@d": f"mAD@Γt {unit}", "mAP@d (literal)": "mAP@Γt %", "mAR@d (literal)": "mAR@Γt %",
            "PCKh": "PCKh@0.5 %",
            "AUC": "AUC of PCKh %",
        }  # fmt: skip
        columns = [
            {"name": key, "label": title, "field": key, "align": "left" if key == "model" else "right"}
            for key, title in titles.items()
        ]
        ui.table(rows=rows, columns=columns).props("dense flat bordered").classes("w-full").mark("numbers")

    def _curve(self) -> None:
        first = next(iter(self._judged.values()))
        frames = first.samples.frames.tolist()
        unit = "cm" if self._space.value == "3d" else "px"
        series: list[dict[str, Any]] = [
            {
                "name": name, "type": "line", "showSymbol": len(frames) < 400, "symbolSize": 5, "color": _colour(index),
                "data": [None if not np.isfinite(x) else round(float(x), 3) for x in each.d],
            }
            for index, (name, each) in enumerate(self._judged.items())
        ]  # fmt: skip
        series[0]["markLine"] = {
            "silent": True, "symbol": "none", "lineStyle": {"color": "#999", "type": "dashed"},
            "data": [{"yAxis": float(self._threshold.value), "name": "Γt"}],
        }  # fmt: skip
        chart = ui.echart(
            {
                "title": {"text": f"mean distance d by frame, {unit}; a click shows the frame", "textStyle": _TITLE},
                "grid": {"left": 48, "right": 16, "top": 40, "bottom": 30},
                "tooltip": {"trigger": "axis"},
                "xAxis": {"type": "category", "data": frames},
                "yAxis": {"type": "value"},
                "series": series,
            },
            on_point_click=lambda event: self._show(int(event.data_index)),
        )
        chart.classes("w-full").style("height: 230px; flex: none").mark("curve")

    def _joints_over_frames(self) -> None:
        """d(t, j) of each model; a click shows the frame, of a stretch of frames the first."""
        for index, (name, each) in enumerate(self._judged.items()):
            whole = each.over_frames
            d, step = whole.binned(COLUMNS), -(-len(whole.frames) // COLUMNS)
            words = f"{name}: d by joint and frame, {d.unit}{f', the worst of {step} frames each' if step > 1 else ''}"
            chart = ui.echart(
                joint_chart(d, {"text": words, "textStyle": _TITLE | {"color": _colour(index)}}),
                on_point_click=lambda event, step=step: self._show(column(event) * step),
            )
            chart.classes("w-full").style(f"height: {height(d)}px; flex: none").mark("joints")

    def _frame_panes(self) -> None:
        with ui.row().classes("no-wrap w-full").style("gap: 10px; height: 420px; align-items: stretch"):
            with ui.element("div").classes("studio-pane"):
                self._canvas = FrameCanvas()
            with ui.element("div").classes("studio-pane") as pane:
                self._cloud = view_3d()
                with self._cloud:
                    self._points = FramePoints()
                pane.on("resize", self._cloud.update)
                self._eye_set = False
            with ui.column().style("width: 260px; gap: 4px; overflow-y: auto"):
                self._title = ui.label().style("font-weight: 600")
                ui.label("white: truth").style("font-size: 12px; opacity: .7")
                there = ui.button("Label this frame", icon="edit", on_click=lambda: self._label(self._frame))
                there.props("outline dense no-caps")
                ui.label("Worst frames").style("font-weight: 600; margin-top: 6px")
                frames = next(iter(self._judged.values())).samples.frames
                for row in self._worst()[:12]:
                    d = [each.d[row] for each in self._judged.values()]
                    words = ", ".join(error_words(x) for x in d)
                    ui.button(f"frame {frames[row]}: {words}", on_click=lambda row=row: self._show(row)).props(
                        "flat dense no-caps align=left"
                    ).style("width: 100%")

    def _boxes(self) -> None:
        """For each joint, boxes of the distances of all that were found, of those below 5 cm and of those below Γt."""
        unit, threshold = ("cm" if self._space.value == "3d" else "px"), float(self._threshold.value)
        for index, (name, each) in enumerate(self._judged.items()):
            error = joint_distances(each.samples, str(self._space.value))
            series: list[dict[str, Any]] = []
            limits = {"all found": np.inf, f"< {_NEAR_CM:g} {unit}": _NEAR_CM, f"< {threshold:g} {unit}": threshold}
            for words, limit in limits.items():
                kept = [column[np.isfinite(column) & (column < limit)] for column in error.T]
                series.append({"name": words, "type": "boxplot", "data": [_box(values) for values in kept]})
            outliers = [
                [joint, round(float(x), 2)]
                for joint, column in enumerate(error.T)
                for x in _outliers(column[np.isfinite(column)])
            ]
            dots = {"name": "outliers of all found", "type": "scatter", "symbolSize": 4, "data": outliers, "color": "#d66"}
            series.append(dots)
            ui.echart(
                {
                    "title": {"text": f"{name}: d by joint, {unit}", "textStyle": _TITLE | {"color": _colour(index)}},
                    "legend": {"top": 22, "textStyle": {"color": "#888"}},
                    "grid": {"left": 48, "right": 16, "top": 56, "bottom": 56},
                    "tooltip": {"trigger": "item"},
                    "xAxis": {"type": "category", "data": list(each.samples.skeleton.joints), "axisLabel": {"rotate": 40}},
                    "yAxis": {"type": "value"},
                    "series": series,
                }
            ).classes("w-full").style("height: 300px; flex: none")

    def _show(self, row: int) -> None:
        try:
            self._show_frame(row)
        except (CabinposeError, OSError) as error:
            ui.notify(f"this frame cannot be read: {self._workspace.trouble() or error}", type="negative", multi_line=True)

    def _show_frame(self, row: int) -> None:
        workspace = self._workspace
        dataset = workspace.corrected(self._dataset) if self._corrected.value else self._dataset
        small = dataset[[str(n) for n in dataset.data_vars if "y" not in dataset[n].dims]]
        frame = small.isel(frame=row).load()
        number_ = int(frame["frame"])
        limbs = dataset_skeleton(frame).limbs
        people: list[dict[str, Any]] = [{**person, "colour": "#ffffff", "fixed": True} for person in people_of(frame)]
        for person in people:
            for joint in person["joints"]:
                joint["colour"] = "#ffffff"
        for index, model in enumerate(workspace.predictions.values()):
            batch = model.take(np.array([number_]))
            own = skeleton_of(model).limbs
            for p in range(len(model.persons)):
                seen = [{"name": name, "u": _at(batch, p, j, 0), "v": _at(batch, p, j, 1)} for j, name in enumerate(model.joints)]
                people.append({"colour": _colour(index), "joints": seen, "limbs": own, "fixed": True})
        near, far = depth_range(self._dataset, row)
        self._canvas.show(workspace.url(number_, "depth"), near=near, far=far)
        self._canvas.joints(people, limbs)
        self._frame, self._title.text = number_, f"frame {number_}"
        self._show_cloud(frame)

    def _show_cloud(self, frame: Any) -> None:
        """The frame's cloud with truth in white and each model's answers in its colour."""
        workspace, vehicle_from_camera = self._workspace, frame["vehicle_from_camera"].values
        places = apply(vehicle_from_camera, frame["joints_3d"].values.astype(np.float64))
        people = [skeleton_lines(person, dataset_skeleton(frame).limbs, "#ffffff") for person in places]
        for index, model in enumerate(workspace.predictions.values()):
            batch = model.take(np.array([int(frame["frame"])]))
            found = np.where(batch.presence[0, ..., None] >= _PRESENT, batch.joints_3d[0], np.nan).astype(np.float64)
            limbs = skeleton_of(model).limbs
            people += [skeleton_lines(person, limbs, _colour(index)) for person in apply(vehicle_from_camera, found)]
        url = workspace.cloud_url(int(frame["frame"]), "depth") if "depth" in self._dataset else ""
        self._points.show(url, people)
        if not self._eye_set:
            self._eye_set = True
            look_through(self._cloud, vehicle_from_camera)


_TITLE = {"fontSize": 13, "fontWeight": "normal", "color": "#888"}
_PRESENT = EvaluationOptions().presence


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


def _at(batch: PoseBatch, person: int, joint: int, axis: int) -> float | None:
    value = float(batch.joints_2d[0, person, joint, axis])
    return value if np.isfinite(value) and batch.presence[0, person, joint] >= _PRESENT else None


def _box(values: NDArray[np.floating]) -> list[float]:
    """Lowest, quartiles and highest without outliers (Tukey's 1.5 interquartile ranges)."""
    if not values.size:
        return []
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    reach = 1.5 * (high - low)
    inside = values[(values >= low - reach) & (values <= high + reach)]
    return [round(float(x), 3) for x in (inside.min(), low, middle, high, inside.max())]


def _outliers(values: NDArray[np.floating]) -> list[float]:
    if not values.size:
        return []
    low, high = np.quantile(values, (0.25, 0.75))
    return [float(x) for x in values[(values < low - 1.5 * (high - low)) | (values > high + 1.5 * (high - low))]]


def _build(page: Page) -> None:
    if page.workspace.dataset is None:
        no_dataset(
            page.workspace.recording, "Open a dataset with its truth, and predictions to hold against it:",
            "cabinpose studio DATASET --predictions FILE",
        )  # fmt: skip
    else:
        CompareTab(page.workspace, page.label)


TAB = Tab("Compare", _build, of_dataset=True)
