"""Where the camera is in the optical system's world, by a board that both see: camera_from_world.

Two ways. `camera_from_world` is the thesis' (Gonçalves 2020, section 4.1.2.4, eq. 4.9): markers in the amplitude image become
points, and those are laid on the optical system's by Kabsch. `cabinpose.align.bundle.refine_camera_from_world` uses that the
optical system also tells where every corner of the board is, and fits all pixels at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cabinpose.align.board import Board
from cabinpose.core import AlignmentError, Camera, Matrix, apply, transform
from cabinpose.signals import kabsch

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MEDIAN_OF_NORM = 1.538  # median length of a vector of three standard normals
_CANDIDATES = 400  # starts of the robust fit
_MOST_MARKERS = 8  # above it, permutations are too many to try
_OUTLIER_SIGMA, _OUTLIER_FLOOR_M = 4.0, 0.003  # a pair farther from the fit than both is left out
_FEWEST_VIEWS = 3
_LEAST_SPREAD_M = (
    0.02  # rms of the points across their best plane, below which a mirrored world could not be told from a right one
)
_GREATEST_RMS_M = 0.02


@dataclass(frozen=True)
class BoardPose:
    """camera_from_board, the rms distance (px) of its corners, and the other solution of the plane with its rms, where there is
    one.

    Where `other_rms_px` is not well above `rms_px`, the tilt's sign is open: a board that is far or seen straight on.
    """

    camera_from_board: Matrix
    rms_px: float
    other: Matrix | None = None
    other_rms_px: float = float("inf")


@dataclass(frozen=True)
class ExtrinsicsResult:
    """camera_from_world, and how far it can be trusted.

    residual_m: (V, M) distance of each marker of each view between both systems, m, NaN where it was not seen by both · used:
    (V, M) the pairs that the fit kept · rms_m: over the used ones · held_out_rms_m: over used pairs of views that their fit has
    not seen · covariance: (6, 6) of a small rotation vector (rad) and translation (m) in the camera frame, with p_camera =
    exp(rotation) (camera_from_world p_world) + translation, from the scatter between views · names: of the markers · method:
    `markers` or `corners` · rms_px, held_out_rms_px: of corners in the image, by `corners` only · sigma_px,
    sigma_m: what the fit took for the noise of image and optical system · camera: the intrinsics fitted along with it, by
    `corners`.
    """

    camera_from_world: Matrix
    residual_m: F64
    used: Mask
    rms_m: float
    held_out_rms_m: float
    covariance: F64
    names: tuple[str, ...]
    method: str
    rms_px: float = float("nan")
    held_out_rms_px: float = float("nan")
    sigma_px: float = float("nan")
    sigma_m: float = float("nan")
    camera: Camera | None = None


def board_pose(camera: Camera, corners: ArrayLike, board: Board) -> BoardPose:
    """The board's pose from its corners (N, 2) px, in the order of `Board.corners`, by the plane's two solutions, both refined.

    Collins and Bartoli, "Infinitesimal plane-based pose estimation" (2014), then least squares of the reprojection. Raises
    AlignmentError where corners are missing or lie beyond what the lens model covers.
    """
    uv = np.asarray(corners, np.float64)
    if uv.shape != (board.rows * board.columns, 2):
        raise AlignmentError(
            f"corners {uv.shape} do not fit a board of {board.columns} x {board.rows}",
            hint="give them in the order of Board.corners",
        )
    xy = camera.undistort((uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    if not np.isfinite(xy).all():
        raise AlignmentError("a corner is missing or outside the lens model", hint="keep the board away from the image's edge")
    points = board.corners
    count, turns, shifts, _ = cv2.solvePnPGeneric(points, xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    found = []
    for k in range(count):
        start = np.concatenate((np.ravel(turns[k]), np.ravel(shifts[k]))).astype(np.float64)
        # Where the board's front would be behind the camera, or seen from its back, it is no solution.
        pose, rms = _refined(camera, points, uv, start)
        if np.isfinite(rms) and pose[:3, 2] @ pose[:3, 3] > 0:
            found.append((rms, pose))
    if not found:
        raise AlignmentError("the corners fit no board before the camera", hint="check the order of the corners and the camera")
    found.sort(key=lambda f: f[0])
    second = found[1] if len(found) > 1 and np.abs(found[1][1] - found[0][1]).max() > 1e-6 else None
    return BoardPose(found[0][1], found[0][0], second[1] if second else None, second[0] if second else float("inf"))


def marker_pixels(amplitude: ArrayLike, camera: Camera, camera_from_board: Matrix, board: Board) -> F64:
    """(M, 2) sub-pixel centres of the board's markers in an amplitude image (H, W), NaN where none shines where it is expected.

    The centroid of what is brighter than its surroundings, within the marker's predicted size and 2 px. A saturated disc keeps
    its centroid. The place where a sphere's centre would be seen differs from the middle of its outline; that is taken into
    account.
    """
    image = np.asarray(amplitude, np.float64)
    centres = apply(camera_from_board, board.marker_centres)
    predicted = camera.project(centres)
    result = np.full(predicted.shape, np.nan)
    for m, (uv, centre) in enumerate(zip(predicted, centres, strict=True)):
        radius = board.marker_radius_m * camera.fx / centre[2]
        found = _centroid(image, uv, radius + 2.0)
        if found is not None:
            result[m] = found - (_outline_middle(camera, centre, board.marker_radius_m) - uv)
    return result


def marker_points(camera: Camera, uv: ArrayLike, camera_from_board: Matrix, board: Board) -> F64:
    """(M, 3) markers in the camera frame, m: rays through their pixels (M, 2), met with the plane of the centres; NaN stays
    NaN.
    """
    xy = camera.undistort((np.asarray(uv, np.float64) - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    ray = np.concatenate((xy, np.ones((len(xy), 1))), axis=-1)
    normal = camera_from_board[:3, 2]
    on_plane = apply(camera_from_board, board.marker_centres)
    return np.asarray(ray * ((on_plane @ normal) / (ray @ normal))[:, None])


def check_labels(p_world: ArrayLike, board: Board, *, tolerance_m: float = 0.008) -> tuple[int, ...]:
    """Whether the optical system's labels are the board's: the order (M,) that p_world (V, M, 3) has to be taken in, by
    distances.

    (0, 1, 2, ...) where the labels are right. The distances between markers, the median over the views, are held against the
    board's for every order. Raises AlignmentError where no order fits to tolerance_m (another board, millimetres for metres,
    markers mounted elsewhere), or where two fit alike. Distances are blind to mirrored axes: `camera_from_world` looks for
    these.
    """
    points = np.asarray(p_world, np.float64)
    truth = board.marker_centres
    if points.ndim != 3 or points.shape[1:] != truth.shape:
        raise AlignmentError(
            f"markers (views, {len(truth)}, 3) are needed, not {points.shape}", hint="give the board's markers by name"
        )
    if len(truth) > _MOST_MARKERS:
        raise AlignmentError(
            f"{len(truth)} markers on a board", hint=f"at most {_MOST_MARKERS} can be told apart by their distances"
        )
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    seen = np.isfinite(apart).sum(axis=0)
    if seen.min() == 0:
        raise AlignmentError("two of the board's markers were never seen together", hint="record more views of the board")
    measured = np.nanmedian(apart, axis=0)
    expected = np.linalg.norm(truth[:, None] - truth[None], axis=-1)
    orders = list(permutations(range(len(truth))))
    error = np.array([np.sqrt(np.mean((measured[np.ix_(order, order)] - expected) ** 2)) for order in orders])
    best = int(np.argmin(error))
    if error[best] > tolerance_m:
        scale = float(np.sum(measured * expected) / np.sum(expected**2))
        raise AlignmentError(
            f"the markers' distances do not fit the board: {error[best] * 1e3:.1f} mm apart, {tolerance_m * 1e3:g} mm allowed",
            hint=f"they are {scale:.4g} times the board's: check units, the board's marker positions and which board it was",
        )
    second = float(np.sort(error)[1]) if len(error) > 1 else np.inf
    if second < 2 * error[best] or second < 0.003:
        raise AlignmentError(
            "the board looks the same with its markers swapped", hint="place the markers so that no two distances are alike"
        )
    return tuple(orders[best])


def camera_from_world(p_camera: ArrayLike, p_world: ArrayLike, board: Board | None = None) -> ExtrinsicsResult:
    """camera_from_world from markers in the camera (V, M, 3) and in the optical world (V, M, 3), m, NaN where not seen.

    Kabsch over all pairs, robust: the start with the least median residual, among those of single views and of pairs of views,
    and then pairs beyond `_OUTLIER_SIGMA` times sigma are left out until nothing changes (sigma from the median residual).
    board: where given, swapped labels are looked for first, and its markers give their names.

    Raises AlignmentError for: swapped labels; fewer than three views with three markers; points on a line or in one plane;
    mirrored (left-handed) axes; more than a third of the pairs being outliers; an rms above 2 cm.
    """
    camera, world = np.asarray(p_camera, np.float64), np.asarray(p_world, np.float64)
    if camera.shape != world.shape or camera.ndim != 3 or camera.shape[2] != 3:
        raise AlignmentError(
            f"markers (views, markers, 3) of both systems are needed, not {camera.shape} and {world.shape}", hint="pair the views"
        )
    labels = board.marker_names if board else tuple(f"marker{m + 1}" for m in range(camera.shape[1]))
    if board is not None:
        order = check_labels(world, board)
        if order != tuple(range(len(order))):
            swapped = ", ".join(f"{labels[k]} is {labels[m]}" for k, m in enumerate(order) if k != m)
            raise AlignmentError(
                f"markers are swapped in the optical system: by their distances {swapped}",
                hint="label them anew, or reorder them",
            )
    both = np.isfinite(camera).all(axis=-1) & np.isfinite(world).all(axis=-1)
    enough = both.sum(axis=1) >= 3
    if enough.sum() < _FEWEST_VIEWS:
        raise AlignmentError(
            f"{enough.sum()} views have three markers seen by both systems, {_FEWEST_VIEWS} needed",
            hint="record more views of the board",
        )
    spread = np.linalg.svd(world[both] - world[both].mean(axis=0), compute_uv=False) / np.sqrt(both.sum())
    if spread[1] < _LEAST_SPREAD_M:
        raise AlignmentError("the markers lie on a line", hint="markers that span a plane are needed, else a turn is left open")
    if spread[2] < _LEAST_SPREAD_M:
        raise AlignmentError(
            f"all markers of all views lie in a plane to {spread[2] * 1e3:.0f} mm: mirrored axes could not be noticed",
            hint="tilt the board and hold it nearer and further between views",
        )
    a, b = camera[both], world[both]
    view = np.nonzero(both)[0]
    start = _best_start(a, b, view)
    _refuse_mirrored(a, b, view, start)
    fit, kept = _trimmed(a, b, start)
    rms = float(np.sqrt(np.mean(np.sum((apply(fit, b[kept]) - a[kept]) ** 2, axis=1))))
    if kept.mean() < 2 / 3 or rms > _GREATEST_RMS_M:
        raise AlignmentError(
            f"the markers of both systems do not fit: {np.mean(~kept):.0%} outliers, {rms * 1e3:.1f} mm for the rest",
            hint="check that images and optical frames are of the same moments, the units, and the board's dimensions",
        )
    residual = np.full(both.shape, np.nan)
    residual[both] = np.linalg.norm(apply(fit, b) - a, axis=1)
    used = np.zeros(both.shape, bool)
    used[both] = kept
    good = a[kept], b[kept], view[kept]
    return ExtrinsicsResult(fit, residual, used, rms, _held_out(*good), _covariance(*good, fit), labels, "markers")


def _refined(camera: Camera, points: F64, uv: F64, start: F64) -> tuple[Matrix, float]:
    def residual(x: F64) -> F64:
        at = apply(transform(Rotation.from_rotvec(x[:3]), x[3:]), points)
        pixels = camera.project(np.where(at[:, 2:] > 1e-3, at, (0.0, 0.0, 1e-3)), folded=True)
        return np.asarray((pixels - uv).ravel())

    solved = least_squares(residual, start, method="lm", xtol=1e-14, ftol=1e-14)
    pose = transform(Rotation.from_rotvec(solved.x[:3]), solved.x[3:])
    return pose, float(np.sqrt(np.sum(solved.fun**2) / len(points)))


def _centroid(image: F64, uv: F64, reach: float) -> F64 | None:
    """The centroid (2,) of what shines around a pixel; it is looked for in twice the reach and then weighed within the reach."""
    wide = 2 * reach
    if not (wide <= uv[0] <= image.shape[1] - 1 - wide and wide <= uv[1] <= image.shape[0] - 1 - wide):
        return None
    left, top = np.floor(uv - wide).astype(int)
    right, bottom = np.ceil(uv + wide).astype(int)
    v, u = np.mgrid[top : bottom + 1, left : right + 1]
    value = image[top : bottom + 1, left : right + 1]
    ground = float(np.median(value))
    peak = float(value[np.hypot(u - uv[0], v - uv[1]) <= reach].max())
    scatter = 1.4826 * float(np.median(np.abs(value - ground)))
    if peak - ground < max(0.5 * ground, 8 * scatter):
        return None  # a retro-reflective marker is many times brighter than a painted board
    bright = (value - ground > 0.5 * (peak - ground)) & (np.hypot(u - uv[0], v - uv[1]) <= reach)
    at = np.array((np.mean(u[bright]), np.mean(v[bright])))
    for _ in range(3):
        away = np.hypot(u - at[0], v - at[1])
        ring = value[(away > reach) & (away <= reach + 2.0)]
        weight = np.where(away <= reach, value - float(np.median(ring)), 0.0)
        at = np.array(((weight * u).sum(), (weight * v).sum())) / weight.sum()
    return at


def _outline_middle(camera: Camera, centre: F64, radius: float) -> F64:
    """(2,) middle, by area, of the outline in which a sphere is seen: an ellipse, further out than the projection of its
    centre.
    """
    distance = float(np.linalg.norm(centre))
    to = centre / distance
    side = np.linalg.svd(to[None])[2][1:]
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False)[:, None]
    sine = radius / distance
    rim = to * (1 - sine**2) + sine * np.sqrt(1 - sine**2) * (np.cos(turn) * side[0] + np.sin(turn) * side[1])
    p = camera.project(rim)
    q = np.roll(p, -1, axis=0)
    origin = p.mean(axis=0)
    p, q = p - origin, q - origin
    area = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    return np.asarray(origin + ((p + q) * area[:, None]).sum(axis=0) / (3 * area.sum()))


def _best_start(a: F64, b: F64, view: NDArray[np.intp]) -> Matrix:
    """The transform with the least median residual over all pairs, among fits to all, to three of a view, to two views."""
    groups = [np.nonzero(view == v)[0] for v in np.unique(view)]
    groups = [g for g in groups if len(g) >= 3]
    picks = [np.arange(len(a)), *(np.array(t) for g in groups for t in combinations(g, 3))]
    picks += [np.concatenate(pair) for pair in combinations(groups, 2)]
    best, least = np.eye(4), np.inf
    for pick in picks[:: max(len(picks) // _CANDIDATES, 1)]:
        try:
            fit = kabsch(a[pick], b[pick])
        except AlignmentError:
            continue  # three markers on a line say nothing
        median = float(np.median(np.linalg.norm(apply(fit, b) - a, axis=1)))
        if median < least:
            best, least = fit, median
    if not np.isfinite(least):
        raise AlignmentError("the markers lie on a line", hint="markers that span a plane are needed, else a turn is left open")
    return best


def _refuse_mirrored(a: F64, b: F64, view: NDArray[np.intp], start: Matrix) -> None:
    """Raises where the mirror image of the world fits clearly better than the world."""
    mirror = b * (-1.0, 1.0, 1.0)
    plain = float(np.median(np.linalg.norm(apply(start, b) - a, axis=1)))
    mirrored = float(np.median(np.linalg.norm(apply(_best_start(a, mirror, view), mirror) - a, axis=1)))
    if plain > 0.001 and mirrored < 0.3 * plain:
        raise AlignmentError(
            f"one of the systems has left-handed axes: {plain * 1e3:.1f} mm as they are, {mirrored * 1e3:.1f} mm when mirrored",
            hint="change the sign or swap two axes of the optical system's export (x right-handed to y, z up)",
        )


def _trimmed(a: F64, b: F64, start: Matrix) -> tuple[Matrix, Mask]:
    """Kabsch over the pairs within some sigma of the fit before, or `_OUTLIER_FLOOR_M`, until the set stays."""
    fit, kept = start, np.zeros(len(a), bool)
    for _ in range(50):
        away = np.linalg.norm(apply(fit, b) - a, axis=1)
        sigma = float(np.median(away)) / _MEDIAN_OF_NORM
        now = away <= max(_OUTLIER_SIGMA * sigma, _OUTLIER_FLOOR_M)
        if (now == kept).all():
            break
        kept = now
        fit = kabsch(a[kept], b[kept])
    return fit, kept


def _held_out(a: F64, b: F64, view: NDArray[np.intp]) -> float:
    """Rms (m) over pairs whose view was left out of the fit, each view in turn (at most 20 groups)."""
    views = np.unique(view)
    squares = np.zeros(len(a))
    for group in np.array_split(views, min(len(views), 20)):
        out = np.isin(view, group)
        fit = kabsch(a[~out], b[~out])
        squares[out] = np.sum((apply(fit, b[out]) - a[out]) ** 2, axis=1)
    return float(np.sqrt(squares.mean()))


def _covariance(a: F64, b: F64, view: NDArray[np.intp], fit: Matrix) -> F64:
    """(6, 6) of rotation vector and translation in the camera frame, by the sandwich over views.

    The markers of a view err together, with the pose of its board; so views are the independent ones (Liang & Zeger 1986), with
    the usual factor for few of them. Least squares: dp = -[p]x rotation + translation.
    """
    p = apply(fit, b)
    jacobian = np.zeros((len(p), 3, 6))
    jacobian[:, :, :3] = -skew(p)
    jacobian[:, :, 3:] = np.eye(3)
    bread = np.linalg.inv(np.einsum("nia,nib->ab", jacobian, jacobian))
    pull = np.einsum("nia,ni->na", jacobian, a - p)
    views = np.unique(view)
    meat = np.stack([pull[view == v].sum(axis=0) for v in views])
    factor = len(views) / max(len(views) - 2, 1)
    return np.asarray(bread @ (meat.T @ meat * factor) @ bread)


def skew(p: F64) -> F64:
    """(..., 3, 3) matrices with skew(p) q = p x q."""
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    zero = np.zeros_like(x)
    return np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=-1).reshape(*p.shape[:-1], 3, 3)


def world_from_boards(p_world: F64, board: Board) -> F64:
    """(V, 4, 4) the board in the optical world in each view, by Kabsch from its markers (V, M, 3); NaN where fewer than three
    are seen.
    """
    result = np.full((len(p_world), 4, 4), np.nan)
    for k, points in enumerate(p_world):
        seen = np.isfinite(points).all(axis=-1)
        if seen.sum() >= 3:
            result[k] = kabsch(points[seen], board.marker_centres[seen])
    return result
