"""A batch of training frames in a model's view."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Batch(NamedTuple):
    """N frames with S places and J joints, in the model's view (h, w).

    depth: (N, h, w) m, 0 = invalid; (N, 0, 0) for a method without images · joints: (N, S, J, 3) u, v (px) and depth (m), NaN
    unknown · visibility: (N, S, J) uint8, the five states of the standard · present: (N, S) bool, somebody the camera sees
    sits there · amplitude: (N, h, w), or None where the method does not read it · labels: (N, h, w) uint8 classes of the
    pixels, or None where the method does not need them.
    """

    depth: Tensor
    joints: Tensor
    visibility: Tensor
    present: Tensor
    amplitude: Tensor | None = None
    labels: Tensor | None = None
