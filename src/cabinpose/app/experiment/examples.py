"""Frames of a test for the page, by rule: such as are right, in which one joint fails, and in which whole bodies fail."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.experiment.cells import TestCell
from cabinpose.app.experiment.config import MEAN_ERRORS
from cabinpose.app.experiment.frames import opened
from cabinpose.app.experiment.plan import ExperimentPlan
from cabinpose.app.experiment.results import Results
from cabinpose.app.report.frames import drawing, shown_frame
from cabinpose.app.report.html import Html
from cabinpose.app.view.sheet import caption
from cabinpose.core import Segmenter, skeleton_with
from cabinpose.evaluate import EvaluationOptions, ModelErrors

RULE = (
    "White: truth; orange: found; red: how far apart. Of the training with the best number in the test's first column, its first "
    "repeat. A joint is right within half a head size. Good: all joints are right, nearest to the median of such frames. One "
    "joint fails: it alone is not right; the farthest first. A body fails: half of its joints or more are not right; the worst "
    "first. A joint that is not found counts as three head sizes; of a sequence one frame at the most; of frames alike the first."
)
GOOD, ONE_JOINT, BODY = "good frames", "one joint fails", "a body fails"
_RIGHT, _MISSED = 0.5, 3.0  # head sizes
_SHOWN, _TOLD = 8, 3
ShownFrames = Mapping[tuple[str, str], Sequence[tuple[Html, str]]]
"""By test and kind, frames as SVG with their captions."""


def chosen_frames(errors: ModelErrors, space: str) -> dict[str, list[int]]:
    """The frames that the rule takes, by kind, as positions; see `RULE`. space: "2d" or "3d"."""
    off = np.minimum(_away(errors, space), _MISSED)
    counted = np.isfinite(off)
    wrong = (off > _RIGHT) & counted
    worst = np.where(counted, off, 0.0).max(axis=1, initial=0.0)
    mean = np.where(counted, off, 0.0).sum(axis=1) / np.maximum(counted.sum(axis=1), 1)
    people = np.asarray(counted.any(axis=1))
    good = _people(errors, people & np.asarray(wrong.any(axis=1))) == 0
    good &= _people(errors, people) > 0
    of_frame = np.zeros(errors.frames)
    np.maximum.at(of_frame, errors.at, np.where(people, mean, 0.0))
    middle = float(np.median(of_frame[good])) if good.any() else 0.0
    single = people & (wrong.sum(axis=1) == 1)
    body = people & (2 * wrong.sum(axis=1) >= counted.sum(axis=1))
    return {
        GOOD: _apart(errors, np.flatnonzero(good), np.abs(of_frame[good] - middle)),
        ONE_JOINT: _apart(errors, errors.at[single], -worst[single]),
        BODY: _apart(errors, errors.at[body], -mean[body]),
    }


def what_fails(errors: ModelErrors, joints: Sequence[str], position: int, space: str) -> str:
    """The joints of a frame that are not right, in words, the farthest first; "" of none."""
    away = _away(errors, space)[errors.at == position]
    wrong = sorted(((away[p, j], joints[j]) for p, j in np.argwhere(away > _RIGHT)), reverse=True)
    told = [f"{joint} not found" if np.isinf(far) else f"{joint} {far:.1f} heads off" for far, joint in wrong[:_TOLD]]
    return ", ".join(told) + (f" and {len(wrong) - _TOLD} more" if len(wrong) > _TOLD else "")


def _away(errors: ModelErrors, space: str) -> NDArray[np.float64]:
    """(S, J) how far joints are from the truth, head sizes: infinite where not found, NaN of no account."""
    far, head = (errors.error_px, errors.head_px) if space == "2d" else (errors.error_m, errors.head_m)
    return np.asarray(far / head[:, None])


def _people(errors: ModelErrors, people: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(F,) how many of some people (S,) a frame has."""
    return np.bincount(errors.at[people], minlength=errors.frames)


def _apart(errors: ModelErrors, frames: NDArray[np.int64], rank: NDArray[np.float64]) -> list[int]:
    """The first `_SHOWN` frames by rank, then by number, of each cluster one."""
    taken: dict[int, int] = {}
    for position in frames[np.lexsort((frames, rank))].tolist():
        taken.setdefault(int(errors.cluster[position]), position)
    return list(taken.values())[:_SHOWN]


def shown_frames(plan: ExperimentPlan, results: Results) -> ShownFrames:
    """The frames of each test that is there, drawn; none of models of body parts, nor of datasets without depth."""
    shown: dict[tuple[str, str], Sequence[tuple[Html, str]]] = {}
    for test in plan.experiment.tests:
        column = next((column for column in plan.experiment.columns if column.test == test), None)
        if column is None:
            continue
        sign = -1.0 if column.measure in MEAN_ERRORS else 1.0
        known = {row: n.value for row in plan.experiment.trainings if (n := results.numbers[row, column.title]) is not None}
        known = {row: sign * value for row, value in known.items() if np.isfinite(value)}
        if not known:
            continue
        cell = next(cell for cell in plan.tested[max(known, key=known.__getitem__), test] if cell.done)
        errors, joints = cell.errors()
        if errors.error_px.size and all(piece.folder.exists() for source in cell.frames for piece in source.pieces):
            for kind, positions in chosen_frames(errors, column.space).items():
                told = [what_fails(errors, joints, position, column.space) for position in positions]
                if frames := list(_drawn(cell, joints, dict(zip(positions, told, strict=True)))):
                    shown[test, kind] = frames
    return shown


def _drawn(cell: TestCell, joints: Sequence[str], positions: Mapping[int, str]) -> Iterable[tuple[Html, str]]:
    """Frames by position, with what is said of each."""
    from cabinpose.app.models import opened_models  # noqa: PLC0415 - ONNX Runtime

    datasets = [
        each for s, d in zip(cell.frames, cell.drawn(), strict=True) for each in opened(s.part, d, cell.trained.settings).values()
    ]
    firsts, options = [0, *accumulate(each.sizes["frame"] for each in datasets)], EvaluationOptions(resamples=0)
    for position, told in positions.items():
        number = int(np.searchsorted(firsts, position, side="right")) - 1
        dataset = datasets[number]
        if "depth" not in dataset:
            continue
        (model,) = opened_models([str(cell.trained.model())], dataset)
        assert not isinstance(model, Segmenter)  # which finds no joints
        dataset = dataset.sel(person=list(cell.slots))
        skeleton = skeleton_with(joints)
        shown = shown_frame(dataset, skeleton, model, options, int(dataset["frame"].values[position - firsts[number]]))
        points = None if shown.flat else shown.found
        words = ": ".join(filter(None, (caption(shown.frame), told)))
        yield drawing(shown.frame, skeleton, shown.uv, cell.slots, True, points), words
