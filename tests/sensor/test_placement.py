"""Presets, placement and geometry buffers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation
from sensor_scenes import generator, small_sensor

from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import invert, is_rigid, transform
from cabinpose.scene.sensor import OWN_SENSORS, SENSORS, GeometryBuffers, Sensor, jittered, place_camera, sensor_by_name

coordinate = st.floats(-3, 3)
point = st.tuples(coordinate, coordinate, coordinate)


@given(eye=point, target=point)
@settings(max_examples=100, deadline=None)
def test_the_target_lies_on_the_axis_and_the_image_is_upright(
    eye: tuple[float, float, float], target: tuple[float, float, float]
) -> None:
    distance = np.linalg.norm(np.subtract(target, eye))
    if distance < 0.01:
        return
    pose = place_camera(eye, target, rng=generator(1, 1))
    assert is_rigid(pose)
    np.testing.assert_allclose((invert(pose) @ (*target, 1))[:3], (0, 0, distance), atol=1e-9)
    if np.hypot(*(np.subtract(target, eye)[:2])) > 0.01 * distance:
        assert pose[2, 1] < 0  # the camera's y, down in the image, points down in the vehicle
        assert abs(pose[2, 0]) < 1e-9  # the horizon is level


def test_straight_down_has_the_front_of_the_car_upwards() -> None:
    pose = place_camera((1, 0, 1.2), (1, 0, 0), rng=generator(1, 1))
    np.testing.assert_allclose(pose[:3, :3] @ (0, -1, 0), (1, 0, 0), atol=1e-12)


def test_jitter_is_uniform_about_the_cameras_own_axes() -> None:
    nominal = place_camera((0, 0, 1), (1, 0.5, 0.5), rng=generator(1, 1))
    rng = generator(4, 4)
    jitter = {"translation_jitter": (0.01, 0.02, 0.03), "rotation_jitter": 0.05}
    moves = invert(nominal) @ np.array([place_camera((0, 0, 1), (1, 0.5, 0.5), **jitter, rng=rng) for _ in range(3000)])
    shift, turn = moves[:, :3, 3], Rotation.from_matrix(moves[:, :3, :3]).as_rotvec()
    for values, half in ((shift, (0.01, 0.02, 0.03)), (turn, 0.05)):
        assert np.all(np.abs(values) <= np.asarray(half) + 1e-12)
        np.testing.assert_allclose(values.std(axis=0), np.broadcast_to(half, 3) / np.sqrt(3), rtol=0.04)
        np.testing.assert_allclose(values.mean(axis=0), 0, atol=0.04 * np.max(half))


def test_the_stream_of_random_numbers_does_not_depend_on_the_setting() -> None:
    streams = [generator(1, 1) for _ in range(2)]
    jittered(np.eye(4), rng=streams[0])
    jittered(np.eye(4), translation_jitter=0.1, rotation_jitter=0.1, rng=streams[1])
    assert streams[0].random() == streams[1].random()


def test_bad_poses_are_refused() -> None:
    with pytest.raises(ConfigError, match="coincide"):
        place_camera((1, 1, 1), (1, 1, 1), rng=generator(1, 1))
    with pytest.raises(ConfigError, match="rigid"):
        jittered(2 * np.eye(4), rng=generator(1, 1))
    with pytest.raises(ConfigError, match="negative"):
        jittered(transform(), translation_jitter=-0.1, rng=generator(1, 1))


def test_published_figures_of_the_presets() -> None:
    """Table 2.3 of the thesis, and the fields of view of section 2.1.3."""
    table = {
        1: ((1.0, 4.0), 5, 2000), 2: ((1.0, 4.0), 10, 1000), 3: ((0.5, 1.5), 15, 700),
        4: ((0.3, 2.0), 25, 450), 5: ((0.3, 2.0), 35, 600), 6: ((0.1, 1.0), 45, 500),
    }  # fmt: skip
    for case, (window, fps, integration_us) in table.items():
        sensor = SENSORS[f"pico_monstar_105/{case}"]
        assert (sensor.range_m, sensor.fps, round(sensor.integration_s * 1e6)) == (window, fps, integration_us)
        assert (sensor.camera.width, sensor.camera.height) == (352, 287)
    assert SENSORS["pico_monstar_105"].range_m == table[3][0]
    for name, horizontal, vertical in (("pico_monstar_105", 100, 85), ("evk75123", 100, None), ("evk75023", 90, None)):
        camera = SENSORS[name].camera
        edges = [(-0.5, camera.cy), (camera.width - 0.5, camera.cy), (camera.cx, -0.5), (camera.cx, camera.height - 0.5)]
        x, y = np.degrees(np.arctan(camera.unproject(edges, np.ones(4))[:, :2])).T
        assert x[1] - x[0] == pytest.approx(horizontal, abs=0.2), name
        if vertical:
            assert y[3] - y[2] == pytest.approx(vertical, abs=0.2), name


@pytest.mark.parametrize("name", list(OWN_SENSORS))
def test_every_pixel_of_a_preset_has_a_ray(name: str) -> None:
    assert np.isfinite(SENSORS[name].camera.range_over_depth).all()


def test_own_sensor_from_plain_data() -> None:
    sensor = Sensor.model_validate(
        {
            "name": "mine",
            "camera": {"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 31.5, "cy": 23.5},
            "range_m": [0.2, 2.0],
            "integration_s": 0.001,
            "fps": 30,
            "frequencies_hz": [60e6],
        }
    )
    assert sensor.camera.rays.shape == (48, 64, 2)
    assert hash(sensor) == hash(sensor.model_copy())


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"range_m": (2.0, 1.0)}, "empty"),
        ({"frequencies_hz": ()}, "no modulation frequency"),
        ({"integration_s": 450.0}, "an exposure of 450 s is longer than a frame"),
        ({"frequencies_hz": (60e6, 60e6)}, "do not unwrap"),
        ({"frequencies_hz": (80e6, 61.7e6)}, "do not unwrap"),
    ],
)
def test_contradictions_are_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        small_sensor(**fields)


def test_unknown_names_list_the_known() -> None:
    with pytest.raises(ConfigError) as error:
        sensor_by_name("pico")
    assert "kinect_v1" in str(error.value.hint)
    with pytest.raises(ValidationError):
        small_sensor(contrst=0.5)


def test_buffers_of_unlike_shapes_are_refused() -> None:
    depth = np.ones((6, 8), np.float32)
    material = np.zeros((6, 8), np.uint8)
    with pytest.raises(ConfigError, match="differ"):
        GeometryBuffers.dense(2, depth, depth[:4], material)
    with pytest.raises(ConfigError, match="samples"):
        GeometryBuffers.dense(4, depth, depth, material)
    with pytest.raises(ConfigError, match="arrays"):
        replace(GeometryBuffers.dense(2, depth, depth, material), depth_m=np.ones((3, 4)))
    assert GeometryBuffers.dense(2, depth, depth, material).shape == (3, 4)
