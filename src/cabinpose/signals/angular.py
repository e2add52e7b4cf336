"""How fast and how far a body turns: scalars that two systems see alike, whatever their frames of world and body."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError
from cabinpose.signals.resample import resample_rotations, rising_times
from cabinpose.signals.rotations import angle, conjugate, product, rotation_vectors, since_first

F64 = NDArray[np.float64]


def rotation_angle(quaternion_wxyz: ArrayLike) -> F64:
    """(T,) rad in [0, π]: the angle of q·q0*, the turn of orientations (T, 4) since the first one that is known.

    The same in any frame of the world and of the body, so that a suit and an optical system agree; but both have to begin with
    the same orientation, as at rest. NaN where the orientation is. The thesis' eq. 3.4 with the least angle: q and -q are one.
    """
    q = _orientations(quaternion_wxyz)
    return angle(since_first(q)) if len(q) else np.zeros(0)


def angular_velocity(
    time_s: ArrayLike, quaternion_wxyz: ArrayLike, *, max_gap_s: float = np.inf, baseline_s: float | None = None
) -> F64:
    """The angular velocity of a body in its own frame, as a gyroscope on it measures it.

    Both ways to take the derivative are centred on the sample, whatever the pauses, so that nothing is delayed.

    Parameters
    ----------
    time_s
        (T,) s, rising strictly.
    quaternion_wxyz
        (T, 4) world_from_body.
    max_gap_s
        The longest pause between two samples that is crossed.
    baseline_s
        Length of the turn that is measured, half of it before the sample and half after, between samples by SLERP; long enough
        that noise of the orientations does not drown the turn. None: the turns to the neighbouring samples, each over its pause,
        interpolated linearly to the sample.

    Returns
    -------
    NDArray
        (T, 3) rad/s, NaN where a neighbour is missing, as at both ends.

    Raises
    ------
    AlignmentError
        For times that do not rise strictly, and for other shapes.
    """
    q = _orientations(quaternion_wxyz)
    time = rising_times(time_s, len(q))
    result = np.full((len(q), 3), np.nan)
    if len(q) < 3:
        return result
    if baseline_s is not None:
        early, late = (resample_rotations(time, q, time + s * 0.5 * baseline_s, max_gap_s=max_gap_s) for s in (-1, 1))
        return rotation_vectors(product(conjugate(early), late)) / baseline_s
    pause = np.diff(time)[:, None]
    velocity = rotation_vectors(product(conjugate(q[:-1]), q[1:])) / pause  # of the middle of each pause
    velocity[pause[:, 0] > max_gap_s] = np.nan
    result[1:-1] = (velocity[:-1] * pause[1:] + velocity[1:] * pause[:-1]) / (pause[:-1] + pause[1:])
    return result


def angular_speed(
    time_s: ArrayLike, quaternion_wxyz: ArrayLike, *, max_gap_s: float = np.inf, baseline_s: float | None = None
) -> F64:
    """(T,) rad/s: the length of `angular_velocity`, which needs neither a common start nor a common frame."""
    return np.linalg.norm(angular_velocity(time_s, quaternion_wxyz, max_gap_s=max_gap_s, baseline_s=baseline_s), axis=-1)


def _orientations(quaternion_wxyz: ArrayLike) -> F64:
    q = np.asarray(quaternion_wxyz, np.float64)
    if q.ndim != 2 or q.shape[1] != 4:
        raise AlignmentError(f"quaternions (T, 4) are needed, not {q.shape}", hint="give one segment's")
    return q
