"""Clocks: counters that wrap, values that come late, host time that advances with the monotonic clock."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.core.clock import HostClock, Unwrapper


def test_a_camera_that_counts_microseconds_wraps() -> None:
    unwrap = Unwrapper(2**32)
    assert unwrap(2**32 - 10) == 2**32 - 10
    assert unwrap(5) == 2**32 + 5
    assert unwrap(2**32 - 1) == 2**32 - 1  # late
    assert unwrap(7) == 2**32 + 7


@given(st.integers(2, 2**32), st.lists(st.integers(), min_size=1, max_size=50), st.integers(0, 2**40))
def test_steps_of_less_than_half_a_turn_are_found_again(modulus: int, steps: list[int], start: int) -> None:
    unwrap, true = Unwrapper(modulus), start
    offset = unwrap(true % modulus) - true
    highest = true
    for step in steps:
        true = highest + step % ((modulus + 1) // 2)
        highest = max(highest, true)
        assert unwrap(true % modulus) == true + offset


def test_after_a_restart_the_count_begins_anew() -> None:
    unwrap = Unwrapper(16)
    assert [unwrap(14), unwrap(1)] == [14, 17]
    unwrap.restart()
    assert unwrap(3) == 3


def test_host_time_does_not_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = HostClock()
    first = clock.now_ns()
    assert abs(first - time.time_ns()) < 1_000_000_000
    monkeypatch.setattr(time, "time_ns", lambda: 0)  # somebody sets the system's time
    assert 0 <= clock.now_ns() - first < 60_000_000_000
    moment = time.monotonic_ns()
    assert clock.from_monotonic_ns(moment) <= clock.now_ns()
