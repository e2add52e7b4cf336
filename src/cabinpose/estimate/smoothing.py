"""Joints of frames in a row, smoothed over time: by the frames until then, or by some later ones too.

- `one-euro`: G. Casiez, N. Roussel and D. Vogel, "1 € filter: a simple speed-based low-pass filter for noisy input in interactive
  systems", CHI 2012: a low-pass filter of the first order whose cut-off frequency rises with the speed.
- `fixed-lag`: a Kalman filter of points at a constant velocity but for white accelerations (Y. Bar-Shalom, X. R. Li and
  T. Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 6.2.2), for which an answer counts the
  less, the farther off it is expected to be, and which is asked for a frame once some later ones are there as well (H. E. Rauch,
  F. Tung and C. T. Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA Journal 1965).

Without later frames the second would leave joints that shake twice as much as those of the first, which lag as far behind.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from operator import itemgetter
from types import MappingProxyType
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ConfigError, PoseBatch, joined, unknown_name

LONGEST_GAP_S = 0.5
"""A joint that was not found for longer, and everybody after so long without a frame, starts anew."""
MOST_LAG = 30
"""Frames by which an answer may come later."""
# Chosen on eight sequences of people and seeds that none of the documented figures is of.
_CUTOFF_HZ, _CUTOFF_PER_SPEED, _SPEED_CUTOFF_HZ = 0.5, 20.0, 1.0  # the 1 € filter's f_c,min, beta (1/m) and f_c of the speed
_ACCELERATION = 0.3  # power spectral density of the white accelerations, m²/s³
_START_SPEED = 0.5  # standard deviation of a joint's speed where it starts, m/s
_LEAST_ERROR_M = 1e-4  # that counts
_USUAL_ERROR_M = 0.04  # of a detector that does not say how far off its joints may be
_MEAN_NORM = 1.596  # of three normal deviates, 2 √(2 / π): an expected error is a mean distance
_ELSEWHERE_M, _ELSEWHERE_PER_S = 0.15, 1.5  # a person half of whose joints are farther from where they were is another one
_EXTENT_M = 0.35  # root mean square of a seated person's joints about their mean, by which px become m without depths
_UV, _XYZ = slice(0, 2), slice(2, 5)

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]
Poses = TypeVar("Poses", bound=PoseBatch)


class Smoother(ABC):
    """The joints of one detector in the frames of one camera, smoothed as they come.

    What was not found stays so; a joint that comes back within `LONGEST_GAP_S` goes on from where it was. Presence, scores and
    expected errors stay the detector's. Frames of another `sequence`, or not later than the one before, or later by more than
    `LONGEST_GAP_S`, have nothing to do with those before; nor has a person who is all at once elsewhere, as where two swap.

    Attributes
    ----------
    name
        What the smoothed joints are called by.
    lag
        Frames by which an answer comes later than its frame.
    followed
        Frames so far that followed another: the others were given back as they came.
    """

    def __init__(self, name: str, lag: int) -> None:
        self.name, self.lag, self.followed = name, lag, 0
        self._before: tuple[int, int] | None = None  # time and sequence of the last frame
        self._point = self._age_s = np.zeros(0)  # (P, J, 5) where joints were seen last, and (P, J) how long ago
        self._given: deque[PoseBatch] = deque()  # frames without an answer yet

    def __call__(self, found: Poses, at_ns: int, sequence: int = 0) -> Poses | None:
        """The smoothed joints of the frame `lag` frames before.

        Parameters
        ----------
        found
            What the detector says of a frame: arrays (P, J, ...), or (1, P, J, ...).
        at_ns
            When the frame was taken, on any clock that runs evenly.
        sequence
            A number that frames have in common which follow each other.

        Returns
        -------
        PoseBatch or None
            What was found in that frame, with other joints_2d (px) and joints_3d (m, camera frame); None in the first `lag`
            calls.

        Raises
        ------
        ConfigError
            For several frames at once, see `smoothed`, or for those of another detector.
        """
        if found.score.ndim > 2 and len(found.score) != 1:
            raise ConfigError(f"these are {len(found.score)} frames", hint="give them one by one, or all to `smoothed`")
        points = np.concatenate((found.joints_2d, found.joints_3d), axis=-1).astype(np.float64)  # (..., P, J, 5): u v x y z
        self._take(self._seen(points.reshape(-1, *points.shape[-2:]), found.expected_error_m, at_ns, sequence))
        self._given.append(found)
        return self._next(self.lag) if len(self._given) > self.lag else None  # type: ignore[return-value]

    def model_name(self, model: str) -> str:
        """What predictions call a model whose joints were smoothed."""
        return f"{model} + {self.name}"

    def rest(self) -> Iterator[PoseBatch]:
        """The frames that have no answer yet, at the end: the last of them rests on no later one."""
        while self._given:
            yield self._next(len(self._given) - 1)

    def _seen(self, points: Array, expected_m: NDArray[np.float32], at_ns: int, sequence: int) -> _Seen:
        """A frame as filters take it, by when and where joints (P, J, 5) were before; what is remembered is this frame then."""
        there = np.isfinite(points)
        found = np.asarray(there.any(axis=-1))
        if not self._point.size:
            self._point, self._age_s = np.full(points.shape, np.nan), np.full(found.shape, np.inf)
        elif self._point.shape != points.shape:
            raise ConfigError(
                "these people or joints are not those of the frames before", hint="make a smoother for each detector"
            )
        step_s = 1e-9 * (at_ns - self._before[0]) if self._before and self._before[1] == sequence else np.inf
        broken = not 0.0 < step_s <= LONGEST_GAP_S
        self.followed += not broken
        age_s = np.full(found.shape, np.inf) if broken else self._age_s + step_s
        scale = _metres_per_px(points)
        fresh = (age_s > LONGEST_GAP_S) | (there != np.isfinite(self._point)).any(axis=-1)
        moved = np.where(fresh, np.nan, _metres(points - self._point, scale)) / (_ELSEWHERE_M + _ELSEWHERE_PER_S * age_s)
        fresh = found & (fresh | (_median(moved) > 1.0)[:, None])
        before, self._point = self._point, np.where(found[..., None], points, self._point)
        self._before = at_ns, sequence
        self._age_s = np.where(found, 0.0, age_s)
        expected = expected_m.reshape(found.shape).astype(np.float64)
        error = np.where(np.isfinite(expected), np.maximum(expected, _LEAST_ERROR_M), _USUAL_ERROR_M) / _MEAN_NORM
        return _Seen(points, before, found, fresh, error, scale, 0.0 if broken else step_s, age_s)

    def _next(self, back: int) -> PoseBatch:
        """The oldest frame without an answer, which came `back` frames before the last one."""
        found, points = self._given.popleft(), self._smoothed(back).astype(np.float32)
        uv, xyz = (points[..., part].reshape(old.shape) for part, old in ((_UV, found.joints_2d), (_XYZ, found.joints_3d)))
        lacking = np.isnan(found.joints_2d), np.isnan(found.joints_3d)
        return replace(found, joints_2d=np.where(lacking[0], np.nan, uv), joints_3d=np.where(lacking[1], np.nan, xyz))

    @abstractmethod
    def _take(self, seen: _Seen) -> None:
        """Take the next frame in."""

    @abstractmethod
    def _smoothed(self, back: int) -> Array:
        """(P, J, 5) where joints were `back` frames ago, by all frames that were taken in."""


class _Seen(NamedTuple):
    """One frame. points, before: (P, J, 5) px and m, of it and of when each joint was found last · found, fresh: (P, J) whether
    a joint was found, and starts anew · error: (P, J) m, expected along an axis · scale: (P,) m for a px · step_s: since the
    frame before · age_s: (P, J) since `before`.
    """

    points: Array
    before: Array
    found: Bool
    fresh: Bool
    error: Array
    scale: Array
    step_s: float
    age_s: Array


def _metres_per_px(points: Array) -> Array:
    """(P,) by how far apart a person's joints are in the image; 0 without any."""
    uv = points[..., _UV]
    known = np.asarray(np.isfinite(uv).all(axis=-1, keepdims=True))
    count = np.maximum(known.sum(axis=1), 1)
    mean = np.where(known, uv, 0.0).sum(axis=1) / count
    square = (np.where(known, uv - mean[:, None], 0.0) ** 2).sum(axis=(1, 2)) / count[:, 0]
    return np.where(square > 0, _EXTENT_M / np.sqrt(np.maximum(square, 1.0)), 0.0)


