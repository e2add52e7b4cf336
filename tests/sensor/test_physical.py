"""The continuous-wave model against closed forms.

With N electrons of signal in both taps of a sample and contrast K: C_i = E_A - E_B has mean N K cos(phase + i pi / 2) and
variance N + N_ambient + s^2, where s is the read noise of the difference. atan2(C3 - C1, C0 - C2) then has
sigma_phase = sqrt(N + N_ambient + s^2) / (sqrt(2) N K), and sigma_range = c sigma_phase / (4 pi f), which two frequencies
weighted by f^2 turn into c sigma_phase / (4 pi sqrt(f1^2 + f2^2)).
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from sensor_scenes import WHITE, generator, samples, small_sensor, sphere_of_range, step_edge, use_case, wall

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.scene.materials import MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import NO_EFFECTS, OWN_SENSORS, SENSORS, GeometryBuffers, PhysicalNoise, Sensor, simulate
from cabinpose.scene.sensor.noise import edge_pixels

C = 299_792_458.0
DISTANCES = (0.5, 0.8, 1.2, 1.7, 2.4)


def unambiguous_range(sensor: Sensor) -> float:
    """Range (m) at which the phase wraps, c / 2f; with two frequencies that of their greatest common divisor."""
    return C / 2 / float(np.gcd.reduce([round(f) for f in sensor.frequencies_hz])) if sensor.frequencies_hz else np.inf


def only(**effects: object) -> PhysicalNoise:
    """No effect but those named."""
    return NO_EFFECTS.model_copy(update=effects)


def ranges_of(sensor: Sensor, buffers: GeometryBuffers, noise: PhysicalNoise, frames: int = 1) -> np.ndarray:
    """(frames, H, W) range in metres of repeated frames."""
    depth = np.stack([simulate(buffers, sensor, noise, rng=generator(5, i)).depth_m for i in range(frames)])
    return depth * sensor.camera.range_over_depth


def flat_range(sensor: Sensor, value: float) -> GeometryBuffers:
    return sphere_of_range(sensor, np.full((sensor.camera.height, sensor.camera.width), value))


# ---------------------------------------------------------------------------------------------------------------- noise


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("frequencies", [(50e6,), (80e6, 60e6)])
def test_sigma_has_its_closed_form(distance: float, frequencies: tuple[float, ...]) -> None:
    sensor = small_sensor(frequencies_hz=frequencies, read_noise_e=12.0)
    noise = only(shot_noise=True, read_noise=True, reflectance=True, ambient=0.1, wrapping=True)
    measured = ranges_of(sensor, flat_range(sensor, distance), noise, frames=4)
    rho = MATERIALS[MATERIAL_ID[WHITE]].reflectance
    signal = 4.1e6 * 7e-4 * rho / distance**2
    ambient = 4.1e6 * 7e-4 * rho * 0.1
    sigma_phase = np.sqrt(signal + ambient + 12.0**2) / (np.sqrt(2) * signal * 0.75)
    sigma = C * sigma_phase / (4 * np.pi * np.sqrt(np.sum(np.square(frequencies))))
    assert measured.std() == pytest.approx(sigma, rel=0.05)
    # 27 648 samples: the mean stands within five of its own sigmas (and the noise is not white lies: it is centred)
    assert abs(measured.mean() - distance) < 5 * sigma / np.sqrt(measured.size)


def test_read_noise_alone_and_shot_noise_alone_add_up() -> None:
    sensor = small_sensor(read_noise_e=40.0)
    buffers = flat_range(sensor, 1.5)
    shot, read, both = (
        ranges_of(sensor, buffers, only(shot_noise=s, read_noise=r), frames=4).var()
        for s, r in ((True, False), (False, True), (True, True))
    )
    assert both == pytest.approx(shot + read, rel=0.05)
    assert min(shot, read) > 0.2 * both


@pytest.mark.parametrize("name", [n for n, s in OWN_SENSORS.items() if s.principle == "time_of_flight"])
def test_nothing_is_biased_without_effects(name: str) -> None:
    """Every pixel at its own distance, over the whole unambiguous range that the sensor delivers."""
    sensor = SENSORS[name]
    shape = (sensor.camera.height, sensor.camera.width)
    far = min(unambiguous_range(sensor), 5.0)
    truth = np.linspace(0.01 * far, 0.99 * far, shape[0] * shape[1]).reshape(shape)
    error = ranges_of(sensor, sphere_of_range(sensor, truth), only(wrapping=True))[0] - truth
    assert np.isfinite(error).all()
    assert np.abs(error).max() < 5e-6
    assert abs(error.mean()) < 5e-7


def test_depth_is_along_the_axis_not_along_the_ray() -> None:
    sensor = SENSORS["pico_monstar_105"]
    depth = simulate(wall(sensor, 1.0), sensor, NO_EFFECTS, rng=generator(1, 1)).depth_m
    # A wall is flat in depth; its range grows by half at the corners. Averaging 2 x 2 samples costs micrometres.
    assert np.abs(depth - 1.0).max() < 2e-4


# ------------------------------------------------------------------------------------------------------------- wiggling


def test_wiggling_has_its_closed_form() -> None:
    """A triangular correlation: phase_est = atan(x / (1 - x)), x = 2 phase / pi, in each quarter turn."""
    sensor = small_sensor()
    shape = (sensor.camera.height, sensor.camera.width)
    truth = np.linspace(0.02, 2.97, shape[0] * shape[1]).reshape(shape)
    measured = ranges_of(sensor, sphere_of_range(sensor, truth), only(wiggling=1.0, wrapping=True))[0]
    phase = 4 * np.pi * 50e6 * truth / C
    quarter, rest = np.divmod(phase, np.pi / 2)
    x = 2 * rest / np.pi
    expected = quarter * np.pi / 2 + np.arctan2(x, 1 - x)
    np.testing.assert_allclose(measured * 4 * np.pi * 50e6 / C, expected, atol=3e-6)
    error = measured - truth
    assert np.degrees(np.abs(expected - phase).max()) == pytest.approx(4.07, abs=0.01)
    assert np.ptp(error) * 1e3 == pytest.approx(67.8, abs=0.15)


def test_wiggling_has_names() -> None:
    assert PhysicalNoise.model_validate({"wiggling": "calibrated"}) == PhysicalNoise()
    assert PhysicalNoise.model_validate({"wiggling": "uncalibrated"}).wiggling == 0.5
    assert PhysicalNoise.model_validate({"wiggling": 0.42}).wiggling == 0.42
    for wrong in ("none", 1.5, []):
        with pytest.raises((ValueError, ConfigError), match="wiggling"):
            PhysicalNoise.model_validate({"wiggling": wrong})


def test_residual_wiggling_is_a_share() -> None:
    sensor = small_sensor()
    shape = (sensor.camera.height, sensor.camera.width)
    truth = np.linspace(0.1, 2.9, shape[0] * shape[1]).reshape(shape)
    buffers = sphere_of_range(sensor, truth)
    spans = [np.ptp(ranges_of(sensor, buffers, only(wiggling=w, wrapping=True))[0] - truth) for w in (0.0, 0.1, 1.0)]
    assert spans[0] < 1e-5
    assert spans[1] == pytest.approx(0.1 * spans[2], rel=0.1)


# -------------------------------------------------------------------------------------------------------- flying pixels


@pytest.mark.parametrize("frequencies", [(50e6,), (80e6, 60e6)])
def test_flying_pixels_are_the_phase_of_the_phasor_sum(frequencies: tuple[float, ...]) -> None:
    """One column of pixels sees two walls half and half: predicted from complex numbers."""
    sensor = small_sensor(frequencies_hz=frequencies)
    near, far, column = 0.7, 1.1, 40
    split = step_edge(sensor, near, far, 2 * column + 1)
    row = sensor.camera.height // 2
    measured = ranges_of(sensor, split, only(flying_pixels=True, wrapping=True, reflectance=True, incidence=True))[0, row]
    sub = sensor.camera.scaled(2).range_over_depth[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
    ranges = sub * [near, far]
    energy = 1 / sub / ranges**2  # cosine of incidence on these walls is 1 / (range over depth)
    expected = 0.0
    for f in frequencies:
        phase = np.angle(np.sum(energy * np.exp(4j * np.pi * f * ranges / C)))
        turns = round(0.9 * 2 * f / C - phase / (2 * np.pi))
        expected += (turns + phase / (2 * np.pi)) * C / (2 * f) * f**2 / np.sum(np.square(frequencies))
    assert measured[column] == pytest.approx(expected, abs=1e-5)
    assert ranges.min() < measured[column] < ranges.max()
    # Nearer to the near wall than the mean of the depths: it returns more light.
    assert measured[column] < ranges.mean() - 0.02
    factor = sensor.camera.range_over_depth[row]
    assert measured[column - 1] == pytest.approx(near * factor[column - 1], abs=1e-4)
    assert measured[column + 1] == pytest.approx(far * factor[column + 1], abs=1e-4)


def test_inconsistent_phases_are_invalid() -> None:
    """Dark trim before a white wall in one pixel: the phases that the sums have belong to no single distance."""
    sensor = small_sensor(frequencies_hz=(80e6, 60e6))
    near, far, column = 0.65, 1.65, 40
    split = step_edge(sensor, near, far, 2 * column + 1)
    depth, cosine, material = samples(split)
    material[:, : 2 * column + 1] = MATERIAL_ID["soft_trim"]
    split = GeometryBuffers.dense(2, depth, cosine, material)
    mixed = {"flying_pixels": True, "wrapping": True, "reflectance": True}
    rho = [MATERIALS[MATERIAL_ID[name]].reflectance for name in ("soft_trim", WHITE)]
    row = sensor.camera.height // 2
    sub = sensor.camera.scaled(2).range_over_depth[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
    ranges = sub * [near, far]
    t1, t2 = (np.angle(np.sum(rho * np.exp(4j * np.pi * f * ranges / C) / ranges**2)) / (2 * np.pi) for f in (80e6, 60e6))
    difference = 4 * t2 - 3 * t1
    assert abs(difference - round(difference)) > 0.25
    kept = ranges_of(sensor, split, only(**mixed))[0, row]
    dropped = ranges_of(sensor, split, only(**mixed, consistency=True))[0, row]
    assert np.isfinite(kept).all()
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(dropped)), [column])


def test_blur_spreads_light_and_keeps_its_sum() -> None:
    sensor = small_sensor()
    shape = (sensor.camera.height, sensor.camera.width)
    ranges = np.full(shape, 2.0)
    ranges[30, 40] = 0.25
    share = 0.1
    lit = sphere_of_range(sensor, ranges)
    sharp, soft = (simulate(lit, sensor, only(blur=b), rng=generator(1, 1)).amplitude.astype(float) for b in (0.0, share))
    kernel = np.outer((share, 1 - 2 * share, share), (share, 1 - 2 * share, share))
    spot = sharp[30, 40]
    # In phase the spot's light adds to what its neighbours have; at a quarter and less of the spot's they stay small beside it.
    np.testing.assert_allclose(soft[29:32, 39:42] / spot, kernel, atol=0.02)
    np.testing.assert_allclose(soft[:25], sharp[:25], atol=1)


def test_edges_go_by_the_depth_that_is_delivered() -> None:
    """Bright near light reaches by the lens' blur a pixel that the geometry at the centres has well behind the edge."""
    sensor = small_sensor()
    split = step_edge(sensor, 0.4, 1.4, 81)  # in the middle of pixel 40, whose centre is on the far wall
    mixed = {"flying_pixels": True, "blur": 0.1, "reflectance": True}
    kept, cleaned = (
        simulate(split, sensor, only(**mixed, remove_edges=out), rng=generator(1, 1)).depth_m for out in (False, True)
    )
    off_walls = np.minimum(np.abs(kept - 0.4), np.abs(kept - 1.4)) > 0.05
    np.testing.assert_array_equal(np.flatnonzero(off_walls.any(axis=0)), [41])
    gone = np.isnan(cleaned)
    np.testing.assert_array_equal(np.flatnonzero(gone.any(axis=0)), [39, 40, 41, 42])
    assert gone[:, 39:43].all()
    np.testing.assert_array_equal(cleaned[~gone], kept[~gone])


