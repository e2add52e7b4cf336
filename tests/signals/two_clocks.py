"""Two clocks that differ by an offset and a drift, and a motion that both see."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

OFFSET, DRIFT = 0.1234567, 50e-6
CAMERA_S = np.arange(0, 40, 1 / 30)
OPTICAL_S = np.arange(-2, 43, 1 / 100)


def to_b(t: np.ndarray) -> np.ndarray:
    return t + OFFSET + DRIFT * t


def to_a(t: np.ndarray) -> np.ndarray:
    return (t - OFFSET) / (1 + DRIFT)


def motion(t: np.ndarray) -> np.ndarray:
    """(T, 2): nothing above 1.5 Hz, and no repetition."""
    u = 60 * np.sin(3.8 * t + 0.6 * np.sin(0.31 * t)) + 25 * np.sin(1.7 * t + 2 * np.sin(0.23 * t))
    return np.stack((u, 20 * np.cos(2.9 * t + np.sin(0.4 * t)) + 0.3 * t), axis=-1)


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)
