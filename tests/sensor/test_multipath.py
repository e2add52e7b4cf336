"""Indirect and scattered light against closed forms, integrals by scipy, and the light that mitransient traced in corners."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.ndimage import gaussian_filter
from sensor_scenes import WHITE, generator, small_sensor, sphere_of_range, step_edge, wall

from cabinpose.scene.materials import MATERIAL_ID
from cabinpose.scene.sensor import NO_EFFECTS, GeometryBuffers, PhysicalNoise, indirect, simulate
from cabinpose.scene.sensor.indirect import indirect_light
from cabinpose.scene.sensor.optics import material_table

C = 299_792_458.0
FREQUENCIES = np.array((80e6, 60e6))
REFERENCE = Path(__file__).with_name("multipath_reference.npz")
TOOL = Path(__file__).resolve().parents[2] / "tools" / "multipath_reference.py"
ALBEDO = 0.5


def table(*black: str) -> np.ndarray:
    """Walls of one reflectance, and materials that return nothing."""
    result = material_table(True, True, 0.0, 0.0).copy()
    result[MATERIAL_ID[WHITE], 0] = ALBEDO
    result[[MATERIAL_ID[name] for name in black], 0] = 0.0
    return result


def only(**effects: object) -> PhysicalNoise:
    return NO_EFFECTS.model_copy(update=effects)


def corner_view(sensor: object, distance: float = 1.0) -> GeometryBuffers:
    """Two walls at right angles that meet in the plane x = 0, where the axis meets them at a distance."""
    x = sensor.camera.rays[..., 0]  # type: ignore[attr-defined]
    z = distance / (1 + np.abs(x))
    factor = sensor.camera.range_over_depth  # type: ignore[attr-defined]
    return GeometryBuffers.dense(
        1,
        z.astype(np.float32),
        ((1 + np.abs(x)) / np.sqrt(2) / factor).astype(np.float32),
        np.full(z.shape, MATERIAL_ID[WHITE], np.uint8),
    )


# --------------------------------------------------------------------------------------------------------- indirect light


def test_one_bounce_in_a_corner_is_its_integral(monkeypatch: pytest.MonkeyPatch) -> None:
    """Energy and phasor at pixels of the right wall: the integral over the left one, in the image plane, by scipy."""
    monkeypatch.setattr(indirect, "BOUNCES", 1)
    sensor = small_sensor()
    camera = sensor.camera
    light = indirect_light(corner_view(sensor), sensor, table(), FREQUENCIES, falloff=False)
    normal = np.array((1.0, 0.0, -1.0)) / np.sqrt(2), np.array((-1.0, 0.0, -1.0)) / np.sqrt(2)  # of the left and right walls
    left, top = camera.rays[0, 0] - (0.5 / camera.fx, 0.5 / camera.fy)
    for v, u in ((36, 52), (36, 60), (12, 70), (60, 90)):
        rx, ry = camera.rays[v, u]
        at = np.array((rx, ry, 1.0)) / (1 + abs(rx))

        def integrand(y: float, x: float, at: np.ndarray = at, wave: float = 0.0, turn: float = 0.0) -> float:
            source = np.array((x, y, 1.0)) / (1 + abs(x))
            way = at - source
            d = np.sqrt(way @ way)
            cosines = max(normal[0] @ way, 0.0) * max(-normal[1] @ way, 0.0) / d**2
            length = np.sqrt(source @ source) + d + np.sqrt(at @ at)
            return ALBEDO / np.pi * cosines / d**2 / (1 + x * x + y * y) ** 1.5 * np.cos(wave * length - turn)

        waves = [(0.0, 0.0)] + [(2 * np.pi * f / C, turn) for f in FREQUENCIES for turn in (0.0, np.pi / 2)]
        expected = [
            ALBEDO * dblquad(integrand, left, 0.0, top, -top, args=(at, *wave), epsrel=2e-3, epsabs=1e-5)[0] for wave in waves
        ]
        np.testing.assert_allclose(light[v, :, u], expected, atol=0.04 * expected[0])


@pytest.mark.parametrize("unseen", [0.0, 0.3])
def test_a_cap_of_a_sphere_has_the_light_of_an_integrating_sphere(unseen: float) -> None:
    """Inside a sphere all places receive the same of each: a series of its reflectance times the share that is seen."""
    sensor = small_sensor()
    camera, radius = sensor.camera, 1.2
    light = indirect_light(
        sphere_of_range(sensor, np.full((72, 96), radius)), sensor, table(), FREQUENCIES, falloff=False, unseen=unseen
    )
    seen = np.sum(1 / camera.range_over_depth**3) / (camera.fx * camera.fy) / (4 * np.pi)  # share of the sphere
    q = ALBEDO * seen + unseen * ALBEDO * 4 * np.pi * radius**2 * seen * (1 - seen) ** 2 / indirect.UNSEEN_M2
    first = q / radius**2  # of irradiance 1 / r^2
    expected = ALBEDO * first * sum(q**k for k in range(indirect.BOUNCES))
    inner = light[12:-12, :, 12:-12]
    assert np.median(inner[:, 0]) == pytest.approx(expected, rel=0.06)  # neighbours count as discs on their axes
    assert np.abs(inner[:, 0] / expected - 1).max() < 0.09
    assert (np.hypot(inner[:, 1], inner[:, 2]) < inner[:, 0]).all()


def test_what_is_between_two_walls_keeps_their_light_apart() -> None:
    """A black post in a passage with a black end: walls receive less where it stands between them, and the same before it."""
    sensor = small_sensor()
    x = np.abs(sensor.camera.rays[..., 0])
    depth = np.minimum(0.5 / np.maximum(x, 1e-9), 3.0)
    cosine = np.where(depth < 3.0, x, 1.0) / sensor.camera.range_over_depth
    material = np.where(depth < 3.0, MATERIAL_ID[WHITE], MATERIAL_ID["rubber"]).astype(np.uint8)
    received = []
    for z in (depth, np.where(x < 0.06, 2.6, depth)):
        view = GeometryBuffers.dense(1, z.astype(np.float32), cosine.astype(np.float32), material)
        received.append(indirect_light(view, sensor, table("rubber"), FREQUENCIES, falloff=False)[:, 0])
    empty, with_post = received
    beside, before = (depth > 2.5) & (depth < 2.8), depth < 1.75
    assert with_post[beside].sum() < 0.99 * empty[beside].sum()
    np.testing.assert_allclose(with_post[before].sum(), empty[before].sum(), rtol=5e-3)


def test_a_flat_wall_and_an_empty_view_have_no_multipath() -> None:
    sensor = small_sensor()
    for depth in (1.0, 0.0):
        frames = [
            simulate(wall(sensor, depth), sensor, only(multipath=on, multipath_unseen=0.0), rng=generator(1, 1))
            for on in (True, False)
        ]
        np.testing.assert_array_equal(frames[0].depth_m, frames[1].depth_m)


def test_multipath_lengthens_ranges_and_keeps_the_noise() -> None:
    """A corner comes out rounded, in the same random numbers; the light that is added makes it brighter."""
    sensor = small_sensor(frequencies_hz=tuple(FREQUENCIES))
    view = corner_view(sensor)
    still, noisy = only(incidence=True), only(incidence=True, shot_noise=True, read_noise=True)
    on, off = (
        simulate(view, sensor, still.model_copy(update={"multipath": m, "multipath_unseen": 0.0}), rng=generator(1, 1))
        for m in (True, False)
    )
    error = on.depth_m - off.depth_m
    assert (error > 0.001).all()
    assert error[36, 50] > 1.15 * error[36, 94]
    assert (on.amplitude > off.amplitude).all()
    other = (
        simulate(view, sensor, noisy.model_copy(update={"multipath": True, "multipath_unseen": 0.0}), rng=generator(1, 1)).depth_m
        - on.depth_m
    )
    plain = simulate(view, sensor, noisy, rng=generator(1, 1)).depth_m - off.depth_m
    assert np.corrcoef(other.ravel(), plain.ravel())[0, 1] > 0.8


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("multipath_reference", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("walls", [2, 3])
@pytest.mark.parametrize("albedo", [0.3, 0.5, 0.8])
def test_errors_in_corners_are_those_of_traced_light(tool: ModuleType, walls: int, albedo: float) -> None:
    """All bounces, by mitransient, as `tools/multipath_reference.py` stored them: within 20 % by their root mean square."""
    theirs = np.load(REFERENCE)[f"corner{walls}_{round(10 * albedo)}"].astype(float)
    ours = tool.blocks(1e3 * tool.ours(tool.corner(walls, albedo), 0.0)[0])
    use = np.isfinite(theirs) & np.isfinite(ours)
    assert use.mean() > 0.8
    rms = np.sqrt(np.mean(theirs[use] ** 2))
    assert rms > 10.0
    assert np.sqrt(np.mean((ours - theirs)[use] ** 2)) < 0.12 * rms
    assert np.sqrt(np.mean(ours[use] ** 2)) == pytest.approx(rms, rel=0.10)


# --------------------------------------------------------------------------------------------------------- scattered light


def test_scattered_light_is_three_gaussians() -> None:
    """Phasors of a near and a far wall, spread by scipy; a far and dark wall is pulled to the near one by centimetres."""
    sensor = small_sensor(frequencies_hz=(50e6,), vignetting_exponent=0.0)
    view = step_edge(sensor, 0.4, 1.2, 40, supersample=1)
    share, width = 0.05, 10.0
    depth = simulate(view, sensor, only(lens_scatter=share, lens_scatter_px=width), rng=generator(1, 1)).depth_m
    ranges = view.depth_m * sensor.camera.range_over_depth
    light = np.exp(4j * np.pi * 50e6 / C * ranges) / ranges**2
    spread = sum(gaussian_filter(light, k * width, mode="constant", truncate=5.0) for k in (1, 2, 4)) / 3
    mixed = (1 - share) * light + share * spread
    phase = np.angle(mixed) % (2 * np.pi)
    expected = phase * C / (4 * np.pi * 50e6) / sensor.camera.range_over_depth
    error = depth - view.depth_m
    assert error[36, 50] < -0.01
    away = np.abs(np.arange(96) - 39.5) > 6  # the cells of 8 pixels are wider than what is nearer to the edge
    np.testing.assert_allclose(depth[:, away], expected[:, away], atol=0.03)
    assert np.sqrt(np.mean((depth - expected)[:, away] ** 2)) < 0.05 * np.sqrt(np.mean(error[:, away] ** 2))
