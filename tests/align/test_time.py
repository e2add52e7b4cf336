"""Delays of a suit and of a camera against an optical system, from a head that turns and a pendulum that swings."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.align.time import suit_to_optical, tof_to_optical
from cabinpose.core.camera import Camera
from cabinpose.core.errors import AlignmentError, ConfigError
from cabinpose.core.frames import apply, invert, look_at
from cabinpose.signals import DelaySearch

sys.path.insert(0, str(Path(__file__).parents[1] / "signals"))

from two_clocks import CAMERA_S, DRIFT, OFFSET, OPTICAL_S, motion, to_a, to_b, wxyz


def _pendulum(t: np.ndarray) -> np.ndarray:
    """(T, 3) of the world: a swing of 1.8 s, a little elliptic, dying away."""
    along, across = 0.35 * np.exp(-t / 90) * np.sin(3.49 * t), 0.1 * np.exp(-t / 90) * np.cos(3.49 * t)
    return np.stack((1.9 + 0.8 * np.sin(across), 0.8 * np.sin(along), 2.1 - 0.8 * np.cos(along) * np.cos(across)), axis=-1)


def _head(t: np.ndarray) -> Rotation:
    start = np.clip((t - 1) / 2, 0, 1)
    angles = (0.7 * np.sin(0.9 * t + 0.5 * np.sin(0.37 * t)), 0.4 * np.sin(1.3 * t + np.sin(0.21 * t)), 0.3 * np.sin(1.7 * t))
    return Rotation.from_euler("ZYX", np.stack(angles, axis=-1) * start[:, None])


@pytest.mark.parametrize(("signal", "exact"), [("velocity", 1e-4), ("speed", 5e-4), ("angle", 5e-4)])
def test_suit_and_optical_system_by_the_head(signal: str, exact: float):
    """Other worlds and other frames of the body; 60 Hz against 100 Hz."""
    rng = np.random.default_rng(8)
    world, body = Rotation.random(2, rng=rng)
    time = np.arange(0, 60, 1 / 60)
    suit = wxyz(world * _head(time) * body) * rng.choice((-1.0, 1.0), (len(time), 1))
    optical_s = np.arange(-1.5, 63, 0.01)
    optical = wxyz(_head(to_a(optical_s)))
    optical[2000:2200] = np.nan
    delay = suit_to_optical(time, suit, optical_s, optical, DelaySearch(max_lag_s=1.0, drift=True), signal=signal)
    assert np.abs(delay.to_b(time) - to_b(time)).max() < exact


def test_velocity_withstands_heading_drift_and_noise():
    rng = np.random.default_rng(9)
    time, optical_s = np.arange(0, 60, 1 / 60), np.arange(-1.5, 63, 0.01)
    drifting = Rotation.from_euler("z", (2e-3 * time)[:, None])
    noise = Rotation.from_rotvec(rng.normal(scale=np.radians(0.3), size=(len(time), 3)))
    suit, optical = wxyz(drifting * _head(time) * noise), wxyz(_head(to_a(optical_s)))
    delay = suit_to_optical(time, suit, optical_s, optical, DelaySearch(max_lag_s=1.0, drift=True))
    assert np.abs(delay.to_b(time) - to_b(time)).max() < 2e-3
    thesis = suit_to_optical(time, suit, optical_s, optical, DelaySearch(max_lag_s=1.0, drift=True), signal="angle")
    assert abs(thesis.offset_s - to_b(np.array(thesis.reference_s)) + thesis.reference_s) > 2e-3


def test_a_head_that_turns_about_one_axis_is_aligned_by_its_speed():
    time, optical_s = np.arange(0, 40, 1 / 60), OPTICAL_S
    yaw = 0.02 * motion(time)[:, :1], 0.02 * motion(to_a(optical_s))[:, :1]
    suit, optical = (wxyz(Rotation.from_euler("z", angle)) for angle in yaw)
    delay = suit_to_optical(time, suit, optical_s, optical, DelaySearch(max_lag_s=1.0, drift=True))
    assert np.abs(delay.to_b(time) - to_b(time)).max() < 5e-4


def test_camera_and_optical_system_by_the_pendulum():
    camera = Camera.from_fov(352, 287, 1.2, dist=(-0.2, 0.05, 0.001, -0.001, 0.0))
    camera_from_world = invert(look_at((0, 0, 1.5), (2, 0, 1.4)))
    uv = camera.project(apply(camera_from_world, _pendulum(CAMERA_S)))
    marker = _pendulum(to_a(OPTICAL_S))
    delay = tof_to_optical(CAMERA_S, uv, OPTICAL_S, marker, camera, camera_from_world, DelaySearch(max_lag_s=0.8, drift=True))
    assert np.abs(delay.to_b(CAMERA_S) - to_b(CAMERA_S)).max() < 1e-6
    rng = np.random.default_rng(10)
    uv += rng.normal(scale=0.1, size=uv.shape)
    uv[rng.random(len(uv)) < 0.02] = np.nan
    marker += rng.normal(scale=3e-4, size=marker.shape)
    marker[500:560] = np.nan
    delay = tof_to_optical(CAMERA_S, uv, OPTICAL_S, marker, camera, camera_from_world, DelaySearch(max_lag_s=0.8))
    assert abs(delay.offset_s - OFFSET - DRIFT * delay.reference_s) < 5e-4
    with pytest.raises(AlignmentError, match=r"ambiguous: .* \(r = 1.000\) or .* s \(r = 1.000\)") as error:
        tof_to_optical(CAMERA_S, uv, OPTICAL_S, marker, camera, camera_from_world, DelaySearch(max_lag_s=3.0))
    assert "half a period" in str(error.value.hint)
    with pytest.raises(AlignmentError, match="pixels"):
        tof_to_optical(CAMERA_S, uv[:, 0], OPTICAL_S, marker, camera, camera_from_world, DelaySearch(max_lag_s=0.8))


def test_a_signal_has_a_known_name():
    with pytest.raises(ConfigError, match="signal 'gyro'"):
        suit_to_optical([0.0], np.ones((1, 4)), [0.0], np.ones((1, 4)), DelaySearch(max_lag_s=1, drift=True), signal="gyro")