@pytest.mark.parametrize("holes", [True, False])
def test_neighbours_are_counted_as_by_definition(holes: bool) -> None:
    """Noise, holes and a slope: the count of a loop over all windows of 3 x 3, without borders."""
    rng = generator(7, 7)
    depth = (1.0 + 0.01 * np.arange(40) + rng.normal(0, 0.02, (30, 40))).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.nan
    rule = PhysicalNoise(edge_tolerance=0.03, edge_threshold_m=0.035, edge_neighbours=6, edge_holes=holes)

    def few(window: np.ndarray) -> bool:
        near = np.abs(window - window[4]) <= min(0.035, 0.03 * window[4])
        ignored = 0 if holes else 9 if np.isnan(window[4]) else np.isnan(window).sum()
        return near.sum() - near[4] + ignored < 6

    expected = ndimage.generic_filter(depth.astype(np.float64), few, 3)[1:-1, 1:-1] > 0
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(edge_pixels(depth, rule)[1:-1, 1:-1], expected)


def test_without_flying_pixels_no_depth_lies_between() -> None:
    sensor = small_sensor()
    depth = simulate(step_edge(sensor, 0.7, 1.1, 81), sensor, NO_EFFECTS, rng=generator(1, 1)).depth_m
    assert np.all((np.abs(depth - 0.7) < 1e-3) | (np.abs(depth - 1.1) < 1e-3))


