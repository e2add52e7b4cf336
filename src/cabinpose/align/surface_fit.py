"""Correction of the suit's chain from depth: what turns and lengths of its segments lay a body onto the pixels of the person.

A suit's errors hardly change in a take: a sensor that sits askew, skin that moves by the angle of a joint, a length that was
measured wrong. So they are parameters of the whole take, with the suit's stated errors as priors, and what the camera sees of
the body's surface in some of its frames are the measurements: an articulated ICP, point to plane, by iterated reweighted least
squares. The head stays where the optical system has it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from cabinpose.align.flesh import REGIONS, Flesh, flesh_of
from cabinpose.align.posture import OUTWARDS
from cabinpose.align.suit import CARRIER, JOINT_POINTS, POINTS
from cabinpose.core import MVN_SEGMENTS, Camera, Matrix

F64 = NDArray[np.float64]
Ints = NDArray[np.int64]

FITTED_FRAMES: Final = 16  # of a take, evenly spread: what is fitted is constant, and more say nothing new
# The suit's errors, one sigma, as docs/alignment.md states them: of a segment's turn about each axis, constant, with the initial
# pose corrected and without; growing with the joint's angle since the N-pose (soft tissue); of a length, as a part of it.
# Shoulders are not corrected by the initial pose. No sensor is between pelvis and breastbone: the spine bends as a model has it.
_TURN_DEG: Final = 0.6
_UNCORRECTED_DEG: Final = 2.0
_TURNS_DEG: Final = {
    **dict.fromkeys(("Pelvis", "L5", "L3", "T12"), 2.5), "T8": 0.5, "Neck": 0.4, "LeftShoulder": 2.0, "RightShoulder": 2.0,
}  # fmt: skip
_TISSUE_DEG: Final = 1.5
_LENGTH: Final = 0.02
# By region: mean and sigma of what flesh and clothes are thicker than the body's, and how well its shape fits the person's, m.
# All assumed; hands are bare.
_THICKER_M: Final = np.array([0.010, 0.008, 0.008, 0.005, 0.005, 0.000, 0.005, 0.005, 0.005, 0.0])
_THICKER_SD_M: Final = np.array([0.020, 0.020, 0.020, 0.015, 0.012, 0.005, 0.015, 0.010, 0.010, 0.01])
_SHAPE_SD_M: Final = np.array([0.025, 0.025, 0.025, 0.015, 0.012, 0.012, 0.020, 0.015, 0.020, 1.0])
_INDEPENDENT: Final = 3.0  # frames that all of a take are worth: the shape is wrong in the same way in each
_PATCH_M: Final = 0.06  # points in a cube of this size err together, and count once
# Of each round: how far from the skin a pixel may be, and the residual at which its weight has fallen to a quarter, m.
_ROUNDS: Final = ((0.08, 0.03), (0.06, 0.02), (0.05, 0.015), (0.04, 0.012))
_STRIDE_PX, _ACROSS_PX, _JUMP_M = 6, 3, 0.10
_ALIKE: Final = 0.6  # cosine between the normals of pixel and skin
_EDGE_ON: Final = -0.05  # cosine between the normal and the line of sight from which on the camera sees the skin
_HEAD = POINTS.index("Head")
_SEGMENTS, _POINTS, _REGIONS = len(MVN_SEGMENTS), len(POINTS), len(REGIONS)
_TURN, _LONG = 3 * _SEGMENTS, 6 * _SEGMENTS  # unknowns: constant turns, turns by angle, lengths, thickness
_THICK = _LONG + _POINTS
_UNKNOWNS = _THICK + _REGIONS


class SurfacePoints(NamedTuple):
    """Measured points (P, 3) m of a frame, and the unit normals (P, 3) of the surface there, towards the camera."""

    points: F64
    normals: F64


def surface_cloud(camera: Camera, depth_m: NDArray[np.floating]) -> SurfacePoints:
    """Every sixth pixel in both directions of a depth image (H, W) m, NaN = invalid, in space; none beside edges."""
    height, width = depth_m.shape
    row, column = np.mgrid[0:height, 0:width]
    pixels = np.stack((column, row), axis=-1).reshape(-1, 2).astype(np.float64)
    smooth = median_filter(np.nan_to_num(depth_m, nan=0.0), size=3).ravel()
    points = camera.unproject(pixels, np.where(smooth > 0, smooth, np.nan)).reshape(height, width, 3)
    inner = slice(_ACROSS_PX, -_ACROSS_PX)
    right = points[inner, 2 * _ACROSS_PX :] - points[inner, : -2 * _ACROSS_PX]
    down = points[2 * _ACROSS_PX :, inner] - points[: -2 * _ACROSS_PX, inner]
    middle = points[inner, inner]
    some = (slice(None, None, _STRIDE_PX),) * 2
    right, down, middle = right[some].reshape(-1, 3), down[some].reshape(-1, 3), middle[some].reshape(-1, 3)
    normal = np.cross(down, right)
    length = np.linalg.norm(normal, axis=1)
    with np.errstate(invalid="ignore"):
        whole: NDArray[np.bool_] = np.asarray(
            (length > 0) & (np.linalg.norm(right, axis=1) < _JUMP_M) & (np.linalg.norm(down, axis=1) < _JUMP_M)
        )
    whole &= np.isfinite(middle).all(axis=1)
    normal, middle = normal[whole] / length[whole, None], middle[whole]
    away = np.einsum("pi,pi->p", normal, middle) > 0
    normal[away] *= -1
    return SurfacePoints(middle, normal)


def fitted_frames(kept: NDArray[np.bool_]) -> Ints:
    """Which frames of a take (T,) are looked at: at most `FITTED_FRAMES` of those that are kept, evenly spread."""
    frames = np.flatnonzero(kept)
    return np.asarray(frames[np.unique(np.linspace(0, len(frames) - 1, min(FITTED_FRAMES, len(frames))).astype(np.int64))])


def fit_surface(points: Matrix, clouds: Iterable[tuple[int, SurfacePoints]], *, pose_corrected: bool) -> F64:
    """Fit a suit's chain to the pixels of who wears it.

    Maximum a posteriori: unknown are a constant turn of each segment, one that grows with the angle of its joint, the lengths,
    and the thickness of flesh and clothes by region; priors are the suit's stated errors. A pixel counts where it lies near skin
    that the camera can see, with a like normal; its weight falls with its residual (Geman & McClure 1987). Where nothing is seen
    the priors alone speak, and the suit's pose stays.

    Parameters
    ----------
    points
        (T, 25, 4, 4) camera_from_segment of `suit_points`, as `align_take` has them; NaN in moments without a pose.
    clouds
        Frames of the take and what the camera measured in them.
    pose_corrected
        Whether the suit's initial pose was corrected.

    Returns
    -------
    ndarray
        (T, 20, 3) m: what is to be added to each joint, camera frame; 0 in moments without a pose.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=(1, 2, 3)))
    flesh = flesh_of(points[known])
    angles = np.zeros((len(points), _SEGMENTS))
    angles[known] = _since_n_pose(points[known])
    moments = [FittedMoment.of(points[frame], angles[frame], cloud) for frame, cloud in clouds if known[frame]]
    mean = np.zeros(_UNKNOWNS)
    mean[_THICK:] = _THICKER_M
    precision = 1.0 / _prior_sd(pose_corrected=pose_corrected) ** 2
    found = mean.copy()
    for gate, scale in _ROUNDS:
        normal_matrix, right_side = np.diag(precision), precision * (mean - found)
        for moment in moments:
            rows, residual, weight = moment.equations(flesh, found, gate, scale)
            weight = weight * _INDEPENDENT / len(moments)
            normal_matrix += (rows * weight[:, None]).T @ rows
            right_side += rows.T @ (weight * residual)
        found = found + np.linalg.solve(normal_matrix, right_side)
    shift = np.zeros((len(points), len(JOINT_POINTS), 3))
    shift[known] = [_by_unknowns(p, a)[JOINT_POINTS] @ found[:_THICK] for p, a in zip(points[known], angles[known], strict=True)]
    return shift


