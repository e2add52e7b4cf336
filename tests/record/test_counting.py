"""Frames of cameras that lose, swap, repeat and begin anew, against what was really sent; device time over many turns."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cabinpose.record.sources.counting import DeviceClock, FrameNumbers, FramePeriod
from cabinpose.signals.recorded import Counts


@given(st.lists(st.booleans(), min_size=1, max_size=300), st.integers(0, 2**16 - 1))
def test_every_lost_frame_is_counted_over_the_wrap(arrives: list[bool], first: int) -> None:
    counts = Counts()
    numbers = FrameNumbers(counts, 2**16)
    sent = [first + i for i, here in enumerate(arrives) if here]
    found = [numbers.number(n % 2**16) for n in sent]
    assert [n - found[0] for n in found] == [n - sent[0] for n in sent]
    assert counts.lost == (sent[-1] - sent[0] + 1 - len(sent) if sent else 0)
    assert counts.reordered == counts.duplicate == counts.restarts == 0


def test_a_late_frame_was_not_lost_and_a_double_one_is_told() -> None:
    counts = Counts()
    numbers = FrameNumbers(counts)
    assert [numbers.number(n) for n in (10, 11, 14, 12, 12, 15)] == [0, 1, 4, 2, 2, 5]
    assert (counts.lost, counts.reordered, counts.duplicate, counts.restarts) == (1, 1, 1, 0)  # 13 never came


def test_a_counter_that_begins_anew_is_no_loss() -> None:
    counts = Counts()
    numbers = FrameNumbers(counts, 2**32)
    assert [numbers.number(n) for n in (5000, 5001, 0, 1, 3)] == [0, 1, 2, 3, 5]
    assert (counts.lost, counts.restarts) == (1, 1)
    numbers.reached_again()  # the source counts this one, when it has reached the device
    assert numbers.number(77) == 6
    assert (counts.lost, counts.restarts) == (1, 1)


@given(st.lists(st.integers(1, 10**10), min_size=1, max_size=50), st.integers(0, 2**32 - 1))
def test_device_time_survives_pauses_of_many_turns(steps_us: list[int], start: int) -> None:
    clock, true, host = DeviceClock(1000, 2**32), start, 10**18
    offset = clock.device_ns(true, host) - true * 1000
    for step in steps_us:
        true += step
        host += step * 1000 + 1000 * (step // 10**6)  # the host runs a ppm faster
        assert clock.device_ns(true % 2**32, host) - true * 1000 == offset


def test_losses_from_time_stamps_alone() -> None:
    period = FramePeriod(50_000_000)
    assert [period.lost_before(t * 10**6) for t in (0, 51, 99, 201, 250)] == [0, 0, 0, 1, 0]
    assert period.lost_before(10 * 10**6) is None  # the device's clock began anew
    assert period.lost_before(60 * 10**6) == 0
    learnt = FramePeriod()
    stamps = [0, 40, 80, 120, 161, 200, 240, 360, 400]
    assert [learnt.lost_before(t * 10**6) for t in stamps] == [0, 0, 0, 0, 0, 0, 0, 2, 0]
