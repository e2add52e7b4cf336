"""The tests' own clock."""

from __future__ import annotations

import threading
import time

import pytest
from virtual_clock import VirtualClock


def test_time_passes_while_all_wait() -> None:
    clock, log = VirtualClock(0), []

    def tick(name: str, period_s: float) -> None:
        for _ in range(3):
            clock.sleep(period_s)
            log.append((name, clock.now_s()))

    threads = [threading.Thread(target=tick, args=args) for args in (("slow", 100.0), ("fast", 30.0))]
    began = time.monotonic()
    for thread in threads:
        thread.start()
    for thread in threads:
        assert clock.join(thread, float("inf"))
    assert time.monotonic() - began < 30
    assert sorted(log, key=lambda entry: entry[1]) == log
    assert [at for name, at in log if name == "fast"] == pytest.approx([30, 60, 90])
    assert [at for name, at in log if name == "slow"] == pytest.approx([100, 200, 300])


def test_who_is_busy_holds_time_up() -> None:
    clock, event = VirtualClock(0), threading.Event()
    thread = threading.Thread(target=lambda: (clock.now_ns(), time.sleep(0.2), event.set()))
    thread.start()
    while len(clock._users) < 2:
        time.sleep(0.001)
    assert clock.wait(event, 1.0)
    assert clock.now_s() == 0
    assert not clock.wait(threading.Event(), 1.0)
    assert clock.now_s() == 1
