"""How the calibration pendulum moves: swung about by hand, let go, then by itself until the air has stopped it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

F64 = NDArray[np.float64]

GRAVITY = 9.80665
_STEP_S = 0.7  # between the places to which the hand leads the marker
_HELD_S = 0.5  # it rests in the hand before it is let go


@dataclass(frozen=True)
class Swing:
    """A marker on a string. `hand` leads it to `release_s`; from there it swings.

    Both give the direction of the string: `hand` (t,) -> (2, T) its two angles (rad), `free` (t,) -> (6, T) place and speed.
    """

    length_m: float
    release_s: float
    end_s: float
    hand: CubicSpline
    free: object

    def __call__(self, time_s: ArrayLike) -> F64:
        """The marker (T, 3) below the pivot, m, z up, at times (T,) from 0 to `end_s`; before and after, it rests."""
        t = np.clip(np.atleast_1d(np.asarray(time_s, np.float64)), 0.0, self.end_s)
        led = self.length_m * _direction(self.hand(np.minimum(t, self.release_s)))
        swung = self.free(np.maximum(t, self.release_s))[:3].T  # type: ignore[operator]
        return np.where((t < self.release_s)[:, None], led, swung)


def _direction(angles: F64) -> F64:
    """Unit vectors (..., 3) of a string turned by (..., 2) rad from straight down, forwards (x) and aside (y)."""
    x, y = np.sin(angles[..., 0]) * np.cos(angles[..., 1]), np.sin(angles[..., 1])
    return np.stack((x, y, -np.sqrt(1 - x * x - y * y)), axis=-1)


def swing(
    duration_s: float,
    *,
    length_m: float = 0.65,
    amplitude_deg: float = 32.0,
    by_hand_s: float = 5.0,
    damping_per_s: float = 0.06,
    heading: float = 0.0,
    rng: Generator,
) -> Swing:
    """A spherical pendulum with damping proportional to speed, after some seconds in a hand that leads it to and fro.

    A pendulum alone looks like itself one period later, so that the peak of a correlation would be ambiguous. The hand's
    motion repeats nothing; the ellipse turns; the amplitude falls, and with it the period. Released `amplitude_deg` from
    straight down in the direction `heading` (rad about z from x), with a push aside.
    """
    release = min(by_hand_s, duration_s / 2)
    held = min(_HELD_S, release / 4)
    places = max(int((release - held) / _STEP_S), 2)
    led = np.radians(rng.uniform(-25.0, 25.0, (places, 2)))
    start = np.radians(amplitude_deg) * np.array((np.cos(heading), np.sin(heading)))
    times = np.concatenate((np.linspace(0.0, release - held, places + 1), (release,)))
    hand = CubicSpline(times, np.concatenate((led, (start, start))), bc_type="clamped")
    along = _direction(hand(release))
    aside = np.cross((0.0, 0.0, 1.0), along)
    push = rng.uniform(0.25, 0.4) * np.sqrt(GRAVITY * length_m) * np.sin(np.radians(amplitude_deg))
    state = np.concatenate((length_m * along, push * aside / np.linalg.norm(aside)))

    def motion(_: float, y: F64) -> F64:
        p, v = y[:3], y[3:]
        free = -damping_per_s * v - (0.0, 0.0, GRAVITY)
        return np.concatenate((v, free - p * (p @ free + v @ v) / length_m**2))  # the string takes what lies along it

    solution = solve_ivp(
        motion, (release, max(duration_s, release + 1e-3)), state, method="DOP853", rtol=1e-10, atol=1e-12, dense_output=True
    )
    return Swing(length_m, release, duration_s, hand, solution.sol)
