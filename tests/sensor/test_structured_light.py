"""The structured-light model: Nguyen's axial noise, disparity steps, the projector's shadow, holes."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_scenes import generator, step_edge, wall

from cabinpose.scene.materials import MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import SENSORS, GeometryBuffers, StructuredLightNoise, simulate

KINECT = SENSORS["kinect_v1"]
QUIET = StructuredLightNoise(axial=False, lateral_px=0.0, quantise=False, shadow=False, min_return=0.0, grazing_deg=90.0)


def facing(depth: float) -> GeometryBuffers:
    """A wall seen square to every ray."""
    flat = wall(KINECT, depth, 1)
    return GeometryBuffers.dense(1, flat.depth_m, np.ones_like(flat.depth_m), flat.material)


@pytest.mark.parametrize("depth", [0.8, 1.5, 2.5, 4.0])
def test_axial_noise_is_nguyens(depth: float) -> None:
    noise = QUIET.model_copy(update={"axial": True})
    measured = simulate(facing(depth), KINECT, noise, rng=generator(1, 1)).depth_m
    assert measured.std() == pytest.approx(0.0012 + 0.0019 * (depth - 0.4) ** 2, rel=0.02)
    assert measured.mean() == pytest.approx(depth, abs=2e-4)


def test_disparity_comes_in_eighths() -> None:
    depth = np.linspace(0.6, 4.5, 320 * 240).reshape(240, 320).astype(np.float32)
    ramp = GeometryBuffers.dense(1, depth, np.ones_like(depth), facing(1.0).material)
    measured = simulate(ramp, KINECT, QUIET.model_copy(update={"quantise": True}), rng=generator(1, 1)).depth_m
    disparity = 2 * 285.714 * 0.075 / measured.astype(np.float64)
    np.testing.assert_allclose(disparity * 8, np.round(disparity * 8), atol=1e-4)
    # Khoshelham: the step of depth is z^2 x step of disparity / (f b), 2.9 mm at 1 m on 640 columns.
    levels = np.unique(measured)
    steps = np.diff(levels)
    np.testing.assert_allclose(steps, levels[:-1] * levels[1:] * 0.125 / (2 * 285.714 * 0.075), rtol=1e-3)


def test_shadow_has_the_width_of_the_disparity_step() -> None:
    near, far, split = 1.0, 2.5, 160
    flat = facing(far)
    depth = flat.depth_m.copy()
    depth[:, split:220] = near
    noise = QUIET.model_copy(update={"shadow": True})
    scene = GeometryBuffers.dense(1, depth, flat.cos_incidence, flat.material)
    measured = simulate(scene, KINECT, noise, rng=generator(1, 1)).depth_m
    width = 285.714 * 0.075 * (1 / near - 1 / far)
    hidden = np.flatnonzero(np.isnan(measured[100]))
    assert len(hidden) == pytest.approx(width, abs=1)
    assert hidden.max() == split - 1  # left of the nearer object: the projector stands to the right
    assert np.isfinite(measured[:, 220:]).all()
    filled = simulate(scene, KINECT, noise.model_copy(update={"fill_px": 16}), rng=generator(1, 1)).depth_m
    np.testing.assert_array_equal(filled[:, :split], np.float32(far))


def test_lateral_noise_frays_edges() -> None:
    edge = step_edge(KINECT, 1.0, 2.0, 320)
    sharp, ragged = (
        simulate(edge, KINECT, QUIET.model_copy(update={"lateral_px": p}), rng=generator(1, 1)).depth_m for p in (0.0, 0.8)
    )
    assert np.ptp(np.argmax(sharp > 1.5, axis=1)) == 0
    first = np.argmax(ragged > 1.5, axis=1)
    assert 1 <= np.ptp(first) <= 4
    assert not np.any((ragged > 1.05) & (ragged < 1.95))


def test_grazing_and_dark_surfaces_are_holes() -> None:
    flat = facing(2.0)
    cosine = np.broadcast_to(np.linspace(0.01, 1, 320, dtype=np.float32), flat.depth_m.shape).copy()
    tilted = GeometryBuffers.dense(1, flat.depth_m, cosine, flat.material)
    holes = np.isnan(simulate(tilted, KINECT, QUIET.model_copy(update={"grazing_deg": 80.0}), rng=generator(1, 1)).depth_m)
    np.testing.assert_array_equal(holes, cosine < np.cos(np.radians(80)))
    dark = GeometryBuffers.dense(1, flat.depth_m, flat.cos_incidence, np.full_like(flat.material, MATERIAL_ID["rubber"]))
    black = MATERIALS[MATERIAL_ID["rubber"]].reflectance
    noise = QUIET.model_copy(update={"min_return": black / 4})  # the very light that rubber returns at 2 m
    assert np.isnan(simulate(dark, KINECT, noise, rng=generator(1, 1)).depth_m).mean() == pytest.approx(0.5, abs=0.02)
    assert np.isfinite(simulate(flat, KINECT, noise, rng=generator(1, 1)).depth_m).all()


def test_same_random_numbers_same_bytes() -> None:
    frames = [simulate(facing(2.0), KINECT, StructuredLightNoise(), rng=generator(1, i)).depth_m.tobytes() for i in (1, 1, 2)]
    assert frames[0] == frames[1] != frames[2]