@dataclass(frozen=True, eq=False)
class FittedMoment:
    """A frame that is fitted: turns (23, 3, 3) and places (25, 3) of the suit's points, angles (23,) of its joints, by_unknowns
    (25, 3, U): how the points move with the unknowns, and the cloud.
    """

    turns: F64
    places: F64
    angles: F64
    by_unknowns: F64
    cloud: SurfacePoints

    @classmethod
    def of(cls, points: Matrix, angles: F64, cloud: SurfacePoints) -> FittedMoment:
        return cls(points[:_SEGMENTS, :3, :3], points[:, :3, 3], angles, _by_unknowns(points, angles), cloud)

    def skin(self, flesh: Flesh, found: F64) -> tuple[F64, F64]:
        """Places and outward normals (V, 3) of the skin with the unknowns (U,)."""
        vectors = found[:_TURN] + np.repeat(self.angles, 3) * found[_TURN:_LONG]
        turns = self.turns @ Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
        skin, normals = flesh.posed(turns, (self.places + self.by_unknowns @ found[:_THICK])[:_SEGMENTS])
        return skin + normals * found[_THICK + flesh.region][:, None], normals

    def equations(self, flesh: Flesh, found: F64, gate: float, scale: float) -> tuple[F64, F64, F64]:
        """Rows (P, U), residuals (P,) m and weights (P,) 1/m² of the pixels that lie within `gate` of seen skin."""
        skin, normals = self.skin(flesh, found)
        facing = np.einsum("vi,vi->v", normals, skin) < _EDGE_ON * np.linalg.norm(skin, axis=1)
        seen = np.flatnonzero(facing & (flesh.region < _REGIONS - 1))
        distance, nearest = KDTree(skin[seen]).query(self.cloud.points, distance_upper_bound=gate)
        near = np.isfinite(distance)
        vertex, measured, there = seen[nearest[near]], self.cloud.points[near], self.cloud.normals[near]
        alike = np.einsum("pi,pi->p", there, normals[vertex]) > _ALIKE
        vertex, measured, there = vertex[alike], measured[alike], there[alike]
        # Between the two normals (symmetric ICP, Rusinkiewicz 2019): the pixel's is noisy, the body's is of another body.
        across = there + normals[vertex]
        across /= np.linalg.norm(across, axis=1)[:, None]
        residual = np.einsum("pi,pi->p", across, measured - skin[vertex])
        weight = 1.0 / (1.0 + (residual / scale) ** 2) ** 2 / _SHAPE_SD_M[flesh.region[vertex]] ** 2
        cells = np.column_stack((np.floor(measured / _PATCH_M), flesh.region[vertex]))
        _, cell = np.unique(cells, axis=0, return_inverse=True)
        weight /= np.bincount(cell.ravel(), minlength=1)[cell.ravel()]
        return self.rows(flesh, vertex, across, normals[vertex]), residual, weight

    def rows(self, flesh: Flesh, vertex: Ints, across: F64, normals: F64) -> F64:
        """(P, U): how far skin moves along `across` with each unknown: carried by its segments, turned with them, and thicker."""
        rows = np.zeros((len(vertex), _UNKNOWNS))
        carried = (flesh.weight[vertex][:, :, None] * across[:, None, :]).reshape(-1, _TURN)
        rows[:, :_THICK] = carried @ self.by_unknowns[:_SEGMENTS].reshape(-1, _THICK)
        lever = np.cross(flesh.local[vertex], np.einsum("pi,sij->psj", across, self.turns))
        own = (flesh.weight[vertex][:, :, None] * lever).reshape(-1, _TURN)
        rows[:, :_TURN] += own
        rows[:, _TURN:_LONG] += own * np.repeat(self.angles, 3)
        rows[np.arange(len(vertex)), _THICK + flesh.region[vertex]] = np.einsum("pi,pi->p", across, normals)
        return rows


