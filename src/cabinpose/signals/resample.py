"""Series brought to other times: positions along straight lines, rotations by SLERP, nothing across gaps.

Times are float seconds from a common origin (an epoch in nanoseconds has more digits than a float holds: subtract it first).
Missing stays missing: NaN outside the span of the samples, between two samples that are further apart than `max_gap_s`, and
where a sample that is needed is NaN. A time that is a sample's own gives that sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import AlignmentError

F64 = NDArray[np.float64]
_MOST_HZ = 10_000.0  # of a common clock; suits and optical systems have 1 kHz at most


def resample_positions(
    time_s: ArrayLike, values: ArrayLike, at_s: ArrayLike, *, max_gap_s: float, policy: Literal["linear", "previous"] = "linear"
) -> F64:
    """Values of a series at other times.

    Parameters
    ----------
    time_s
        (T,) s, rising strictly.
    values
        (T, ...) of any unit, NaN = missing.
    at_s
        (A,) s.
    max_gap_s
        The longest pause between two samples that a look-up crosses.
    policy
        What stands between two samples: "linear", or the "previous" one.

    Returns
    -------
    NDArray
        (A, ...), NaN where there is none.

    Raises
    ------
    AlignmentError
        For times that do not rise strictly, for shapes that do not fit, for no samples at all.
    """
    values = np.asarray(values, np.float64)
    place = _place(time_s, len(values), at_s, max_gap_s)
    if policy == "linear":
        return _interpolated(place, values, lambda before, after, weight: before + weight * (after - before))
    result = values[place.before]
    result[~place.known] = np.nan
    return result


def resample_rotations(time_s: ArrayLike, quaternion_wxyz: ArrayLike, at_s: ArrayLike, *, max_gap_s: float) -> F64:
    """Rotations of a series at other times: spherical linear interpolation (Shoemake 1985) along the shorter arc.

    q and -q are one rotation, so that a change of sign between samples makes no turn; the result's sign is that of the sample
    before. The rest as `resample_positions`.

    Parameters
    ----------
    time_s
        (T,) s, rising strictly.
    quaternion_wxyz
        (T, ..., 4), normalised here; one of length zero is missing, like NaN.
    at_s
        (A,) s.
    max_gap_s
        The longest pause between two samples that a look-up crosses.

    Returns
    -------
    NDArray
        (A, ..., 4) wxyz of unit length, or NaN.

    Raises
    ------
    AlignmentError
        As `resample_positions`.
    """
    q = np.asarray(quaternion_wxyz, np.float64)
    if q.shape[-1:] != (4,):
        raise AlignmentError(f"quaternions (T, ..., 4) are needed, not {q.shape}", hint="the last axis holds w, x, y, z")
    place = _place(time_s, len(q), at_s, max_gap_s)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    return _interpolated(place, q / np.where(length > 0, length, np.nan), _slerp)


def common_clock(spans: Iterable[Sequence[float] | F64], rate_hz: float) -> F64:
    """Times (A,) at `rate_hz` over what all series have in common: from the latest first time to the earliest last one.

    spans: a (first, last) of each series, or its rising times. Raises AlignmentError where they have no time in common.
    """
    ends = np.array([(span[0], span[-1]) for span in spans], np.float64).reshape(-1, 2)
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise AlignmentError(f"a clock cannot tick at {rate_hz} Hz", hint="give a rate above 0")
    if rate_hz > _MOST_HZ:
        raise AlignmentError(f"no system gives {rate_hz:g} samples a second", hint=f"give a rate up to {_MOST_HZ:g} Hz")
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


def _interpolated(place: _Place, values: F64, between: Callable[[F64, F64, F64], F64]) -> F64:
    """Values (A, ...) by `between(before, after, weight)`, of values (T, ...)."""
    weight = place.weight.reshape(-1, *(1,) * (values.ndim - 1))
    before, after = values[place.before], values[place.after]
    # A sample's own time takes that sample alone, even where its neighbour is missing.
    result = np.where(weight == 0, before, np.where(weight == 1, after, between(before, after, weight)))
    result[~place.known] = np.nan
    return result


def _slerp(before: F64, after: F64, weight: F64) -> F64:
    """Between unit quaternions (..., 4), along the shorter arc; no division by a small sine, since sin x / x has none."""
    after = np.where(np.sum(before * after, axis=-1, keepdims=True) < 0, -after, after)
    # Half the chord and half its complement give the angle without the loss of digits of an arc cosine.
    chord, rest = (np.linalg.norm(before + sign * after, axis=-1, keepdims=True) for sign in (-1, 1))
    turns = 2 * np.arctan2(chord, rest) / np.pi  # at most half: np.sinc takes them times pi
    result = ((1 - weight) * np.sinc((1 - weight) * turns) * before + weight * np.sinc(weight * turns) * after) / np.sinc(turns)
    return result / np.linalg.norm(result, axis=-1, keepdims=True)
