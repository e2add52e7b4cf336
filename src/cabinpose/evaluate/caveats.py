"""What is to be known before the numbers of a model: how much it answered, whether of this dataset, and what stands out in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from cabinpose.core import PoseBatch, unseen_words
from cabinpose.evaluate.errors import finite
from cabinpose.evaluate.mistakes import Explanation

Identity = Literal["id", "name", "unchecked", "run"]

MOST_OUTSIDE: Final = 0.5  # of positions beyond the image's border or behind the camera; weak detectors had up to 0.1
MOST_EXPECTED_M: Final = 1.0  # median expected error: farther off than an arm is long, nobody would write a joint down
_SAME_FRAMES: Final = 3

_IDENTITY: Final = MappingProxyType({
    "id": "",
    "run": "",
    "name": "the predictions name the dataset's folder, not its id: that they are of these frames is not checked",
    "unchecked": "the predictions name no dataset: that they are of this one is not checked",
})  # fmt: skip


@dataclass(frozen=True)
class Caveats:
    """What is to be known before the numbers of one model.

    frames, answered, trained_on: how many frames there are, for how many there is an answer, and how many the model is known to
    have been trained on · identity: how it is known that the answers
    are of this dataset: they name its id, they name a folder, they name nothing, or the detector ran on these frames now ·
    explanations: mistakes that would explain the errors · notes: what else stands out · unseen: in how many frames nobody can be
    seen, by the reason that the detector gives.
    """

    frames: int = 0
    answered: int = 0
    identity: Identity = "run"
    explanations: tuple[Explanation, ...] = ()
    notes: tuple[str, ...] = ()
    unseen: Mapping[str, int] = field(default_factory=dict)
    trained_on: int = 0

    @property
    def coverage(self) -> str:
        """In words, beside every figure: for how many frames there are answers, on how many the model was trained, in how many
        nobody can be seen, and whether the answers are known to be of these.
        """
        missing = f"answers for {self.answered} of {self.frames} frames" if self.answered < self.frames else ""
        trained = trained_words(self.trained_on, self.frames)
        return "; ".join(filter(None, (missing, trained, *unseen_words(self.unseen, self.frames), _IDENTITY[self.identity])))


def trained_words(trained_on: int, frames: int) -> str:
    """What is to be known of a model that was trained on so many of the frames; "" where there are none."""
    return f"the model was trained on {trained_on} of these {frames} frames: it errs more on new ones" if trained_on else ""


def remarks(batch: PoseBatch, size: tuple[int, int], presence: float) -> Iterator[str]:
    """What stands out in answers whatever the truth is.

    Parameters
    ----------
    batch
        Answers of F frames.
    size
        Width and height of the image, px.
    presence
        Least presence of a joint that counts as found.
    """
    two, three = (finite(each) for each in (batch.joints_2d, batch.joints_3d))
    either = two | three
    if not either.any():
        return
    if (most := float(batch.presence[either].max())) < presence:
        yield f"no joint has a presence of {presence:g} or more (the highest is {most:.3g}): nothing counts as found"
    uv, xyz = batch.joints_2d[two], batch.joints_3d[three]
    inside = ((uv >= -0.5) & (uv < np.array(size) - 0.5)).all(axis=-1)
    if two.any() and (share := 1 - inside.mean()) > MOST_OUTSIDE:
        yield f"{100 * share:.0f} % of the positions u, v lie outside of the image ({size[0]} × {size[1]} px)"
    if three.any() and (share := (xyz[:, 2] <= 0).mean()) > MOST_OUTSIDE:
        yield f"{100 * share:.0f} % of the positions x, y, z lie behind the camera (z up to 0 m)"
    filled = np.nan_to_num(np.concatenate((batch.joints_2d, batch.joints_3d), axis=-1))[either.any(axis=(1, 2))]
    if len(filled) >= _SAME_FRAMES and (filled == filled[0]).all():
        yield f"the answers are the same in all {len(filled)} frames that were looked at"
    expected = batch.expected_error_m[np.isfinite(batch.expected_error_m)]
    if expected.size and (median := float(np.median(expected))) > MOST_EXPECTED_M:
        yield f"the median of expected_error_m is {median:.3g} m, farther than an arm is long: is it in metres?"
