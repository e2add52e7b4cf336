"""What decoding gives: joints in the view and in the camera frame, with how sure the model is of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Found(NamedTuple):
    """Joints of N frames, P persons and J joints.

    uv: (N, P, J, 2) px of the model's view; NaN = no answer · joints_3d: (N, P, J, 3) m, camera frame; NaN = no answer ·
    score: (N, P, J), more is better · presence: (N, P, J) probability that the joint is in the image · spreads: (N, P, J, C) m,
    how far apart the parts of the model are that answered, in C ways; None where the model does not say.
    """

    uv: NDArray[np.float64]
    joints_3d: NDArray[np.float64]
    score: NDArray[np.float64]
    presence: NDArray[np.float64]
    spreads: NDArray[np.float64] | None = None


def sigmoid(logit: NDArray[Any]) -> NDArray[np.float64]:
    """1 / (1 + exp(-x)), without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * np.asarray(logit, dtype=np.float64))))
