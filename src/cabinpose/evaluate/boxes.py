"""Boxes of errors as box plots draw them: quartiles, whiskers and outliers, by joint and by range of the error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_WHISKER = 1.5  # interquartile ranges beyond the box that a whisker reaches at most (Tukey 1977)
_DRAWN = 100  # outliers that are kept; more would be a bar of ink
FOUND = "all found"


@dataclass(frozen=True)
class Box:
    """What a box plot draws of `samples` numbers.

    low, high: ends of the whiskers · lower, median, upper: the quartiles · beyond: how many numbers lie beyond the whiskers ·
    outliers: these numbers, rising; of more than a hundred every so many, the greatest among them.
    """

    samples: int
    low: float
    lower: float
    median: float
    upper: float
    high: float
    outliers: tuple[float, ...] = ()
    beyond: int = 0


Boxes = Mapping[str, Mapping[str, Box]]  # by range of the error, then by joint


def box_of(values: NDArray[np.floating]) -> Box | None:
    """The box of finite numbers (n,), its whiskers at the farthest numbers within 1.5 interquartile ranges; None of no number."""
    if not values.size:
        return None
    known = np.sort(values.astype(np.float64)).round(4)
    lower, median, upper = np.quantile(known, (0.25, 0.5, 0.75)).round(4).tolist()
    reach = _WHISKER * (upper - lower)
    within = (known >= lower - reach) & (known <= upper + reach)
    far = known[~within]
    drawn = far if len(far) <= _DRAWN else far[np.linspace(len(far) - 1, 0, _DRAWN).round().astype(int)[::-1]]
    low, high = known[within][[0, -1]].tolist()
    return Box(len(known), low, lower, median, upper, high, tuple(drawn.tolist()), len(far))


def boxes_by_range(errors: NDArray[np.floating], joints: Sequence[str], limit: float, unit: str) -> Boxes:
    """The boxes of errors (S, J), NaN = not found: of all, of those below half of a limit, and of those below it."""
    ranges = {FOUND: np.inf, f"< {limit / 2:g} {unit}": limit / 2, f"< {limit:g} {unit}": limit}
    with np.errstate(invalid="ignore"):
        made = {
            name: {joint: box_of(e[e < most]) for joint, e in zip(joints, errors.T, strict=True)} for name, most in ranges.items()
        }
    return {name: {joint: box for joint, box in by_joint.items() if box is not None} for name, by_joint in made.items()}