def _metres(difference: Array, scale: Array) -> Array:
    """(P, J) length in m of differences (P, J, 5): in space, or else in the image; NaN where there is neither."""
    space = np.sqrt((difference[..., _XYZ] ** 2).sum(axis=-1))
    return np.where(np.isfinite(space), space, scale[:, None] * np.sqrt((difference[..., _UV] ** 2).sum(axis=-1)))


def _median(values: Array) -> Array:
    """(P,) medians of those (P, J) that are there; 0 of none."""
    none = ~np.isfinite(values).any(axis=1, keepdims=True)
    return np.asarray(np.nanmedian(np.where(none, 0.0, values), axis=1))


class OneEuro(Smoother):
    """The 1 € filter of every joint, one cut-off frequency for all of its coordinates, by its speed in space."""

    def __init__(self, lag: int | None = None) -> None:
        """lag: none but 0; raises ConfigError."""
        if lag:
            raise ConfigError(f"one-euro answers at once, not {lag} frames later", hint="leave the lag out, or take fixed-lag")
        super().__init__("one-euro", 0)
        self._now = self._velocity = np.zeros(0)

    def _take(self, seen: _Seen) -> None:
        points, fresh = seen.points, seen.fresh[..., None]
        if not self._now.size:
            self._now, self._velocity = points, np.zeros_like(points)
        found, step = seen.found[..., None], np.where(seen.fresh | ~seen.found, 1.0, seen.age_s)[..., None]
        # Of successive answers, as in the authors' programs: against what the filter gave, it would depend on the rate.
        velocity = (points - seen.before) / step
        velocity = self._velocity + _share(_SPEED_CUTOFF_HZ, step) * (velocity - self._velocity)
        velocity = np.where(found, np.where(fresh, 0.0, velocity), self._velocity)
        cutoff = _CUTOFF_HZ + _CUTOFF_PER_SPEED * _metres(velocity, seen.scale)[..., None]
        now = self._now + _share(cutoff, step) * (points - self._now)
        self._now, self._velocity = np.where(found, np.where(fresh, points, now), self._now), velocity

    def _smoothed(self, back: int) -> Array:  # noqa: ARG002 - it answers at once
        return self._now


