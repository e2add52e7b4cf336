"""What the pages of the four evaluations draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.mocap.stick import stick_figure
from cabinpose.app.report.charts import box_chart, charts, legend, series_chart
from cabinpose.app.report.html import Html, el, join, table
from cabinpose.core import CABINPOSE, MVN_JOINTS
from cabinpose.evaluate import Box
from cabinpose.evaluate.mocap import (
    ALL,
    ICP,
    KABSCH,
    PELVIS_STAGE,
    POSITION,
    STAGES,
    Bone,
    DfeRun,
    DseRun,
    Judgement,
    SfeRun,
    SseRun,
    Summary,
    limbs,
)

F64 = NDArray[np.float64]
Section = tuple[str, str, str]  # title, body (HTML), note
# Without the pelvis, which is where a pose's frame begins, the legs hang from L5.
_SEGMENT_PARENTS = {c: "L5" if p == "Pelvis" and c != "L5" else p for _, p, c in MVN_JOINTS}
_POINTS = 400  # of a line; more than a chart has pixels
_BOX_NOTE = "Box: quartiles and median; line: 5 % to 95 %."


def boxes(judgement: Judgement, measures: Sequence[str], *, chart_by: Literal["measure", "condition"] = "measure") -> Html:
    """A chart a measure with a box for each thing and condition, or the other way round."""
    rows = [s for s in judgement.summaries if s.measure in measures and s.samples]
    rows = [s for s in rows if s.condition in _conditions([r for r in rows if r.measure == s.measure])]
    found = []
    for title in dict.fromkeys(getattr(s, chart_by) for s in rows):
        chosen = [s for s in rows if getattr(s, chart_by) == title]
        drawn: dict[str, dict[str, Box]] = {}
        for s in chosen:
            low, lower, median, upper, high = s.box
            drawn.setdefault(s.condition if chart_by == "measure" else s.measure, {})[s.name] = Box(
                s.samples, low, lower, median, upper, high
            )
        found += [legend(drawn)] if len(drawn) > 1 else []
        found.append(box_chart(f"{title}, {chosen[0].unit}", drawn, height=300))
    return join(found)


def _conditions(rows: Sequence[Summary]) -> list[str]:
    """The single conditions, or "All" where there is but one, which then has no rows of its own."""
    return [c for c in dict.fromkeys(s.condition for s in rows) if c != ALL] or [ALL]


def sse_sections(judgement: Judgement, runs: Sequence[SseRun], measures: Sequence[str]) -> list[Section]:
    """Error by angle of the motor, for each axis."""
    turns: dict[str, dict[str, tuple[list[float], list[float]]]] = {"error": {}, "tilt": {}}
    for run in runs:
        steps = np.unique(run.step)
        angle = [float(np.degrees(run.reference_rad[run.step == s].mean())) for s in steps]
        for what, values in (("error", run.turn_rad - run.reference_rad), ("tilt", run.tilt_rad)):
            mean = [float(np.degrees(values[run.step == s].mean())) for s in steps]
            name = run.axis if run.axis not in turns[what] else f"{run.axis} {len(turns[what]) + 1}"
            turns[what][name] = (angle, mean)
    titles = {"error": "Sensor − motor, °", "tilt": "Tilt off the axis, °"}
    drawn = charts((series_chart(titles[what], "angle of the motor, °", turns[what], size=(620, 220)) for what in titles), "two")
    return [
        ("Error by angle", legend(turns["error"]) + drawn, "The mean at each step."),
        ("Error by axis", boxes(judgement, measures), _BOX_NOTE),
    ]


def sfe_sections(
    judgement: Judgement, runs: Sequence[SfeRun], measures: Sequence[str], bones: Mapping[str, Sequence[Bone]]
) -> list[Section]:
    """Both poses over each other, and lengths over the take."""
    figures = []
    for run in runs:
        bodies = {"first": run.first_m, "last": run.last_m}
        figures.append(stick_figure(f"{run.condition}: {run.drive_s:.1f} s between", bodies, limbs(run.names, _SEGMENT_PARENTS)))
    return [
        ("Both poses", legend(["first", "last"]) + charts(figures, "two"), "Laid on each other as the errors are."),
        ("Error by joint", boxes(judgement, measures), f"{_BOX_NOTE} Over the frames of the last pose."),
        ("Lengths over the take", _bone_table(bones), "Of bones, which do not change: the ten that do most."),
    ]


def dse_sections(judgement: Judgement, runs: Sequence[DseRun], measures: Sequence[str]) -> list[Section]:
    """Boxes by plane, and both angles over time."""
    body = legend(["suit", "optical", "error"])
    for run in runs:
        lines = []
        thin = slice(None, None, max(len(run.time_s) // _POINTS, 1))
        for i, name in enumerate(run.names):
            if np.isfinite(run.difference_rad[:, i]).any():
                both = {"suit": run.suit_rad, "optical": run.optical_rad, "error": run.difference_rad}
                drawn = {k: (run.time_s[thin].tolist(), np.degrees(v[thin, i]).tolist()) for k, v in both.items()}
                lines.append(series_chart(f"{name}, °", "s", drawn, size=(420, 180)))
        body = Html(body + (el("h3", run.condition) if len(runs) > 1 else "") + charts(lines))
    return [("Error by segment", boxes(judgement, measures), _BOX_NOTE), ("Angle since the first frame", body, "")]


def dfe_sections(judgement: Judgement, runs: Sequence[DfeRun], measures: Sequence[str]) -> list[Section]:
    """Boxes by stage, the mean error over time, and bodies of a typical and of the worst frame."""
    near = [f"{POSITION}, {stage}" for stage in (PELVIS_STAGE, ICP, KABSCH)]
    moved = [m for m in measures if m.endswith((f", {ICP}", f", {PELVIS_STAGE}")) and m not in near]
    raw = [f"{POSITION}, {STAGES[0]}"]
    lines, figures = [], []
    for run in runs:
        thin = slice(None, None, max(len(run.time_s) // _POINTS, 1))
        drawn = {}
        for stage in (PELVIS_STAGE, ICP, KABSCH):
            error = run.position_error_m(stage)[thin]
            known = np.isfinite(error)
            mean = np.where(known, error, 0).sum(axis=1) / np.where(known.any(axis=1), known.sum(axis=1), np.nan)
            drawn[stage] = (run.time_s[thin].tolist(), (1e3 * mean).tolist())
        lines.append(series_chart(f"{run.condition}: mean over the joints, mm", "s", drawn, size=(620, 220)))
        figures += _dfe_figures(run)
    stages, over_time = legend([PELVIS_STAGE, ICP, KABSCH]), charts(lines, "two")
    bodies = legend(["suit", "optical"]) + charts(figures, "two")
    eq38 = "The thesis' eq. 3.8: constant differences drop out."
    return [
        ("Error by joint", boxes(judgement, near, chart_by="condition"), _BOX_NOTE),
        ("Displacement since the first frame", boxes(judgement, moved, chart_by="condition"), eq38),
        ("As they come", boxes(judgement, raw), "Positions in the two worlds, before anything is laid on anything."),
        ("Over time", stages + over_time, ""),
        ("Both bodies", bodies, "In the suit's pelvis frame; red: the error."),
    ]  # fmt: skip


def _dfe_figures(run: DfeRun) -> list[Html]:
    error = run.position_error_m(KABSCH)
    known = np.flatnonzero(np.isfinite(error).sum(axis=1) >= 3)
    if not len(known):
        return []
    mean = np.nanmean(error[known], axis=1)
    order = known[np.argsort(mean, kind="stable")]
    found = []
    for what, t in (("typical", order[len(order) // 2]), ("worst", order[-1])):
        for stage in (PELVIS_STAGE, ICP):
            bodies = {"suit": run.suit_m[stage][t], "optical": run.optical_m[stage][t]}
            mean_mm = 1e3 * np.nanmean(run.position_error_m(stage)[t])
            told = f"{run.condition}, {what} frame at {run.time_s[t]:.2f} s, {stage}: {mean_mm:.1f} mm"
            found.append(stick_figure(told, bodies, limbs(run.names, CABINPOSE.parent), links=[("suit", "optical")]))
    return found


def _bone_table(bones: Mapping[str, Sequence[Bone]]) -> str:
    rows: list[list[object]] = [["", "take", "mean, mm", "σ, mm", "range, mm", "frames"]]
    for condition, lengths in bones.items():
        for bone in sorted(lengths, key=lambda b: -b.sd_m)[:10]:
            values = (f"{1e3 * x:.2f}" for x in (bone.mean_m, bone.sd_m, bone.range_m))
            rows.append([f"{bone.start} – {bone.end}", condition, *values, bone.frames])
    return table(rows, words=(0, 1))
