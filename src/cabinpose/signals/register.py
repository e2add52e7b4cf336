"""Rigid registration of point sets: Kabsch from pairs, and iterative closest points where the pairs are not known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from cabinpose.core import AlignmentError, Matrix, apply

F64 = NDArray[np.float64]


def kabsch(p_a: ArrayLike, p_b: ArrayLike, weights: ArrayLike | None = None, *, rotation_only: bool = False) -> Matrix:
    """The rigid transforms that take points of frame b nearest to their partners in frame a.

    Minimises the weighted sum of squares and never reflects: where the best orthogonal matrix is left-handed, the axis of the
    least singular value is turned (Umeyama, eq. 40).

    Parameters
    ----------
    p_a, p_b
        (..., N, 3) in frames a and b, m.
    weights
        (..., N), at least 0; None: all 1.
    rotation_only
        No translation, for directions.

    Returns
    -------
    NDArray
        `a_from_b` (..., 4, 4).

    Raises
    ------
    AlignmentError
        For fewer than 3 pairs (2 directions), for numbers that are not finite, and for points on a line, about which any turn
        fits.

    References
    ----------
    W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Crystallographica A32 (1976).
    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE TPAMI 13 (1991).
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
    """Points b registered to points a by iterative closest points, point to point. It finds the optimum near the start only.

    Parameters
    ----------
    p_a, p_b
        (M, 3) and (N, 3), m.
    start
        The first a_from_b; None: identity.
    keep
        The share of the pairs, the nearest ones, that each step fits (trimmed ICP, Chetverikov et al. 2002).
    iterations
        The most steps.
    tolerance
        Ends where the mean square distance falls by less than this share of it.
    rotation_only
        No translation, for directions.

    Returns
    -------
    IcpFit
        The transform, and each point's partner.

    References
    ----------
    P. J. Besl, N. D. McKay, "A method for registration of 3-D shapes", IEEE TPAMI 14 (1992).
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
