"""Rigid registration of point sets: Kabsch from pairs, and iterative closest points where the pairs are not known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from cabinpose.core.errors import AlignmentError
from cabinpose.core.frames import Matrix, apply

F64 = NDArray[np.float64]


def kabsch(p_a: ArrayLike, p_b: ArrayLike, weights: ArrayLike | None = None, *, rotation_only: bool = False) -> Matrix:
    """`a_from_b` (..., 4, 4), the rigid transforms that take points (..., N, 3) of frame b nearest to their partners in frame a.

    weights: (..., N), at least 0 · rotation_only: no translation, for directions. Minimises the weighted sum of squares and never
    reflects: where the best orthogonal matrix is left-handed, the axis of the least singular value is turned (Kabsch 1976;
    Umeyama 1991, eq. 40). Raises AlignmentError for fewer than 3 pairs (2 directions), for numbers that are not finite, and for
    points on a line, which leave a turn about it open.
    """
    a, b = np.asarray(p_a, np.float64), np.asarray(p_b, np.float64)
    w = np.ones(a.shape[:-1]) if weights is None else np.asarray(weights, np.float64)
    least = 2 if rotation_only else 3
    if a.shape != b.shape or a.ndim < 2 or a.shape[-1] != 3 or w.shape != a.shape[:-1]:
        raise AlignmentError(f"pairs of points (N, 3) are needed, not {a.shape} and {b.shape}", hint="give the points in pairs")
    if not (np.isfinite(a).all() and np.isfinite(b).all() and np.isfinite(w).all() and (w >= 0).all()):
        raise AlignmentError("a point or a weight is not a number", hint="leave out pairs with a missing partner")
    fewest = np.count_nonzero(w, axis=-1).min()
    if fewest < least:
        raise AlignmentError(f"{fewest} pairs of points, {least} needed", hint="more points have to be seen by both")
    w = w / w.sum(axis=-1, keepdims=True)
    middle_a, middle_b = ((w[..., None, :] @ p) * (not rotation_only) for p in (a, b))  # (..., 1, 3)
    u, spread, vt = np.linalg.svd(np.swapaxes(w[..., None] * (a - middle_a), -1, -2) @ (b - middle_b))
    if (spread[..., 1] < 1e-9 * np.maximum(spread[..., 0], np.finfo(float).tiny)).any():
        raise AlignmentError("the points lie on a line", hint="points that span a plane are needed, else a turn is left open")
    u[..., 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    result = np.zeros((*a.shape[:-2], 4, 4))
    result[..., :3, :3] = u @ vt
    result[..., :3, 3] = (middle_a - middle_b @ np.swapaxes(u @ vt, -1, -2))[..., 0, :]
    result[..., 3, 3] = 1.0
    return result


@dataclass(frozen=True)
class IcpFit:
    """What `icp` found: a_from_b, the distance (N,) of each point of b to its partner, that one's index (N,), the steps."""

    a_from_b: Matrix
    distance: F64
    partner: NDArray[np.intp]
    iterations: int


def icp(
    p_a: ArrayLike,
    p_b: ArrayLike,
    *,
    start: Matrix | None = None,
    keep: float = 1.0,
    iterations: int = 200,
    tolerance: float = 1e-12,
    rotation_only: bool = False,
) -> IcpFit:
    """Points b (N, 3) laid on points a (M, 3) by iterative closest points, point to point (Besl & McKay 1992).

    start: the first a_from_b · keep: the part of the pairs, the nearest, that each step fits (trimmed ICP, Chetverikov 2002) ·
    tolerance: ends where the mean square distance falls by less than this part of it. It finds the optimum near the start only.
    """
    a, b = np.asarray(p_a, np.float64), np.asarray(p_b, np.float64)
    if not 0 < keep <= 1:
        raise AlignmentError(f"cannot keep {keep} of the pairs", hint="keep lies above 0 and is at most 1")
    tree = KDTree(a)
    a_from_b = np.eye(4) if start is None else np.array(start, np.float64)
    kept = max(int(np.ceil(keep * len(b))), 3)
    last = np.inf
    step = 0
    for step in range(1, iterations + 1):  # noqa: B007 - told afterwards
        distance, partner = tree.query(apply(a_from_b, b))
        near = np.argsort(distance, kind="stable")[:kept]
        error = float(np.mean(distance[near] ** 2))
        if last - error <= tolerance * error or error == 0.0:
            break
        last = error
        a_from_b = kabsch(a[partner[near]], b[near], rotation_only=rotation_only)
    distance, partner = tree.query(apply(a_from_b, b))
    return IcpFit(a_from_b, cast(F64, distance), cast("NDArray[np.intp]", partner), step)
