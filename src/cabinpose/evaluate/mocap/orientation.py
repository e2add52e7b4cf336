"""An orientation filter against optical truth, as the BROAD benchmark scores it (Laidig et al., Data 2021, 6, 72, sec. 3.3).

The error quaternion in the world, e = q_filter · q_truth*, is taken apart into heading (about the vertical) and inclination
(about a horizontal axis); their turns, and the whole one, are averaged as root mean squares over the phases of movement in
which the truth is known. With a magnetometer the filter knows north, as the truth does, and nothing is removed. Without one
it starts at any heading: then `heading="removed"` takes out the constant one that fits best.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError
from cabinpose.signals import angle, conjugate, product

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class OrientationErrors:
    """Root mean squares (rad) of the whole error, its heading, its inclination; over how many frames; heading removed (rad)."""

    total_rad: float
    heading_rad: float
    inclination_rad: float
    frames: int
    removed_rad: float


def orientation_errors(
    estimate_wxyz: ArrayLike, truth_wxyz: ArrayLike, *, counts: ArrayLike | None = None,
    heading: Literal["kept", "removed"] = "kept",
) -> OrientationErrors:  # fmt: skip
    """Of orientations (T, 4) in worlds with z up, over the frames `counts` (T,) in which both are known.

    Raises AlignmentError where there are none, or the lengths differ.
    """
    estimate, truth = np.asarray(estimate_wxyz, np.float64), np.asarray(truth_wxyz, np.float64)
    if estimate.shape != truth.shape or estimate.ndim != 2 or estimate.shape[1] != 4:
        raise AlignmentError(
            f"orientations (T, 4) of the same frames are needed, not {estimate.shape} and {truth.shape}",
            hint="resample one to the other's times",
        )
    known = np.isfinite(estimate).all(axis=1) & np.isfinite(truth).all(axis=1)
    if counts is not None:
        known &= np.asarray(counts, bool)
    if not known.any():
        raise AlignmentError("no frame counts in which both orientations are known", hint="check the mask and the times")
    e = product(estimate[known], conjugate(truth[known]))
    removed = 0.0
    if heading == "removed":
        about = 2 * np.arctan2(e[:, 3], e[:, 0])
        removed = float(np.angle(np.exp(1j * about).mean()))
        e = product((np.cos(removed / 2), 0.0, 0.0, -np.sin(removed / 2)), e)
    turn = np.abs(2 * np.arctan2(e[:, 3], e[:, 0]))
    parts = (angle(e), np.minimum(turn, 2 * np.pi - turn), 2 * np.arctan2(np.hypot(e[:, 1], e[:, 2]), np.hypot(e[:, 0], e[:, 3])))
    total, around, tilt = (float(np.sqrt(np.mean(part**2))) for part in parts)
    return OrientationErrors(total, around, tilt, int(known.sum()), removed)
