"""Clocks of the virtual laboratory against arithmetic in whole numbers and fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.app.lab.clocks import Clock, ClockSettings
from cabinpose.app.lab.rig import ERRORS, SOURCES, TRACKER_ERRORS, Tracker, VirtualRig
from cabinpose.core.errors import ConfigError

START = 1_750_000_000_000_000_000


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=(seed, 0)))


@given(st.integers(0, 3_600_000_000_000), st.floats(-500, 500), st.floats(-100, 100))
def test_a_clock_shows_offset_and_drift(after_ns: int, offset_s: float, drift_ppm: float) -> None:
    clock = Clock(ClockSettings(offset_s=offset_s, drift_ppm=drift_ppm), START)
    exact = Fraction(offset_s) * 10**9 + after_ns * (1 + Fraction(drift_ppm) / 10**6)
    assert abs(int(clock.device_from_true(START + after_ns)) - exact) <= 1.5


@given(st.integers(0, 600_000_000_000))
def test_maps_between_two_clocks(after_ns: int) -> None:
    rig = VirtualRig()
    true = START + after_ns
    for a in SOURCES:
        for b in SOURCES:
            shown = rig.clock(a).device_from_true(true)
            assert abs(int(rig.clock_map(a, b)(shown)) - int(rig.clock(b).device_from_true(true))) <= 3


def test_stamps_are_rounded_to_the_resolution_without_bias() -> None:
    true = START + np.arange(0, 3_000_000_000, 1_234_567)
    fine = Clock(ClockSettings(offset_s=5), START).stamps(true)
    coarse = Clock(ClockSettings(offset_s=5, resolution_ns=1_000_000), START).stamps(true)
    assert (coarse % 1_000_000 == 0).all()
    assert np.abs(coarse - fine).max() <= 500_000
    assert abs((coarse - fine).mean()) < 20_000


def test_samples_come_when_the_device_counts_them_off() -> None:
    clock = Clock(ClockSettings(offset_s=3.0004, drift_ppm=50), START)
    shown = clock.device_from_true(clock.ticks(25, 10, 12))
    assert np.abs(shown - np.rint(shown / 40e6) * 40_000_000).max() <= 1
    assert len(shown) == 50
    assert (np.diff(shown) > 39_000_000).all()
    assert START + 10 * 10**9 <= clock.ticks(25, 10, 12)[0] < START + 10.04 * 10**9


def test_two_spans_side_by_side_have_each_sample_once() -> None:
    clock = VirtualRig().clock("suit")
    joined = np.concatenate((clock.ticks(60, 0, 7.3), clock.ticks(60, 7.3, 9)))
    assert (joined == clock.ticks(60, 0, 9)).all()


def test_arrivals_have_a_hard_minimum_an_exponential_tail_and_keep_their_order() -> None:
    clock = Clock(ClockSettings(latency_s=0.04, jitter_s=0.003), START)
    true = START + np.arange(20_000) * 100_000_000  # so rare that none waits for another
    late_s = (clock.arrivals(true, rng=rng()) - true) / 1e9
    assert late_s.min() >= 0.04
    assert abs(np.mean(late_s - 0.04) / 0.003 - 1) < 0.03
    assert abs(np.median(late_s - 0.04) / (0.003 * np.log(2)) - 1) < 0.03
    dense = clock.arrivals(START + np.arange(20_000) * 100_000, rng=rng())
    assert (np.diff(dense) >= 0).all()
    assert (np.diff(dense) == 0).any(), "in a burst, samples wait for each other"


def test_the_same_generator_gives_the_same_arrivals() -> None:
    clock, true = VirtualRig().clock("tof"), START + np.arange(100) * 40_000_000
    assert (clock.arrivals(true, rng=rng(4)) == clock.arrivals(true, rng=rng(4))).all()
    assert (clock.arrivals(true, rng=rng(4)) != clock.arrivals(true, rng=rng(5))).any()


def test_a_rig_without_errors_keeps_what_is_to_be_found() -> None:
    rig, exact = VirtualRig(optical_swaps=True), VirtualRig(optical_swaps=True).noise_free()
    assert exact == VirtualRig.exact()
    assert (exact.camera_from_world == rig.camera_from_world).all()
    true = START + np.arange(10) * 12_345_678
    for source in SOURCES:
        before, after = rig.clock(source), exact.clock(source)
        assert (after.stamps(true) == after.device_from_true(true)).all()
        assert after.device_from_true == before.device_from_true
        assert (after.arrivals(true, rng=rng()) - true == round(before.settings.latency_s * 1e9)).all()
    assert not any((exact.sensor_noise, exact.sensor_systematic, exact.optical_noise_m, exact.optical_occlusion))
    assert not any(exact.suit_errors.model_dump().values())


def test_each_error_can_be_switched_on_alone() -> None:
    full, exact = VirtualRig(optical_swaps=True, tracker=Tracker()), VirtualRig.exact(tracker=Tracker())
    reached = set()
    for error in (*ERRORS, *TRACKER_ERRORS):
        values, none = full.only(error).model_dump(), exact.model_dump()
        changed = {name for name in values if values[name] != none[name]}
        assert changed, error
        for name in changed:
            if isinstance(values[name], dict):
                reached |= {(name, field) for field in values[name] if values[name][field] != none[name][field]}
            else:
                reached.add((name, ""))
                assert values[name] == full.model_dump()[name]
    everything = full.model_dump()
    for name, value in exact.model_dump().items():
        if isinstance(value, dict):
            for field in value:
                assert ((name, field) in reached) == (value[field] != everything[name][field]), (name, field)
        else:
            assert ((name, "") in reached) == (value != everything[name]), name
    with pytest.raises(ConfigError) as error_of_name:
        full.only("gremlins")
    assert "sensor_noise" in str(error_of_name.value.hint)


def test_a_rig_goes_through_text_and_back() -> None:
    rig = VirtualRig(optical_noise_m=0.0002)
    assert VirtualRig.model_validate_json(rig.model_dump_json()) == rig
    assert hash(rig) == hash(VirtualRig(optical_noise_m=0.0002))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"extrinsics": np.diag([1.0, 1.0, -1.0, 1.0])}, "rigid"),
        ({"tof": {"rate_hz": 60}}, "25 frames per second"),
        ({"optical_noise_m": -1}, "greater than or equal to 0"),
    ],
)
def test_a_rig_that_cannot_be(settings: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        VirtualRig(**settings)
