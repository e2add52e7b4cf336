"""Which of a model's answers on frames without labels may stand for labels: what it is sure of, and what moves as a body can.

Learning from such answers is self-training (Lee, "Pseudo-label", ICML workshop 2013). Answers are chosen by their confidence, and
the student sees varied frames, as with Xie et al. ("Self-training with noisy student", CVPR 2020).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core import ANATOMY, CABINPOSE, ConfigError, Visibility
from cabinpose.store import Predictions

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]
PRESENT = 0.5  # presence from which a joint counts as found
_GAP_S = 0.5  # frames farther apart do not follow each other
_NEVER_NS = 0  # the stamp of a frame whose time is not known


class Course(NamedTuple):
    """How frames follow each other. time_s: (F,) s, NaN where it is not known · group: (F,) the same number in a row of them."""

    time_s: Floats
    group: NDArray[np.int64]

    def part(self, rows: NDArray[np.int64] | Mask) -> Course:
        """Of some frames."""
        return Course(self.time_s[rows], self.group[rows])


@dataclass(frozen=True)
class Rules:
    """When an answer stands for a label.

    presence, error_m: least presence and greatest expected error of a joint (m) · speed_m_s: the fastest that a body moves in a
    car (assumed; a hand that reaches has 2 to 3) · joints: the fewest of a person · absent: whoever is not found has no joint of
    a greater presence.
    """

    presence: float = 0.9
    error_m: float = 0.03
    speed_m_s: float = 4.0
    joints: int = 6
    absent: float = 0.25


class PseudoLabels(NamedTuple):
    """What was chosen. joints: (F, P, J) that stand for labels · frames: (F,) that are learnt from · left_out: why others are
    not, with how many frames.
    """

    joints: Mask
    frames: Mask
    left_out: dict[str, int]


def is_found(found: Predictions) -> Mask:
    """(F, P, J) whether a joint counts as found: it has a place, and a presence of `PRESENT` or more."""
    return np.asarray(np.isfinite(found.joints_3d).all(axis=-1) & (found.presence >= PRESENT))


def course_of(dataset: xr.Dataset, rate_hz: float | None = None) -> Course:
    """How the frames of a dataset follow each other: by their times, or by a rate where they have none.

    Raises ConfigError for a rate beside times.
    """
    number, sequence, stamp = (dataset[name].values.astype(np.int64) for name in ("frame", "sequence", "sync_ns"))
    if (stamp == _NEVER_NS).all():
        time = np.full(len(number), np.nan) if rate_hz is None else number / rate_hz
    elif rate_hz is not None:
        raise ConfigError("--rate-hz says nothing of frames that have times", hint="leave out --rate-hz")
    else:
        time = (stamp - stamp.min()) * 1e-9
    apart = np.diff(time)
    follows = (np.diff(sequence) == 0) & (apart > 0) & (apart <= _GAP_S)
    return Course(time, np.concatenate(([0], np.cumsum(~follows))))


def inconsistent(joints_3d: NDArray[np.floating], course: Course, speed_m_s: float, slack_m: NDArray[np.floating]) -> Mask:
    """(F, P, J) joints that are farther from where they were a frame before, or are a frame later, than a body can move.

    joints_3d: (F, P, J, 3) m, NaN = not found · slack_m: (F, P, J) m, how far an answer may be off, of each of both frames.
    """
    wrong = np.zeros(joints_3d.shape[:-1], bool)
    apart = np.diff(course.time_s)[:, None, None]
    follows = (np.diff(course.group) == 0)[:, None, None]
    way = np.linalg.norm(np.diff(joints_3d.astype(np.float64), axis=0), axis=-1)
    with np.errstate(invalid="ignore"):
        jump = follows & (way > speed_m_s * apart + slack_m[1:] + slack_m[:-1])
    wrong[1:] |= jump
    wrong[:-1] |= jump
    return wrong


def choose(found: Predictions, course: Course, rules: Rules) -> PseudoLabels:
    """The answers that may stand for labels.

    A joint does where it is surely there, expected to be near the truth, and nowhere jumps. A frame is learnt from where
    somebody is found, all who are found have enough such joints, and all others are surely not there. A model that knows no
    expected errors is taken at its presence; a joint of which it alone knows none is not sure.
    """
    expected = found.expected_error_m.astype(np.float64)
    there = is_found(found)
    near = expected <= rules.error_m if np.isfinite(expected).any() else np.ones_like(there)
    sure = there & (found.presence >= rules.presence) & near
    slack = np.where(np.isfinite(expected), expected, rules.error_m)
    jumps = inconsistent(np.where(there[..., None], found.joints_3d, np.nan), course, rules.speed_m_s, slack)
    joints = sure & ~jumps
    people: Mask = np.any(there, axis=2)
    few = people & (joints.sum(axis=2) < rules.joints)
    doubtful = ~people & (found.presence.max(axis=2) > rules.absent)
    reasons = {
        "nobody is found": ~people.any(axis=1),
        "somebody may or may not be there": doubtful.any(axis=1),
        "too few joints are sure": few.any(axis=1) & ((sure.sum(axis=2) < rules.joints) & people).any(axis=1),
        "joints jump": few.any(axis=1),
    }
    left = np.zeros(len(found.frame), bool)
    counts = {}
    for words, frames in reasons.items():
        counts[words] = int((frames & ~left).sum())
        left |= frames
    return PseudoLabels(joints & ~left[:, None, None], ~left, counts)


def labelled(dataset: xr.Dataset, found: Predictions, chosen: PseudoLabels, exchanged: Mask) -> xr.Dataset:
    """The frames that are learnt from, with the answers for labels: images and camera are the dataset's, all else the model's.

    exchanged: (F,) frames in which the model took the wheel to be on the right, which they then say.
    Joints that are found and did not pass are there at an unknown place; those that are not found are outside of the image.
    """
    rows = np.flatnonzero(chosen.frames)
    count, people = len(rows), len(found.persons)
    columns = [CABINPOSE.index[name] for name in found.joints]
    xyz = np.full((count, people, len(CABINPOSE.joints), 3), np.nan, np.float32)
    uv = np.full((*xyz.shape[:-1], 2), np.nan, np.float32)
    states = np.full(xyz.shape[:-1], Visibility.ABSENT, np.uint8)
    kept: Mask = chosen.joints[rows]
    xyz[:, :, columns] = np.where(kept[..., None], found.joints_3d[rows], np.nan)
    uv[:, :, columns] = np.where(kept[..., None], found.joints_2d[rows], np.nan)
    presence, score = found.presence[rows], found.score[rows]
    here: Mask = np.any(presence >= PRESENT, axis=2)
    seen = np.where(score >= PRESENT * presence, Visibility.VISIBLE, Visibility.OCCLUDED)
    state = np.where(presence >= PRESENT, seen, Visibility.OUTSIDE_IMAGE)
    states[:, :, columns] = np.where(np.expand_dims(here, 2), state, Visibility.ABSENT)
    images = [name for name in ("depth", "amplitude", "rgb", "camera_k", "camera_dist") if name in dataset]
    frames = dataset[images].isel(frame=rows).drop_vars(("subject", "action"), errors="ignore")
    dims = ("frame", "person", "joint")
    who = np.where(here, "somebody", "").astype(object)
    arrays = {"joints_3d": ((*dims, "xyz"), xyz), "joints_2d": ((*dims, "uv"), uv), "visibility": (dims, states)}
    told = dataset["drive_side"].values[rows] if "drive_side" in dataset else ""
    side = np.where(exchanged[rows], "right", told).astype(object)
    names = {
        "person": list(found.persons), "joint": list(CABINPOSE.joints), "subject": (dims[:2], who), "drive_side": ("frame", side),
    }  # fmt: skip
    named = frames.assign(arrays).assign_coords(names)
    return named.assign_attrs(generator="cabinpose.adapt", joint_definition=ANATOMY)
