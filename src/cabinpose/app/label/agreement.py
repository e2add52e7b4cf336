"""Who labelled what and when, and how far two who labelled the same frames agree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DatasetError, Visibility
from cabinpose.store import Change, JointLabel, Key, read_labels

WITHIN_PX = (2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Work:
    """What one role did. frames, joints: how many hold its word now · first, last: UTC · how: changes by their kind."""

    role: str
    frames: int
    joints: int
    first: str
    last: str
    how: dict[str, int]


@dataclass(frozen=True)
class Agreement:
    """Of two who labelled the same dataset.

    joints, frames: labelled by both · alone: joints by the first, and by the second alone · median_px, p90_px: distances of the
    joints that both have placed, None where there are none · within: share of those by `WITHIN_PX` · same_state: share of joints
    that both say are seen alike · kappa: the same beyond chance, of Cohen (1960, A coefficient of agreement for nominal scales):
    1 is all, 0 what chance gives; None where both use a single state.
    """

    joints: int
    frames: int
    alone: tuple[int, int]
    median_px: float | None
    p90_px: float | None
    within: dict[float, float]
    same_state: float
    kappa: float | None


def work_of(history: Sequence[Change]) -> list[Work]:
    """What each role did, by their names."""
    holds: dict[Key, Change] = {}
    for change in history:
        holds[change.key] = change
    works = []
    for role in sorted({change.role for change in history}):
        theirs = [change for change in history if change.role == role]
        keys = [key for key, change in holds.items() if change.role == role and change.label is not None]
        frames = {(frame, person) for frame, person, _ in keys}
        kinds = dict(Counter(change.how for change in theirs).most_common())
        works.append(Work(role, len(frames), len(keys), theirs[0].time, theirs[-1].time, kinds))
    return works


def agreement_of(first: Path, second: Path) -> Agreement:
    """How far two journals of labels agree. Raises DatasetError where they are of different datasets, or share no joint."""
    (head_a, a), (head_b, b) = read_labels(first), read_labels(second)
    if head_a["dataset"] != head_b["dataset"]:
        raise DatasetError(f"{first} and {second} are of different datasets", hint="give two journals of the same dataset")
    both = sorted(a.keys() & b.keys())
    if not both:
        raise DatasetError(f"{first} and {second} have no joint in common", hint="let both label some of the same frames")
    pairs = [(a[key], b[key]) for key in both]
    apart = np.array([_apart(*pair) for pair in pairs])
    placed = apart[np.isfinite(apart)]
    states = np.array([(one.visibility, other.visibility) for one, other in pairs])
    same = float((states[:, 0] == states[:, 1]).mean())
    return Agreement(
        joints=len(both),
        frames=len({(frame, person) for frame, person, _ in both}),
        alone=(len(a.keys() - b.keys()), len(b.keys() - a.keys())),
        median_px=float(np.median(placed)) if placed.size else None,
        p90_px=float(np.quantile(placed, 0.9)) if placed.size else None,
        within={limit: float((placed <= limit).mean()) if placed.size else 0.0 for limit in WITHIN_PX},
        same_state=same,
        kappa=_kappa(states, same),
    )


def _apart(a: JointLabel, b: JointLabel) -> float:
    """Their distance in px; NaN where one of them has no place."""
    placed = Visibility.ABSENT not in (a.visibility, b.visibility)
    return float(np.hypot(*np.subtract(a.uv, b.uv))) if placed else float("nan")


def _kappa(states: NDArray[np.int64], same: float) -> float | None:
    chance = sum(float((states == state).mean(axis=0).prod()) for state in Visibility)
    return None if chance >= 1 else (same - chance) / (1 - chance)
