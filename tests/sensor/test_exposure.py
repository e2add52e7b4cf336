"""What moves while the correlation samples of a frame are exposed, and two integrations, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_scenes import WHITE, generator, small_sensor, sphere_of_range, step_edge, use_case, wall

from cabinpose.core.errors import ConfigError
from cabinpose.scene.materials import MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import (
    NO_EFFECTS,
    SENSORS,
    EmpiricalNoise,
    GeometryBuffers,
    NoiseModel,
    PhysicalNoise,
    Sensor,
    StructuredLightNoise,
    median_of_valid,
    sample_times,
    simulate,
)
from cabinpose.scene.sensor.noise import smoothed

C = 299_792_458.0


def only(**effects: object) -> PhysicalNoise:
    return NO_EFFECTS.model_copy(update=effects)


def facing(sensor: Sensor, range_m: float) -> GeometryBuffers:
    """Surfaces at one range everywhere that return the same light at any distance: the cosine makes up for 1 / r^2."""
    factor = sensor.camera.range_over_depth
    cosine = np.full(factor.shape, (range_m / 3.0) ** 2, np.float32)
    return GeometryBuffers.dense(
        1, (range_m / factor).astype(np.float32), cosine, np.full(factor.shape, MATERIAL_ID[WHITE], np.uint8)
    )


def test_samples_are_exposed_one_after_the_other() -> None:
    """Use case 5: four times 0.6 ms with 0.96 ms of reading in between; use case 3 has two frequencies."""
    np.testing.assert_allclose(sample_times(use_case(5), PhysicalNoise()) * 1e3, 1.56 * np.array([-1.5, -0.5, 0.5, 1.5]))
    np.testing.assert_allclose(np.diff(sample_times(use_case(3), PhysicalNoise())), 1.66e-3)
    assert len(sample_times(use_case(3), PhysicalNoise())) == 8
    assert len(sample_times(use_case(3), PhysicalNoise(second_frequency=False))) == 4
    # A shorter integration comes after the longer one: half of its first exposure, and of the last one of the longer, apart.
    two = sample_times(small_sensor(second_integration_s=1e-4, readout_s=2e-4), PhysicalNoise())
    np.testing.assert_allclose(np.diff(two), [9e-4] * 3 + [6e-4] + [3e-4] * 3)
    assert two[0] - 3.5e-4 == pytest.approx(-(two[-1] + 0.5e-4))


@pytest.mark.parametrize("speed", [-3.0, 1.0, 8.0])
def test_motion_along_the_axis_has_its_closed_form(speed: float) -> None:
    """tan(phase) = sin(p + d/2) / cos(p - d/2), of a phase p in the middle that goes on by d from sample to sample.

    To first order the error is d/2 cos(2 p): what is called motion artefact (Lindner and Kolb 2009; Hussmann et al. 2011).
    """
    sensor = small_sensor(integration_s=2e-3)
    noise = only(reflectance=True, incidence=True, wrapping=True)
    times = sample_times(sensor, noise)
    for middle in (0.5, 0.9, 1.4, 2.1, 2.6):
        exposures = [facing(sensor, middle + speed * t) for t in times]
        frame = simulate(facing(sensor, middle), sensor, noise, rng=generator(1, 1), exposures=exposures)
        per_m = 4 * np.pi * 50e6 / C
        p, d = per_m * middle, per_m * speed * (times[1] - times[0])
        expected = np.arctan2(np.sin(p + d / 2), np.cos(p - d / 2)) % (2 * np.pi) / per_m
        measured = frame.depth_m * sensor.camera.range_over_depth
        np.testing.assert_allclose(measured, expected, atol=1e-5)
        assert (measured - middle).mean() == pytest.approx(d / 2 * np.cos(2 * p) / per_m, abs=0.02 * abs(d) / per_m)


@pytest.mark.parametrize("frequencies", [(50e6,), (80e6, 60e6)])
def test_an_edge_that_moves_aside_mixes_what_it_sweeps(frequencies: tuple[float, ...]) -> None:
    """Pixels that see one wall in some samples and the other in the rest decode as their four samples say; no others change."""
    sensor = small_sensor(frequencies_hz=frequencies)
    noise = only(wrapping=True, reflectance=True)
    count = len(sample_times(sensor, noise))
    near, far, first = 0.7, 1.1, 40
    exposures = [step_edge(sensor, near, far, first + k, supersample=1) for k in range(count)]
    still, moved = (simulate(exposures[0], sensor, noise, rng=generator(1, 1), exposures=e).depth_m for e in ((), exposures))
    swept = np.zeros(sensor.camera.width, bool)
    swept[first : first + count - 1] = True
    np.testing.assert_allclose(moved[:, ~swept], still[:, ~swept], rtol=0, atol=1e-6)  # eight eighths in floats
    assert (np.abs(moved - near) > 1e-3)[:, swept].all()
    row = sensor.camera.height // 2
    factor = sensor.camera.range_over_depth[row]
    for column in np.flatnonzero(swept):
        ranges = np.where(column < first + np.arange(count), near, far) * factor[column]
        phases = []
        for k, f in enumerate(frequencies):
            r = ranges[4 * k : 4 * k + 4]
            c = np.cos(4 * np.pi * f * r / C + np.arange(4) * np.pi / 2) / r**2
            phases.append(np.arctan2(c[3] - c[1], c[0] - c[2]) / (2 * np.pi))
        if len(frequencies) == 1:
            assert moved[row, column] * factor[column] == pytest.approx(phases[0] % 1 * C / (2 * 50e6), abs=1e-4)
        else:  # whole turns that bring the two ranges nearest to each other, within the common period of 7.49 m
            turns = [(a, b) for a in range(4) for b in range(3)]
            either = [((phases[0] + a) % 4 * C / 160e6, (phases[1] + b) % 3 * C / 120e6) for a, b in turns]
            first_m, second_m = min(either, key=lambda r: abs(r[0] - r[1]))
            assert moved[row, column] * factor[column] == pytest.approx((first_m * 16 + second_m * 9) / 25, abs=1e-4)


def test_what_does_not_move_has_the_bytes_of_a_still_frame() -> None:
    sensor = use_case(3)
    still = step_edge(sensor, 0.7, 1.1, 351)
    noise = PhysicalNoise(sun=1.0, light_offset_m=0.03, low_amplitude_spread=0.3)
    alone = simulate(still, sensor, noise, rng=generator(1, 1))
    for exposures in ([still] * 8, [still.copy()] * 8):
        seen = simulate(still, sensor, noise, rng=generator(1, 1), exposures=exposures)
        for a, b in zip(alone, seen, strict=True):
            np.testing.assert_array_equal(a, b)
    # Views that are the same, but not one object, are added up in floats.
    several = simulate(still, sensor, noise, rng=generator(1, 1), exposures=[still.copy() for _ in range(8)])
    both = np.isfinite(several.depth_m) & np.isfinite(alone.depth_m)
    np.testing.assert_allclose(several.depth_m[both], alone.depth_m[both], atol=2e-5)
    assert both.sum() > 0.99 * np.isfinite(alone.depth_m).sum()


def test_wrong_numbers_of_exposures_are_refused() -> None:
    sensor = small_sensor()
    with pytest.raises(ConfigError, match="3 exposures for the 4 samples"):
        simulate(wall(sensor, 1.0), sensor, NO_EFFECTS, rng=generator(1, 1), exposures=[wall(sensor, 1.0)] * 3)


# ------------------------------------------------------------------------------------------------------ two integrations


@pytest.mark.parametrize(("z", "ambient", "full"), [(0.3, 0.1, True), (1.5, 8.0, True), (1.5, 0.1, False)])
def test_full_pixels_come_from_the_shorter_integration(z: float, ambient: float, full: bool) -> None:
    """Too near, or in too much light, sigma is that of the shorter exposure in closed form; else the frame is the same bytes."""
    long_s, short_s = 2e-3, 2.5e-4
    one = small_sensor(integration_s=long_s, full_well_e=20_000.0, read_noise_e=12.0)
    two = one.model_copy(update={"second_integration_s": short_s})
    noise = only(shot_noise=True, read_noise=True, full_well=True, wrapping=True, reflectance=True, ambient=ambient)
    buffers = sphere_of_range(one, np.full((one.camera.height, one.camera.width), z))
    frames = [simulate(buffers, two, noise, rng=generator(1, i)) for i in range(3)]
    alone = simulate(buffers, one, noise, rng=generator(1, 0))
    rho = MATERIALS[MATERIAL_ID[WHITE]].reflectance
    signal, background = (4.1e6 * (short_s if full else long_s) * rho * share for share in (1 / z**2, ambient))
    sigma = C * np.sqrt(signal + background + 12.0**2) / (np.sqrt(2) * signal * 0.75) / (4 * np.pi * 50e6)
    ranges = np.stack([frame.depth_m for frame in frames]) * one.camera.range_over_depth
    assert ranges.std() == pytest.approx(sigma, rel=0.05)
    assert ranges.mean() == pytest.approx(z, abs=5 * sigma / np.sqrt(ranges.size))
    # Amplitudes keep one scale, that of the longer exposure.
    assert frames[0].amplitude.mean() == pytest.approx(0.75 * 4.1e6 * long_s * rho / z**2, rel=0.05)
    if full:
        assert np.isnan(alone.depth_m).all()
        return
    for a, b in zip(alone, frames[0], strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_noise_image_is_the_spread_of_repeated_frames() -> None:
    """Along the axis, where the image is bright and where it is dark; NaN where nothing is measured."""
    sensor = use_case(3)
    buffers = wall(sensor, 1.0)
    frames = [simulate(buffers, sensor, PhysicalNoise(), rng=generator(2, i)) for i in range(12)]
    depth, noise = np.stack([f.depth_m for f in frames]), np.stack([f.noise_m for f in frames])
    np.testing.assert_array_equal(np.isnan(noise), np.isnan(depth))
    valid = np.isfinite(depth).all(axis=0)
    spread, stated = depth.std(axis=0, ddof=1), noise.mean(axis=0)
    low, high = np.quantile(stated[valid], (0.1, 0.9))
    assert high > 1.5 * low  # the image's edge is darker
    for region in (valid & (stated < low), valid & (stated > high), valid):
        rms = np.sqrt(np.mean(spread[region] ** 2) / np.mean(stated[region] ** 2))
        assert rms == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize(("name", "noise"), [("pico_monstar_105", EmpiricalNoise()), ("kinect_v1", StructuredLightNoise())])
def test_the_other_models_state_the_sigma_they_draw(name: str, noise: EmpiricalNoise | StructuredLightNoise) -> None:
    """1 + 5 z + z^2 mm of the thesis; Nguyen's axial law of a surface that faces the camera, at 1 m."""
    sensor = SENSORS[name]
    frame = simulate(wall(sensor, 1.0), sensor, noise, rng=generator(1, 1))
    np.testing.assert_array_equal(np.isnan(frame.noise_m), np.isnan(frame.depth_m))
    expected = 0.007 if name == "pico_monstar_105" else 0.0012 + 0.0019 * 0.6**2
    assert np.nanmedian(frame.noise_m) == pytest.approx(expected, rel=0.01)


