"""Clocks: counters that wrap, values that come late, host time that advances with the monotonic clock."""

from __future__ import annotations

import selectors
import socket
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.signals.clock import ClockMap, HostClock, Unwrapper


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
    assert 0 <= clock.now_s() - first / 1e9 < 60


def test_waiting_ends_when_it_should() -> None:
    clock, event = HostClock(), threading.Event()
    began = time.monotonic()
    clock.sleep(-1)
    clock.sleep(0.05)
    assert not clock.wait(event, 0.05)
    assert time.monotonic() - began >= 0.1
    event.set()
    assert clock.wait(event, 60)
    ended = threading.Thread(target=event.wait)
    ended.start()
    assert clock.join(ended, 60)
    hanging = threading.Thread(target=time.sleep, args=(0.5,), daemon=True)
    hanging.start()
    assert not clock.join(hanging, 0.0)
    one, other = socket.socketpair()
    with one, other, selectors.DefaultSelector() as selector:
        key = selector.register(one, selectors.EVENT_READ)
        assert not clock.readable(one, 0.0)
        assert clock.select(selector, 0.0) == []
        other.send(b"x")
        assert clock.readable(one, 60)
        assert clock.select(selector, 60) == [(key, selectors.EVENT_READ)]


def test_a_map_between_clocks_and_its_inverse_keep_every_nanosecond():
    start = 1_700_000_000_000_000_000
    a = start + np.arange(0, 3_600_000_000_000, 977_777_777)
    b_from_a = ClockMap(-1_699_999_000_123_456_789, 1e-4, start)
    b = b_from_a(a)
    assert b[0] == 999_876_543_211
    assert abs((b[-1] - b[0]) / (a[-1] - a[0]) - 1.0001) < 1e-12
    assert np.abs(b_from_a.inverse()(b) - a).max() <= 1


def test_maps_between_clocks_follow_one_another():
    b_from_a, c_from_b = ClockMap(5_000_000_000, 2e-5, 100), ClockMap(-70, -3e-5, 4_000_000_000)
    a = np.arange(0, 10**12, 10**10 + 7)
    assert np.abs(b_from_a.then(c_from_b)(a) - c_from_b(b_from_a(a))).max() <= 1
