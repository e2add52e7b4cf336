"""Where a camera stands: by the view of a cabin or by an own pose, with random jitter."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from cabinpose.core import ConfigError, Matrix, is_rigid, look_at, rotation_vector, transform
from cabinpose.core import reproducible as rp

_STRAIGHT = 1e-3  # sine of the angle to the vertical below which "up" is the vehicle's forward


def place_camera(
    eye: ArrayLike, target: ArrayLike, *, translation_jitter: ArrayLike = 0.0, rotation_jitter: ArrayLike = 0.0, rng: Generator
) -> Matrix:
    """`vehicle_from_camera` of a camera at `eye` that looks at `target` (both (3,), m, vehicle frame), then jittered.

    The image is upright (z up); a camera that looks straight down or up has the vehicle's forward upwards instead.
    Jitter: see `jittered`. ConfigError where `eye` and `target` coincide.
    """
    eye_, target_ = np.asarray(eye, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = target_ - eye_
    length = rp.norm(forward)
    if not length > 1e-6:
        raise ConfigError("the camera's eye and target coincide", hint="give a target at least a millimetre away")
    vertical = rp.hypot(forward[0], forward[1]) < _STRAIGHT * length
    pose = look_at(eye_, target_, (1.0, 0.0, 0.0) if vertical else (0.0, 0.0, 1.0))
    return _jittered(pose, translation_jitter, rotation_jitter, rng)


def jittered(
    vehicle_from_camera: Matrix, *, translation_jitter: ArrayLike = 0.0, rotation_jitter: ArrayLike = 0.0, rng: Generator
) -> Matrix:
    """A camera pose moved and turned about its own axes by uniform random amounts.

    `translation_jitter` (m) along and `rotation_jitter` (rad) about the camera's x, y, z: the half width of the uniform
    distribution, one number for all axes or three. Six numbers are always drawn, so that a stream of
    random numbers does not depend on the setting. ConfigError where the pose is not rigid or a jitter is negative.
    """
    if not is_rigid(vehicle_from_camera):
        raise ConfigError(
            "the camera pose is not a rigid transform", hint="give a rotation and a translation as 4x4, last row 0 0 0 1"
        )
    return _jittered(vehicle_from_camera, translation_jitter, rotation_jitter, rng)


def _jittered(pose: Matrix, translation_jitter: ArrayLike, rotation_jitter: ArrayLike, rng: Generator) -> Matrix:
    """See `jittered`; the pose is known to be rigid."""
    translation = np.asarray(translation_jitter, dtype=np.float64)
    rotation = np.asarray(rotation_jitter, dtype=np.float64)
    if not (translation.min() >= 0 and rotation.min() >= 0):
        raise ConfigError("camera jitter is negative", hint="give the half width of the jitter, 0 or more")
    draw = rng.uniform(-1.0, 1.0, 6)
    return rp.matmul(pose, transform(rotation_vector(draw[3:] * rotation), draw[:3] * translation))
