"""The wall experiment: what was put into frames of walls comes out of the fit.

Two oracles: frames drawn by numpy alone, tap by tap, as Poisson counts, and the simulated camera.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from sensor_scenes import generator, small_sensor, use_case, wall

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.scene.sensor import EmpiricalNoise, PhysicalNoise, Sensor, simulate
from cabinpose.scene.sensor.noise_fit import fit_empirical, fit_physical
from cabinpose.scene.sensor.walls import Wall, walls_of_frames

C = 299_792_458.0
DISTANCES = (0.4, 0.5, 0.6, 0.75, 0.9, 1.1, 1.3, 1.6, 1.9, 2.3)
Frame = tuple[np.ndarray, np.ndarray | None]


def recorded(
    sensor: Sensor, noise: PhysicalNoise | EmpiricalNoise, distances: Sequence[float], frames: int = 60, *, amplitude: bool = True
) -> list[Wall]:
    """The simulated camera before a wall."""

    def seen(k: int, distance: float) -> Iterator[Frame]:
        flat = wall(sensor, distance)
        for i in range(frames):
            frame = simulate(flat, sensor, noise, rng=generator(k, i))
            yield frame.depth_m, frame.amplitude if amplitude else None

    return [w for k, d in enumerate(distances) for w in walls_of_frames(seen(k, d), sensor.camera)]


def normal_frames(depth: np.ndarray, sigma: np.ndarray | float, count: int = 40, seed: int = 1) -> Iterator[Frame]:
    """Depth with Gaussian noise."""
    rng = generator(seed, 0)
    for _ in range(count):
        yield depth + sigma * rng.standard_normal(depth.shape), None


# ------------------------------------------------------------------------------------------------------------- the law


@pytest.mark.parametrize(
    "law", [(1.0, 5.0, 1.0), *(pytest.param(law, marks=pytest.mark.slow) for law in ((2.0, 1.5, 2.0), (0.5, 8.0, 1.0)))]
)
def test_the_measured_law_is_recovered(law: tuple[float, float, float]) -> None:
    """Within 3 % of each coefficient, by the simulated camera."""
    a, b, c = law
    put_in = EmpiricalNoise(a_mm=a, b_mm_per_m=b, c_mm_per_m2=c, range_window=False, remove_spikes=False)
    distances = (0.3, 0.4, 0.55, 0.75, 1.0, 1.4, 1.9, 2.6, 3.5, 4.5)
    fit = fit_empirical(recorded(use_case(3), put_in, distances, frames=25))
    for name, found in fit.parameters.items():
        assert found.value == pytest.approx(getattr(put_in, name), rel=0.03), name
        assert found.low < getattr(put_in, name) < found.high, name
    np.testing.assert_allclose(fit.fitted_m, fit.sigma_m, rtol=0.005)


def test_a_term_that_is_not_there_is_not_negative() -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    walls = [w for z in (0.5, 1.0, 2.0, 4.0) for w in walls_of_frames(normal_frames(np.full((72, 96), z), 2e-3 * z), camera)]
    fit = fit_empirical(walls)
    assert fit.parameters["b_mm_per_m"].value == pytest.approx(2.0, rel=0.03)
    assert all(found.value >= 0 for found in fit.parameters.values())
    assert fit.noise.a_mm < 0.03


def test_three_walls_have_intervals_of_their_pixels() -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    walls = [w for z in (0.6, 1.0, 1.6) for w in walls_of_frames(normal_frames(np.full((72, 96), z), 2e-3 * z), camera)]
    found = fit_empirical(walls).parameters["b_mm_per_m"]
    assert found.low < 2.0 < found.high
    assert found.high - found.low < 0.2


def test_what_is_fitted_as_zero_may_be_more() -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    frames = {z: normal_frames(np.full((72, 96), z), 3e-3 * z * z, 12) for z in (0.5, 1.0, 2.0, 4.0)}
    found = fit_empirical([w for z in frames for w in walls_of_frames(frames[z], camera)]).parameters
    assert found["a_mm"].value == 0.0
    assert 0.01 < found["a_mm"].high < 0.3
    assert found["c_mm_per_m2"].low < 3.0 < found["c_mm_per_m2"].high


# ------------------------------------------------------------------------------------------------- the pixels' figures


@pytest.mark.parametrize(
    ("fields", "ambient", "amplitude"),
    [
        ({}, None, True),
        ({"read_noise_e": 20.0, "signal_e_per_s": 2e6, "illumination_exponent": 2.0}, None, True),
        ({"read_noise_e": 30.0, "contrast": 0.5}, None, False),
        ({"read_noise_e": 20.0, "signal_e_per_s": 2e6, "frequencies_hz": (80e6, 60e6)}, 0.2, True),
        (
            {"read_noise_e": 10.0, "integration_s": 3e-4, "signal_e_per_s": 2e7, "camera": Camera.from_fov(120, 90, 1.4)},
            0.1,
            True,
        ),
    ],
)
def test_the_figures_of_a_simulated_camera_are_recovered(
    fields: dict[str, object], ambient: float | None, amplitude: bool
) -> None:
    """Within 3 %; `ambient` None: in the dark. Calibrated of wiggling, which bends the noise itself by its slope."""
    truth = small_sensor(**fields)
    noise = PhysicalNoise(range_window=False, wiggling=0.0, ambient=ambient or 0.0)
    walls = recorded(truth, noise, DISTANCES, amplitude=amplitude)
    unknown = {"signal_e_per_s": 1e6} | ({"read_noise_e": 1.0} if ambient is None else {})
    if amplitude:
        unknown |= {"illumination_exponent": 0.7}
    fit = fit_physical(walls, truth.model_copy(update=unknown), dark=ambient is None)
    assert fit.sensor.signal_e_per_s == pytest.approx(truth.signal_e_per_s, rel=0.03)
    if ambient is None:
        assert fit.sensor.read_noise_e == pytest.approx(truth.read_noise_e, rel=0.03)
        assert "ambient" not in fit.parameters
    else:
        assert fit.noise.ambient == pytest.approx(ambient, rel=0.03)
        assert fit.sensor.read_noise_e == truth.read_noise_e
    if amplitude:
        assert fit.sensor.illumination_exponent == pytest.approx(truth.illumination_exponent, abs=0.1)
        assert fit.parameters["amplitude_per_electron"].value == pytest.approx(1.0, rel=0.03)
    np.testing.assert_allclose(fit.fitted_m, fit.sigma_m, rtol=0.02)
    np.testing.assert_allclose(fit.fitted_range_m, fit.sigma_range_m, rtol=0.05)


@pytest.mark.parametrize(("electrons", "contrast", "read_noise", "unit"), [(2000.0, 0.75, 25.0, 1.0), (800.0, 0.45, 12.0, 0.31)])
def test_poisson_counts_of_eight_taps(electrons: float, contrast: float, read_noise: float, unit: float) -> None:
    """Nothing of the simulated camera: four pairs of taps a pixel, drawn by numpy, and decoded; amplitudes in an own unit."""
    camera, frequency = Camera.from_fov(96, 72, 0.6), 50e6
    ratio = camera.range_over_depth
    walls = []
    for k, z in enumerate((0.5, 0.7, 0.9, 1.2, 1.5, 1.9)):
        signal = 0.75 * electrons / ratio / (z * ratio) ** 2  # incidence cosine 1 / ratio
        turn = 4 * np.pi * frequency * z * ratio / C + np.pi / 2 * np.arange(4)[:, None, None]
        rng = generator(17, k)

        def drawn(signal: np.ndarray = signal, turn: np.ndarray = turn, rng: np.random.Generator = rng) -> Iterator[Frame]:
            for _ in range(60):
                taps = [rng.poisson(signal / 2 * (1 + sign * contrast * np.cos(turn))) for sign in (1, -1)]
                c = taps[0] - taps[1] + read_noise * rng.standard_normal(turn.shape)
                phase = np.arctan2(c[3] - c[1], c[0] - c[2]) % (2 * np.pi)
                yield phase * C / (4 * np.pi * frequency) / ratio, unit * np.hypot(c[3] - c[1], c[0] - c[2]) / 2

        walls += walls_of_frames(drawn(), camera)
    known = small_sensor(contrast=contrast, vignetting_exponent=0.0, integration_s=1e-3)
    fit = fit_physical(walls, known, dark=True)
    assert fit.sensor.signal_e_per_s == pytest.approx(1e3 * electrons, rel=0.03)
    assert fit.sensor.read_noise_e == pytest.approx(read_noise, rel=0.03)
    assert fit.parameters["amplitude_per_electron"].value == pytest.approx(unit, rel=0.03)


@pytest.mark.slow
def test_the_fitted_camera_has_the_noise_that_was_measured() -> None:
    """The circle closes: simulated with what was fitted, walls have the sigma that they had, wiggling and all."""
    truth = use_case(1).model_copy(update={"signal_e_per_s": 2.5e6, "read_noise_e": 9.0})
    given = PhysicalNoise(range_window=False, ambient=0.05)
    distances = (0.8, 1.1, 1.5, 2.0, 2.7)
    before = recorded(truth, given, distances, frames=15)
    fit = fit_physical(before, use_case(1))
    after = recorded(fit.sensor, fit.noise.model_copy(update={"range_window": False}), distances, frames=15)
    for old, new in zip(before, after, strict=True):
        assert np.nanmean(new.sigma_m) == pytest.approx(np.nanmean(old.sigma_m), rel=0.03)


@pytest.mark.parametrize("spatial_filter", ["mean", "median"])
def test_a_filter_is_not_laid_on_twice(spatial_filter: str) -> None:
    """What was measured behind the camera's filter comes out of a camera without one."""
    truth, given = small_sensor(spatial_filter=spatial_filter), PhysicalNoise(ambient=0.0, wiggling=0.0)
    before = recorded(truth, given, (0.5, 0.9, 1.4), frames=12)
    fit = fit_physical(before, truth, dark=True)
    for old, new in zip(before, recorded(fit.sensor, fit.noise, (0.5, 0.9, 1.4), frames=12), strict=True):
        assert np.nanmean(new.sigma_m) == pytest.approx(np.nanmean(old.sigma_m), rel=0.05)