def test_a_full_pixel_has_infinite_noise() -> None:
    sensor = small_sensor(full_well_e=2000.0)
    frame = simulate(wall(sensor, 0.3), sensor, only(full_well=True), rng=generator(1, 1))
    assert np.isinf(frame.noise_m).all()
    assert np.isnan(frame.depth_m).all()
    with pytest.raises(ConfigError, match="is not the shorter one"):
        small_sensor(second_integration_s=7e-4)


# --------------------------------------------------------------------------------------------------------------- filters


def normal_numbers(shape: tuple[int, ...]) -> np.ndarray:
    return generator(7, 7).standard_normal(shape, np.float32)


@pytest.mark.parametrize(("kind", "variance"), [("mean", 1 / 9), ("median", 0.16610)])
def test_filters_leave_the_variance_of_their_order_statistic(kind: str, variance: float) -> None:
    """Nine normal numbers: 1/9 of the mean, 0.16610 of the median (tables of order statistics); a lost pixel stays lost."""
    sensor = small_sensor(spatial_filter=kind)
    depth = normal_numbers((300, 300))
    depth[100, 100] = np.nan
    result = smoothed(depth, sensor)
    assert np.isnan(result[100, 100])
    assert np.isnan(result).sum() == 1
    assert result[1:-1, 1:-1][~np.isnan(result[1:-1, 1:-1])].var() == pytest.approx(variance, rel=0.03)
    beside = depth[99:102, 98:101].ravel()  # of pixel (100, 99): eight valid ones
    expected = np.nanmedian(beside) if kind == "median" else np.nanmean(beside)
    assert result[100, 99] == pytest.approx(expected, rel=1e-5)


