"""Correction of the suit's initial pose: what its own calibration got wrong, from a pose whose truth is known.

A suit learns in its calibration how each sensor sits on its segment, and trusts that the person stands in the N-pose. By what
that pose was off, each segment is turned in every frame that follows (Gonçalves 2020, sections 4.4 and 8.2, names the correction
as future work, after Orozco 2015). In a take of a pose whose truth is known the error shows, at each of the suit's points: the
point lies off the place where the suit has it, by the same vector in the axes of the segment that carries it, whatever the
person does later. A vector of the suit's own lengths, where these are wrong, is corrected along with it if the truth is optical.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.align.suit import CARRIER, POINTS
from cabinpose.core import AlignmentError, Matrix

F64 = NDArray[np.float64]

_HELD_RAD = np.deg2rad(5.0)  # rms by which a segment may turn while the pose is held
_MOST_M = 0.15  # a point farther off its place is no error of a calibration: the person stood otherwise
# Collar bones drop with the arms, by an amount that nobody sees from outside: no N-pose says how the shoulders are turned.
_SHOULDERS = (POINTS.index("LeftShoulder"), POINTS.index("RightShoulder"))
_HEAD = POINTS.index("Head")
_ARMS = tuple(
    (POINTS.index(side + part), sign) for side, sign in (("Left", -1), ("Right", 1)) for part in ("UpperArm", "Forearm", "Hand")
)


def _outwards() -> list[tuple[int, int, int]]:
    """Neighbouring points (near, far, carried) from the head outwards; `carried`: which of the two the other one carries."""
    edges, queue, reached = [], deque([_HEAD]), {_HEAD}
    while queue:
        near = queue.popleft()
        for far in range(len(POINTS)):
            if far not in reached and (CARRIER[far] == near or CARRIER[near] == far):
                edges.append((near, far, far if CARRIER[far] == near else near))
                queue.append(far)
                reached.add(far)
    return edges


OUTWARDS = _outwards()


def n_pose(points: Matrix, arms_off_rad: float = 0.0) -> F64:
    """Where the suit's points are if the person stands in the N-pose: (T, 25, 3) m in the suit's world.

    Parameters
    ----------
    points
        (T, 25, 4, 4) world_from_segment of `suit_points`, of the pose.
    arms_off_rad
        By how much the hanging arms are off the vertical, to the sides.

    Returns
    -------
    ndarray
        All segments upright, the arms down; lengths, place, heading (over all segments) and shoulders are the suit's own.
    """
    true = np.tile(np.eye(3), (len(POINTS), 1, 1))
    for point, sign in _ARMS:
        true[point] = Rotation.from_euler("x", sign * (np.pi / 2 - arms_off_rad)).as_matrix()
    turns = points[..., :3, :3]
    true = _heading(turns @ np.swapaxes(true, -1, -2)) @ true
    places: F64 = points[..., :3, 3].copy()
    for point, carrier in enumerate(CARRIER):
        if carrier >= 0:
            by_suit = points[:, point, :3, 3] - points[:, carrier, :3, 3]
            if carrier not in _SHOULDERS:
                by_suit = np.einsum("tji,tj->ti", turns[:, carrier], by_suit) @ true[carrier].T
            places[:, point] = places[:, carrier] + by_suit
    return places


def optical_pose(points: Matrix, places: F64, world_from_head: F64) -> F64:
    """Where the suit's points are by the optical system: (T, 25, 3) m in the suit's world but for a translation.

    Both worlds have z up, so that only a heading lies between them. The head tells it: its tilt is known worse, by what the skin
    moves under the suit's sensor, and would move feet by centimetres.

    Parameters
    ----------
    points
        (T, 25, 4, 4) world_from_segment of `suit_points`, of the pose.
    places
        (T, 25, 3) m, in the optical world; NaN where they are not known.
    world_from_head
        (T, 3, 3) rotations of the head segment in the optical world.
    """
    turned: F64 = places @ _heading(points[:, _HEAD, :3, :3] @ np.swapaxes(world_from_head, -1, -2)).T
    return turned


def _heading(turns: F64) -> F64:
    """(3, 3) the turn about z that is nearest to turns (..., 3, 3): in the plane Kabsch has one angle."""
    total = np.nanmean(turns.reshape(-1, 3, 3), axis=0)
    angle = np.arctan2(total[1, 0] - total[0, 1], total[0, 0] + total[1, 1])
    return np.asarray(Rotation.from_euler("z", angle).as_matrix())


def pose_shifts(points: Matrix, true_places: F64) -> F64:
    """By what each of the suit's points is off, from the moments T of a pose that was held.

    Parameters
    ----------
    points
        (T, 25, 4, 4) world_from_segment of `suit_points`.
    true_places
        (T, 25, 3) m, where the points really are, in the suit's world but for a common translation; NaN where it is not known.

    Returns
    -------
    ndarray
        (25, 3) m: what is to be added to each point's place in the axes of the segment that carries it, as the suit has these.
        0 where nothing is known: what a chain of such points is off by is put down to its last one.

    Raises
    ------
    AlignmentError
        Where the pose was not held, or was another one.
    """
    turns = points[..., :3, :3]
    for point, name in enumerate(POINTS):
        seen = turns[np.isfinite(turns[:, point]).all(axis=(1, 2)), point]
        if len(seen):
            each = Rotation.from_matrix(seen)
            moved = float(np.sqrt(np.mean((each.mean().inv() * each).magnitude() ** 2)))
            if moved > _HELD_RAD:
                raise AlignmentError(
                    f"the pose was not held: {name} turned by {np.degrees(moved):.1f} deg",
                    hint="record some seconds in which the subject stands still, and nothing else",
                )
    off = true_places - points[..., :3, 3]
    known = np.isfinite(off.sum(axis=2)).any(axis=0)
    if not known[_HEAD] or known.sum() < 2:
        raise AlignmentError(
            "the pose is not known: the head and another joint are needed", hint="give the model of the whole body"
        )
    shifts = np.zeros((len(POINTS), 3))
    carried = {_HEAD: off[:, _HEAD]}
    for near, far, moved_point in OUTWARDS:
        carried[far] = off[:, far] if known[far] else carried[near]
        along = np.einsum("tji,tj->ti", turns[:, CARRIER[moved_point]], carried[far] - carried[near])
        shifts[moved_point] = (1 if far == moved_point else -1) * np.nan_to_num(np.nanmean(along, axis=0))
    worst = int(np.linalg.norm(shifts, axis=1).argmax())
    if np.linalg.norm(shifts[worst]) > _MOST_M:
        raise AlignmentError(
            f"the pose was another one: {POINTS[worst]} is {100 * np.linalg.norm(shifts[worst]):.0f} cm off",
            hint="give the pose that the subject really held",
        )
    return shifts


def shifted(points: Matrix, shifts: F64) -> F64:
    """The places (T, 25, 3) m of the suit's points with the shifts (25, 3) of `pose_shifts`; the head's stays where it is."""
    places: F64 = points[..., :3, 3].copy()
    moved = np.zeros_like(places)
    for near, far, carried in OUTWARDS:
        step = points[:, CARRIER[carried], :3, :3] @ shifts[carried]
        moved[:, far] = moved[:, near] + (step if far == carried else -step)
    return places + moved
