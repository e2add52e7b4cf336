"""DSE, the dynamic evaluation of sensors: segments' turns since the first frame, suit against optical system (thesis, 3.1.2.1).

θ_t = 2 arccos(Re(q_t · q_0*)) of both systems (eq. 3.4), ξ_t = |θ_1,t − θ_2,t| (eq. 3.6). This needs neither a common world nor
the mounting of the sensors, but two turns by one angle about different axes count as equal. So the geodesic angle between the two
turns is reported as well, after the suit's world is turned about the vertical to fit the other's; it is never smaller (triangle
inequality of rotations).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError
from cabinpose.evaluate.mocap.result import Errors, Judgement, judgement
from cabinpose.signals import angle, angle_between, conjugate, product, rotation_vectors, since_first

F64 = NDArray[np.float64]
DIFFERENCE, GEODESIC = "difference of the angles", "angle between the turns"
_LEAST_TURN = np.radians(5.0)  # of some segment, needed to find the heading between the worlds


@dataclass(frozen=True)
class DseRun:
    """One run of T frames and N segments, all in rad.

    suit_rad, optical_rad (T, N): the angle since the first frame · difference_rad (T, N): eq. 3.6 · geodesic_rad (T, N): the
    angle between the turns · heading_rad: of optical_from_suit about the vertical; NaN, as geodesic_rad, where nobody turned.
    """

    condition: str
    names: tuple[str, ...]
    time_s: F64
    suit_rad: F64
    optical_rad: F64
    difference_rad: F64
    geodesic_rad: F64
    heading_rad: float

    def errors(self) -> tuple[Errors, Errors]:
        """Both errors."""
        return (
            Errors(DIFFERENCE, "rad", self.condition, self.names, self.time_s, self.difference_rad),
            Errors(GEODESIC, "rad", self.condition, self.names, self.time_s, self.geodesic_rad),
        )


def dse_run(
    time_s: ArrayLike, suit_wxyz: ArrayLike, optical_wxyz: ArrayLike, names: Sequence[str], *, condition: str = "all",
    heading_rad: float | None = None,
) -> DseRun:  # fmt: skip
    """One run: orientations (T, N, 4) of the same segments at the same times, NaN where one is not known.

    The first frame of a segment is the first in which both systems know it. heading_rad: of optical_from_suit about the vertical;
    None: the one that brings the turns of all segments closest. Raises AlignmentError where no segment is known by both in two
    frames or more; the errors of a segment that only one system knows are NaN.
    """
    time = np.asarray(time_s, np.float64)
    suit, optical = np.array(suit_wxyz, np.float64), np.array(optical_wxyz, np.float64)
    shape = (len(time), len(names), 4)
    if suit.shape != shape or optical.shape != shape:
        raise AlignmentError(
            f"orientations {shape} are needed, not {suit.shape} and {optical.shape}", hint="resample both to one clock"
        )
    both = np.isfinite(suit).all(axis=-1) & np.isfinite(optical).all(axis=-1)
    if both.sum(axis=0).max(initial=0) < 2:
        raise AlignmentError(
            "no segment is known by both systems at the same times", hint="check the delay, and that the recordings overlap"
        )
    suit[~both], optical[~both] = np.nan, np.nan
    turned, true = since_first(suit), since_first(optical)
    suit_rad, optical_rad = angle(turned), angle(true)
    heading = common_heading(turned, true) if heading_rad is None else heading_rad
    about = np.array([np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)])
    geodesic = angle_between(product(product(about, turned), conjugate(about)), true)
    return DseRun(condition, tuple(names), time, suit_rad, optical_rad, np.abs(suit_rad - optical_rad), geodesic, float(heading))


def common_heading(suit_turns_wxyz: F64, optical_turns_wxyz: F64) -> float:
    """rad, of optical_from_suit about the vertical: the turn that brings the rotation vectors of (..., 4) turns closest.

    The horizontal Procrustes problem, in closed form. NaN where no turn about a horizontal axis exceeds 5°: a turn about the
    vertical looks the same in every heading.
    """
    a, b = (rotation_vectors(q).reshape(-1, 3)[:, :2] for q in (suit_turns_wxyz, optical_turns_wxyz))
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    a, b = a[known], b[known]
    if not len(a) or max(np.hypot(*a.T).max(), np.hypot(*b.T).max()) < _LEAST_TURN:
        return float("nan")
    return float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))


def dse(runs: Sequence[DseRun], *, rng: np.random.Generator, resamples: int = 1000, block_s: float | None = None) -> Judgement:
    """The segments' errors by plane of motion (the runs' conditions) and over all of them."""
    notes = []
    for run in runs:
        unseen = [name for name, column in zip(run.names, run.difference_rad.T, strict=True) if not np.isfinite(column).any()]
        if unseen:
            notes.append(f"{run.condition}: never known by both systems: {', '.join(unseen)}")
        if not np.isfinite(run.heading_rad):
            notes.append(f"{run.condition}: nobody turned about a horizontal axis, so that the worlds' heading is not known")
    return judgement("dse", runs, notes, rng=rng, resamples=resamples, block_s=block_s)