def _prior_sd(*, pose_corrected: bool) -> F64:
    """(U,) standard deviations of the unknowns, rad, rad/rad, parts of a length, m."""
    turn = np.array([_TURNS_DEG.get(segment, _TURN_DEG) for segment in MVN_SEGMENTS])
    if not pose_corrected:
        turn = np.hypot(turn, _UNCORRECTED_DEG)
    tissue = np.full(_SEGMENTS, _TISSUE_DEG)
    turn[_HEAD] = tissue[_HEAD] = 1e-6  # the head is the optical system's
    return np.concatenate(
        (np.repeat(np.radians(turn), 3), np.repeat(np.radians(tissue), 3), np.full(_POINTS, _LENGTH), _THICKER_SD_M)
    )


def _since_n_pose(points: Matrix) -> F64:
    """(T, 23) rad: angle of each segment to the one that carries it, since the N-pose."""
    result = np.zeros((len(points), _SEGMENTS))
    for segment, name in enumerate(MVN_SEGMENTS):
        if CARRIER[segment] < 0:
            continue
        carrier = Rotation.from_matrix(points[:, CARRIER[segment], :3, :3])
        turn = carrier.inv() * Rotation.from_matrix(points[:, segment, :3, :3])
        if name.endswith("UpperArm"):  # which hangs in the N-pose, and is stretched out at the pose of identity
            turn = turn * Rotation.from_euler("x", 90 if name.startswith("Left") else -90, degrees=True)
        result[:, segment] = turn.magnitude()
    return result


def _by_unknowns(points: Matrix, angles: F64) -> F64:
    """(25, 3, U'): how points (25, 4, 4) move with turns and lengths of segments, outwards from the head, which stays."""
    turns, places = points[:, :3, :3], points[:, :3, 3]
    moved = np.zeros((_POINTS, 3, _THICK))
    for near, far, carried in OUTWARDS:
        carrier = CARRIER[carried]
        span = turns[carrier].T @ (places[carried] - places[carrier])
        step = np.zeros((3, _THICK))
        by_turn = turns[carrier] @ np.cross(np.eye(3), span).T
        step[:, 3 * carrier : 3 * carrier + 3] = by_turn
        step[:, _TURN + 3 * carrier : _TURN + 3 * carrier + 3] = angles[carrier] * by_turn
        step[:, _LONG + carried] = turns[carrier] @ span
        moved[far] = moved[near] + (step if far == carried else -step)
    return moved
