"""The camera against OpenCV, and its round trips."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from cabinpose.align.calibration import Intrinsics
from cabinpose.core.camera import Camera
from cabinpose.core.camera_check import check_camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.intrinsics import fit_camera
from cabinpose.record.sources.tof.camera import Lens
from cabinpose.scene.sensor import SENSORS, Sensor
from cabinpose.store.convert.format import ImportOptions
from cabinpose.store.convert.ntu import KINECT_V2
from cabinpose.store.convert.reading import given_camera

PLAIN = Camera(320, 240, 285.714, 285.714, 160.0, 120.0)
BARREL = Camera(352, 287, 173.6, 173.6, 175.5, 143.0, (-0.133684, 0.02, 0.0, 0.0, 0.0))
FULL = Camera(640, 480, 510.0, 505.0, 322.4, 236.1, (0.08, -0.17, 0.0012, -0.0008, 0.05))
CAMERAS = (PLAIN, BARREL, FULL)

distortion = st.tuples(
    st.floats(-0.15, 0.15), st.floats(-0.02, 0.02), st.floats(-0.005, 0.005), st.floats(-0.005, 0.005), st.floats(-0.002, 0.002)
)


def points_before(rng: np.random.Generator, count: int = 200) -> NDArray[np.float64]:
    xy = rng.uniform(-0.6, 0.6, (count, 2))
    z = rng.uniform(0.3, 4.0, (count, 1))
    return np.concatenate((xy * z, z), axis=1)


@given(dist=distortion, seed=st.integers(0, 1000))
@settings(max_examples=50, deadline=None)
def test_projection_is_opencvs(dist: tuple[float, float, float, float, float], seed: int) -> None:
    camera = Camera(320, 240, 210.0, 214.0, 158.3, 121.7, dist)
    points = points_before(np.random.default_rng(seed))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.k, np.array(dist))
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("quarters", [0, 1, 2, 3, 4])
def test_a_turned_camera_has_the_rays_of_the_turned_image(camera: Camera, quarters: int) -> None:
    turned = camera.turned(quarters)
    x, y = np.rot90(camera.rays, quarters).transpose(2, 0, 1)
    wanted = {0: (x, y), 1: (y, -x), 2: (-x, -y), 3: (-y, x)}[quarters % 4]
    np.testing.assert_allclose(turned.rays, np.stack(wanted, axis=-1), atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
def test_undistortion_is_opencvs(camera: Camera) -> None:
    rng = np.random.default_rng(1)
    uv = rng.uniform((0, 0), (camera.width - 1, camera.height - 1), (300, 2))
    expected = cv2.undistortPoints(
        uv[:, None], camera.k, np.array(camera.dist), criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-13)
    )[:, 0]
    np.testing.assert_allclose(camera.unproject(uv, np.ones(300))[:, :2], expected, atol=1e-8)


@given(dist=distortion, seed=st.integers(0, 1000))
@settings(max_examples=50, deadline=None)
def test_project_and_unproject_are_inverse(dist: tuple[float, float, float, float, float], seed: int) -> None:
    camera = Camera(320, 240, 210.0, 214.0, 158.3, 121.7, dist)
    points = points_before(np.random.default_rng(seed))
    np.testing.assert_allclose(camera.unproject(camera.project(points), points[:, 2]), points, atol=1e-7)


def test_points_behind_the_camera_have_no_pixel() -> None:
    assert np.isnan(FULL.project([(0.1, 0.1, 0.0), (0.1, 0.1, -1.0)])).all()
    assert not FULL.contains(FULL.project((0.0, 0.0, -1.0)))


def test_rays_beyond_the_lens_model_are_nan() -> None:
    steep = Camera(400, 300, 100.0, 100.0, 199.5, 149.5, (-0.2, 0.0, 0.0, 0.0, 0.0))
    rays = steep.rays
    corner, centre = rays[0, 0], rays[150, 200]
    assert np.isnan(corner).all()
    np.testing.assert_allclose(centre, (0.005, 0.005), atol=1e-6)
    seen = np.isfinite(rays[..., 0])
    assert 0 < seen.mean() < 1
    # r (1 - 0.2 r^2) turns back at r^2 = 5/3, where it has reached 0.8607 of a focal length.
    v, u = np.mgrid[:300, :400]
    radius = np.hypot(u - 199.5, v - 149.5) / 100
    np.testing.assert_array_equal(seen[np.abs(radius - 0.8607) > 1e-3], (radius < 0.8607)[np.abs(radius - 0.8607) > 1e-3])


@pytest.mark.parametrize("camera", CAMERAS)
def test_depth_and_range_are_tied_by_the_ray(camera: Camera) -> None:
    depth = np.random.default_rng(2).uniform(0.3, 4, (camera.height, camera.width))
    points = camera.points(depth)
    np.testing.assert_allclose(np.linalg.norm(points, axis=-1), camera.range_from_depth(depth), rtol=1e-12)
    np.testing.assert_allclose(camera.depth_from_range(camera.range_from_depth(depth)), depth, rtol=1e-12)
    v, u = np.mgrid[: camera.height, : camera.width]
    np.testing.assert_allclose(camera.project(points), np.stack((u, v), axis=-1), atol=1e-6)
    assert camera.range_over_depth.min() >= 1


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("factor", [2, 3])
def test_a_scaled_camera_cuts_pixels_into_equal_parts(camera: Camera, factor: int) -> None:
    points = points_before(np.random.default_rng(3))
    scaled = camera.scaled(factor)
    np.testing.assert_allclose(scaled.project(points) + 0.5, factor * (camera.project(points) + 0.5), atol=1e-9)
    assert (scaled.width, scaled.height) == (factor * camera.width, factor * camera.height)
    if factor == 3:  # the middle one of three samples looks along the pixel's own ray
        np.testing.assert_allclose(scaled.rays[1::3, 1::3], camera.rays, atol=1e-9)


def test_field_of_view_runs_from_edge_to_edge() -> None:
    camera = Camera.from_fov(320, 240, np.radians(90), np.radians(70))
    edges = camera.unproject([(-0.5, 119.5), (319.5, 119.5), (159.5, -0.5), (159.5, 239.5)], np.ones(4))
    angles = np.degrees(np.arctan(edges[:, :2]))
    np.testing.assert_allclose((angles[1, 0] - angles[0, 0], angles[3, 1] - angles[2, 1]), (90, 70), atol=1e-9)
    square = Camera.from_fov(320, 240, np.radians(90))
    assert square.fx == square.fy == pytest.approx(160.0)


def test_pixels_of_the_image_are_half_open() -> None:
    uv = [(-0.5, -0.5), (319.49, 239.49), (319.5, 0), (0, 239.5), (-0.51, 0), (np.nan, 0)]
    np.testing.assert_array_equal(PLAIN.contains(uv), [True, True, False, False, False, False])


def test_itops_intrinsics() -> None:
    """ITOP gives x = (u - 160) d 0.0035 and y = (120 - v) d 0.0035, y upwards."""
    point = PLAIN.unproject((200.0, 90.0), 2.5)
    np.testing.assert_allclose(point, ((200 - 160) * 2.5 * 0.0035, -(120 - 90) * 2.5 * 0.0035, 2.5), rtol=1e-5)


@pytest.mark.parametrize(
    "bad", [{"width": 0}, {"height": -1}, {"fx": 0.0}, {"fy": float("nan")}, {"fx": float("inf")}, {"cx": float("inf")}]
)
def test_impossible_cameras_are_refused(bad: dict[str, float]) -> None:
    good: dict[str, float] = {"width": 4, "height": 4, "fx": 2.0, "fy": 2.0, "cx": 1.5, "cy": 1.5}
    with pytest.raises(ConfigError) as error:
        Camera(**(good | bad))  # type: ignore[arg-type]
    assert error.value.hint


MONSTAR = {"width": 352, "height": 287, "fx": 173.6, "fy": 173.6, "cx": 175.5, "cy": 143.0}


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"fx": 1e9, "fy": 1e9}, "a field of view of 2.02e-05 x"),
        ({"fx": 1e-3}, "a field of view of 180 x"),
        ({"cx": 1e6}, r"the principal point 1e\+06, 143 is far outside"),
        ({"cy": -3000.0}, "far outside the 352x287 image"),
        ({"dist": (1e6, 0.0, 0.0, 0.0, 0.0)}, "moves rays to 0.0084 to 0.045 times"),
        ({"dist": (-5.0, 0.0, 0.0, 0.0, 0.0)}, "only 3 % of the pixels have a ray"),
        ({"dist": (0.0, 0.0, 1e3, 0.0, 0.0)}, "of the pixels have a ray"),
        ({"dist": (0.0, 0.0, 0.0, 0.0, -5.0)}, "only 17 % of the pixels have a ray"),
    ],
)
def test_what_no_lens_is_is_refused(bad: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^mine: .*{message}") as error:
        check_camera(Camera(**(MONSTAR | bad)), "mine")
    assert error.value.hint


def test_lenses_that_there_are_are_taken() -> None:
    """Presets, Kinect v2, strong barrels and pincushions, a fisheye by its own points, an image cut out of another."""
    for camera in (*(SENSORS[name].camera for name in SENSORS.names()), KINECT_V2, PLAIN, BARREL, FULL):
        check_camera(camera, "")
    for k1, k2 in ((-0.35, 0.12), (-0.28, 0.07), (0.2, -0.1), (0.3, 0.5)):
        check_camera(Camera(**MONSTAR, dist=(k1, k2, 0.001, -0.001, 0.0)), "")  # type: ignore[arg-type]
    u, v = np.meshgrid(np.arange(512.0) - 255.5, np.arange(512.0) - 255.5)
    angle = np.hypot(u, v) * np.radians(60.0) / 256  # equidistant: 120 degrees in the image circle
    field = np.where(angle < np.radians(60.0), np.tan(angle) / np.maximum(np.hypot(u, v), 1e-9), np.nan)
    fitted = fit_camera(np.stack((u * field, v * field), axis=-1))
    assert fitted is not None
    check_camera(fitted.camera, "")
    with pytest.warns(UserWarning, match="cut out of larger ones"):
        check_camera(Camera(64, 48, 170.0, 170.0, -20.0, 60.0), "mine")


def test_a_ray_ends_where_the_polynomial_folds() -> None:
    """Beyond it the polynomial has roots again, on the other side of the axis."""
    folding = Camera(**MONSTAR, dist=(-5.0, 0.0, 0.0, 0.0, 0.0))  # type: ignore[arg-type]
    assert folding.monotonic_radius == pytest.approx(1 / np.sqrt(15.0))
    rays = folding.rays[np.isfinite(folding.rays[..., 0])]
    v, u = np.nonzero(np.isfinite(folding.rays[..., 0]))
    assert np.linalg.norm(rays, axis=-1).max() <= 1.02 * folding.monotonic_radius
    assert (np.sum(rays * np.stack((u - 175.5, v - 143.0), axis=-1), axis=-1) >= 0.0).all()
    assert BARREL.monotonic_radius == np.inf
    r = np.linspace(0.0, 4.0, 400_001)
    for dist in ((-0.2, 0.0, 0.0, 0.0, 0.0), (-0.28, 0.09, 0.0, 0.0, -0.01), (0.1, -0.05, 0.0, 0.0, 0.0)):
        lens = Camera(**MONSTAR, dist=dist)  # type: ignore[arg-type]
        falls = np.diff(lens.distort(np.stack((r, 0 * r), axis=-1))[:, 0]) < 0
        assert lens.monotonic_radius == pytest.approx(r[np.argmax(falls)], abs=3e-5)


def test_where_a_polynomial_folds_is_its_derivatives_first_root() -> None:
    rng = np.random.default_rng(7)
    for scale in (0.1, 1.0, 100.0):
        for k1, k2, k3 in rng.standard_normal((300, 3)) * (scale, scale, scale) * rng.integers(0, 2, (300, 3)):
            roots = np.roots((7 * k3, 5 * k2, 3 * k1, 1.0))  # of r^2
            folds = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
            lens = Camera(**MONSTAR, dist=(k1, k2, 0.0, 0.0, k3))  # type: ignore[arg-type]
            assert lens.monotonic_radius == pytest.approx(np.sqrt(folds.min()) if len(folds) else np.inf, rel=1e-7)


@pytest.mark.parametrize(("k1", "k2"), [(-0.3, 0.02), (-0.25, 0.0), (-0.35, 0.02)])
def test_points_beyond_the_fold_are_not_in_the_image(k1: float, k2: float) -> None:
    """The radius grows until 1 + 3 k1 r^2 + 5 k2 r^4 = 0; from there OpenCV brings points back into the image."""
    squared = (-3 * k1 - np.sqrt(9 * k1**2 - 20 * k2)) / (10 * k2) if k2 else -1 / (3 * k1)
    fold = np.degrees(np.arctan(np.sqrt(squared)))
    lens = Camera(320, 240, 200.0, 200.0, 159.5, 119.5, (k1, k2, 0.0, 0.0, 0.0))
    angles = np.append(np.arange(1, 90), (fold - 1e-4, fold + 1e-4))
    away, around = np.meshgrid(np.radians(angles), np.radians(np.arange(0, 360, 15)))
    points = np.stack([np.sin(away) * np.cos(around), np.sin(away) * np.sin(around), np.cos(away)], axis=-1).reshape(-1, 3)
    theirs = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.k, np.array(lens.dist))[0][:, 0]
    before = (away < np.radians(fold)).ravel()
    assert lens.contains(theirs[~before]).sum() > 100
    np.testing.assert_allclose(lens.project(points)[before], theirs[before], atol=1e-9)
    assert np.isnan(lens.project(points)[~before]).all()
    assert np.isnan(lens.project(points[~before][0])).all()
    np.testing.assert_allclose(lens.project(points, folded=True), theirs, rtol=1e-9)


def test_a_lens_is_looked_at_wherever_one_is_given() -> None:
    """Sensors, calibrations, rigs and imports."""
    bent = (1e6, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ConfigError, match="sensor 'x': distortion"):
        Sensor.model_validate(SENSORS["evk75023"].model_dump() | {"name": "x", "camera": MONSTAR | {"dist": bent}})
    with pytest.raises(ConfigError, match="intrinsics: distortion"):
        Intrinsics(**MONSTAR, dist=bent)
    lens = Lens(fx=173.0, fy=173.0, cx=1e6, cy=143.0)
    with pytest.raises(ConfigError, match="lens: the principal point"):
        lens.camera(352, 287)
    with pytest.raises(ValidationError, match="finite"):
        Lens(fx=float("inf"), fy=173.0, cx=0.0, cy=143.0)
    with pytest.raises(ConfigError, match="--intrinsics: the principal point"):
        given_camera(ImportOptions(intrinsics=(173.0, 173.0, 1e6, 143.0)), (352, 287))
