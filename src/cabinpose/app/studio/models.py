"""What can be chosen as a model in the tabs, packaged ones and predictions that are open; how far off these are in each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.studio.workspace import Workspace
from cabinpose.core import Predictor, skeleton_of
from cabinpose.estimate import packaged_detectors
from cabinpose.estimate.remote import open_predictor
from cabinpose.evaluate import (
    EvaluationOptions,
    FrameDistances,
    Report,
    Samples,
    common_joints,
    frame_distances,
    make_report,
    samples_of,
    shared_places,
)
from cabinpose.store import Predictions

_FILE = "file:"


def choices(workspace: Workspace) -> dict[str, str]:
    """Values and words of a select; "" is nothing."""
    files = {_FILE + name: f"{name} (predictions)" for name in workspace.predictions}
    return {"": "nothing", **files, **{name: name for name in detectors()}}


def first_choice(workspace: Workspace) -> str:
    """The value of `choices` that labelling begins with."""
    return _FILE + workspace.proposals if workspace.proposals else ""


def detectors() -> list[str]:
    """Names of the packaged models."""
    return list(packaged_detectors())


def load_choice(workspace: Workspace, value: str) -> Predictor | Predictions | None:
    """What a value of `choices` stands for. Raises ModelError."""
    if not value:
        return None
    if value.startswith(_FILE):
        return workspace.predictions[value.removeprefix(_FILE)]
    return open_predictor(value)


@dataclass(frozen=True)
class Judged:
    """A model's errors and numbers, and its errors over the frames."""

    samples: Samples
    report: Report
    over_frames: FrameDistances

    @property
    def d(self) -> NDArray[np.float64]:
        """(F,) the error of each frame, see `FrameDistances.mean`."""
        return self.over_frames.mean


def judged(
    dataset: xr.Dataset, model: Predictions, options: EvaluationOptions, space: str, joints: Sequence[str], persons: Sequence[str]
) -> Judged:
    """What `evaluate` says of a model, and how far its joints are off in each frame."""
    samples, caveats = samples_of(dataset, model, options, joints=joints, persons=persons)
    return Judged(samples, make_report(samples, options, model.model, "", caveats), frame_distances(samples, space, options))


class FrameErrors(NamedTuple):
    """How far predictions are off. d: (F,) error of each frame, as `FrameDistances.mean` · unit: cm, or px."""

    d: NDArray[np.float64]
    unit: str

    def choose(self, rows: NDArray[np.int64], over: float | None, worst: float | None, *, by_error: bool) -> NDArray[np.int64]:
        """Those of some rows whose error is greater than `over`, at most so many, the worst; in order, or worst first."""
        if over is not None:
            rows = rows[self.d[rows] > over]
        ranked = rows[worst_first(self.d[rows])][: None if worst is None else max(int(worst), 1)]
        return ranked if by_error else np.sort(ranked)

    def words(self, row: int) -> str:
        """The error of a frame, with its unit."""
        return f"{error_words(self.d[row])} {self.unit}" if np.isfinite(self.d[row]) else error_words(self.d[row])


def frame_errors(workspace: Workspace, opened: xr.Dataset, name: str, person: str = "") -> FrameErrors:
    """How far predictions that are open are off in each frame of `opened`: in 3D, or in the image where they know no space.

    Held against the corrected labels, as in Compare; person: only theirs. Raises PredictionsError.
    """
    model, dataset = workspace.predictions[name], workspace.corrected(opened)
    options, persons = EvaluationOptions(resamples=0), (person,) if person else shared_places(dataset, [model])
    samples, _ = samples_of(dataset, model, options, joints=common_joints(dataset, [model]), persons=persons)
    space = "3d" if "3d" in samples.spaces() else "2d"
    return FrameErrors(frame_distances(samples, space, options).mean, "cm" if space == "3d" else "px")


