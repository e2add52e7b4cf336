"""What an evaluation can be told: which joints count, what a head is, which thresholds, how people are matched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cabinpose.core import ConfigError, Visibility

HeadSize = Literal["thesis", "true"]
Matching = Literal["slot", "oks", "distance"]


@dataclass(frozen=True)
class EvaluationOptions:
    """What counts, when it is right, and how people are matched."""

    min_visibility: Visibility = Visibility.OCCLUDED
    """Least visibility of the joints that count; the others are neither right nor wrong."""
    presence: float = 0.5
    """Least probability at which a joint counts as found."""
    head: HeadSize = "thesis"
    """Head size of PCKh: 26 px and 200 mm, or each person's own length from head to neck."""
    pck_px: tuple[float, ...] = (26.0,)
    """Thresholds of PCK in 2D, px."""
    pck_m: tuple[float, ...] = (0.05, 0.10, 0.15, 0.20)
    """Thresholds of PCK in 3D, m."""
    pckh: tuple[float, ...] = (0.5, 1.0)
    """Thresholds of PCKh, in head sizes."""
    hit_px: float = 26.0
    """Threshold d of mAD@d, mAP@d and mAR@d in 2D, px; box plots show all errors, those below it and below half of it."""
    hit_m: float = 0.10
    """The same in 3D, m."""
    match: Matching = "slot"
    """How predictions are matched to people: by seat, or by the assignment with the best OKS or the least distance."""
    resamples: int = 1000
    """Resamples of the bootstrap for the intervals; 0: no intervals."""
    seed: int = 0
    """Seed of the bootstrap."""

    def __post_init__(self) -> None:
        """Raise ConfigError for what makes no sense."""
        if self.min_visibility == Visibility.ABSENT:
            raise ConfigError("absent joints cannot count", hint="give min_visibility outside_image or higher")
        if not 0 <= self.presence <= 1:
            raise ConfigError(f"presence is a probability, not {self.presence}", hint="give a number from 0 to 1")
        thresholds = (*self.pck_px, *self.pck_m, *self.pckh, self.hit_px, self.hit_m)
        if not all(0 < t < float("inf") for t in thresholds):
            raise ConfigError("a threshold is a positive number", hint="give thresholds above 0")
        if self.resamples < 0:
            raise ConfigError(f"{self.resamples} resamples cannot be drawn", hint="give 0 or more")
        if self.seed < 0:
            raise ConfigError(f"{self.seed} is no seed", hint="give 0 or more")


THESIS_HEAD_PX = 26.0
THESIS_HEAD_M = 0.2