@pytest.mark.parametrize("slope", [0.0, 0.01, 0.03])
def test_the_centre_of_a_smooth_pixel_stands_for_its_parts(slope: float) -> None:
    """A tilted wall, depth (1 + slope u) m at u pixels from the middle: with and without parts, far below the noise."""
    sensor = small_sensor()
    fine = sensor.camera.scaled(2)
    x, normal = fine.rays[..., 0], np.array([slope * sensor.camera.fx, 1.0])
    depth = 1.0 / (1.0 - normal[0] * np.where(np.abs(x) < 10 / sensor.camera.fx, x, 0.0))
    rays = np.concatenate((fine.rays, np.ones((*x.shape, 1))), axis=-1)
    tilt = np.array([-normal[0], 0.0, 1.0])
    cosine = (rays @ tilt) / np.linalg.norm(tilt) / np.linalg.norm(rays, axis=-1)
    material = np.full(x.shape, MATERIAL_ID[WHITE], np.uint8)
    dense = GeometryBuffers.dense(2, depth.astype(np.float32), np.abs(cosine).astype(np.float32), material)
    ray = sensor.camera.rays
    z = 1.0 / (1.0 - normal[0] * ray[..., 0])
    tilted = np.concatenate((ray, np.ones((*z.shape, 1))), axis=-1)
    one = (tilted @ tilt) / np.linalg.norm(tilt) / np.linalg.norm(tilted, axis=-1)
    centre = GeometryBuffers.dense(1, z.astype(np.float32), np.abs(one).astype(np.float32), material[::2, ::2])
    parts, whole = (simulate(b, sensor, only(flying_pixels=True, incidence=True), rng=generator(1, 1)) for b in (dense, centre))
    near = np.abs(ray[..., 0]) < 9 / sensor.camera.fx
    difference = np.abs(parts.depth_m - whole.depth_m)[near]
    assert difference.max() < (1e-4 if slope < 0.02 else 4e-4)
    brightness = np.abs(parts.amplitude[near] / whole.amplitude[near].astype(float) - 1)
    assert brightness.max() < 1e-3 + 1 / whole.amplitude[near].min()