class JointPlaces(NamedTuple):
    """Where a joint of people was, and how far a model was off there.

    rows: (n,) frames · where: (n, 3) m in the vehicle's frame ("xyz") or (n, 2) px ("uv") · error: (n,) cm or px, infinite
    where it was not found · axes: which of both.
    """

    rows: NDArray[np.int64]
    where: NDArray[np.float64]
    error: NDArray[np.float64]
    axes: str


def joint_places(
    dataset: xr.Dataset, model: Predictions, joint: str, persons: Sequence[str], options: EvaluationOptions
) -> JointPlaces:
    """The places of a joint that counts of the people in some seats, and how far off a model's answer for the same seat is.

    In space where both know it, else in the image.
    """
    batch, names = model.take(dataset["frame"].values), [str(name) for name in dataset["person"].values]
    seats, theirs = ([among.index(person) for person in persons] for among in (names, list(model.persons)))
    j, k = [str(name) for name in dataset["joint"].values].index(joint), list(model.joints).index(joint)
    counts = dataset["visibility"].values[:, seats, j] >= options.min_visibility
    found = batch.presence[:, theirs, k] >= options.presence
    true, given = dataset["joints_3d"].values[:, seats, j].astype(float), batch.joints_3d[:, theirs, k].astype(float)
    in_space = bool(np.isfinite(true[counts]).all() and np.isfinite(given[found]).any())
    if not in_space:
        true, given = dataset["joints_2d"].values[:, seats, j].astype(float), batch.joints_2d[:, theirs, k].astype(float)
    error = np.linalg.norm(given - true, axis=-1) * (100 if in_space else 1)
    error = np.where(found & np.isfinite(error), error, np.inf)
    rows, at = np.nonzero(counts & np.isfinite(true).all(axis=-1))
    where = true[rows, at]
    if in_space and len(rows):
        frames = dataset["vehicle_from_camera"].values[rows].astype(float)  # (n, 4, 4)
        where = np.einsum("nij,nj->ni", frames[:, :3, :3], where) + frames[:, :3, 3]
    return JointPlaces(rows, where, error[rows, at], "xyz" if in_space else "uv")


class PredictedPeople(NamedTuple):
    """Whom predictions find in a frame. uv, xyz: (P, J, 2) px and (P, J, 3) m, camera frame, NaN where they are not sure enough ·
    names: of the J joints · limbs: pairs of them.
    """

    uv: NDArray[np.float64]
    xyz: NDArray[np.float64]
    names: tuple[str, ...]
    limbs: Sequence[tuple[int, int]]

    def drawn(self, colour: str, *, dashed: bool = False) -> list[dict[str, Any]]:
        """As `FrameCanvas.joints` draws people whom nobody moves."""
        places = [
            [{"u": u, "v": v} if np.isfinite(u) else {"u": None, "v": None} for u, v in person] for person in self.uv.tolist()
        ]
        joints = [[{"name": name, **at} for name, at in zip(self.names, person, strict=True)] for person in places]
        limbs = [list(limb) for limb in self.limbs]
        return [{"colour": colour, "joints": each, "limbs": limbs, "fixed": True, "dashed": dashed} for each in joints]


def found_in(model: Predictions, number: int) -> PredictedPeople:
    """Whom predictions find in the frame of a number."""
    batch = model.take(np.array([number]))
    sure = (batch.presence[0] >= EvaluationOptions().presence)[..., None]
    uv, xyz = (np.where(sure, values[0], np.nan).astype(np.float64) for values in (batch.joints_2d, batch.joints_3d))
    return PredictedPeople(uv, xyz, tuple(model.joints), skeleton_of(model).limbs)


def worst_first(d: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows by falling error, frames without one at the end."""
    return np.argsort(-np.where(np.isnan(d), -1.0, d), kind="stable")


def error_words(error: float) -> str:
    """A frame's error as the tabs show it."""
    return "nobody found" if np.isinf(error) else "–" if np.isnan(error) else f"{error:.1f}"
