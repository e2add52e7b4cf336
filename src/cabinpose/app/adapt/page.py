"""The page on a model and the user's frames: what differs, what could be learnt, and whether it was worth it; one HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.adapt.decision import Compared, Decision
from cabinpose.app.adapt.differences import NOBODY, UNSURE, AnswerFacts, Row
from cabinpose.app.adapt.facts import BINS_M, CameraFacts
from cabinpose.app.adapt.pseudo_labels import PRESENT, PseudoLabels
from cabinpose.app.report.charts import charts, legend, series_chart
from cabinpose.app.report.html import Html, document, el, figure, picture_uri, section, table, tiles
from cabinpose.app.view.draw import depth_image
from cabinpose.evaluate import Report
from cabinpose.store import Predictions

_PICTURES = 6
_HIGH_PX = 320  # of a picture
_ERRORS_CM = np.arange(0.0, 10.1, 0.5)
_LABELLED = (("AUC of PCKh", "2d"), ("median error", "3d"))  # what is told where the frames have labels
_NOTES = {
    "differences": "Reference: frames of the kind that the model was trained for. A note stands where a difference is large"
    " enough to matter; the limits are assumed.",
    "pseudo": "Frames that may be learnt from: every joint drawn is surely there, expected to be near, and moves as a body can. "
    "They are of the first three quarters; the last quarter of the frames judges.",
    "decision": "Measured without any label of yours: on the last quarter of the frames, which neither model has learnt from, and"
    " on generated frames of people who were not learnt from (the best epoch was chosen on these). Of the joints that both models"
    " find. Intervals of the mean difference, after minus before: 95 %, by a bootstrap over rows of ten frames. The adapted model"
    " is taken where it finds people as often, is better by one measure at least and worse by none; slightly worse,"
    " by less than 1 mm of unsteadiness or 1 % of the other two, does not count.",
}


@dataclass(frozen=True)
class FirstLook:
    """What is known before anything is trained.

    model, frames: their names · dataset: the frames that were looked at · rows: what differs · theirs, reference: facts of both,
    None where there is no reference · answers, found: of the model · chosen: of the frames, those that are judged on left out.
    """

    model: str
    frames: str
    dataset: xr.Dataset
    rows: Sequence[Row]
    theirs: CameraFacts
    reference: CameraFacts | None
    answers: AnswerFacts
    found: Predictions
    chosen: PseudoLabels


@dataclass(frozen=True)
class Adaptation:
    """What came of the training. noise: of the generated frames, in words · budget: in words · labelled: reports before and after
    where the frames have labels.
    """

    noise: str
    budget: str
    decision: Decision
    labelled: tuple[Report, Report] | None


def adapt_page(look: FirstLook, outcome: Adaptation | None) -> str:
    """The page (HTML); outcome: None before anything was trained."""
    named = [row for row in look.rows if row.note]
    heading = f"{look.model} on {look.frames}"
    words = f"{len(named)} of {len(look.rows)} figures stand out" if named else "nothing stands out"
    differs = table([["", "your frames", "reference", "note"], *look.rows], words=(0, 3))
    sections = [
        section("At a glance", tiles(_tiles(look, outcome))),
        section("What differs", differs, _NOTES["differences"]),
        section("Depth, noise, doubt", _charts(look)),
        section("Pseudo-labels", _pseudo(look), _NOTES["pseudo"]),
    ]
    if outcome is not None:
        words = outcome.decision.words
        learnt = [["noise of the generated frames", outcome.noise], ["budget", outcome.budget]]
        sections.insert(1, section("Better?", _decision(outcome), _NOTES["decision"]))
        sections.append(section("What was learnt from", table(learnt, words=(0, 1), head=False)))
    return document(f"Adapting {heading}", heading, f"{words[:1].upper()}{words[1:]}.", sections)


def _tiles(look: FirstLook, outcome: Adaptation | None) -> list[tuple[str, str, str, Sequence[str], str]]:
    found, answers = look.dataset.sizes["frame"], look.answers
    kinds = "warn" if answers.nobody > NOBODY else ""
    entries: list[tuple[str, str, str, Sequence[str], str]] = [
        (str(found), "", "frames looked at", (), ""),
        (f"{100 * (1 - answers.nobody):.0f}", "%", "in which somebody is found", (), kinds),
    ]
    if np.isfinite(answers.error_m):
        bad = "warn" if answers.error_m > UNSURE * answers.usual_m else ""
        entries.append(
            (f"{100 * answers.error_m:.1f}", "cm", "expected error", (f"usually {100 * answers.usual_m:.1f} cm",), bad)
        )
    entries.append(
        (str(int(look.chosen.frames.sum())), "", "frames to learn from", (f"{int(look.chosen.joints.sum())} joints",), "")
    )
    if outcome is not None:
        adopt = outcome.decision.adopt
        entries.insert(0, ("take" if adopt else "leave", "", "the adapted model", (), "" if adopt else "warn"))
    return entries


def _charts(look: FirstLook) -> Html:
    names = ("your frames", "reference")
    middle = ((BINS_M[1:] + BINS_M[:-1]) / 2).tolist()
    far = int(np.ceil(max(f.depth_m[2] for f in (look.theirs, look.reference) if f) * 12)) + 1
    both = {name: facts for name, facts in zip(names, (look.theirs, look.reference), strict=True) if facts is not None}
    depths = {name: (middle[:far], (100 * facts.histogram[:far]).tolist()) for name, facts in both.items()}
    drawn = [series_chart("depths, % of the pixels", "m", depths)]
    if len(look.theirs.still_m):
        z, sigma = look.theirs.still_m.T
        drawn.append(series_chart("noise over time, mm", "m", {"your frames": (z.tolist(), (1e3 * sigma).tolist())}))
    expected = 100 * look.found.expected_error_m[look.found.presence >= PRESENT]
    if np.isfinite(expected).any():
        shares = np.histogram(np.minimum(expected[np.isfinite(expected)], _ERRORS_CM[-1] - 1e-6), _ERRORS_CM)[0]
        line = ((_ERRORS_CM[1:] - 0.25).tolist(), (100 * shares / shares.sum()).tolist())
        drawn.append(series_chart("expected error, % of the joints", "cm", {"your frames": line}))
    return Html(legend(both) + charts(drawn))


def _pseudo(look: FirstLook) -> Html:
    rows: list[Sequence[object]] = [["frames", "how many"], ["learnt from", int(look.chosen.frames.sum())]]
    rows += [[f"left out: {why}", count] for why, count in look.chosen.left_out.items()]
    rows.append(["kept to judge on", len(look.found.frame) - len(look.chosen.frames)])
    where = np.flatnonzero(look.chosen.frames)
    picked = where[np.unique(np.linspace(0, len(where) - 1, min(_PICTURES, len(where))).astype(int))] if len(where) else ()
    pictures = el("div", *(_picture(look, int(row)) for row in picked), class_="shots")
    return Html(table(rows) + (el("h3", "Some of them") + pictures if len(picked) else ""))


def _picture(look: FirstLook, row: int) -> Html:
    depth: NDArray[np.float32] = look.dataset["depth"].isel(frame=row).values
    kept = look.chosen.joints[row]
    presence = np.where(kept, look.found.presence[row], 0).astype(np.float32)
    one = look.found.take(look.found.frame[row : row + 1])
    drawn = Predictions(
        **{**vars(one), "presence": presence[None]}, frame=np.zeros(1, np.int64), persons=look.found.persons,
        joints=look.found.joints, model=look.model, skeleton=look.found.skeleton,
    ).draw(depth_image(depth, *look.theirs.depth_m[::2]), frame=0, scale=max(round(_HIGH_PX / depth.shape[0]), 1))  # fmt: skip
    return figure(el("img", src=picture_uri(drawn), alt=""), f"frame {int(look.found.frame[row])}: {int(kept.sum())} joints")


def _decision(outcome: Adaptation) -> Html:
    decision = outcome.decision
    rows: list[Sequence[object]] = [["", "before", "after", "difference, 95 %", "frames", ""]]
    rows += [[name, *_cells(each)] for name, each in decision.measures.items()]
    before, after = (f"{100 * share:.1f} %" for share in decision.found)
    rows.append(["frames in which somebody is found", before, after, "", "", ""])
    rows.append(["joints have moved by, median", "", f"{100 * decision.moved_m:.1f} cm", "", "", ""])
    told = Html(table(rows, words=(0, 5)))
    return Html(told + _labelled(outcome.labelled)) if outcome.labelled else told


def _cells(each: Compared) -> Sequence[str]:
    unit = each.unit
    span = f"{each.low:+.2f} to {each.high:+.2f} {unit}" if each.frames else "not to be measured: too few rows of frames"
    return (f"{each.before:.2f} {unit}", f"{each.after:.2f} {unit}", span, str(each.frames), each.said if each.frames else "")


def _labelled(reports: tuple[Report, Report]) -> Html:
    """What the labels of these frames say, which were not used otherwise."""
    rows: list[Sequence[str]] = [["by the labels of these frames", "before", "after"]]
    for metric, space in _LABELLED:
        values = [report.value(metric, space) for report in reports]
        if all(values):
            cells = [f"{v.value:.2f} {v.unit} ({v.low:.2f} to {v.high:.2f})" for v in values if v]
            rows.append([f"{metric}, {space.upper()}", *cells])
    return table(rows)


def plain(look: FirstLook, outcome: Adaptation | None) -> Mapping[str, object]:
    """The same as plain data."""
    data: dict[str, object] = {
        "model": look.model,
        "frames": look.dataset.sizes["frame"],
        "differences": [row._asdict() for row in look.rows],
        "nobody": look.answers.nobody,
        "expected_error_m": look.answers.error_m,
        "usual_error_m": look.answers.usual_m,
        "pseudo_labels": {
            "frames": int(look.chosen.frames.sum()),
            "joints": int(look.chosen.joints.sum()),
            "left_out": look.chosen.left_out,
        },
    }
    if outcome is not None:
        decision = outcome.decision
        measures = {name: {**vars(each), "said": each.said} for name, each in decision.measures.items()}
        data |= {"adopt": decision.adopt, "decision": decision.words, "measures": measures, "found": decision.found}
        data |= {"moved_m": decision.moved_m, "noise": outcome.noise, "budget": outcome.budget}
        if outcome.labelled:
            data["labelled"] = [
                {f"{m}, {s}": [v.value, v.low, v.high] for m, s in _LABELLED if (v := report.value(m, s))}
                for report in outcome.labelled
            ]
    return data
