"""From the lifting network's answers to joints; the same for torch and ONNX Runtime."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.lifting.config import LiftingConfig


def decode(outputs: Mapping[str, NDArray[Any]], config: LiftingConfig, seen: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Joints (N, J, 3) in the camera frame (m) of N people; NaN for people of too few 2D joints.

    outputs: relative (N, J, 3) m, root (N, 3) x/z, y/z, z · seen: pose (N, J, 3), the input.
    """
    root = np.asarray(outputs["root"], dtype=np.float64)
    at = np.concatenate((root[:, :2] * root[:, 2:], root[:, 2:]), axis=-1)
    joints = np.asarray(outputs["relative"], dtype=np.float64) + at[:, None]
    enough = seen["pose"][..., 2].sum(axis=-1) >= config.min_joints
    return np.where(enough[:, None, None], joints, np.nan)
