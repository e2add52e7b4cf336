"""Quaternions in arrays (..., 4), order wxyz, of which some may be missing (NaN): products, angles, turns about an axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]


def product(a_wxyz: ArrayLike, b_wxyz: ArrayLike) -> F64:
    """(..., 4) Hamilton product a·b, first b then a; broadcasts."""
    a, b = np.asarray(a_wxyz, np.float64), np.asarray(b_wxyz, np.float64)
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    vector = aw * bv + bw * av + np.cross(av, bv)
    return np.concatenate((aw * bw - (av * bv).sum(axis=-1, keepdims=True), vector), axis=-1)


def conjugate(quaternion_wxyz: ArrayLike) -> F64:
    """(..., 4) the inverse rotation."""
    return np.asarray(quaternion_wxyz, np.float64) * (1.0, -1.0, -1.0, -1.0)


def angle(quaternion_wxyz: ArrayLike) -> F64:
    """(...) rad in [0, π], the least angle of the rotation. By the arctangent: the arccosine of w loses angles below 1e-8."""
    q = np.asarray(quaternion_wxyz, np.float64)
    return 2 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), np.abs(q[..., 0]))


def angle_between(a_wxyz: ArrayLike, b_wxyz: ArrayLike) -> F64:
    """(...) rad in [0, π], the geodesic distance of two orientations."""
    return angle(product(a_wxyz, conjugate(b_wxyz)))


def rotation_vectors(quaternion_wxyz: ArrayLike) -> F64:
    """(..., 3) axis times least angle, rad."""
    q = np.asarray(quaternion_wxyz, np.float64)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        # the angle over its sine's half tends to 2 where there is no turn
        scale = np.where(sine > 1e-12, 2 * np.arctan2(sine, q[..., :1]) / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return q[..., 1:] * scale


def since_first(quaternion_wxyz: ArrayLike) -> F64:
    """(T, ..., 4) q_t · q_0*: the turn in the world since the first frame in which each column (...) is known."""
    q = np.asarray(quaternion_wxyz, np.float64)
    known = np.isfinite(q).all(axis=-1)
    first = np.take_along_axis(q, known.argmax(axis=0)[None, ..., None], axis=0)
    return product(q, conjugate(first))


def turn_about(quaternion_wxyz: ArrayLike, axis: ArrayLike) -> F64:
    """(...) rad in (-π, π], the turn about a unit vector (3,): the twist of the swing-twist decomposition."""
    q = np.asarray(quaternion_wxyz, np.float64)
    turn = 2 * np.arctan2(q[..., 1:] @ np.asarray(axis, np.float64), q[..., 0])
    return -((-turn + np.pi) % (2 * np.pi) - np.pi)


def mean_orientation(quaternion_wxyz: ArrayLike, weights: ArrayLike | None = None) -> F64:
    """(4,) the mean of orientations (T, 4), missing ones left out: the eigenvector of their products (Markley et al. 2007)."""
    q = np.asarray(quaternion_wxyz, np.float64).reshape(-1, 4)
    known = np.isfinite(q).all(axis=-1)
    w = np.ones(len(q)) if weights is None else np.asarray(weights, np.float64)
    if not (known & (w > 0)).any():
        return np.full(4, np.nan)
    _, vectors = np.linalg.eigh((q[known] * w[known, None]).T @ q[known])
    best = vectors[:, -1]
    return best if best[0] >= 0 else -best