def test_the_bilateral_filter_keeps_steps_and_smooths_what_is_between() -> None:
    depth = np.full((60, 60), 0.7, np.float32)
    depth[:, 30:] = 1.1
    noisy = depth + 0.003 * normal_numbers(depth.shape)
    result = smoothed(noisy, small_sensor(spatial_filter="bilateral", spatial_px=5))
    assert np.abs(result - depth).max() < 0.006
    assert (result - depth)[2:-2, 2:28].std() == pytest.approx(0.003 / 5, rel=0.1)


def test_the_median_over_frames_is_that_of_the_valid_ones() -> None:
    depths = normal_numbers((5, 200, 200))
    assert median_of_valid(depths).var() == pytest.approx(0.28683, rel=0.03)  # of five normal numbers
    depths[0, 0, 0] = depths[2, 0, 0] = depths[-1, 1, 1] = np.nan
    result = median_of_valid(depths)
    assert result[0, 0] == np.nanmedian(depths[:, 0, 0])
    np.testing.assert_array_equal(np.argwhere(np.isnan(result)), [[1, 1]])


@pytest.mark.parametrize("noise", [PhysicalNoise(), EmpiricalNoise(), StructuredLightNoise()])
def test_a_sensor_delivers_filtered_depth(noise: NoiseModel) -> None:
    plain, filtered = (small_sensor(spatial_filter=kind) for kind in ("none", "median"))
    buffers = wall(plain, 1.0)
    depths = [simulate(buffers, s, noise, rng=generator(3, 3)).depth_m for s in (plain, filtered)]
    assert not np.array_equal(*depths, equal_nan=True)
    np.testing.assert_array_equal(smoothed(depths[0], filtered), depths[1])
