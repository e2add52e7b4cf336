"""DFE, the dynamic evaluation of the full body: joints' positions, suit against optical system (thesis, 3.1.2.2).

Each body is in its system's world. They are aligned in stages, and the errors of every stage are reported: `raw`, unaligned;
`pelvis`, both relative to their pelvis (eq. 3.3); `pelvis + ICP`, the optical body fitted to the suit's, frame by frame, by
iterative closest points (algorithm 3.1.7), which spreads the pelvis' error over the body; `pelvis + Kabsch`, the same fit with
the known pairs, in closed form, which no rigid motion betters in the sum of squares. ICP pairs nearest points, which need not
be the same joint: the share of wrong pairs is reported.

Errors are Euclidean (eq. 3.2). The thesis' eq. 3.8 compares displacements since the first frame, κ_t − κ_0, in which every
constant difference between the two models drops out; it is reported beside the error of position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError, apply
from cabinpose.evaluate.mocap.pairs import PELVIS
from cabinpose.evaluate.mocap.result import Errors, Judgement, judgement
from cabinpose.signals import icp, kabsch

F64 = NDArray[np.float64]
RAW, PELVIS_STAGE, ICP, KABSCH = "raw", "pelvis", "pelvis + ICP", "pelvis + Kabsch"
STAGES = (RAW, PELVIS_STAGE, ICP, KABSCH)
POSITION, DISPLACEMENT = "position", "displacement"
_SWAPPED_M = 0.03  # median distance; below it a body is too symmetrical (an N-pose) to tell its sides apart


@dataclass(frozen=True)
class DfeRun:
    """One run of T frames and N joints.

    suit_m, optical_m (T, N, 3) by stage: both bodies as that stage aligns them · wrong (T,): share of the joints that ICP paired
    with another one, NaN where a frame had too few joints.
    """

    condition: str
    names: tuple[str, ...]
    time_s: F64
    suit_m: MappingProxyType[str, F64]
    optical_m: MappingProxyType[str, F64]
    wrong: F64

    def position_error_m(self, stage: str) -> F64:
        """(T, N), eq. 3.2."""
        return np.linalg.norm(self.suit_m[stage] - self.optical_m[stage], axis=-1)

    def displacement_error_m(self, stage: str) -> F64:
        """(T, N), eq. 3.8: of what has moved since the first frame in which both systems know a joint."""
        difference = self.suit_m[stage] - self.optical_m[stage]
        first = np.isfinite(difference).all(axis=-1).argmax(axis=0)
        return np.linalg.norm(difference - np.take_along_axis(difference, first[None, :, None], axis=0), axis=-1)

    def errors(self) -> tuple[Errors, ...]:
        """Errors of position at every stage, then errors of displacement at every stage."""
        found = []
        for what, error in ((POSITION, self.position_error_m), (DISPLACEMENT, self.displacement_error_m)):
            found += [Errors(f"{what}, {s}", "m", self.condition, self.names, self.time_s, error(s)) for s in STAGES]
        return tuple(found)


def pelvis_frames(left_m: F64, right_m: F64, hip_m: F64) -> F64:
    """(T, 4, 4) world_from_pelvis from both femur heads and L5, each (T, 3).

    Origin between the femur heads, y to the left, z towards L5 and square to y, x forward. By joints, since two systems' pelvis
    segments need not have the same axes.
    """
    origin = (left_m + right_m) / 2
    y = left_m - right_m
    with np.errstate(invalid="ignore", divide="ignore"):
        y = y / np.linalg.norm(y, axis=-1, keepdims=True)
        z = hip_m - origin
        z = z - (z * y).sum(axis=-1, keepdims=True) * y
        z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    frames = np.zeros((len(origin), 4, 4))
    frames[:, :3, 0], frames[:, :3, 1], frames[:, :3, 2], frames[:, :3, 3] = np.cross(y, z), y, z, origin
    frames[:, 3, 3] = 1.0
    return frames


def dfe_run(
    time_s: ArrayLike, suit_m: ArrayLike, optical_m: ArrayLike, names: Sequence[str], *, condition: str = "all",
    suit_pelvis: ArrayLike | None = None, optical_pelvis: ArrayLike | None = None,
) -> DfeRun:  # fmt: skip
    """One run: positions (T, N, 3) of the same joints at the same times in worlds with z up, NaN where one is not known.

    suit_pelvis, optical_pelvis (T, 4, 4): world_from_pelvis, whose axes must mean the same in both; None: from the joints
    lpelvis, rpelvis and hip, see `pelvis_frames`. Frames in which the pelvis is unknown, or all but two joints, count in `raw`
    alone. Raises AlignmentError where a joint of the pelvis is missing, where left and right are swapped, where no frame is left.
    """
    time = np.asarray(time_s, np.float64)
    suit, optical = np.array(suit_m, np.float64), np.array(optical_m, np.float64)
    shape = (len(time), len(names), 3)
    if suit.shape != shape or optical.shape != shape:
        raise AlignmentError(
            f"positions {shape} are needed, not {suit.shape} and {optical.shape}", hint="resample both to one clock"
        )
    both = np.isfinite(suit).all(axis=-1) & np.isfinite(optical).all(axis=-1)
    suit[~both], optical[~both] = np.nan, np.nan
    laid_suit = _in_pelvis(suit, _pelvis(suit, names, suit_pelvis))
    laid_optical = _in_pelvis(optical, _pelvis(optical, names, optical_pelvis))
    known = np.asarray(np.isfinite(laid_suit - laid_optical).all(axis=-1))
    count = np.sum(known, axis=1)
    if not (count >= 3).any():
        raise AlignmentError(
            "in no frame do both systems know the pelvis and three joints",
            hint="check the delay, and that the recordings overlap",
        )
    _refuse_swapped(suit, names, suit_pelvis, laid_optical)
    by_icp, by_pairs = np.full(shape, np.nan), np.full(shape, np.nan)
    wrong = np.full(len(time), np.nan)
    for t in np.flatnonzero(count >= 3).tolist():
        seen = np.flatnonzero(known[t])
        a, b = laid_suit[t, seen], laid_optical[t, seen]
        try:
            paired = kabsch(a, b)
            fit = icp(a, b)
        except AlignmentError:  # on a line, which leaves a turn open
            continue
        by_icp[t, seen], by_pairs[t, seen] = apply(fit.a_from_b, b), apply(paired, b)
        wrong[t] = np.mean(fit.partner != np.arange(len(b)))
    suits = {RAW: suit, PELVIS_STAGE: laid_suit, ICP: laid_suit, KABSCH: laid_suit}
    opticals = {RAW: optical, PELVIS_STAGE: laid_optical, ICP: by_icp, KABSCH: by_pairs}
    return DfeRun(condition, tuple(names), time, MappingProxyType(suits), MappingProxyType(opticals), wrong)


def dfe(runs: Sequence[DfeRun], *, rng: np.random.Generator, resamples: int = 1000, block_s: float | None = None) -> Judgement:
    """The joints' errors by stage, by condition and over all conditions."""
    notes = []
    for run in runs:
        fitted = np.isfinite(run.wrong)
        share = f"ICP pairs {100 * run.wrong[fitted].mean():.1f} % of the joints with another one" if fitted.any() else "no fit"
        notes.append(f"{run.condition}: {fitted.sum()} of {len(fitted)} frames laid on each other; {share}")
    return judgement("dfe", runs, notes, rng=rng, resamples=resamples, block_s=block_s)


