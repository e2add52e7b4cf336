"""Whether a model would know frames better turned, or with their depths scaled: an image the wrong way up, a wrong unit.

Tried on a few of the frames that it is doubtful of, by what it expects of its own errors. Nothing is changed, and it is told.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import FrameBatch

Array = NDArray[Any]
Counts = NDArray[np.int64]


class Alternative(NamedTuple):
    """What may have been done to frames, told in words; turns counter-clockwise by quarters, and a factor of depths, undo it."""

    quarters: int
    factor: float
    told: str

    def undone(self, frames: FrameBatch, index: int, images: Collection[str]) -> FrameBatch:
        """One frame's images of these names, changed back; without its camera."""
        every = cast(Mapping[str, Array], frames)
        taken = {name: image[index : index + 1] for name, image in every.items() if name in images}
        if self.factor != 1.0:
            taken["depth"] = taken["depth"] * np.float32(self.factor)
        return cast(FrameBatch, {name: np.rot90(image, self.quarters, axes=(1, 2)) for name, image in taken.items()})


def _scaled(factor: float) -> Alternative:
    times, size = (factor, "small") if factor > 1 else (1 / factor, "large")
    return Alternative(0, factor, f"depths seem to be about {times:.2g} times too {size}")


# The mirror image stands for those that are mirrored, which models know as well: packaged ones answer as much of either.
ALTERNATIVES: Final = (
    Alternative(1, 1.0, "images seem to be turned by 90° clockwise"),
    Alternative(2, 1.0, "images seem to be turned by 180°, or mirrored upside down"),
    Alternative(3, 1.0, "images seem to be turned by 90° counter-clockwise"),
    *map(_scaled, (0.2, 0.3, 0.5, 0.7, 1.4, 2.0, 3.3, 5.0)),
)

# Of 650 generated frames as they should be, of all sensors, two vote for an alternative; of turned ones 60 to 90 % for theirs.
SURE: Final = 1.5  # a joint is sure whose expected error is at most so many times the model's usual one for it
DOUBTFUL: Final = 0.5  # share of the joints found that are sure, up to which a frame is doubtful
ENOUGH: Final = 0.5  # of one person's joints are sure, or a frame says nothing of either
BETTER: Final = 2.0  # times as many sure joints are a vote
VOTES: Final = 4  # so many, and more than half of the frames that say anything, are told
_FAMILIAR, _MOST_TRIES = 16, 24  # frames that are not doubtful, and more than are, or tries, after which no more is tried


class Alternatives:
    """Frames of one camera as a model sees them, and would see them changed. told: what speaks for a change, "" = nothing."""

    def __init__(self, name: str, usual_m: NDArray[np.float64]) -> None:
        """name: of the model · usual_m: (J,) its usual expected errors, NaN = not known."""
        self.told = ""
        self._name, self._usual_m = name, usual_m
        known = int(np.isfinite(usual_m).sum())
        self._enough, self.open = ENOUGH * known, known > 0  # open: whether more is tried
        self._familiar = self._doubtful = self._tries = self._empty = self._next = 0
        self._votes = np.zeros(len(ALTERNATIVES), np.int64)
        self._sure = np.zeros(1 + len(ALTERNATIVES), np.int64)  # of the tries; first of the frames as they are

    def look(self, presence: Array, expected_m: Array, ask: Callable[[], tuple[Array, Array]]) -> None:
        """A frame in which a model found joints (1, P, J) so; ask: the same of all alternatives (A, P, J)."""
        (found,), (sure,) = self._counts(presence, expected_m)
        if sure > DOUBTFUL * found:
            self._familiar += 1
            self.open = self._familiar < _FAMILIAR or self._familiar <= self._doubtful
            return
        self._doubtful += 1
        if self._doubtful <= self._next:
            return
        founds, sures = self._counts(*ask())
        if max(sure, *sures) < self._enough:  # nobody, or an image of nothing that it knows
            self._empty += 1
            self._next = self._doubtful + 2**self._empty - 1
            return
        self._tries += 1
        self._next = self._doubtful + self._tries // 2
        self._votes += (sures >= max(self._enough, BETTER * sure)) & (sures > DOUBTFUL * founds)
        self._sure += (sure, *sures)
        self._judge()

    def _counts(self, presence: Array, expected_m: Array) -> tuple[Counts, Counts]:
        """(N,) joints that are found, and those of them that are sure, of those whose error is known."""
        found = (presence >= 0.5) & np.isfinite(expected_m)
        return found.sum(axis=(1, 2)), (found & (expected_m <= SURE * self._usual_m)).sum(axis=(1, 2))

    def _judge(self) -> None:
        """Tell the alternative with the most sure joints, of those with the votes."""
        enough = (self._votes >= VOTES) & (2 * self._votes > self._tries)
        if enough.any() and self._doubtful >= self._familiar:
            best = int(np.argmax(np.where(enough, self._sure[1:], -1)))
            before, after = (self._sure[i] / self._tries for i in (0, 1 + best))
            self.told = (
                f"{ALTERNATIVES[best].told}: in {self._votes[best]} of {self._tries} frames that were tried {self._name} would be"
                f" sure of far more: {after:.0f} joints a frame in place of {before:.0f}. Nothing was changed"
            )
        self.open = not self.told and self._tries < _MOST_TRIES