def _share(cutoff_hz: Array | float, step_s: Array) -> Array:
    """What a new value counts in a low-pass filter of the first order."""
    return np.asarray(1.0 / (1.0 + 1.0 / (2.0 * np.pi * cutoff_hz * step_s)))


class _Filtered(NamedTuple):
    """A frame's. state: (P, J, 2, 5) points and their velocities · covariance: (P, J, 2, 2), of each coordinate in m and m/s ·
    predicted, back: (P, J, 2, 5) and (P, J, 2, 2), what the frame before led to expect, and the gain by which that learns of it.
    """

    state: Array
    covariance: Array
    predicted: Array
    back: Array


class FixedLag(Smoother):
    """The Kalman smoother of every joint; its gains, by errors in m, are those of its coordinates in space and in the image."""

    def __init__(self, lag: int | None = None) -> None:
        """lag: from 1 to `MOST_LAG` frames, by default 3; raises ConfigError for another."""
        lag = 3 if lag is None else lag
        if not 1 <= lag <= MOST_LAG:
            raise ConfigError(
                f"fixed-lag cannot answer {lag} frames later", hint=f"give a lag from 1 to {MOST_LAG}; one-euro answers at once"
            )
        super().__init__(f"fixed-lag {lag}", lag)
        self._states: deque[_Filtered] = deque(maxlen=lag + 1)

    def _take(self, seen: _Seen) -> None:
        points, t = seen.points, seen.step_s
        variance = seen.error**2
        start = np.zeros((*points.shape[:2], 2, 2))
        start[..., 0, 0], start[..., 1, 1] = variance, _START_SPEED**2
        still = np.stack((points, np.zeros_like(points)), axis=2)
        if not self._states:
            self._states.append(_Filtered(still, start, still, np.zeros_like(start)))
            return
        before = self._states[-1]
        move = np.array([[1.0, t], [0.0, 1.0]])
        predicted = move @ before.state
        covariance = move @ before.covariance @ move.T + _ACCELERATION * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        back = before.covariance @ move.T @ np.linalg.inv(covariance)
        back[seen.fresh] = 0.0
        surprise = np.nan_to_num(points - predicted[:, :, 0])
        gain = covariance[..., 0] / (covariance[..., 0, 0] + variance)[..., None]  # (P, J, 2)
        gain[~seen.found] = 0.0
        state = predicted + gain[..., None] * surprise[..., None, :]
        covariance = covariance - gain[..., None] * covariance[..., None, 0, :]
        fresh = seen.fresh[..., None, None]
        self._states.append(_Filtered(np.where(fresh, still, state), np.where(fresh, start, covariance), predicted, back))

    def _smoothed(self, back: int) -> Array:
        state: Array = self._states[-1].state
        for k in range(1, back + 1):
            after, here = self._states[-k], self._states[-k - 1]
            state = here.state + after.back @ np.nan_to_num(state - after.predicted)
        return np.asarray(state[:, :, 0])


SMOOTHERS: Mapping[str, Callable[[int | None], Smoother]] = MappingProxyType({"one-euro": OneEuro, "fixed-lag": FixedLag})
"""Smoothers by name; each is made with the frames by which answers come later, None for its own."""


def make_smoother(name: str, lag: int | None = None) -> Smoother:
    """A new smoother of `SMOOTHERS`. Raises ConfigError for another name, or a lag that it cannot have."""
    if name not in SMOOTHERS:
        raise unknown_name("smoother", name, list(SMOOTHERS))
    return SMOOTHERS[name](lag)


def smoothed(poses: Poses, at_ns: NDArray[np.int64], sequence: NDArray[np.int64], smoother: Smoother) -> Poses:
    """All frames of a detector, smoothed in their order.

    Parameters
    ----------
    poses
        (F, P, J, ...).
    at_ns, sequence
        (F,) when each was taken, and to which sequence it belongs.
    smoother
        A new one.
    """
    answers: list[PoseBatch] = []
    for f, (at, of) in enumerate(zip(at_ns.tolist(), sequence.tolist(), strict=True)):
        if (answer := smoother(poses.map(itemgetter(slice(f, f + 1))), at, of)) is not None:
            answers.append(answer)
    answers += smoother.rest()
    if not answers:
        return poses
    result = joined(answers)
    return replace(poses, joints_2d=result.joints_2d, joints_3d=result.joints_3d)