def _pelvis(position: F64, names: Sequence[str], given: ArrayLike | None) -> F64:
    if given is not None:
        return np.asarray(given, np.float64)
    if absent := [joint for joint in PELVIS.values() if joint not in names]:
        raise AlignmentError(
            f"the pelvis' frame needs {', '.join(absent)}", hint="give those joints, or the poses of both pelvis segments"
        )
    left, right, hip = (position[:, names.index(PELVIS[key])] for key in ("left", "right", "hip"))
    return pelvis_frames(left, right, hip)


def _in_pelvis(position: F64, world_from_pelvis: F64) -> F64:
    """(T, N, 3) relative to the pelvis, eq. 3.3."""
    return np.einsum("tji,tnj->tni", world_from_pelvis[:, :3, :3], position - world_from_pelvis[:, None, :3, 3])


def _refuse_swapped(suit: F64, names: Sequence[str], given: ArrayLike | None, laid_optical: F64) -> None:
    """Raise AlignmentError where left and right are swapped in one system, of a limb or of the whole body.

    A swapped limb lies where the other side's does. A body swapped as a whole has its pelvis backwards: exchanging its sides, the
    pelvis' too, brings it far nearer to the other.
    """
    hint = "left and right are swapped: check the pairs and the names in both systems"
    other = {name: {"l": "r", "r": "l"}.get(name[0], "") + name[1:] for name in names}
    order = [names.index(other[name]) if other[name] in names else i for i, name in enumerate(names)]
    laid = _in_pelvis(suit, _pelvis(suit, names, given))
    for i, j in enumerate(order):
        if i < j and names[i] not in PELVIS.values():
            straight, crossed = _apart(laid[:, [i, j]], laid_optical[:, [i, j]]), _apart(laid[:, [i, j]], laid_optical[:, [j, i]])
            if straight > 2 * crossed:
                raise AlignmentError(f"'{names[i]}' of one system lies where '{names[j]}' of the other is", hint=hint)
    exchanged = suit[:, order]
    swapped = _apart(_in_pelvis(exchanged, _pelvis(exchanged, names, given)), laid_optical)
    if _apart(laid, laid_optical) > max(2 * swapped, _SWAPPED_M):
        raise AlignmentError("the sides of one body are those of the other exchanged", hint=hint)


def _apart(a: F64, b: F64) -> float:
    """Median distance, 0 where there is none."""
    distance = np.linalg.norm(a - b, axis=-1)
    distance = distance[np.isfinite(distance)]
    return float(np.median(distance)) if distance.size else 0.0