# ------------------------------------------------------------------------------------------------- wrapping, second frequency


def test_one_frequency_wraps_at_its_wavelength() -> None:
    sensor = small_sensor()
    wrap = C / (2 * 50e6)
    for distance in (wrap + 0.4, 2 * wrap + 1.3):
        assert ranges_of(sensor, flat_range(sensor, distance), only(wrapping=True)).mean() == pytest.approx(
            distance % wrap, abs=1e-5
        )
        assert ranges_of(sensor, flat_range(sensor, distance), NO_EFFECTS).mean() == pytest.approx(distance, abs=1e-5)


@pytest.mark.parametrize("frequencies", [(80e6, 60e6), (60e6, 80e6), (50e6, 30e6), (100e6, 80e6), (40e6, 20e6)])
def test_a_second_frequency_unwraps_to_the_common_period(frequencies: tuple[float, float]) -> None:
    sensor = small_sensor(frequencies_hz=frequencies, range_m=(0.05, 20.0))
    common = C / 2 / np.gcd(*(round(f) for f in frequencies))
    assert unambiguous_range(sensor) == pytest.approx(common)
    shape = (sensor.camera.height, sensor.camera.width)
    truth = np.linspace(0.01, 1.98 * common, shape[0] * shape[1]).reshape(shape)
    keep = np.abs(truth / common - 1) > 0.001
    measured = ranges_of(sensor, sphere_of_range(sensor, truth), only(wrapping=True))[0]
    np.testing.assert_allclose(measured[keep], (truth % common)[keep], atol=2e-5)
    single = ranges_of(sensor, sphere_of_range(sensor, truth), only(wrapping=True, second_frequency=False))[0]
    wave = C / (2 * frequencies[0])
    far_from_wrap = np.abs((truth + wave / 2) % wave - wave / 2) > 1e-3
    np.testing.assert_allclose(single[far_from_wrap], (truth % wave)[far_from_wrap], atol=2e-5)


