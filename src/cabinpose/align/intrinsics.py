"""A camera's intrinsics from checkerboards in its amplitude images, with the error on views that the fit has not seen.

Zhang, "A flexible new technique for camera calibration" (2000), in OpenCV's implementation, with the distortion (k1, k2, p1,
p2, k3). Views are weighed before they count: those without the whole board, too oblique, repeated or inconsistent are left out
and say why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.align.board import Board
from cabinpose.core import AlignmentError, Camera, Matrix, apply, transform

F64 = NDArray[np.float64]

_SAME_VIEW_PX = 1.0  # two views that differ by less are one: the board was not moved
_WORST_FACTOR = 3.0  # a view with so many times the median error, and above _WORST_PX, is inconsistent
_WORST_PX = 0.3
_MAX_ITERATIONS = 200
_MIN_VIEWS = 6
_MIN_TILT_DEG = 10.0  # two boards tilted against each other by less leave the focal length open
_MAX_OBLIQUE_DEG = 65.0  # between the line of sight and the board's normal
_MAX_FOCAL_STD = 0.02  # standard deviation of the focal lengths, as a part of them


@dataclass(frozen=True)
class ViewFit:
    """One image: whether it was used, why not (empty where used), its corners (N, 2) px or None, the rms distance (px) between
    corners and model, the board's tilt against the line of sight (rad), its pose; `held_out_px` is the rms under the fit
    without it.
    """

    index: int
    used: bool
    reason: str = ""
    corners: F64 | None = None
    rms_px: float = float("nan")
    held_out_px: float = float("nan")
    tilt_rad: float = float("nan")
    camera_from_board: Matrix | None = None


@dataclass(frozen=True)
class IntrinsicsResult:
    """A calibrated camera.

    camera: fitted to all used views · rms_px: root mean square distance between corners and model on them · held_out_rms_px: the
    same on views that a second fit, to the others, has not seen (their poses are its own to choose) · std: standard deviations of
    (fx, fy, cx, cy, k1, k2, p1, p2, k3) · coverage: the part of the image that the corners' convex hull covers; beyond it the
    distortion is extrapolated · tilt_range_rad: the largest angle between two views' boards.
    """

    camera: Camera
    rms_px: float
    held_out_rms_px: float
    std: tuple[float, ...]
    coverage: float
    tilt_range_rad: float
    views: tuple[ViewFit, ...]

    @property
    def used(self) -> tuple[int, ...]:
        return tuple(v.index for v in self.views if v.used)

    @property
    def rejected(self) -> dict[int, str]:
        return {v.index: v.reason for v in self.views if not v.used}


def calibrate_from_corners(
    corners: Sequence[F64 | None], size: tuple[int, int], board: Board, *, reasons: Sequence[str] = (), holdout: float = 0.2
) -> IntrinsicsResult:
    """The camera that took images of a board held here and there.

    Parameters
    ----------
    corners
        (N, 2) px of each view; None where they were not found.
    size
        Width and height of the images, px.
    board
        What was shown.
    reasons
        Of each view, why its corners were not found, "" where they were.
    holdout
        The part of the views, evenly spread, that a second fit leaves out to be judged on.

    Raises
    ------
    AlignmentError
        Where too few views are usable, with the reasons of rejected ones, where all boards stand alike, or where the focal length
        is not determined.
    """
    why = list(reasons) or ["" if c is not None else "no corners given" for c in corners]
    for index, uv in enumerate(corners):
        if uv is None:
            continue
        twin = next((k for k in range(index) if not why[k] and _same(corners[k], uv)), None)
        if twin is not None:
            why[index] = f"the board stands as in view {twin}"
    used = _enough([k for k, reason in enumerate(why) if not reason], why)
    fit = _fit(corners, used, size, board)
    # Judged by a fit that they are part of, views that are worst are judged again without them.
    while True:
        bad = {k: reason for k in used if (reason := _unfit(fit, k))}
        if not bad:
            break
        for k, reason in bad.items():
            why[k] = reason
        used = _enough([k for k in used if k not in bad], why)
        fit = _fit(corners, used, size, board)
    tilt = _tilt_range(fit)
    if tilt < np.deg2rad(_MIN_TILT_DEG):
        raise AlignmentError(
            f"all boards stand alike: {np.rad2deg(tilt):.1f} deg between the most different, {_MIN_TILT_DEG:g} needed",
            hint="tilt the board between views, to the sides and up and down, by about 30 degrees",
        )
    worst = max(fit.std[0] / fit.camera.fx, fit.std[1] / fit.camera.fy)
    if not worst <= _MAX_FOCAL_STD:
        raise AlignmentError(
            f"the focal length is not determined: its standard deviation is {worst:.1%} of it, {_MAX_FOCAL_STD:.1%} allowed",
            hint="more views, nearer, with the board tilted about both axes",
        )
    held_out = _held_out(corners, used, size, board, holdout)
    views = []
    for k, uv in enumerate(corners):
        if k in fit.pose:
            pose = fit.pose[k]
            views.append(ViewFit(k, True, "", uv, fit.rms_px[k], held_out.get(k, float("nan")), _obliqueness(pose, board), pose))
        else:
            views.append(ViewFit(k, False, why[k], uv))
    error = np.array([fit.rms_px[k] for k in used])
    out = np.array(list(held_out.values()))
    inside = np.clip(np.concatenate([corners[k] for k in used]), -0.5, np.array(size) - 0.5)
    hull = cv2.convexHull(inside.astype(np.float32))
    return IntrinsicsResult(
        camera=fit.camera,
        rms_px=float(np.sqrt(np.mean(error**2))),
        held_out_rms_px=float(np.sqrt(np.mean(out**2))) if len(out) else float("nan"),
        std=fit.std,
        coverage=float(cv2.contourArea(hull) / (size[0] * size[1])),
        tilt_range_rad=tilt,
        views=tuple(views),
    )


@dataclass(frozen=True)
class _Fit:
    camera: Camera
    std: tuple[float, ...]
    pose: dict[int, Matrix]  # camera_from_board of each view
    rms_px: dict[int, float]
    board: Board


def _fit(corners: Sequence[F64 | None], used: list[int], size: tuple[int, int], board: Board) -> _Fit:
    points = board.corners.astype(np.float32)
    seen = [np.asarray(corners[k], np.float32).reshape(-1, 1, 2) for k in used]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _MAX_ITERATIONS, 1e-12)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # of several, each adds its views to a sum when it is ready: another order, other last digits
    try:
        _, k_matrix, dist, turns, shifts, std, _, _ = cv2.calibrateCameraExtended(
            [points] * len(used), seen, size, None, None, criteria=criteria
        )  # type: ignore[call-overload]
    except cv2.error as error:
        raise AlignmentError(f"the views determine no camera ({error.err})", hint="tilt the board between views") from error
    finally:
        cv2.setNumThreads(threads)
    k1, k2, p1, p2, k3 = (float(d) for d in np.ravel(dist)[:5])
    fx, fy, cx, cy = (float(k_matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not (np.isfinite((fx, fy, cx, cy, k1, k2, p1, p2, k3)).all() and fx > 0 and fy > 0):
        raise AlignmentError("the views determine no camera", hint="tilt the board between views, about both axes")
    camera = Camera(*size, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    pose = {
        k: transform(Rotation.from_rotvec(np.ravel(turn)), np.ravel(shift))
        for k, turn, shift in zip(used, turns, shifts, strict=True)
    }
    rms = {k: _rms(camera, pose[k], corners[k], board) for k in used}
    return _Fit(camera, tuple(float(s) for s in np.ravel(std)[:9]), pose, rms, board)


def _held_out(
    corners: Sequence[F64 | None], used: list[int], size: tuple[int, int], board: Board, holdout: float
) -> dict[int, float]:
    """Rms (px) of the views, evenly spread over the used ones, that a fit to the others has not seen; {} where too few are
    left.
    """
    count = round(holdout * len(used))
    if count < 1 or len(used) - count < 4:
        return {}
    out = [used[int((k + 0.5) * len(used) / count)] for k in range(count)]
    camera = _fit(corners, [k for k in used if k not in out], size, board).camera
    result = {}
    for k in out:
        uv = corners[k]
        _, turn, shift = cv2.solvePnP(board.corners, np.asarray(uv, np.float64), camera.k, np.array(camera.dist))
        result[k] = _rms(camera, transform(Rotation.from_rotvec(np.ravel(turn)), np.ravel(shift)), uv, board)
    return result


def _rms(camera: Camera, camera_from_board: Matrix, uv: F64 | None, board: Board) -> float:
    """Of a view (px); infinite where the fitted lens folds before the last corner."""
    away = camera.project(apply(camera_from_board, board.corners)) - np.asarray(uv)
    return float(np.sqrt(np.mean(np.sum(np.nan_to_num(away, nan=np.inf) ** 2, axis=-1))))


def _same(one: F64 | None, other: F64) -> bool:
    return one is not None and float(np.sqrt(np.mean(np.sum((one - other) ** 2, axis=-1)))) < _SAME_VIEW_PX


def _enough(used: list[int], why: list[str]) -> list[int]:
    if len(used) < _MIN_VIEWS:
        raise AlignmentError(
            f"{len(used)} of {len(why)} views are usable, {_MIN_VIEWS} needed{_told(why)}",
            hint="show the whole board, at 0.5 to 1.2 m, in other places and tilts for each view",
        )
    return used


def _told(why: list[str]) -> str:
    """The reasons of rejected views, counted: ': 3 x no board found, 1 x ...'."""
    counts: dict[str, int] = {}
    for reason in why:
        kind = "the board was not moved" if reason.startswith("the board stands as") else reason
        if kind:
            counts[kind] = counts.get(kind, 0) + 1
    return ": " + ", ".join(f"{n} x {kind}" for kind, n in sorted(counts.items(), key=lambda c: -c[1])) if counts else ""


def _unfit(fit: _Fit, k: int) -> str:
    """Why a view does not count, or nothing."""
    tilt = np.rad2deg(_obliqueness(fit.pose[k], fit.board))
    if tilt > _MAX_OBLIQUE_DEG:
        return f"too oblique: {tilt:.0f} deg, {_MAX_OBLIQUE_DEG:g} allowed"
    limit = max(_WORST_FACTOR * float(np.median(list(fit.rms_px.values()))), _WORST_PX)
    if fit.rms_px[k] > limit and fit.rms_px[k] == max(fit.rms_px.values()):  # one at a time: the worst bends the others' fit
        return f"inconsistent with the others: {fit.rms_px[k]:.2f} px, {limit:.2f} allowed"
    return ""


def _obliqueness(camera_from_board: Matrix, board: Board) -> float:
    """Angle (rad) between the board's normal and the line of sight to its middle."""
    sight = apply(camera_from_board, board.corners.mean(axis=0))
    return float(np.arccos(np.clip(camera_from_board[:3, 2] @ sight / np.linalg.norm(sight), -1, 1)))


def _tilt_range(fit: _Fit) -> float:
    """The largest angle (rad) between the normals of two boards: 0 where all are parallel, whatever the focal length is said to
    be.
    """
    normals = np.stack([pose[:3, 2] for pose in fit.pose.values()])
    return float(np.arccos(np.clip(normals @ normals.T, -1, 1)).max())
