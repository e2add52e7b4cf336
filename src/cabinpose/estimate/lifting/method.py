"""Lifting as a method."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.lifting.config import LiftingConfig
from cabinpose.estimate.methods import Arrays, Layout, NetworkMethod

if TYPE_CHECKING:
    from torch import Tensor

    from cabinpose.estimate.lifting.model import Lifting
    from cabinpose.estimate.tasks import PeopleBatch


class LiftingMethod(NetworkMethod[LiftingConfig]):
    """2D joints of one person to 3D by a residual fully connected network, see `model.py`."""

    name = "lifting"
    task = "lift"
    settings_type = LiftingConfig
    outputs = ("relative", "root")
    of_places = False
    learning_rate = 1e-3
    weight_decay = 0.01

    def network(self, settings: LiftingConfig) -> Lifting:
        from cabinpose.estimate.lifting.model import Lifting  # noqa: PLC0415 - torch

        return Lifting(settings)

    def layout(self, settings: LiftingConfig) -> Layout:
        """Columns of the first layer and rows of the last, see `model.Lifting.forward`."""
        joints = settings.shared_joints
        given = {1: [*product(joints, "xy"), *product(joints, ["known"]), *product(["centre"], "xy")]}
        found = {0: [*product(joints, "xyz"), *product(["root"], "xyz")]}
        return {"first.0.weight": given, "last.weight": found, "last.bias": found}

    def loss(self, network: Lifting, batch: PeopleBatch) -> dict[str, Tensor]:
        from cabinpose.estimate.lifting.fit import loss  # noqa: PLC0415 - torch

        return loss(network, batch)

    def decode(self, outputs: Arrays, settings: LiftingConfig, seen: Arrays) -> NDArray[np.float64]:
        """Joints (N, J, 3) in the camera frame (m) of N people; NaN for people of too few 2D joints.

        outputs: relative (N, J, 3) m, root (N, 3) x/z, y/z, z · seen: pose (N, J, 3), the input.
        """
        root = np.asarray(outputs["root"], dtype=np.float64)
        at = np.concatenate((root[:, :2] * root[:, 2:], root[:, 2:]), axis=-1)
        joints = np.asarray(outputs["relative"], dtype=np.float64) + at[:, None]
        enough = seen["pose"][..., 2].sum(axis=-1) >= settings.min_joints
        return np.where(enough[:, None, None], joints, np.nan)


METHOD = LiftingMethod()