def test_amplitudes_of_zero_are_none() -> None:
    """A dataset without amplitudes has zeros for them."""
    sensor, given = small_sensor(), PhysicalNoise(ambient=0.0)

    def seen(distance: float) -> Iterator[Frame]:
        for i in range(12):
            depth = simulate(wall(sensor, distance), sensor, given, rng=generator(round(10 * distance), i)).depth_m
            yield depth, np.zeros(depth.shape, np.uint16)

    walls = [w for z in (0.5, 0.9, 1.4) for w in walls_of_frames(seen(z), sensor.camera)]
    assert all(w.amplitude is None for w in walls)
    found = fit_physical(walls, sensor, dark=True).parameters
    assert found["signal_e_per_s"].value == pytest.approx(sensor.signal_e_per_s, rel=0.05)
    with pytest.raises(ConfigError, match="reflects 75"):
        fit_physical(walls, sensor, reflectance=75.0)


# ---------------------------------------------------------------------------------------------------- frames to walls


def test_a_tilted_wall_among_other_things() -> None:
    camera = Camera(160, 120, 120.0, 120.0, 79.5, 59.5, (-0.1, 0.01, 0.0, 0.0, 0.0))
    normal = np.array((0.3, -0.2, 1.0))
    xy1 = np.concatenate((camera.rays, np.ones((120, 160, 1))), axis=-1)
    truth = 1.5 * normal[2] / (xy1 @ normal)  # 1.5 m along the axis
    seen = truth.copy()
    seen[95:] = 0.8  # the floor
    seen[:, :12] = np.nan
    (found,) = walls_of_frames(normal_frames(seen, 3e-3), camera)
    assert found.distance_m == pytest.approx(1.5, abs=1e-3)
    assert not found.used[95:].any()
    assert not found.used[:, :12].any()
    assert found.used[:95, 12:].mean() > 0.99
    np.testing.assert_allclose(found.depth_m[found.used], truth[found.used], atol=2e-3)
    cosine = xy1 @ normal / (np.linalg.norm(normal) * camera.range_over_depth)
    np.testing.assert_allclose(found.cos_incidence[found.used], cosine[found.used], atol=5e-3)
    assert np.nanmean(found.sigma_m) == pytest.approx(3e-3, rel=0.02)
    assert found.flatness_m < 1e-3