def test_preset_ranges_fit_their_modulation() -> None:
    for name, sensor in OWN_SENSORS.items():
        assert sensor.range_m[1] < unambiguous_range(sensor), name


# --------------------------------------------------------------------------------------------- full well, window, field, floor


def test_full_well_clips_near_surfaces() -> None:
    """The fullest tap holds N / 2 (1 + K |cos phase|) or the same with the sine; beyond the well the pixel is invalid."""
    sensor = small_sensor(full_well_e=20_000.0)
    shape = (sensor.camera.height, sensor.camera.width)
    truth = np.linspace(0.1, 0.6, shape[0] * shape[1]).reshape(shape)
    frame = simulate(sphere_of_range(sensor, truth), sensor, only(full_well=True), rng=generator(1, 1))
    phase = 4 * np.pi * 50e6 * truth / C
    fullest = 4.1e6 * 7e-4 / truth**2 / 2 * (1 + 0.75 * np.maximum(np.abs(np.cos(phase)), np.abs(np.sin(phase))))
    border = np.abs(fullest / 20_000.0 - 1) < 1e-3
    np.testing.assert_array_equal(np.isnan(frame.depth_m)[~border], (fullest > 20_000.0)[~border])
    assert 0.05 < np.isnan(frame.depth_m).mean() < 0.95
    assert (frame.confidence[np.isnan(frame.depth_m)] == 0).all()
    free = simulate(sphere_of_range(sensor, truth), sensor, NO_EFFECTS, rng=generator(1, 1))
    assert np.isfinite(free.depth_m).all()
    assert frame.amplitude.max() < free.amplitude.max()


def test_range_window_is_on_depth() -> None:
    sensor = use_case(3)
    window = only(range_window=True, circular_field=True)
    for depth, inside in ((0.49, False), (0.51, True), (1.49, True), (1.51, False)):
        valid = np.isfinite(simulate(wall(sensor, depth, 1), sensor, window, rng=generator(1, 1)).depth_m)
        assert valid[100:190, 100:250].all() == inside
        assert valid[100:190, 100:250].any() == inside


def test_circular_field_is_a_circle() -> None:
    sensor = use_case(3)
    frame = simulate(wall(sensor, 1.0, 1), sensor, only(circular_field=True), rng=generator(1, 1))
    v, u = np.mgrid[: sensor.camera.height, : sensor.camera.width]
    radius = np.hypot(u - sensor.camera.cx, v - sensor.camera.cy)
    np.testing.assert_array_equal(np.isfinite(frame.depth_m), radius < sensor.field_radius_px)
    assert np.isnan(frame.depth_m).sum() > 1000
    assert (frame.amplitude[radius >= sensor.field_radius_px] == 0).all()


