"""A batch of training frames in a model's view, as tensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from cabinpose.estimate.inputs import InputView

NOT_LABELLED = 255
"""State of a joint of somebody who is there, of whom nothing says where it is: it is neither learnt nor learnt to be absent."""


class Batch(NamedTuple):
    """N frames with S places and J joints, in the model's view (h, w).

    depth: (N, h, w) m, 0 = invalid; (N, 0, 0) for a method without images · joints: (N, S, J, 3) u, v (px) and depth (m), NaN
    unknown · visibility: (N, S, J) uint8, the five states of the standard, or `NOT_LABELLED` · present: (N, S) bool, somebody
    the camera sees sits there · amplitude: (N, h, w), or None where the method does not read it · labels: (N, h, w) uint8
    classes of the pixels, or None where the method does not need them · wheel: (N,) int8, 1 where it is on the left, -1 on the
    right, 0 none or not known; None: nowhere · rgb: (N, 3, h, w) sRGB, 0 to 255, or None where the method does not read it.
    """

    depth: Tensor
    joints: Tensor
    visibility: Tensor
    present: Tensor
    amplitude: Tensor | None = None
    labels: Tensor | None = None
    wheel: Tensor | None = None
    rgb: Tensor | None = None

    @property
    def told(self) -> Tensor:
        """(N, S, J) bool: whether it is said where a joint is, or that the image does not show it."""
        somewhere = self.present.unsqueeze(-1) & (self.visibility > 1)
        return (self.visibility != NOT_LABELLED) & ~(somewhere & ~torch.isfinite(self.joints).all(-1))

    def images(self, names: Sequence[str]) -> tuple[Tensor, ...]:
        """The images of these names, as a network takes them. Raises ValueError for one that was not read."""
        images: tuple[Tensor | None, ...] = tuple(getattr(self, name) for name in names)
        if any(image is None for image in images):
            raise ValueError(f"this model reads {', '.join(names)}")
        return tuple(image for image in images if image is not None)


def ray_tensor(view: InputView) -> Tensor:
    """(2, h, w) float32: x/z and y/z of the view's pixels."""
    return torch.tensor(view.camera.rays.transpose(2, 0, 1), dtype=torch.float32)