def test_a_given_distance_shows_the_bias() -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    (found,) = walls_of_frames(normal_frames(np.full((72, 96), 1.02), 2e-3), camera, distance_m=1.0)
    assert found.distance_m == 1.0
    assert found.bias_m == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize("given", [1000.0, 100.0, 3.28, 0.3])
def test_a_given_distance_in_another_unit_is_refused(given: float) -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    with pytest.raises(ConfigError, match=rf"1\.00 m away by its depths, and {given:g} m are given") as error:
        walls_of_frames(normal_frames(np.full((72, 96), 1.0), 2e-3, 12), camera, distance_m=given)
    assert "in metres" in str(error.value.hint)


def test_pixels_of_depth_zero_are_invalid() -> None:
    camera, rng = Camera.from_fov(96, 72, 0.6), generator(5, 5)
    frames = [np.where(rng.random(d.shape) < 0.02, 0.0, d) for d, _ in normal_frames(np.full((72, 96), 1.0), 2e-3, 30)]
    (zeros,), (none,) = (
        walls_of_frames([(f, None) for f in kind], camera) for kind in (frames, [np.where(f > 0, f, np.nan) for f in frames])
    )
    np.testing.assert_array_equal(zeros.sigma_m, none.sigma_m)
    assert np.nanmean(zeros.sigma_m) == pytest.approx(2e-3, rel=0.02)