def test_low_amplitude_is_invalid() -> None:
    sensor = small_sensor(min_amplitude_e=100.0)
    shape = (sensor.camera.height, sensor.camera.width)
    truth = np.linspace(2.0, 8.0, shape[0] * shape[1]).reshape(shape)
    frame = simulate(sphere_of_range(sensor, truth), sensor, only(low_amplitude=True), rng=generator(1, 1))
    amplitude = 4.1e6 * 7e-4 * 0.75 / truth**2
    border = np.abs(amplitude - 100) < 0.5
    np.testing.assert_array_equal(np.isfinite(frame.depth_m)[~border], (amplitude > 100)[~border])
    np.testing.assert_allclose(frame.amplitude, amplitude, atol=0.51)


# ------------------------------------------------------------------------------------------------------------- light


def test_amplitude_falls_with_range_incidence_reflectance_and_lens() -> None:
    sensor = SENSORS["pico_monstar_105"]
    lit = only(reflectance=True, incidence=True, vignetting=True)
    frame = simulate(wall(sensor, 1.0, 1), sensor, lit, rng=generator(1, 1))
    ray = sensor.camera.range_over_depth
    rho = MATERIALS[MATERIAL_ID[WHITE]].reflectance
    # 1 / r^2 and the cosine of incidence give cos^3, the lens cos^4, the light cos^-2.
    expected = sensor.signal_e * sensor.contrast * rho * ray ** -(3.0 + 4.0 - 2.0)
    np.testing.assert_allclose(frame.amplitude, expected, atol=0.51, rtol=1e-3)


def test_window_panes_return_next_to_nothing() -> None:
    sensor = SENSORS["pico_monstar_105"]
    flat = wall(sensor, 1.0, material="glass")
    depth, cosine, material = samples(flat)
    steep = GeometryBuffers.dense(2, depth, np.full_like(cosine, 0.6), material)
    full = PhysicalNoise()
    with_glass = simulate(steep, sensor, full, rng=generator(1, 1))
    assert np.isfinite(with_glass.depth_m).mean() < 0.05
    without = simulate(steep, sensor, full.model_copy(update={"glass": False}), rng=generator(1, 1))
    assert np.isfinite(without.depth_m).mean() > 3 * np.isfinite(with_glass.depth_m).mean()
    # Square to the ray the pane is a mirror: a spot that saturates, in the middle and nowhere else.
    facing = simulate(flat, sensor, only(glass=True, full_well=True), rng=generator(1, 1))
    assert np.isnan(facing.depth_m[141:146, 173:179]).all()
    assert np.isnan(facing.depth_m).mean() < 0.02


def test_nothing_hit_is_invalid() -> None:
    sensor = use_case(3)
    flat = wall(sensor, 1.0, 1)
    empty = GeometryBuffers.dense(1, np.zeros_like(flat.depth_m), np.zeros_like(flat.cos_incidence), np.zeros_like(flat.material))
    frame = simulate(empty, sensor, PhysicalNoise(), rng=generator(1, 1))
    assert np.isfinite(frame.depth_m).mean() < 0.03
    silent = simulate(empty, sensor, NO_EFFECTS, rng=generator(1, 1))
    assert np.isnan(silent.depth_m).all()
    assert (silent.amplitude == 0).all()


def test_stray_light_pulls_dark_pixels_towards_the_mean() -> None:
    sensor = small_sensor()
    shape = (sensor.camera.height, sensor.camera.width)
    ranges = np.full(shape, 0.5)
    ranges[20:30, 20:30] = 1.6
    share = 0.01
    stray = ranges_of(sensor, sphere_of_range(sensor, ranges), only(stray_light=share))[0]
    phasors = np.exp(4j * np.pi * 50e6 * ranges / C) / ranges**2
    expected = np.angle(phasors[25, 25] + share * phasors.mean()) % (2 * np.pi) * C / (4 * np.pi * 50e6)
    assert stray[25, 25] == pytest.approx(expected, abs=1e-5)
    assert expected < 1.6 - 0.01


