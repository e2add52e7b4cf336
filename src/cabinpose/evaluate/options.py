"""What an evaluation can be told: which joints count, what a head is, which thresholds, how people are matched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from cabinpose.core import ConfigError, Visibility

HeadSize = Literal["thesis", "true"]
Matching = Literal["slot", "oks", "distance"]


@dataclass(frozen=True)
class EvaluationOptions:
    """Settings of one evaluation; raises `ConfigError` for what makes no sense.

    min_visibility: joints that are at least so visible count; the others are neither right nor wrong.
    presence: from this probability on a predicted joint counts as found.
    head: "thesis" is 26 px in 2D and 200 mm in 3D, "true" each person's own length from head to neck joint.
    pck_px, pck_m: thresholds of PCK in 2D and 3D · pckh: shares of the head size · hit_px, hit_m: the d of mAD@d, mAP@d, mAR@d.
    match: how predictions are matched to people · resamples: of the bootstrap, 0 = no intervals.
    """

    min_visibility: Visibility = Visibility.OCCLUDED
    presence: float = 0.5
    head: HeadSize = "thesis"
    pck_px: tuple[float, ...] = (26.0,)
    pck_m: tuple[float, ...] = (0.05, 0.10, 0.15, 0.20)
    pckh: tuple[float, ...] = (0.5, 1.0)
    hit_px: float = 26.0
    hit_m: float = 0.10
    match: Matching = "slot"
    resamples: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        if self.min_visibility == Visibility.ABSENT:
            raise ConfigError("absent joints cannot count", hint="give min_visibility outside_image or higher")
        if not 0 <= self.presence <= 1:
            raise ConfigError(f"presence is a probability, not {self.presence}", hint="give a number from 0 to 1")
        thresholds = (*self.pck_px, *self.pck_m, *self.pckh, self.hit_px, self.hit_m)
        if not all(0 < t < float("inf") for t in thresholds):
            raise ConfigError("a threshold is a positive number", hint="give thresholds above 0")
        if self.resamples < 0:
            raise ConfigError(f"{self.resamples} resamples cannot be drawn", hint="give 0 or more")


THESIS_HEAD_PX = 26.0
THESIS_HEAD_M = 0.2