def test_the_steps_of_the_depth_are_taken_off() -> None:
    camera, step = Camera.from_fov(96, 72, 0.6), 4e-3
    xy1 = np.concatenate((camera.rays, np.ones((72, 96, 1))), axis=-1)
    slanted = 1.0 / (xy1 @ (0.2, 0.1, 1.0))  # so that pixels lie anywhere between two steps
    rounded = [(np.round(d / step) * step, None) for d, _ in normal_frames(slanted, 3e-3, 200)]
    (raw,), (mended,) = (walls_of_frames(rounded, camera, step_m=s) for s in (0.0, step))
    assert np.nanmean(raw.sigma_m) > 3.15e-3
    assert np.nanmean(mended.sigma_m) == pytest.approx(3e-3, rel=0.01)


def test_frames_of_several_distances_in_any_order() -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    several = [list(normal_frames(np.full((72, 96), z), 2e-3, 12)) for z in (2.0, 1.0, 1.5)]
    moving = list(normal_frames(np.full((72, 96), 1.2), 2e-3, 3))
    mixed = [frame for three in zip(*several, strict=True) for frame in three] + moving
    found = walls_of_frames(mixed, camera)
    assert [round(w.distance_m, 2) for w in found] == [1.0, 1.5, 2.0]
    assert [w.frames for w in found] == [12, 12, 12]


def test_frames_that_will_not_do() -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    flat = np.full((72, 96), 1.0)
    v, u = np.mgrid[-36:36, -48:48] / 36
    ball = np.where(u**2 + v**2 < 1, 1.3 - 0.3 * np.sqrt(np.maximum(1 - u**2 - v**2, 0)), np.nan)
    holes = np.where(np.arange(72 * 96).reshape(72, 96) % 40 == 0, 1.0, np.nan)
    holes[30:40, 40:54] = 1.0
    moving = [(flat * (1 + 0.002 * i), None) for i in range(15)]
    for frames, message, hint in (
        (normal_frames(flat, 1e-3, 5), "5 frames", "a hundred frames"),
        (normal_frames(flat * np.nan, 1e-3), "no depth", "within the camera's range"),
        (normal_frames(ball, 1e-3), "no flat wall", "middle third"),
        (normal_frames(np.where(holes > 0, holes, np.nan) * np.where(v < 0.2, np.nan, 1), 1e-3), "no depth", "range"),
        (moving, "moves", "stand"),
        (normal_frames(np.ones((10, 10)), 1e-3), "10x10 pixels", "sensor"),
    ):
        with pytest.raises(ConfigError, match=message) as error:
            walls_of_frames(frames, camera)
        assert hint in str(error.value.hint)
    few = np.full((72, 96), np.nan)
    few[30:42, 40:56] = 1.0  # 192 pixels
    with pytest.raises(ConfigError, match="192 pixels are valid"):
        walls_of_frames(normal_frames(few, 1e-3), camera)


def test_laws_that_cannot_be_fitted() -> None:
    camera = Camera.from_fov(96, 72, 0.6)
    of = {z: walls_of_frames(normal_frames(np.full((72, 96), z), 2e-3), camera)[0] for z in (1.0, 1.01, 1.5, 2.0)}
    for fit in (fit_empirical, lambda walls: fit_physical(walls, small_sensor())):
        with pytest.raises(ConfigError, match="walls at 2 distances") as error:
            fit([of[1.0], of[1.01], of[1.5]])
        assert "five" in str(error.value.hint)
    still = walls_of_frames(((np.full((72, 96), 3.0), None) for _ in range(20)), camera)
    with pytest.raises(ConfigError, match="no noise"):
        fit_empirical([of[1.0], of[1.5], *still])
    with pytest.raises(ConfigError, match="is not a Time-of-Flight camera"):
        fit_physical([of[1.0], of[1.5], of[2.0]], small_sensor(principle="structured_light"))