def test_pixels_outside_the_lens_model_send_no_stray_light() -> None:
    barrel = Camera(80, 60, 40.0, 40.0, 39.5, 29.5, (-0.35, 0.02, 0.0, 0.0, 0.0))
    sensor = small_sensor(camera=barrel)
    rays = np.isfinite(barrel.range_over_depth)
    assert 0.3 < rays.mean() < 0.7
    shape = (120, 160)
    flat = GeometryBuffers.dense(
        2, np.ones(shape, np.float32), np.ones(shape, np.float32), np.full(shape, MATERIAL_ID[WHITE], np.uint8)
    )
    frame = simulate(flat, sensor, PhysicalNoise(), rng=generator(1, 1))
    assert not np.isfinite(frame.depth_m[~rays]).any()
    assert (frame.amplitude[~rays] == 0).all()
    assert np.isfinite(frame.depth_m[rays]).mean() > 0.95


# ------------------------------------------------------------------------------------------------------------ switches

SWITCHES: dict[str, object] = {
    "shot_noise": False, "read_noise": False, "full_well": False, "flying_pixels": False, "blur": 0.0, "wrapping": False,
    "second_frequency": False, "consistency": False, "wiggling": 0.0, "stray_light": 0.0, "ambient": 0.0, "daylight": 0.0,
    "reflectance": False, "incidence": False, "vignetting": False, "glass": False, "range_window": False,
    "low_amplitude": False, "circular_field": False, "remove_edges": True, "sun": 200.0, "fixed_pattern_mm": 5.0,
    "fixed_pattern_gain": 0.01, "low_amplitude_spread": 0.4,
    "light_offset_m": 0.05, "multipath": True, "lens_scatter": 0.05,
}  # fmt: skip
# Fields that only say how a switch of them acts, with that switch.
DETAILS: dict[str, tuple[object, dict[str, object]]] = {
    "edge_threshold_m": (0.01, {"remove_edges": True}), "edge_width_px": (3, {"remove_edges": True}),
    "edge_tolerance": (0.01, {"remove_edges": True}), "edge_neighbours": (4, {"remove_edges": True}),
    "edge_holes": (False, {"remove_edges": True}),
    "sun_width_m": (0.1, {"sun": 200.0}), "fixed_pattern_seed": (1, {"fixed_pattern_mm": 5.0}),
    "multipath_unseen": (0.5, {"multipath": True}), "lens_scatter_px": (60.0, {"lens_scatter": 0.05}),
}  # fmt: skip


