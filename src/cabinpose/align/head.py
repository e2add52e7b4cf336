"""The suit's head on the optical system's head object: object_from_head, rotation and offset.

At each moment world_from_object · object_from_head = world_from_suit · suit_from_head, in rotations R_o(t) Y = X R_s(t): Y is
what is sought, and X, between the two worlds, is not known either. MVN's head frame: x forward, y left, z up, origin in C1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cabinpose.core import AlignmentError, Matrix, transform
from cabinpose.signals import icp, kabsch

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

TURNS = ("lateral flexion", "flexion", "rotation")  # about x, y, z of the head
_MOST_PAIRS = 6000
_HUBER = 2.0  # of the median residual
_SMALL = np.deg2rad(3.0)  # a smaller turn between two moments has no axis worth its noise
_LARGE = np.deg2rad(150.0)  # near half a turn the axis' sign is open
_STARTS = 12
_SOME = 150  # moments of the clouds that the starts are tried on
_SETTLED = 1e-8  # rad: far below any noise; without noise the last step is quadratic and leaves less


@dataclass(frozen=True)
class HeadAlignment:
    """object_from_head and world_from_suit (rotations, 4x4).

    residual_rad: (T,) angle between R_o Y and X R_s, NaN where one is missing, without the suit's heading drift where that was
    let go · rms_rad: of it · heading_rad: (T,) the suit's heading against the optical world about the vertical, less its mean:
    drift · covariance: (3, 3) of a small rotation vector (rad) in the object frame, on the left of object_from_head ·
    turned_rad: by how much the head turned about x (lateral flexion), y (flexion) and z (rotation) of its mean pose, 2nd to
    98th percentile · second_axis_rad: rms turn about the second most used axis, on which the result stands.
    """

    object_from_head: Matrix
    world_from_suit: Matrix
    residual_rad: F64
    rms_rad: float
    heading_rad: F64
    covariance: F64
    turned_rad: tuple[float, float, float]
    second_axis_rad: float
    method: str


@dataclass(frozen=True)
class HeadOffset:
    """Where the head joint is in the frame of the optical object, (3,) m, its covariance (3, 3), and the rms (m) left per
    moment.
    """

    offset: F64
    covariance: F64
    rms_m: float
    method: str


def align_head(
    suit_head_wxyz: ArrayLike,
    optical_head_wxyz: ArrayLike,
    *,
    method: Literal["closed_form", "icp"] = "closed_form",
    span: int | None = None,
    min_turn_deg: float = 3.0,
    max_rms_deg: float = 6.0,
) -> HeadAlignment:
    """object_from_head from orientations of the head (T, 4), wxyz, of both systems at the same moments; NaN = missing.

    `closed_form`: turns between two moments, seen from the body, are the same in both systems but for Y: their rotation vectors
    are a = Y s, which Kabsch solves without X (as in hand-eye calibration, Park & Martin 1994); then X and Y are refined
    together on the angles of all moments. span: only moments at most so many frames apart are paired, and the suit's heading is
    let go (X may turn slowly about the vertical): for a suit whose heading drifts.

    `icp`: Gonçalves (2020), eq. 4.11. In both systems the turn since the first moment carries P = (0, 0, 1), and the two clouds
    are laid on each other by iterative closest points without use of their pairing, from starts all around P; the best is
    taken. It assumes that both frames have the same z axis, since P is the same in both; where the object's is tilted by an
    angle, the result is wrong by at least about that. Clouds that look alike after half a turn (a head that only nods) have two
    solutions. Taken without the first moment's orientation, as the equation stands, it would find X, which is Y only where both
    heads begin with the world's axes.

    Raises AlignmentError where the head did not turn about two axes (the rms about the second below min_turn_deg), and where
    the systems contradict each other (more than max_rms_deg left by the closed form).
    """
    suit, optical, both = _rotations(suit_head_wxyz, optical_head_wxyz)
    turned, second = _turned(suit)
    if np.rad2deg(second) < min_turn_deg:
        told = ", ".join(f"{name} {np.rad2deg(t):.0f}" for name, t in zip(TURNS, turned, strict=True))
        raise AlignmentError(
            f"the head did not turn about two axes ({told} deg; second: {np.rad2deg(second):.1f} rms, {min_turn_deg:g} needed)",
            hint="begin each take with flexion, lateral flexion and rotation of the head, each to both sides",
        )
    if method == "icp":
        y = _by_clouds(suit, optical)
        x = (optical * y * suit.inv()).mean()
        weights = np.ones(len(suit))
    elif method == "closed_form":
        y = _by_pairs(suit, optical, span)
        x = (optical * y * suit.inv()).mean()
        x, y, weights = _refined(suit, optical, x, y, free_heading=span is not None)
    else:
        raise AlignmentError(f"unknown method '{method}'", hint="known: closed_form, icp")
    error = _error(suit, optical, x, y)
    heading = error[:, 2] - error[:, 2].mean()
    left = np.column_stack((error[:, :2], np.zeros(len(error)))) if span is not None else error
    angle = np.linalg.norm(left, axis=1)
    rms = float(np.sqrt(np.mean(angle**2)))
    if method == "closed_form" and np.rad2deg(rms) > max_rms_deg:
        raise AlignmentError(
            f"the two systems' heads do not move alike: {np.rad2deg(rms):.1f} deg left, {max_rms_deg:g} allowed",
            hint="align their times first; check that the marker cap did not slip; for a drifting heading give a span",
        )
    whole, headings = np.full(len(both), np.nan), np.full(len(both), np.nan)
    whole[both], headings[both] = angle, heading
    covariance = _covariance(suit, x, y, left, weights, free_heading=span is not None)
    return HeadAlignment(transform(y), transform(x), whole, rms, headings, covariance, turned, second, method)


def head_agreement(suit_head_wxyz: ArrayLike, optical_head_wxyz: ArrayLike, object_from_head: Matrix) -> F64:
    """How far apart both systems see the head at each moment (thesis, section 4.2.1.1, figures 4.20 and 4.21).

    Parameters
    ----------
    suit_head_wxyz, optical_head_wxyz
        (T, 4) orientations of the head segment and of the head object at the same moments, NaN = missing.
    object_from_head
        (4, 4) of the calibration.

    Returns
    -------
    ndarray
        (T,) rad, NaN where one system lacks the head. The worlds are laid on each other by one turn for all moments, so what the
        suit's heading drifts by is in it.
    """
    suit, optical = np.asarray(suit_head_wxyz, np.float64), np.asarray(optical_head_wxyz, np.float64)
    both = np.isfinite(suit).all(axis=1) & np.isfinite(optical).all(axis=1)
    result = np.full(len(suit), np.nan)
    if both.any():
        by_suit = Rotation.from_quat(suit[both], scalar_first=True)
        by_optical = Rotation.from_quat(optical[both], scalar_first=True) * Rotation.from_matrix(object_from_head[:3, :3])
        world_from_suit = (by_optical * by_suit.inv()).mean()
        result[both] = (by_optical.inv() * world_from_suit * by_suit).magnitude()
    return result


def head_offset(
    p_object: ArrayLike,
    object_wxyz: ArrayLike,
    *,
    p_pivot: ArrayLike | None = None,
    spans: Sequence[tuple[int, int]] | int | None = None,
    min_turn_deg: float = 5.0,
) -> HeadOffset:
    """The offset c (3,) from the optical object's origin to the point about which it turns, in the object frame, m.

    p_object (T, 3), object_wxyz (T, 4): the object's pose in the optical world; NaN = missing. Least squares, with Huber's
    weights, of p_object + R c - p_pivot = constant within each span (pairs of first and end index, or a length in frames, or
    all in one).

    Without p_pivot it assumes that the head joint stands still within a span: a still trunk, and a head that turns about C1.
    The skull nods and turns about C1 and C2 by some 15 and 40 degrees; further bending comes from the neck below, and the fit
    then finds a mean centre of the neck, centimetres too low. p_pivot (T, 3): how the joint moves in the optical world by what
    the suit says (world_from_suit applied to the head's position relative to the pelvis or T8 of a still trunk): then only the
    rest has to stand still, and large motions are welcome. The covariance is that of the scatter between spans where there are
    at least eight, else that of independent moments, which is too small for a trunk that sways.

    Raises AlignmentError where the head did not turn about two axes by an rms of min_turn_deg: the offset along the axis is
    then open.
    """
    p, q = np.asarray(p_object, np.float64), np.asarray(object_wxyz, np.float64)
    moved = np.zeros_like(p) if p_pivot is None else np.asarray(p_pivot, np.float64)
    if p.ndim != 2 or p.shape[1] != 3 or q.shape != (len(p), 4) or moved.shape != p.shape:
        raise AlignmentError(
            f"positions {p.shape}, {moved.shape} and orientations {q.shape} do not fit", hint="(T, 3) and (T, 4)"
        )
    good = np.asarray(np.isfinite(np.concatenate((p, q, moved), axis=1)).all(axis=1))
    pieces = [np.arange(a, b)[good[a:b]] for a, b in _spans(spans, len(p))]
    pieces = [piece for piece in pieces if len(piece) >= 3]
    if not pieces:
        raise AlignmentError(
            "no span has three moments of the head object", hint="the head object has to be seen while the head turns"
        )
    turn = np.full((len(p), 3, 3), np.nan)
    turn[good] = Rotation.from_quat(q[good], scalar_first=True).as_matrix()
    a = np.concatenate([turn[piece] - turn[piece].mean(axis=0) for piece in pieces])
    b = np.concatenate([(moved - p)[piece] - (moved - p)[piece].mean(axis=0) for piece in pieces])
    group = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    # |(R - mean R) n| of a unit n is the sine of the angle by which it turned: 0 along a single axis.
    least = float(np.sqrt(max(np.linalg.eigvalsh(np.einsum("tij,tik->jk", a, a))[0], 0.0) / len(a)))
    if least < np.sin(np.deg2rad(min_turn_deg)) / np.sqrt(2):
        raise AlignmentError(
            f"the head turned about one axis only: {np.rad2deg(np.arcsin(min(least, 1.0))):.1f} deg about others",
            hint="nod, tilt and turn the head, with a still trunk",
        )
    weight = np.ones(len(a))
    c, left = np.zeros(3), b
    for _ in range(30):
        normal = np.einsum("tij,t,tik->jk", a, weight, a)
        before, c = c, np.linalg.solve(normal, np.einsum("tij,t,ti->j", a, weight, b))
        left = b - a @ c
        weight = _huber(np.linalg.norm(left, axis=1))
        if np.abs(c - before).max() < 1e-12:
            break
    inverse = np.linalg.inv(np.einsum("tij,t,tik->jk", a, weight, a))
    pull = np.einsum("tij,t,ti->tj", a, weight, left)
    if len(pieces) >= 8:
        meat = np.stack([pull[group == k].sum(axis=0) for k in range(len(pieces))])
        covariance = inverse @ (meat.T @ meat * len(pieces) / (len(pieces) - 1)) @ inverse
    else:
        free = max(3 * len(a) - 3 - 3 * len(pieces), 1)
        covariance = inverse * float(np.sum(weight[:, None] * left**2)) / free
    rms = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    return HeadOffset(c, covariance, rms, "pivot" if p_pivot is None else "pivot with the suit's neck")


def measured_offset(offset_m: ArrayLike, *, sigma_m: float = 0.005) -> HeadOffset:
    """A measured offset (3,), m, from the object's origin to C1 in the object frame (the thesis' way), with its stated
    uncertainty.
    """
    offset = np.asarray(offset_m, np.float64)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise AlignmentError(
            f"an offset has three finite numbers, not {offset_m!r}", hint="metres, in the axes of the optical object"
        )
    return HeadOffset(offset, np.eye(3) * sigma_m**2, float("nan"), "measured")


def _rotations(suit_wxyz: ArrayLike, optical_wxyz: ArrayLike) -> tuple[Rotation, Rotation, NDArray[np.bool_]]:
    suit, optical = np.asarray(suit_wxyz, np.float64), np.asarray(optical_wxyz, np.float64)
    if suit.shape != optical.shape or suit.ndim != 2 or suit.shape[1] != 4:
        raise AlignmentError(
            f"orientations (T, 4) of both systems are needed, not {suit.shape} and {optical.shape}", hint="pair them"
        )
    both: Mask = np.asarray(np.linalg.norm(suit, axis=1) > 0.5) & np.asarray(
        np.linalg.norm(optical, axis=1) > 0.5
    )  # False for NaN
    if both.sum() < 10:
        raise AlignmentError(
            f"{both.sum()} moments with the head in both systems, 10 needed", hint="record the head motions longer"
        )
    return (Rotation.from_quat(suit[both], scalar_first=True), Rotation.from_quat(optical[both], scalar_first=True), both)


def _turned(suit: Rotation) -> tuple[tuple[float, float, float], float]:
    """Turn about x, y, z from the mean pose (98th less 2nd percentile), and the rms about the second axis of their scatter,
    rad.
    """
    vectors = (suit.mean().inv() * suit).as_rotvec()
    low, high = np.percentile(vectors, (2, 98), axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(vectors.T)), 0.0))
    x, y, z = (float(t) for t in high - low)
    return (x, y, z), float(spread[1])


def _by_pairs(suit: Rotation, optical: Rotation, span: int | None) -> Rotation:
    """Y from turns between moments: Kabsch on their rotation vectors, with Huber's weights."""
    count = len(suit)
    lags = {max(span // k, 1) for k in (1, 2)} if span else {max(count // k, 1) for k in (2, 3, 5, 8, 13)}
    first = np.concatenate([np.arange(count - lag) for lag in sorted(lags) if lag < count])
    second = np.concatenate([np.arange(lag, count) for lag in sorted(lags) if lag < count])
    keep = np.unique(np.linspace(0, len(first) - 1, min(len(first), _MOST_PAIRS)).astype(int))
    first, second = first[keep], second[keep]
    s = (suit[first].inv() * suit[second]).as_rotvec()
    a = (optical[first].inv() * optical[second]).as_rotvec()
    sizes = np.linalg.norm(s, axis=1), np.linalg.norm(a, axis=1)
    fit = (np.minimum(*sizes) > _SMALL) & (np.maximum(*sizes) < _LARGE)
    if fit.sum() < 10:
        raise AlignmentError(
            "the head hardly turned between the paired moments",
            hint="turn the head further, or pair moments further apart (span)",
        )
    s, a = s[fit], a[fit]
    weight = np.ones(len(s))
    y = np.eye(3)
    for _ in range(20):
        before, y = y, kabsch(a, s, weight, rotation_only=True)[:3, :3]
        if np.abs(y - before).max() < _SETTLED:
            break
        weight = _huber(np.linalg.norm(a - s @ y.T, axis=1))
    return Rotation.from_matrix(y)


def _error(suit: Rotation, optical: Rotation, x: Rotation, y: Rotation) -> F64:
    """(T, 3) rotation vectors of X' R_o Y R_s', in the suit's world: where X and Y leave the systems apart."""
    return np.asarray((x.inv() * optical * y * suit.inv()).as_rotvec())


def _jacobian(suit: Rotation, free_heading: bool) -> F64:
    """(T, 3, 6) of `_error` by small rotations on the right of X and on the right of Y; the vertical's row is 0 where it is
    free.
    """
    result = np.zeros((len(suit), 3, 6))
    result[:, :, :3] = -np.eye(3)
    result[:, :, 3:] = suit.as_matrix()
    if free_heading:
        result[:, 2] = 0.0
    return result


def _refined(
    suit: Rotation, optical: Rotation, x: Rotation, y: Rotation, *, free_heading: bool
) -> tuple[Rotation, Rotation, F64]:
    """Gauss-Newton on both rotations, with Huber's weights. With a free heading only the tilts count."""
    weight = np.ones(len(suit))
    jacobian = _jacobian(suit, free_heading)
    for _ in range(30):
        error = _error(suit, optical, x, y)
        error[:, 2] = 0.0 if free_heading else error[:, 2]
        weight = _huber(np.linalg.norm(error, axis=1))
        normal = np.einsum("tia,t,tib->ab", jacobian, weight, jacobian)
        # A free heading of X is not seen at all: the least step leaves it as it is.
        step = -np.linalg.lstsq(normal, np.einsum("tia,t,ti->a", jacobian, weight, error), rcond=1e-9)[0]
        x, y = x * Rotation.from_rotvec(step[:3]), y * Rotation.from_rotvec(step[3:])
        if np.abs(step).max() < _SETTLED:
            break
    if free_heading:
        heading = _error(suit, optical, x, y)[:, 2].mean()
        x = x * Rotation.from_rotvec((0.0, 0.0, heading))
    return x, y, weight


def _covariance(suit: Rotation, x: Rotation, y: Rotation, left: F64, weight: F64, *, free_heading: bool) -> F64:
    """(3, 3) of Y's rotation vector in the object frame, on the left. Moments near each other err alike: see `_independent`."""
    del x
    jacobian = _jacobian(suit, free_heading)
    inverse = np.linalg.pinv(np.einsum("tia,t,tib->ab", jacobian, weight, jacobian), rcond=1e-9)[3:, 3:]
    numbers = 2 if free_heading else 3
    sigma2 = float(np.sum(weight[:, None] * left**2)) / max(numbers * len(left) - 6, 1)
    return np.asarray(y.as_matrix() @ inverse @ y.as_matrix().T) * sigma2 * len(left) / _independent(left)


def _independent(series: F64) -> float:
    """How many independent moments a residual (T, 3) is worth, by the sum of its autocorrelation up to the first zero."""
    centred = series - series.mean(axis=0)
    power = float(np.sum(centred**2))
    if power < 1e-20:
        return float(len(series))
    spectrum = np.fft.rfft(centred, 2 * len(centred), axis=0)
    together = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[: len(centred)].sum(axis=1) / power
    zero = int(np.argmax(together <= 0)) or len(together)
    return float(max(len(series) / max(1 + 2 * float(together[1:zero].sum()), 1.0), 3.0))


def _by_clouds(suit: Rotation, optical: Rotation) -> Rotation:
    """Y by ICP between the clouds that P = (0, 0, 1) leaves in both systems."""
    p = np.array((0.0, 0.0, 1.0))
    b, a = (suit[0].inv() * suit).apply(p), (optical[0].inv() * optical).apply(p)
    some = np.unique(np.linspace(0, len(b) - 1, min(len(b), _SOME)).astype(int))
    fits = []
    for k in range(_STARTS):
        start = transform(Rotation.from_rotvec((0.0, 0.0, 2 * np.pi * k / _STARTS)))
        fits.append(icp(a, b[some], start=start, rotation_only=True, tolerance=1e-4))
    best = min(fits, key=lambda fit: float(np.mean(fit.distance**2)))
    best = icp(a, b, start=best.a_from_b, rotation_only=True)
    return Rotation.from_matrix(best.a_from_b[:3, :3])


def _huber(length: F64) -> F64:
    """Weights that fall as 1 / length beyond twice the median."""
    limit = max(_HUBER * float(np.median(length)), 1e-12)
    return np.where(length <= limit, 1.0, limit / np.maximum(length, limit))


def _spans(spans: Sequence[tuple[int, int]] | int | None, count: int) -> list[tuple[int, int]]:
    if spans is None:
        return [(0, count)]
    if isinstance(spans, int):
        if spans < 3:
            raise AlignmentError(f"a span of {spans} frames says nothing", hint="three frames at least, better a second of them")
        return [(a, min(a + spans, count)) for a in range(0, count, spans)]
    return [(max(a, 0), min(b, count)) for a, b in spans]
