"""Clocks of devices from arrivals that come late by a floor and more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from cabinpose.align.clocks import host_from_device
from cabinpose.align.streams import on_host
from cabinpose.core.errors import AlignmentError
from cabinpose.signals.clock import ClockMap
from cabinpose.signals.recorded import Sample, SegmentPoses
from cabinpose.store.recording import Recording, RecordingWriter, SegmentSeries, segment_series

TRUE = ClockMap(1_700_000_000_123_456_789, 8e-5, 0)


def arrivals(seed: int, count: int = 1800, jitter_s: float = 0.004) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    device = np.cumsum(rng.integers(16_000_000, 17_000_000, count))
    return device, TRUE(device) + rng.exponential(jitter_s * 1e9, count).astype(np.int64)


def test_without_jitter_the_clock_is_found_to_the_nanosecond():
    device, host = arrivals(1, jitter_s=0.0)
    assert np.abs(host_from_device(device, host)(device) - host).max() <= 2


def test_with_jitter_the_floor_is_found_to_a_part_of_a_percent_of_it():
    errors = []
    for seed in range(20):
        device, host = arrivals(seed)
        errors.append(np.abs(host_from_device(device, host)(device) - TRUE(device)).max() / 1e6)
    assert np.median(errors) < 0.04
    assert max(errors) < 0.2


def test_it_is_the_best_line_below_all_arrivals():
    device, host = arrivals(3, count=300)
    found = host_from_device(device, host)
    x, y = (device - device[0]) / 1e9, (host - host[0] - (device - device[0])) / 1e9
    best = linprog([-x.sum(), -len(x)], A_ub=np.stack((x, np.ones_like(x)), 1), b_ub=y, bounds=(None, None))
    assert abs(found.drift - best.x[0]) < 1e-9
    assert np.sum(host - found(device)) / 1e9 == pytest.approx(np.sum(y) + best.fun, abs=1e-6)
    assert (found(device) <= host + 1).all()


@pytest.mark.parametrize("count", [25, 80])
def test_a_take_of_seconds_has_a_clock_however_late_its_samples_are(count):
    """Of 25 samples the line below alone is steeper than any clock in one of three takes."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        device = np.arange(count) * 40_000_000
        late = rng.exponential(4e6, count)
        found = host_from_device(device, TRUE(device) + late.astype(np.int64), "tof")
        assert abs(found.drift) <= 1e-3
        assert np.abs(found(device) - TRUE(device)).max() < 4e6  # ns, the jitter's mean


def test_what_is_no_steady_clock_is_refused():
    device, host = arrivals(4)
    with pytest.raises(AlignmentError, match="too few"):
        host_from_device(device[:5], host[:5])
    jumped = device.copy()
    jumped[900:] += 400_000_000
    with pytest.raises(AlignmentError, match=r"jumps by (39|40|41)\d ms, 1[4-7] s into"):
        host_from_device(jumped, host, "suit")
    back = device.copy()
    back[900:] -= 10_000_000_000
    with pytest.raises(AlignmentError, match="backwards"):
        host_from_device(back, host)
    with pytest.raises(AlignmentError, match="as no clock does"):
        host_from_device(device * 1000, host)
    with pytest.raises(AlignmentError, match=r"runs -1.9e-03 against"):
        host_from_device((device * 1.002).astype(np.int64), host)


def recorded(path: Path, seconds: np.ndarray, device_s: np.ndarray) -> SegmentSeries:
    """A head that moves by 1 m a second of the host's clock, in the order of arrival."""
    with RecordingWriter(path) as writer:
        for i, (host, device) in enumerate(zip(seconds, device_s, strict=True)):
            head = SegmentPoses("S1", ("Head",), np.array([[host, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]]))
            writer.write("suit", Sample(i, 10**18 + round(host * 1e9), round(device * 1e9), b"", (head,)))
    with Recording(path) as recording:
        return segment_series(recording, "suit", "S1")


@pytest.mark.parametrize("began_anew", [12, 20])  # the second recording is longer than the first, or shorter
def test_a_device_that_is_started_anew_within_a_take_is_refused(tmp_path, began_anew):
    """MVN counts from 0 again with each of its own recordings: samples of both have the same stamps, and belong to none."""
    host = np.arange(0, 30, 0.02)
    series = recorded(tmp_path / "take.mcap", host, np.where(host < began_anew, host, host - began_anew))
    np.testing.assert_array_equal(series.position_m[:, 0, 0], host)
    with pytest.raises(AlignmentError, match="suit: its clock went backwards during the take"):
        on_host(series)


def test_samples_that_are_overtaken_are_put_in_their_place(tmp_path):
    host = np.arange(0, 10, 0.02)
    device = np.insert(np.delete(host, 100), 149, host[100])  # one comes a second late
    series = recorded(tmp_path / "take.mcap", host, device)
    assert (np.diff(series.device_ns) > 0).all()
    on_host(series)
