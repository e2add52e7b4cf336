"""The model's view: frames of any camera through one pinhole, and back."""

from __future__ import annotations

import numpy as np
import pytest

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.estimate.inputs import InputView

VIEW = InputView(64, 48, 40.0, max_depth_m=3.0)
DISTORTED = Camera(160, 120, 90.0, 95.0, 82.0, 57.5, (-0.28, 0.09, 0.001, -0.002, -0.01))


def test_the_views_own_camera_is_the_identity() -> None:
    image = np.random.default_rng(0).integers(0, 60000, (2, 48, 64)).astype(np.uint16)
    assert np.array_equal(VIEW.resample(image, VIEW.camera), image)
    assert np.array_equal(VIEW.to_source(image, VIEW.camera), image)


def test_a_pixel_of_the_view_looks_along_the_same_ray() -> None:
    seen = VIEW.resample(np.moveaxis(DISTORTED.rays, -1, 0) + 10.0, DISTORTED) - 10.0  # 0 marks what the camera does not see
    inside = seen[0] > -9
    assert inside.mean() > 0.8
    off = np.abs(np.moveaxis(seen, 0, -1) - VIEW.camera.rays)[inside]
    assert off.max() < 0.8 / 60  # half a pixel, and distortion squeezes the rays at the border


def test_a_pixel_of_the_camera_gets_what_the_view_says_along_its_ray() -> None:
    said = VIEW.to_source(np.moveaxis(VIEW.camera.rays, -1, 0) + 10.0, DISTORTED) - 10.0
    inside = said[0] > -9
    assert inside.mean() > 0.5
    off = np.abs(np.moveaxis(said, 0, -1) - DISTORTED.rays)[inside]
    assert off.max() <= 0.5 / 40 + 1e-9


def test_what_lies_beyond_the_camera_is_empty() -> None:
    narrow = Camera(20, 20, 100.0, 100.0, 9.5, 9.5)
    seen = VIEW.resample(np.ones((20, 20), np.float32), narrow)
    half = 10 / 100 * 40  # half the width of what the camera sees, in pixels of the view
    u, v = np.meshgrid(np.arange(64) - 31.5, np.arange(48) - 23.5)
    assert np.array_equal(seen > 0, (np.abs(u) < half) & (np.abs(v) < half))


@pytest.mark.parametrize("depth", [0.4, 2.0])
def test_pixels_are_where_the_camera_sees_the_point(depth: float) -> None:
    point = np.array([[0.2, -0.1, 1.0], [-0.3, 0.2, 1.0]]) * depth
    uvz = VIEW.to_view(point)
    np.testing.assert_allclose(VIEW.pixels(uvz[:, :2], DISTORTED), DISTORTED.project(point), atol=1e-9)
    np.testing.assert_allclose(VIEW.from_view(uvz), point, atol=1e-12)


def test_pixels_keep_unknown_joints_unknown() -> None:
    assert np.isnan(VIEW.pixels(np.full((3, 2), np.nan), DISTORTED)).all()


def test_depth_is_zero_where_invalid_or_out_of_range() -> None:
    image = np.full((48, 64), 1.5, np.float32)
    image[0, :6] = np.nan, 0.0, np.inf, -np.inf, 3.01, -1.5
    expected = np.where(image == 1.5, image, 0)
    assert np.array_equal(VIEW.depth(image, VIEW.camera), expected)


def test_frames_of_another_size_are_refused() -> None:
    with pytest.raises(ConfigError, match="64x48") as caught:
        VIEW.resample(np.zeros((48, 64)), DISTORTED)
    assert caught.value.hint
