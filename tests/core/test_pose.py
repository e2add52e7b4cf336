"""Places in a car: where the wheel is, by who sits where."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal
from scipy.spatial.transform import Rotation

from cabinpose.core import SIDE_NAMES, wheel_sides


def test_the_wheel_is_where_its_driver_sits() -> None:
    """Against the places of the people, in random cameras; who is not known, faces the rear or sits behind says nothing."""
    rng = np.random.default_rng(4)
    vehicle_from_camera = np.tile(np.eye(4), (40, 1, 1))
    vehicle_from_camera[:, :3, :3] = Rotation.random(40, rng).as_matrix()
    vehicle_from_camera[:, :3, 3] = rng.normal(size=(40, 3))
    left = rng.random(40) < 0.5
    y = np.where(left[:, None], (0.4, -0.4, 0.4), (-0.4, 0.4, 0.4))  # driver, front passenger, rear left
    hips = np.zeros((40, 3, 2, 3))
    hips[..., 0, 1], hips[..., 1, 1] = y + 0.09, y - 0.09
    seen = np.einsum("nji,npkj->npki", vehicle_from_camera[:, :3, :3], hips - vehicle_from_camera[:, None, None, :3, 3])
    places, wheel = ("driver", "front_passenger", "rear_left"), np.where(left, 1, -1)
    assert_array_equal(wheel_sides(seen, vehicle_from_camera, places), wheel)
    assert_array_equal(wheel_sides(seen[:, 1:], vehicle_from_camera, places[1:]), wheel)
    assert not wheel_sides(seen[:, 2:], vehicle_from_camera, places[2:]).any()
    assert not wheel_sides(seen[:, :, ::-1], vehicle_from_camera, places).any()
    seen[:, 0] = np.nan
    assert_array_equal(wheel_sides(seen, vehicle_from_camera, places), wheel)
    assert not wheel_sides(seen, np.full((4, 4), np.nan), places).any()
    assert [SIDE_NAMES[side] for side in (0, 1, -1)] == ["", "left", "right"]
