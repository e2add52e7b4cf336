"""SFE, the static evaluation of the full body: the first N-pose against the last, before and after a drive (thesis, 3.1.1.2).

Joints are taken relative to the pelvis, T_j^pelvis = T_pelvis^-1 T_j (eq. 3.3), since the person stands elsewhere the second
time; ξ_j is the distance of each joint from where it was (eq. 3.2). It contains the suit's drift and distortion, and how well the
person repeats the pose. Where there is no pelvis (optical markers), the whole body is fitted instead.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError, apply
from cabinpose.evaluate.mocap.result import Errors, Judgement, judgement
from cabinpose.evaluate.mocap.stillness import Window, moving_speed, still_windows
from cabinpose.signals import conjugate, kabsch, product

F64 = NDArray[np.float64]
ERROR, RATE = "joint error", "joint error per second of drive"
_UPRIGHT = np.cos(np.radians(35.0))  # how far from the vertical a limb of an N-pose may hang
# Of an N-pose: upper end, lower end of what is vertical, in MVN's names.
_VERTICAL = (
    ("Head", "Pelvis"), ("T8", "Pelvis"), ("LeftUpperArm", "LeftHand"), ("RightUpperArm", "RightHand"),
    ("LeftUpperLeg", "LeftLowerLeg"), ("RightUpperLeg", "RightLowerLeg"), ("LeftLowerLeg", "LeftFoot"),
    ("RightLowerLeg", "RightFoot"),
)  # fmt: skip


@dataclass(frozen=True)
class SfeRun:
    """One drive: error_m (T, N) in the frames of the last pose, drive_s from the first pose to the last.

    first_m (N, 3): the first pose, relative to the pelvis (fit "body": where it was); last_m (N, 3): the last one, laid on it.
    """

    condition: str
    names: tuple[str, ...]
    time_s: F64
    error_m: F64
    drive_s: float
    first_m: F64
    last_m: F64
    first: Window
    last: Window

    def errors(self) -> tuple[Errors, Errors]:
        """Errors of the joints, and the same divided by the seconds of drive."""
        return (
            Errors(ERROR, "m", self.condition, self.names, self.time_s, self.error_m),
            Errors(RATE, "m/s", self.condition, self.names, self.time_s, self.error_m / self.drive_s),
        )


def find_poses(
    time_s: ArrayLike, position_m: ArrayLike, names: Sequence[str], *, least_s: float = 1.0, limit_m_s: float = 0.05,
    over_s: float = 0.5, any_pose: bool = False,
) -> tuple[Window, Window]:  # fmt: skip
    """The first and the last window in which the person stands still in an N-pose; positions (T, N, 3), z up.

    Still: for `least_s` no segment moves faster than `limit_m_s`, as measured over `over_s`. N-pose: trunk, hanging arms and
    straight legs within 35° of the vertical, so that somebody sitting still is not taken for it; any_pose skips that. Raises
    AlignmentError unless there are two.
    """
    time, position = np.asarray(time_s, np.float64), np.asarray(position_m, np.float64)
    speed = moving_speed(time, position, over_s=over_s)
    known = np.isfinite(speed)
    still = known.any(axis=1) & (np.where(known, speed, 0.0).max(axis=1) < limit_m_s)
    windows = still_windows(time, still, least_s=least_s)
    standing = [w for w in windows if any_pose or is_n_pose(np.nanmedian(position[w.frames(time)], axis=0), names)]
    if len(standing) < 2:
        raise AlignmentError(
            f"the person stands still {len(windows)} times, {len(standing)} of them in an N-pose; two are needed",
            hint="give the times of the first and the last N-pose, or a looser limit of stillness",
        )
    first, last = standing[0], standing[-1]
    return Window("first", first.start_s, first.end_s), Window("last", last.start_s, last.end_s)


def is_n_pose(position_m: F64, names: Sequence[str]) -> bool:
    """Whether a person (N, 3) stands upright, arms hanging, by MVN's segments; raises AlignmentError where one is not there."""
    at = {name: position_m[i] for i, name in enumerate(names)}
    if absent := [name for pair in _VERTICAL for name in pair if name not in at]:
        raise AlignmentError(
            f"no N-pose can be told without {', '.join(dict.fromkeys(absent))}",
            hint="give the times of the first and the last N-pose",
        )
    down = np.array([at[upper] - at[lower] for upper, lower in _VERTICAL])
    return bool((down[:, 2] >= _UPRIGHT * np.linalg.norm(down, axis=1)).all())


