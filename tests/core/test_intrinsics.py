"""Cameras fitted to rays: the true one is found again, OpenCV's projection agrees, too little is said to be too little."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cabinpose.core.camera import Camera
from cabinpose.core.intrinsics import fit_camera, pixel_error

TRUE = Camera(64, 48, 50.0, 52.0, 30.5, 25.25, (-0.2, 0.05, 0.001, -0.002, 0.01))


@settings(max_examples=10)
@given(st.floats(-0.3, 0.1), st.floats(-0.05, 0.1), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3))
def test_the_true_camera_is_found_again(k1: float, k2: float, p1: float, p2: float) -> None:
    true = Camera(40, 30, 45.0, 44.0, 21.0, 13.0, (k1, k2, p1, p2, 0.0))
    fit = fit_camera(true.rays)
    assert fit is not None
    assert fit.max_px < 1e-5
    uv = cv2.projectPoints(
        np.array([[0.2, -0.1, 1.0], [-0.3, 0.2, 1.0]]), np.zeros(3), np.zeros(3), fit.camera.k, np.array(fit.camera.dist)
    )[0][:, 0]
    expected = cv2.projectPoints(
        np.array([[0.2, -0.1, 1.0], [-0.3, 0.2, 1.0]]), np.zeros(3), np.zeros(3), true.k, np.array(true.dist)
    )[0][:, 0]
    np.testing.assert_allclose(uv, expected, atol=1e-4)


def test_holes_and_noise_do_no_harm() -> None:
    rng = np.random.default_rng(1)
    rays = TRUE.rays + rng.normal(0, 2e-4, TRUE.rays.shape)  # 0.01 px
    rays[rng.random(rays.shape[:2]) < 0.6] = np.nan
    fit = fit_camera(rays)
    assert fit is not None
    assert fit.rms_px == pytest.approx(0.01 * np.sqrt(2), rel=0.15)
    np.testing.assert_allclose(fit.camera.k, TRUE.k, atol=0.05)
    np.testing.assert_allclose(pixel_error(fit.camera, TRUE.rays), 0, atol=0.01)


def test_a_straight_camera_does_not_meet_a_bent_one() -> None:
    straight = fit_camera(TRUE.rays, distorted=False)
    assert straight is not None
    assert straight.camera.dist == (0.0,) * 5
    assert straight.rms_px > 0.1
    assert pixel_error(TRUE, TRUE.rays) < 1e-6 < 0.05 < pixel_error(straight.camera, TRUE.rays)


def test_too_few_rays_and_mirrored_ones_fit_nothing() -> None:
    few = np.full((48, 64, 2), np.nan)
    few[10:14, 10:14] = TRUE.rays[10:14, 10:14]
    assert fit_camera(few) is None
    assert fit_camera(np.zeros((20, 20, 2))) is None
    assert fit_camera(TRUE.rays * (-1, 1)) is None
    assert np.isnan(pixel_error(TRUE, np.full((3, 3, 2), np.nan)))
