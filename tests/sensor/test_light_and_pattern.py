"""Sunlight, the light source's shadow, the floor's spread and fixed pattern noise against what they are in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from sensor_scenes import WHITE, generator, samples, small_sensor, sphere_of_range, step_edge, wall

from cabinpose.core.camera import Camera
from cabinpose.scene.materials import MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import NO_EFFECTS, GeometryBuffers, PhysicalNoise, simulate
from cabinpose.scene.sensor.shade import light_shadow, sunlit

C = 299_792_458.0


def only(**effects: object) -> PhysicalNoise:
    return NO_EFFECTS.model_copy(update=effects)


# --------------------------------------------------------------------------------------------------------------- pattern


def test_the_pattern_is_the_same_in_all_frames_and_has_its_size() -> None:
    """Offset and gain in range; the noise over time does not see them, that over pixels sees nothing else."""
    sensor = small_sensor()
    noise = only(fixed_pattern_mm=4.0, fixed_pattern_gain=0.003)
    errors = {}
    for z in (0.5, 2.0):
        frames = np.stack([simulate(wall(sensor, z), sensor, noise, rng=generator(1, i)).depth_m for i in range(3)])
        assert (frames == frames[0]).all()
        errors[z] = (frames[0] - z) * sensor.camera.range_over_depth
        sigma = np.hypot(4e-3, 0.003 * z * sensor.camera.range_over_depth.mean())
        assert errors[z].std() == pytest.approx(sigma, rel=0.03)
        assert abs(errors[z].mean()) < 4 * sigma / np.sqrt(errors[z].size)
    # Two distances tell offset and gain of each pixel apart; they have nothing to do with each other.
    ratio = sensor.camera.range_over_depth
    gain = (errors[2.0] - errors[0.5]) / (1.5 * ratio)
    offset = errors[0.5] - gain * 0.5 * ratio
    assert gain.std() == pytest.approx(0.003, rel=0.03)
    assert offset.std() == pytest.approx(4e-3, rel=0.03)
    assert abs(np.corrcoef(gain.ravel(), offset.ravel())[0, 1]) < 0.05


def test_another_camera_has_another_pattern() -> None:
    sensor = small_sensor()
    frames = [
        simulate(wall(sensor, 1.0), sensor, only(fixed_pattern_mm=4.0, fixed_pattern_seed=s), rng=generator(1, 1))
        for s in (0, 1, 0)
    ]
    a, b, again = (frame.depth_m.ravel() - 1 for frame in frames)
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.05
    np.testing.assert_array_equal(a, again)


def test_the_pattern_keeps_to_the_range_window() -> None:
    sensor = small_sensor(range_m=(0.2, 1.0))
    noise = only(fixed_pattern_mm=4.0, range_window=True)
    frame = simulate(wall(sensor, 0.999), sensor, noise, rng=generator(1, 1))
    seen = np.isfinite(frame.depth_m)
    assert 0.2 < seen.mean() < 0.8
    assert frame.depth_m[seen].max() <= 1.0
    np.testing.assert_array_equal(frame.confidence == 0, ~seen)


# ----------------------------------------------------------------------------------------------------------------- floor


def test_the_floor_of_amplitudes_has_its_spread() -> None:
    """Lost is the share of a log-normal floor that is above the amplitude: its normal distribution function, by amplitude."""
    sensor = small_sensor(min_amplitude_e=300.0)
    scene = sphere_of_range(sensor, np.linspace(1.0, 3.2, 72)[:, None] * np.ones((1, 96)))
    noise = only(low_amplitude=True, low_amplitude_spread=0.4)
    frames = [simulate(scene, sensor, noise, rng=generator(6, i)) for i in range(40)]
    amplitude = frames[0].amplitude[:, 0].astype(float)  # the same all along a row, without noise
    lost = np.mean([np.isnan(frame.depth_m) for frame in frames], axis=(0, 2))
    expected = stats.norm.cdf(np.log(300.0 / amplitude) / 0.4)
    assert expected.max() > 0.8
    assert expected.min() < 0.01
    np.testing.assert_allclose(lost, expected, atol=5 * np.sqrt(0.25 / (40 * 96)))
    assert np.isnan(frames[0].depth_m).tobytes() != np.isnan(frames[1].depth_m).tobytes()


# ---------------------------------------------------------------------------------------------------------------- shadow


@pytest.mark.parametrize("offset", [0.05, -0.05, 0.02])
def test_a_bar_throws_a_shadow_of_its_width_beside_itself(offset: float) -> None:
    """f b (1 / near - 1 / far) pixels beside a bar, away from the source, and as wide as the bar, whether it touches or not."""
    camera = Camera(400, 20, 200.0, 200.0, 199.5, 9.5)
    near, far, first, last = 0.4, 1.6, 180, 190
    depth = np.full((20, 400), far, np.float32)
    depth[:, first:last] = near
    shadow = light_shadow(depth, camera, offset)
    shift = 200 * offset * (1 / near - 1 / far)  # 18.75 px for 5 cm
    columns = np.arange(400)
    expected = (columns + shift > first - 0.5) & (columns + shift < last - 0.5) & ((columns < first) | (columns >= last))
    assert (shadow == shadow[0]).all()
    assert abs(int(shadow[0].sum()) - int(expected.sum())) <= 2
    assert (np.abs(np.flatnonzero(shadow[0])[[0, -1]] - np.flatnonzero(expected)[[0, -1]]) <= 1).all()
    assert not light_shadow(depth, camera, 0.0).any()


def test_no_surface_shades_itself_in_the_light() -> None:
    """A wall at a slant, and a ball: what faces the source is lit, all of it."""
    camera = Camera.from_fov(320, 240, 1.2)
    x, y = np.moveaxis(camera.rays, -1, 0)
    wall_depth = (1.2 / (0.7 * x + 0.2 * y + 1.0)).astype(np.float32)
    assert not light_shadow(wall_depth, camera, 0.06).any()
    b, c = 0.8, 0.8**2 - 0.3**2  # a ball of 0.3 m at 0.8 m
    root = b * b - (1 + x * x + y * y) * c
    on = root > 0
    depth = np.where(on, (b - np.sqrt(np.maximum(root, 0))) / (1 + x * x + y * y), 3.0).astype(np.float32)
    shadow = light_shadow(depth, camera, 0.06)
    points = camera.points(depth)
    outward = (points - (0, 0, 0.8)) / 0.3
    to_source = np.array((0.06, 0.0, 0.0)) - points
    cosine = np.sum(outward * to_source, axis=-1) / np.linalg.norm(to_source, axis=-1)
    assert not shadow[on & (cosine > 0.2)].any()
    assert shadow[~on].sum() > 500  # on the wall behind


def test_a_surface_that_turns_to_the_source_has_no_holes() -> None:
    """Its pixels are wider for the source than for the camera: its shadow is one piece nevertheless."""
    camera = Camera(400, 4, 200.0, 200.0, 199.5, 1.5)
    depth = np.full((4, 400), 1.6, np.float32)
    depth[:, 200:220] = np.linspace(0.35, 0.6, 20)
    shadow = np.flatnonzero(light_shadow(depth, camera, 0.05)[0])
    assert len(shadow) > 10
    assert (np.diff(shadow) == 1).all()


@pytest.mark.parametrize("parts", [False, True])
def test_what_the_light_does_not_reach_has_no_depth(parts: bool) -> None:
    sensor = small_sensor(min_amplitude_e=10.0)
    edge = step_edge(sensor, 0.5, 1.4, 80)
    shadow = light_shadow(edge.depth_m, sensor.camera, -0.03)
    dark, bright = (
        simulate(
            edge,
            sensor,
            only(light_offset_m=offset, incidence=True, low_amplitude=True, flying_pixels=parts),
            rng=generator(1, 1),
        )
        for offset in (-0.03, 0.0)
    )
    assert shadow.sum() > 72
    assert np.isnan(dark.depth_m[shadow]).all()
    assert (dark.amplitude[shadow] == 0).all()
    np.testing.assert_array_equal(dark.depth_m[~shadow], bright.depth_m[~shadow])


# ------------------------------------------------------------------------------------------------------------------- sun


def test_the_beam_is_a_disk_of_its_width_on_a_wall() -> None:
    """Seen along the beam, an ellipse on the wall of area pi w^2 / (4 cos), with that one cosine on all of it."""
    camera = Camera.from_fov(320, 240, 1.2)
    depth = np.full((240, 320), 1.5, np.float32)
    for i in range(12):
        lit = sunlit(depth, np.ones_like(depth, bool), camera, 0.3, rng=generator(7, i))
        on = lit > 0
        cosine = float(np.median(lit[on]))
        np.testing.assert_allclose(lit[on], cosine, atol=2e-3)
        assert 0.29 < cosine <= 1.0
        v, u = np.nonzero(on)
        if u.min() == 0 or v.min() == 0 or u.max() == 319 or v.max() == 239:
            continue  # cut by the image's border
        area = on.sum() * (1.5 / camera.fx) ** 2
        assert area == pytest.approx(np.pi * 0.15**2 / cosine, rel=0.03)


@pytest.mark.slow
def test_a_board_throws_its_shadow_on_the_wall() -> None:
    """Parallel light: the shadow of a board parallel to the wall is as large as the board, wherever it falls."""
    camera = Camera.from_fov(320, 240, 1.2)
    depth = np.full((240, 320), 1.5, np.float32)
    depth[100:140, 130:190] = 1.1
    board = depth < 1.3
    sides = np.array((60, 40)) * 1.1 / camera.fx
    size, widened = np.prod(sides), np.prod(sides + 0.04)  # shade is worked out on a grid of 2 cm
    whole = 0
    for i in range(60):
        lit = sunlit(depth, np.ones_like(board), camera, 20.0, rng=generator(8, i))
        assert (lit[board] > 0).all()
        shade = ~board & (lit == 0)
        v, u = np.nonzero(shade)
        touches = any((shade & np.roll(board, (dv, du), (0, 1))).any() for dv, du in ((0, 1), (0, -1), (1, 0), (-1, 0)))
        if not v.size or touches or u.min() == 0 or v.min() == 0 or u.max() == 319 or v.max() == 239:
            continue  # part of it is hidden by the board, or outside the image
        whole += 1
        assert 0.95 * size < shade.sum() * (1.5 / camera.fx) ** 2 < widened
    assert whole >= 5
    facing = np.zeros_like(board)
    facing[110:130, 150:170] = True  # only a part of the board may be lit
    lit = sunlit(depth, facing, camera, 0.1, rng=generator(8, 0))
    assert (lit[~facing] == 0).all()
    assert (lit[facing] > 0).any()


def test_sunlight_is_shot_noise_and_then_saturates() -> None:
    """In the beam sigma follows the closed form with ambient light of sun x cosine; with more of it the wells are full."""
    sensor = small_sensor(read_noise_e=0.0)
    flat = wall(sensor, 1.0)
    rho = MATERIALS[MATERIAL_ID[WHITE]].reflectance
    ratio = sensor.camera.range_over_depth
    signal = sensor.signal_e * rho / ratio / ratio**2
    sun = 20.0
    noise = only(shot_noise=True, reflectance=True, incidence=True, sun=sun, sun_width_m=9.0, full_well=True)

    def lit() -> np.ndarray:
        return sunlit(flat.depth_m, np.ones(flat.shape, bool), sensor.camera, 9.0, rng=generator(3, 3))

    assert (lit() > 0).all()
    depth = simulate(flat, sensor, noise, rng=generator(3, 3)).depth_m
    ambient = sensor.signal_e * rho * sun * lit()
    sigma = C / (4 * np.pi * 50e6) * np.sqrt(signal + ambient) / (np.sqrt(2) * signal * sensor.contrast)
    error = (depth - 1.0) * ratio / sigma
    assert np.isfinite(depth).all()
    assert error.std() == pytest.approx(1.0, rel=0.03)
    # A tap holds half of the light; beyond twice the full well the pixel is invalid.
    full = 2.2 * sensor.full_well_e / (sensor.signal_e * rho * float(lit().min()))
    assert np.isnan(simulate(flat, sensor, noise.model_copy(update={"sun": full}), rng=generator(3, 3)).depth_m).all()


def test_the_sun_leaves_all_else_alone() -> None:
    """Outside the beam depth, noise and amplitude are those of the frame without sun, from the same random numbers on."""
    sensor = small_sensor()
    edge = step_edge(sensor, 0.8, 1.4, 80)
    depth, cosine, material = samples(edge)
    material[:40] = MATERIAL_ID["glass"]
    scene = GeometryBuffers.dense(2, depth, cosine, material)
    noise = PhysicalNoise(sun=500.0, sun_width_m=0.1, range_window=False, low_amplitude=False)
    inside = np.ones(scene.shape, bool)
    inside[:20] = False
    rng = generator(4, 4)
    lit = sunlit(scene.depth_m, inside, sensor.camera, 0.1, rng=rng) > 0
    frame = simulate(scene, sensor, noise, rng=generator(4, 4))
    without = simulate(scene, sensor, noise.model_copy(update={"sun": 0.0}), rng=rng)
    near_sun = np.zeros_like(lit)  # the lens blurs by a pixel
    for v in (-1, 0, 1):
        for u in (-1, 0, 1):
            near_sun |= np.roll(lit, (v, u), (0, 1))
    assert 20 < lit.sum() < 4000
    assert not lit[:20].any()
    np.testing.assert_array_equal(frame.depth_m[~near_sun], without.depth_m[~near_sun])
    assert np.isnan(frame.depth_m[lit]).mean() > 0.5
    np.testing.assert_array_equal(frame.amplitude[~near_sun], without.amplitude[~near_sun])