def busy_scene(sensor: Sensor) -> GeometryBuffers:
    """Walls before and behind the window, one too near, one beyond the wrap, an edge and a pane, tilted."""
    flat = wall(sensor, 1.2)
    depth, cosine, material = samples(flat)
    height, width = depth.shape
    depth[:, : width // 5] = 0.04
    depth[: height // 4, width // 2 :] = 4.0
    depth[height // 2 :, width // 2 + 1 :] = 0.7
    depth[:, -width // 8 :] = 8.0
    material[: height // 3, width // 3 : width // 2] = MATERIAL_ID["glass"]
    material[height // 3 : height // 2, width // 3 : width // 2] = MATERIAL_ID["rubber"]
    return GeometryBuffers.dense(2, depth, np.float32(0.8) * cosine, material)


@pytest.mark.parametrize("switch", [*SWITCHES, *DETAILS])
def test_every_switch_matters(switch: str) -> None:
    sensor = use_case(3)
    scene = busy_scene(sensor)
    value, others = DETAILS.get(switch) or (SWITCHES[switch], {})
    # A floor and a window that hide little, so that what lies under them shows.
    default = PhysicalNoise(range_window=switch == "range_window", low_amplitude=switch.startswith("low_amplitude"), **others)
    changed = default.model_copy(update={switch: value})
    a, b = (simulate(scene, sensor, noise, rng=generator(3, 3)) for noise in (default, changed))
    assert default != changed
    assert not np.array_equal(a.depth_m, b.depth_m, equal_nan=True)


def test_the_switches_are_all_there_are() -> None:
    assert {*SWITCHES, *DETAILS} == set(PhysicalNoise.model_fields) - {"kind", "effects"}


# --------------------------------------------------------------------------------------------------------- what it promises


def test_same_random_numbers_same_bytes() -> None:
    sensor = use_case(4)
    scene = busy_scene(sensor)
    frames = [simulate(scene, sensor, PhysicalNoise(), rng=generator(2, i)) for i in (1, 1, 2)]
    for name in ("depth_m", "amplitude", "confidence"):
        first, again, other = (getattr(frame, name).tobytes() for frame in frames)
        assert first == again
        assert first != other


@pytest.mark.parametrize("supersample", [2, 3])
def test_mixed_pixels_come_in_any_order(supersample: int) -> None:
    sensor = use_case(3)
    flat = step_edge(sensor, 0.8, 1.3, 150, supersample)
    order = generator(5, supersample).permutation(len(flat.mixed))
    parts = (flat.parts_depth_m, flat.parts_cos_incidence, flat.parts_material)
    shuffled = replace(
        flat,
        mixed=flat.mixed[order],
        **{f"parts_{n}": a[order] for n, a in zip(("depth_m", "cos_incidence", "material"), parts, strict=True)},
    )
    a, b = (simulate(buffers, sensor, PhysicalNoise(), rng=generator(1, 1)) for buffers in (flat, shuffled))
    for one, other in zip(a, b, strict=True):
        np.testing.assert_array_equal(one, other)


def test_threads_do_not_disturb_each_other() -> None:
    sensor = use_case(3)
    scene = busy_scene(sensor)

    def depth(frame: int) -> bytes:
        return simulate(scene, sensor, PhysicalNoise(), rng=generator(4, frame)).depth_m.tobytes()

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(depth, range(8))) == [depth(frame) for frame in range(8)]


def test_dtypes_and_invalid_pixels() -> None:
    frame = simulate(busy_scene(use_case(3)), use_case(3), PhysicalNoise(), rng=generator(2, 2))
    assert (frame.depth_m.dtype, frame.amplitude.dtype, frame.confidence.dtype) == (np.float32, np.uint16, np.uint8)
    np.testing.assert_array_equal(np.isnan(frame.depth_m), frame.confidence == 0)


def test_confidence_falls_with_noise() -> None:
    sensor = small_sensor()
    shape = (sensor.camera.height, sensor.camera.width)
    truth = np.linspace(0.4, 2.9, shape[0] * shape[1]).reshape(shape)
    frame = simulate(sphere_of_range(sensor, truth), sensor, only(shot_noise=True, read_noise=True), rng=generator(1, 1))
    rows = frame.confidence.mean(axis=1)
    assert rows[0] > rows[len(rows) // 2] > rows[-1] > 0
    assert np.all(np.diff(rows[::8]) < 0)


def test_white_wall_follows_the_measured_camera() -> None:
    """Image mean of the temporal sigma, as in the thesis' equation 5.12: 1 + 5 z + 1 z^2 mm in use case 3, within 10 %."""
    sensor = use_case(3)
    noise = PhysicalNoise(range_window=False)
    for depth in (0.5, 1.0, 1.5):
        white = wall(sensor, depth)
        frames = np.stack([simulate(white, sensor, noise, rng=generator(9, i)).depth_m for i in range(12)])
        seen = np.isfinite(frames).all(axis=0)
        sigma = frames[:, seen].std(axis=0, ddof=1).mean() * 1e3
        assert seen.mean() > 0.85
        assert sigma == pytest.approx(1 + 5 * depth + depth**2, rel=0.10), depth


def test_a_structured_light_camera_has_no_phase() -> None:
    sensor = SENSORS["kinect_v1"]
    with pytest.raises(ConfigError) as error:
        simulate(wall(sensor, 2.0), sensor, PhysicalNoise(), rng=generator(1, 1))
    assert "structured_light" in str(error.value.hint)


def test_geometry_of_another_camera_is_refused() -> None:
    with pytest.raises(ConfigError, match="pixels"):
        simulate(wall(SENSORS["evk75023"], 1.0), use_case(3), PhysicalNoise(), rng=generator(1, 1))
