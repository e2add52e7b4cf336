"""The measured noise model: statistics against its own polynomial, edges, crop, window."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats
from sensor_scenes import generator, small_sensor, step_edge, use_case, wall

from cabinpose.scene.sensor import SENSORS, EmpiricalNoise, simulate
from cabinpose.scene.sensor.normals import normal_quantiles

PLAIN = EmpiricalNoise(edge_sigma_mm=0.0, remove_spikes=False, range_window=False, circular_field=False)


@pytest.mark.parametrize("depth", [0.5, 0.8, 1.1, 1.5, 3.0])
def test_noise_is_gaussian_with_the_measured_sigma(depth: float) -> None:
    sensor = small_sensor()
    error = np.concatenate(
        [(simulate(wall(sensor, depth), sensor, PLAIN, rng=generator(1, i)).depth_m - depth).ravel() for i in range(4)]
    ).astype(np.float64)
    sigma = (1 + 5 * depth + depth**2) * 1e-3
    assert error.std() == pytest.approx(sigma, rel=0.02)
    assert abs(error.mean()) < 4 * sigma / np.sqrt(error.size)
    assert stats.kstest(error / sigma, "norm").pvalue > 1e-3


def test_coefficients_are_used() -> None:
    sensor = small_sensor()
    noise = PLAIN.model_copy(update={"a_mm": 0.0, "b_mm_per_m": 0.0, "c_mm_per_m2": 4.0})
    depth = simulate(wall(sensor, 2.0), sensor, noise, rng=generator(1, 1)).depth_m
    assert depth.std() == pytest.approx(0.016, rel=0.05)


def test_edges_are_noisier_and_spikes_are_taken_out() -> None:
    sensor = small_sensor()
    edge = step_edge(sensor, 0.8, 1.4, 80)
    noise = PLAIN.model_copy(update={"edge_sigma_mm": 40.0})
    depth = np.stack([simulate(edge, sensor, noise, rng=generator(2, i)).depth_m for i in range(20)])
    sigma = depth.std(axis=(0, 1))
    at_edge = [39, 40]  # sample column 80 is pixel 40; the central difference sees the step from both sides
    quiet = np.delete(np.arange(96), at_edge)
    assert np.all(sigma[at_edge] == pytest.approx(0.041, rel=0.1))
    assert sigma[quiet].max() < 0.012
    loud = noise.model_copy(update={"edge_sigma_mm": 400.0})
    all_kept = simulate(edge, sensor, loud, rng=generator(2, 2)).depth_m
    cleaned = simulate(edge, sensor, loud.model_copy(update={"remove_spikes": True}), rng=generator(2, 2)).depth_m
    gone = np.isnan(cleaned) & np.isfinite(all_kept)
    assert gone[:, at_edge].mean() > 0.1
    assert not gone[:, quiet].any()


def test_edges_are_taken_out_by_their_neighbours() -> None:
    """Beside a straight step five of eight neighbours are on the same side: both go; of neighbours 2 px away two on each side."""
    sensor = small_sensor()
    edge = step_edge(sensor, 0.8, 1.4, 80)  # between pixels 39 and 40
    before = simulate(edge, sensor, PLAIN, rng=generator(2, 1))
    for width, columns in ((1, [39, 40]), (2, [38, 39, 40, 41])):
        noise = PLAIN.model_copy(update={"remove_edges": True, "edge_width_px": width})
        after = simulate(edge, sensor, noise, rng=generator(2, 1))
        gone = np.zeros(before.depth_m.shape, bool)
        gone[:, columns] = True
        np.testing.assert_array_equal(np.isnan(after.depth_m), gone)
        np.testing.assert_array_equal(after.confidence == 0, gone)
        np.testing.assert_array_equal(after.depth_m[~gone], before.depth_m[~gone])
    for kept in ({"edge_threshold_m": 0.7, "edge_tolerance": 1.0}, {"edge_neighbours": 5}):
        noise = PLAIN.model_copy(update={"remove_edges": True, **kept})
        assert np.isfinite(simulate(edge, sensor, noise, rng=generator(2, 1)).depth_m).all()


def test_window_crop_and_glass() -> None:
    sensor = use_case(3)
    flat = wall(sensor, 1.0, 1)
    radius = np.hypot(*np.mgrid[-143:144, -175.5:176.5])
    frame = simulate(flat, sensor, EmpiricalNoise(), rng=generator(1, 1))
    np.testing.assert_array_equal(np.isfinite(frame.depth_m), radius < sensor.field_radius_px)
    np.testing.assert_array_equal(frame.confidence == 0, np.isnan(frame.depth_m))
    for depth in (0.4, 1.6):
        assert np.isnan(simulate(wall(sensor, depth, 1), sensor, EmpiricalNoise(), rng=generator(1, 1)).depth_m).all()
    pane = wall(sensor, 1.0, 1, "glass")
    assert np.isnan(simulate(pane, sensor, EmpiricalNoise(), rng=generator(1, 1)).depth_m).all()
    seen = simulate(pane, sensor, EmpiricalNoise(glass=False), rng=generator(1, 1)).depth_m
    assert np.isfinite(seen).mean() > 0.8


def test_two_surfaces_are_never_averaged() -> None:
    sensor = small_sensor()
    depth = simulate(step_edge(sensor, 0.8, 1.4, 81), sensor, PLAIN, rng=generator(1, 1)).depth_m
    assert not np.any((depth > 0.9) & (depth < 1.3))


def test_same_random_numbers_same_bytes() -> None:
    sensor = SENSORS["kinect_v1"]
    frames = [simulate(wall(sensor, 2.0), sensor, EmpiricalNoise(), rng=generator(1, i)) for i in (1, 1, 2)]
    assert frames[0].depth_m.tobytes() == frames[1].depth_m.tobytes() != frames[2].depth_m.tobytes()


def test_settings_are_checked() -> None:
    for bad in ({"a_mm": -1.0}, {"unknown": 1}, {"edge_width_px": 0}):
        with pytest.raises(ValidationError):
            EmpiricalNoise.model_validate(bad)


def test_quantiles_are_standard_normal() -> None:
    table = normal_quantiles().astype(np.float64)
    assert np.all(np.diff(table) > 0)
    assert abs(table.mean()) < 1e-7
    assert table.std() == pytest.approx(1.0, abs=1e-6)
    assert (table**4).mean() == pytest.approx(3.0, abs=0.01)
    np.testing.assert_allclose(table[1:-1], stats.norm.ppf((np.arange(1, 65535) + 0.5) / 65536), atol=0.01)
