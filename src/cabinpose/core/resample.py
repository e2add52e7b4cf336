"""Series brought to other times: positions along straight lines, rotations by SLERP, nothing across gaps.

Times are float seconds from a common origin (an epoch in nanoseconds has more digits than a float holds: subtract it first).
The policy of a look-up between two samples is named: "linear" or "slerp" between them, "nearest" (of two equally near the
earlier), "previous". Missing stays missing: NaN outside the span of the samples, between two samples that are further apart than
`max_gap_s`, and where a sample that the policy needs is NaN. A time that is a sample's own gives that sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core.errors import AlignmentError, unknown_name

F64 = NDArray[np.float64]
PositionPolicy = Literal["linear", "nearest", "previous"]
RotationPolicy = Literal["slerp", "nearest", "previous"]


def resample_positions(
    time_s: ArrayLike, values: ArrayLike, at_s: ArrayLike, *, max_gap_s: float, policy: PositionPolicy = "linear"
) -> F64:
    """Values (T, ...) of the times (T,), at the times (A,): (A, ...), NaN where there is none.

    max_gap_s: the longest pause between two samples that a look-up crosses · policy: see the module. Raises AlignmentError for
    times that do not rise strictly, for shapes that do not fit, for no samples at all.
    """
    values = np.asarray(values, np.float64)
    place = _place(time_s, len(values), at_s, max_gap_s)
    if policy == "linear":
        w = _beside(place.weight, values)
        before, after = values[place.before], values[place.after]
        between = before + w * (after - before)
        # A sample's own time takes that sample alone, whatever its neighbour says.
        result = np.where(w == 0, before, np.where(w == 1, after, between))
    elif policy in ("nearest", "previous"):
        result = values[_chosen(place, policy)]
    else:
        raise unknown_name("policy of positions", policy, ("linear", "nearest", "previous"))
    result[~place.known] = np.nan
    return result


def resample_rotations(
    time_s: ArrayLike, quaternion_wxyz: ArrayLike, at_s: ArrayLike, *, max_gap_s: float, policy: RotationPolicy = "slerp"
) -> F64:
    """Unit quaternions (T, ..., 4) wxyz of the times (T,), at the times (A,): (A, ..., 4) wxyz, unit length or NaN.

    Spherical linear interpolation (Shoemake 1985) along the shorter arc: q and -q are one rotation, so that a change of sign
    between samples makes no turn; the result's sign is that of the sample before. Quaternions are normalised; one of length zero
    is missing. The rest as `resample_positions`.
    """
    q = np.asarray(quaternion_wxyz, np.float64)
    if q.shape[-1:] != (4,):
        raise AlignmentError(f"quaternions (T, ..., 4) are needed, not {q.shape}", hint="the last axis holds w, x, y, z")
    place = _place(time_s, len(q), at_s, max_gap_s)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    q = q / np.where(length > 0, length, np.nan)
    if policy == "slerp":
        w = _beside(place.weight, q)
        before, after = q[place.before], q[place.after]
        between = _slerp(before, after, w)
        result = np.where(w == 0, before, np.where(w == 1, after, between))
    elif policy in ("nearest", "previous"):
        result = q[_chosen(place, policy)]
    else:
        raise unknown_name("policy of rotations", policy, ("slerp", "nearest", "previous"))
    result[~place.known] = np.nan
    return result


def common_clock(spans: Iterable[Sequence[float] | F64], rate_hz: float) -> F64:
    """Times (A,) at `rate_hz` over what all series have in common: from the latest first time to the earliest last one.

    spans: a (first, last) of each series, or its rising times. Raises AlignmentError where they have no time in common.
    """
    ends = np.array([(span[0], span[-1]) for span in spans], np.float64).reshape(-1, 2)
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise AlignmentError(f"a clock cannot tick at {rate_hz} Hz", hint="give a rate above 0")
    if not len(ends) or not np.isfinite(ends).all():
        raise AlignmentError("a common clock needs the first and last time of each series", hint="leave out empty series")
    start, end = ends[:, 0].max(), ends[:, 1].min()
    if end < start:
        raise AlignmentError(
            f"the series have no time in common: one ends at {end:.3f} s, before another begins at {start:.3f} s",
            hint="bring their times to one clock first, or take series of the same take",
        )
    # The last tick may miss the end by rounding.
    return start + np.arange(int(np.floor((end - start) * rate_hz + 1e-6)) + 1) / rate_hz


def rising_times(time_s: ArrayLike, count: int, what: str = "the times") -> F64:
    """The times (count,) of a series as float64. Raises AlignmentError unless they are finite and rise strictly."""
    time = np.asarray(time_s, np.float64)
    if time.shape != (count,):
        raise AlignmentError(f"{what} are {time.shape}, for {count} samples", hint="give one time for each sample")
    if not np.isfinite(time).all():
        raise AlignmentError(f"{what} have {np.count_nonzero(~np.isfinite(time))} that are no numbers", hint="leave these out")
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        at = int(back[0])
        raise AlignmentError(
            f"{what} do not rise strictly: after {time[at]:.6f} s comes {time[at + 1]:.6f} s (sample {at + 1}; {back.size} such)",
            hint="the clock was set back, or samples are doubled: sort them, leave out doubles, cut the take where it jumps",
        )
    return time


class _Place(NamedTuple):
    """Where times (A,) lie among samples: the sample before and the one after, the way from one to the other (0 to 1)."""

    before: NDArray[np.intp]
    after: NDArray[np.intp]
    weight: F64
    known: NDArray[np.bool_]


def _place(time_s: ArrayLike, count: int, at_s: ArrayLike, max_gap_s: float) -> _Place:
    if not max_gap_s > 0:
        raise AlignmentError(f"a gap of {max_gap_s} s", hint="max_gap_s lies above 0; take a few periods of the series")
    if not count:
        raise AlignmentError("a series without samples", hint="check that the source was recorded")
    time, at = rising_times(time_s, count), np.asarray(at_s, np.float64)
    if at.ndim != 1:
        raise AlignmentError(f"times (A,) are needed, not {at.shape}", hint="give the times to look up as one row")
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, count - 1)
    after = np.minimum(before + 1, count - 1)
    pause = time[after] - time[before]
    weight = np.divide(at - time[before], pause, out=np.zeros(at.shape), where=pause > 0)
    inside = (at >= time[0]) & (at <= time[-1])
    return _Place(before, after, np.clip(weight, 0, 1), inside & ((pause <= max_gap_s) | (at == time[before])))


def _chosen(place: _Place, policy: str) -> NDArray[np.intp]:
    return np.where(place.weight > 0.5, place.after, place.before) if policy == "nearest" else place.before


def _beside(weight: F64, values: F64) -> F64:
    """Weights (A,) shaped so that they go with (A, ...)."""
    return weight.reshape(-1, *(1,) * (values.ndim - 1))


def _slerp(before: F64, after: F64, weight: F64) -> F64:
    """Between unit quaternions (..., 4), along the shorter arc; no division by a small sine, since sin x / x has none."""
    after = np.where(np.sum(before * after, axis=-1, keepdims=True) < 0, -after, after)
    # Half the chord and half its complement give the angle without the loss of digits of an arc cosine.
    chord, rest = (np.linalg.norm(before + sign * after, axis=-1, keepdims=True) for sign in (-1, 1))
    turns = 2 * np.arctan2(chord, rest) / np.pi  # at most half: np.sinc takes them times pi
    result = ((1 - weight) * np.sinc((1 - weight) * turns) * before + weight * np.sinc(weight * turns) * after) / np.sinc(turns)
    return result / np.linalg.norm(result, axis=-1, keepdims=True)
