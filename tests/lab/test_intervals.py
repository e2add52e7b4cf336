"""Intervals of a suit's delay hold the truth as often as they say, and one that is too wide is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from head_takes import LENGTHS_S, TRUE_S, head_takes

from cabinpose.align.time import TISSUE_S, VAGUE_S, refuse_vague, resolution_s, widened
from cabinpose.core.errors import UndeterminedError
from cabinpose.signals.delay import Delay
from cabinpose.signals.lags import WindowDelays

NONE = WindowDelays(*np.zeros((4, 0)))
KNOWN = Delay(0.02, (0.0197, 0.0203), 0.0, (0.0, 0.0), 3.0, 0.99, np.nan, NONE)


@pytest.mark.slow
def test_the_intervals_hold_the_truth() -> None:
    """Of 60 takes 95 % are 57; fewer than 52 would come once in 150, as of 15 fewer than 12 once in 180."""
    takes = list(head_takes(60, seed=2))
    assert sum(take.held for take in takes) >= 52
    for length in LENGTHS_S:
        some = [take for take in takes if take.seconds == length]
        assert sum(take.held for take in some) >= 12
        halves = [0.5 * np.ptp(take.delay.interval_s) for take in some]
        errors = [take.delay.offset_s - TRUE_S for take in some]
        assert np.median(halves) < 5 * np.std(errors)  # nor are they idle


def test_what_does_not_average_out_is_in_the_interval() -> None:
    """By hand: 0.3 ms of noise, 0.7 of tissue, and 95 % of half a millisecond's rounding."""
    low, high = widened(KNOWN, 0.001).interval_s
    assert 0.5 * (high - low) == pytest.approx(np.sqrt(0.3**2 + 0.7**2 + 0.475**2) / 1000)
    assert 0.5 * (low + high) == pytest.approx(KNOWN.offset_s)
    stamps = 3 + np.cumsum(np.array([16, 17, 17, 16])) * 1_000_000
    assert resolution_s(stamps) == pytest.approx(0.001)
    assert resolution_s(stamps, stamps) == pytest.approx(0.001 * np.sqrt(2))
    assert resolution_s(stamps[:1]) == 0
    assert resolution_s(np.array([0, 10, 20, 40]) * 1_000_000) == 0  # a counter of frames, one of them lost
    assert widened(replace(KNOWN, interval_s=(0.02, 0.02))).interval_s[1] == pytest.approx(0.02 + TISSUE_S)


def test_a_delay_that_is_hardly_known_is_refused() -> None:
    refuse_vague(replace(KNOWN, interval_s=(0.02 - 0.99 * VAGUE_S, 0.02 + 0.99 * VAGUE_S)))
    with pytest.raises(UndeterminedError, match=r"known to ±10.5 ms only; ±10 ms are allowed") as caught:
        refuse_vague(replace(KNOWN, interval_s=(0.0095, 0.0305)))
    assert "record longer" in str(caught.value.hint)