def sfe_run(
    time_s: ArrayLike, position_m: ArrayLike, orientation_wxyz: ArrayLike | None, names: Sequence[str],
    poses: tuple[Window, Window] | None = None, *, condition: str = "drive", root: str | None = "Pelvis", **old: Any,
) -> SfeRun:  # fmt: skip
    """One drive: positions (T, N, 3) m and orientations (T, N, 4) of the named segments, and when the two poses are held.

    The first pose is the mean over its window; every frame of the last is held against it. root: the segment whose pose both are
    taken relative to, and whose own error is none and left out; None: the rigid fit of all joints that both poses have. old: the
    keywords of 0.2, first, last, fit and pelvis.

    Raises AlignmentError where the root is missing, where fewer than three joints are in both poses, and where the last pose
    is not after the first.
    """
    if old or poses is None:
        poses, root = _as_in_0_2(**old)
    first, last = poses
    time, position = np.asarray(time_s, np.float64), np.asarray(position_m, np.float64)
    if last.start_s <= first.end_s:
        raise AlignmentError("the last pose is not after the first", hint="give them in their order, apart from each other")
    rows, after = first.frames(time), last.frames(time)
    if root is not None:
        if root not in names or orientation_wxyz is None:
            raise AlignmentError(
                f"there is no pose of the segment '{root}'", hint=f"there are: {', '.join(names)}; or fit the whole body"
            )
        index = tuple(names).index(root)
        kept = [i for i in range(len(names)) if i != index]
        turn = np.asarray(orientation_wxyz, np.float64)[:, index]
        before_p = _relative(position[rows], position[rows, index], turn[rows])[:, kept]
        last_p = _relative(position[after], position[after, index], turn[after])[:, kept]
        start = _mean(before_p)
    else:
        kept = list(range(len(names)))
        start = _mean(position[rows])
        last_p = np.stack([_fitted(start, frame) for frame in position[after]])
    error = np.linalg.norm(last_p - start, axis=-1)
    both = np.isfinite(error).any(axis=0)
    if both.sum() < 3:
        raise AlignmentError(
            f"{both.sum()} joints are known in both poses, three needed", hint="choose windows in which the body is seen"
        )
    joints = tuple(names[i] for i in kept)
    drive_s = last.start_s - first.end_s
    return SfeRun(condition, joints, time[after], error, drive_s, start, _mean(last_p), first, last)


def _as_in_0_2(
    *, first: Window, last: Window, fit: Literal["pelvis", "body"] = "pelvis", pelvis: str = "Pelvis"
) -> tuple[tuple[Window, Window], str | None]:
    """poses and root of what `sfe_run` took before."""
    warnings.warn("sfe_run takes poses=(first, last), and root= in place of fit= and pelvis=", DeprecationWarning, stacklevel=3)
    return (first, last), pelvis if fit == "pelvis" else None


def sfe(runs: Sequence[SfeRun], *, rng: np.random.Generator, resamples: int = 1000, block_s: float | None = None) -> Judgement:
    """The joints' errors by drive and over all of them."""
    notes = [
        f"{run.condition}: {run.drive_s:.1f} s between the poses; first {run.first.start_s:.2f} to {run.first.end_s:.2f} s, "
        f"last {run.last.start_s:.2f} to {run.last.end_s:.2f} s"
        for run in runs
    ]
    return judgement("sfe", runs, notes, rng=rng, resamples=resamples, block_s=block_s)


def _relative(position: F64, pelvis: F64, turn: F64) -> F64:
    """(T, N, 3) in the pelvis' frame: eq. 3.3, the transpose there meaning the inverse of a rigid transform."""
    moved = position - pelvis[:, None]
    vectors = np.concatenate((np.zeros_like(moved[..., :1]), moved), axis=-1)
    return product(product(conjugate(turn)[:, None], vectors), turn[:, None])[..., 1:]


def _mean(position: F64) -> F64:
    """(N, 3) over the frames in which each is known; NaN where it never is."""
    known = np.isfinite(position).all(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        return np.where(known, position, 0.0).sum(axis=0) / known.sum(axis=0)


def _fitted(start: F64, frame: F64) -> F64:
    known = np.isfinite(start).all(axis=1) & np.isfinite(frame).all(axis=1)
    return apply(kabsch(start[known], frame[known]), frame)
