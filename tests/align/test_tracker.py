"""A mobile tracker beside the optical system: both are made from one true motion, by scipy's rotations alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.tracker import as_optical, place_tracker
from cabinpose.core.errors import AlignmentError
from cabinpose.signals import DelaySearch

LATE_S = 0.037
WORLD, BODY = Rotation.from_euler("zyx", (2.1, 0.3, -0.4)), Rotation.from_euler("zyx", (-0.7, 0.5, 0.2))
T_WORLD, T_BODY = np.array([0.4, -0.7, 0.9]), np.array([0.02, -0.03, 0.06])


def head(time_s: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """A head object in the optical world: it nods, tilts, turns and moves a little."""
    angles = np.column_stack([np.sin(2.1 * time_s + 1), 0.5 * np.sin(3.3 * time_s), 0.4 * np.sin(1.7 * time_s + 0.4)])
    return 0.05 * np.sin(np.outer(time_s, (1.1, 0.7, 1.9))) + (0.3, 0.2, 1.1), Rotation.from_euler("zyx", angles)


def said(scale: float = 1.0, noise_m: float = 0.0) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """What the tracker says of its body and the optical system of the object; the tracker's stamps are early by LATE_S."""
    rng = np.random.default_rng(1)
    at, since = np.arange(0, 12, 0.01), np.arange(0, 12, 1 / 90)
    p, q = head(at)
    true, turned = head(since)
    body = WORLD.inv() * turned * BODY.inv()  # A = X B Y, so that B = X⁻¹ A Y⁻¹
    place = WORLD.inv().apply(true - T_WORLD) - body.apply(T_BODY)
    place = scale * (place + noise_m * rng.standard_normal(place.shape))
    return (since - LATE_S, place, body.as_quat(scalar_first=True)), (at, p, q.as_quat(scalar_first=True))


def test_a_tracker_is_placed_and_says_what_the_optical_system_does() -> None:
    tracker, optical = said()
    found = place_tracker("vive", tracker, optical, DelaySearch(max_lag_s=0.5))
    world, body = np.array(found.world_from_tracker), np.array(found.body_from_object)
    assert np.abs(world[:3, :3] - WORLD.as_matrix()).max() < 1e-4
    assert np.abs(body[:3, :3] - BODY.as_matrix()).max() < 1e-4
    np.testing.assert_allclose(world[:3, 3], T_WORLD, atol=2e-4)
    np.testing.assert_allclose(body[:3, 3], T_BODY, atol=2e-4)
    assert found.tracker_to_optical.offset_s == pytest.approx(LATE_S, abs=2e-4)
    assert found.rms_m is not None
    assert found.rms_m < 2e-4
    tracker[1][10], tracker[2][20] = np.nan, np.nan
    at, p, q = as_optical(found, tracker)
    true, turned = head(at)
    lost = np.isin(np.arange(len(at)), (10, 20))
    np.testing.assert_array_equal(np.isnan(p).any(axis=1), lost)
    np.testing.assert_allclose(p[~lost], true[~lost], atol=5e-4)
    known = np.arange(len(at)) != 20
    assert (Rotation.from_quat(q[known], scalar_first=True).inv() * turned[known]).magnitude().max() < 1e-3


def test_noise_is_told() -> None:
    found = place_tracker("vive", *said(noise_m=0.002), DelaySearch(max_lag_s=0.5))
    assert found.rms_m == pytest.approx(
        0.002 * 3**0.5 * (2 / 3) ** 0.5, rel=0.05
    )  # the mean of two samples, weighted by all phases


def test_a_tracker_in_another_unit_is_refused() -> None:
    with pytest.raises(AlignmentError, match=r"vive and the optical system see the head .* apart"):
        place_tracker("vive", *said(scale=1000), DelaySearch(max_lag_s=0.5))
