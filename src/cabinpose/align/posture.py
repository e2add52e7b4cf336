"""A known posture at the start corrects the suit's systematic error: the constant turn of each segment against its sensor.

A suit learns in its own calibration how each sensor sits on its segment; what it gets wrong there, it is wrong by in every
frame (Gonçalves 2020, sections 4.4 and 8.2, names this as future work). Where the subject holds a posture whose segment
orientations are known (a fixture, an N-pose against a wall, an optical full-body model), that constant is seen: measured =
true · error, in the segment's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import AlignmentError
from cabinpose.core.skeleton import MVN_JOINTS, MVN_SEGMENTS

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class PostureCorrection:
    """error_wxyz: (S, 4) of each segment, on the right of its true orientation · heading_rad: of the suit's world against that
    of the known posture, taken out · scatter_rad: (S,) rms by which the segment moved while the posture was held: what the
    correction is worth · segments: the names · corrected: (S,) False for segments whose posture was not known, which stay as
    they are.
    """

    error_wxyz: F64
    heading_rad: float
    scatter_rad: F64
    segments: tuple[str, ...]
    corrected: NDArray[np.bool_]

    @property
    def angle_rad(self) -> F64:
        """(S,) the size of each segment's error."""
        return np.asarray(Rotation.from_quat(self.error_wxyz, scalar_first=True).magnitude())


def initial_pose_correction(
    wxyz: ArrayLike,
    known_wxyz: ArrayLike,
    *,
    segments: Sequence[str] = MVN_SEGMENTS,
    free_heading: bool = True,
    max_scatter_deg: float = 5.0,
    max_error_deg: float = 45.0,
) -> PostureCorrection:
    """The constant error of each segment from moments (T, S, 4), wxyz, in which a known posture (S, 4) was held; NaN = not known.

    free_heading: the posture is known up to a common turn about the vertical, which is estimated from all segments (the one that
    leaves the least error); else the suit's world is the posture's. Raises AlignmentError where the posture was not held (a known
    segment moved by more than max_scatter_deg rms) or was another one (an error above max_error_deg).
    """
    measured, known = np.asarray(wxyz, np.float64), np.asarray(known_wxyz, np.float64)
    names = tuple(segments)
    if measured.ndim != 3 or measured.shape[1:] != (len(names), 4) or known.shape != (len(names), 4):
        raise AlignmentError(
            f"orientations (T, {len(names)}, 4) and a posture like them are needed, not {measured.shape} and {known.shape}",
            hint="one orientation for each of the suit's segments, NaN where the posture is not known",
        )
    error = np.tile((1.0, 0.0, 0.0, 0.0), (len(names), 1))
    scatter = np.full(len(names), np.nan)
    means: dict[int, Rotation] = {}
    for s in np.nonzero(np.isfinite(known).all(axis=1))[0].tolist():
        valid = np.isfinite(measured[:, s]).all(axis=1)
        if not valid.any():
            continue
        turns = Rotation.from_quat(measured[valid, s], scalar_first=True)
        means[s] = turns.mean()
        scatter[s] = float(np.sqrt(np.mean((means[s].inv() * turns).magnitude() ** 2)))
    if not means:
        raise AlignmentError(
            "no segment of the posture is known and measured", hint="give the posture and the moments it was held in"
        )
    moving = [f"{names[s]} {np.rad2deg(scatter[s]):.1f} deg" for s in means if np.rad2deg(scatter[s]) > max_scatter_deg]
    if moving:
        raise AlignmentError(
            f"the posture was not held: {', '.join(moving)}", hint="choose moments in which the subject stands still"
        )
    truth = {s: Rotation.from_quat(known[s], scalar_first=True) for s in means}
    heading = _common_heading(means, truth) if free_heading else 0.0
    turn = Rotation.from_rotvec((0.0, 0.0, heading))
    for s, mean in means.items():
        error[s] = ((turn * truth[s]).inv() * mean).as_quat(scalar_first=True)
    result = PostureCorrection(error, heading, scatter, names, np.isin(np.arange(len(names)), list(means)))
    far = [
        f"{names[s]} {np.rad2deg(result.angle_rad[s]):.0f} deg" for s in means if np.rad2deg(result.angle_rad[s]) > max_error_deg
    ]
    if far:
        raise AlignmentError(
            f"the posture was another one: {', '.join(far)}", hint="give the posture that the subject really held"
        )
    return result


def corrected_orientations(wxyz: ArrayLike, correction: PostureCorrection) -> F64:
    """(T, S, 4) orientations without the constant errors."""
    q = np.asarray(wxyz, np.float64)
    result = np.full(q.shape, np.nan)
    for s, error in enumerate(Rotation.from_quat(correction.error_wxyz, scalar_first=True)):
        valid = np.isfinite(q[:, s]).all(axis=1)
        if valid.any():
            result[valid, s] = (Rotation.from_quat(q[valid, s], scalar_first=True) * error.inv()).as_quat(scalar_first=True)
    return result


def rebuilt(
    p: ArrayLike,
    wxyz: ArrayLike,
    correction: PostureCorrection,
    *,
    joints: Sequence[tuple[str, str, str]] = MVN_JOINTS,
    anchor: str = "Head",
) -> tuple[F64, F64]:
    """Positions (T, S, 3), m, and orientations (T, S, 4) of the segments, corrected: the body put together anew.

    p, wxyz: as the suit says. A segment's origin lies at a constant place in its parent's axes: the suit's own lengths, the
    median over time. joints: (name, parent, child), parents before children. The origin of `anchor` stays where it was, since
    the chain to the camera hangs on the head. What has no path of known segments is NaN.
    """
    positions, turns = np.asarray(p, np.float64), np.asarray(wxyz, np.float64)
    index = {name: s for s, name in enumerate(correction.segments)}
    missing = [n for _, a, b in joints for n in (a, b) if n not in index]
    if missing or anchor not in index:
        raise AlignmentError(
            f"segments {sorted({*missing, anchor} - set(index))} are not there", hint=f"known: {', '.join(index)}"
        )
    corrected = corrected_orientations(turns, correction)
    before, after = _matrices(turns), _matrices(corrected)
    result = np.full(positions.shape, np.nan)
    root = index[joints[0][1]]
    result[:, root] = positions[:, root]
    for _, parent, child in joints:
        a, b = index[parent], index[child]
        offsets = np.einsum("tji,tj->ti", before[:, a], positions[:, b] - positions[:, a])
        offset = np.nanmedian(offsets, axis=0) if np.isfinite(offsets).all(axis=1).any() else np.full(3, np.nan)
        result[:, b] = result[:, a] + after[:, a] @ offset
    result += (positions[:, index[anchor]] - result[:, index[anchor]])[:, None]
    return result, corrected


def _common_heading(means: dict[int, Rotation], truth: dict[int, Rotation]) -> float:
    """The turn about z that takes the posture nearest to what was measured: in the plane, Kabsch has one angle."""
    total = np.zeros((3, 3))
    for s, mean in means.items():
        total += (mean * truth[s].inv()).as_matrix()
    return float(np.arctan2(total[1, 0] - total[0, 1], total[0, 0] + total[1, 1]))


def _matrices(wxyz: F64) -> F64:
    """(T, S, 3, 3), NaN where the quaternion is."""
    result = np.full((*wxyz.shape[:-1], 3, 3), np.nan)
    valid = np.isfinite(wxyz).all(axis=-1)
    if valid.any():
        result[valid] = Rotation.from_quat(wxyz[valid], scalar_first=True).as_matrix()
    return result
