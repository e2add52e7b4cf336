"""An own sensor by its field of view, and what is taken for all that was not given."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cabinpose.core import Camera, ConfigError
from cabinpose.scene.sensor import OWN_SENSORS, Sensor


def lens(**keys: Any) -> Camera:
    """The camera of these keys on 240 x 180 px."""
    return Sensor.model_validate({"camera": {"width": 240, "height": 180, **keys}}).camera


def seen_deg(camera: Camera, axis: int) -> float:
    """The angle (degrees) between the rays of the image's opposite edges, by the definition of the angle of two vectors."""
    middle = np.array([camera.cx, camera.cy])
    edges = np.tile(middle, (2, 1))
    edges[:, axis] = -0.5, (camera.width, camera.height)[axis] - 0.5
    one, other = camera.unproject(edges, np.ones(2))
    return float(np.degrees(np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))))


@pytest.mark.parametrize("key", ["fov_deg", "hfov"])
def test_a_field_of_view_is_seen_from_edge_to_edge_by_square_pixels(key: str) -> None:
    camera = lens(**{key: 95})
    assert seen_deg(camera, 0) == pytest.approx(95)
    assert camera.fx == camera.fy


def test_both_fields_of_view_or_the_vertical_one_alone() -> None:
    camera = lens(hfov=80, vfov=62)
    assert (seen_deg(camera, 0), seen_deg(camera, 1)) == pytest.approx((80, 62))
    camera = lens(vfov=62)
    assert seen_deg(camera, 1) == pytest.approx(62)
    assert camera.fx == camera.fy


def test_what_a_calibration_says_is_kept() -> None:
    camera = lens(fx=110, fy=111, cx=118.0, cy=90.0, dist=[-0.05, 0.01, 0.0, 0.0, 0.0])
    assert camera == Camera(240, 180, 110.0, 111.0, 118.0, 90.0, (-0.05, 0.01, 0.0, 0.0, 0.0))
    assert lens(fx=110) == Camera(240, 180, 110.0, 110.0, 119.5, 89.5)


def test_a_camera_as_an_object_needs_no_keys() -> None:
    camera = Camera(240, 180, 110.0, 110.0, 119.5, 89.5)
    assert Sensor(camera=camera).camera is camera


@pytest.mark.parametrize("bad", [0, 180, -90, True, "wide", [90]])
def test_what_is_no_field_of_view_is_refused(bad: Any) -> None:
    with pytest.raises(ConfigError, match="no field of view"):
        lens(fov_deg=bad)


def test_what_is_taken_is_told_and_stays_when_it_is_written_down() -> None:
    sensor = Sensor.model_validate({"camera": {"width": 240, "height": 180, "fov_deg": 95}, "fps": 10})
    usual = OWN_SENSORS["pico_monstar_105/4"]
    told = ("range_m", "integration_s", "frequencies_hz", "contrast", "read_noise_e", "signal_e_per_s")
    assert {name: sensor.assumed[name] for name in told} == {name: getattr(usual, name) for name in told}
    assert "fps" not in sensor.assumed
    again = Sensor.model_validate(sensor.model_dump(mode="json"))
    assert again == sensor
    assert not again.assumed


def test_structured_light_has_no_modulation() -> None:
    camera = {"width": 240, "height": 180, "fov_deg": 60}
    assert Sensor.model_validate({"principle": "structured_light", "camera": camera}).frequencies_hz == ()


def test_what_is_left_out_is_a_monstars_but_for_light_and_image_circle() -> None:
    monstar = OWN_SENSORS["pico_monstar_105/4"]
    own = Sensor(camera=monstar.camera)
    others = {name: (getattr(own, name), getattr(monstar, name)) for name in Sensor.model_fields}
    others = {name: both for name, both in others.items() if both[0] != both[1]}
    assert others.pop("name")
    assert others == {"illumination_exponent": (0.0, -2.0), "field_radius_px": (None, 188.0)}  # as the page says
