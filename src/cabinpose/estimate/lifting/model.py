"""The lifting network: a residual fully connected network from the 2D joints of one person to 3D.

J. Martinez, R. Hossain, J. Romero, J. J. Little, "A simple yet effective baseline for 3D human pose estimation", ICCV 2017.
Theirs knows all joints and gives them relative to the root; here joints may be missing, and the root's place is given too.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from cabinpose.estimate.lifting.config import ROOT, LiftingConfig


class Lifted(NamedTuple):
    """The network's answers for N people: relative (N, J, 3) joints from the root, m · root (N, 3) x/z, y/z and z (m)."""

    relative: Tensor
    root: Tensor


class Lifting(nn.Module):
    """The lifting network."""

    def __init__(self, config: LiftingConfig) -> None:
        super().__init__()
        self.config = config
        joints = len(config.joints)
        self.root = config.joints.index(ROOT)
        self.first = nn.Sequential(*_layer(3 * joints + 2, config.width, config.dropout))
        self.blocks = nn.ModuleList(
            nn.Sequential(
                *_layer(config.width, config.width, config.dropout), *_layer(config.width, config.width, config.dropout)
            )
            for _ in range(config.blocks)
        )
        self.last = nn.Linear(config.width, 3 * joints + 3)

    def forward(self, pose: Tensor) -> Lifted:
        """Joints in 3D from pose (N, J, 3): x/z, y/z of each joint, and 1 where it is known, 0 where not.

        Joints enter relative to the root, or to the mean of the known ones where the root is missing, whose place follows.
        """
        known = pose[..., 2:]
        xy = pose[..., :2] * known
        mean = xy.sum(dim=1) / known.sum(dim=1).clamp(min=1)
        rooted = known[:, self.root]
        centre = rooted * xy[:, self.root] + (1 - rooted) * mean
        x = self.first(torch.cat((((xy - centre.unsqueeze(1)) * known).flatten(1), known.flatten(1), centre), dim=1))
        for block in self.blocks:
            x = x + block(x)
        values = self.last(x)
        relative = values[:, :-3].reshape(-1, len(self.config.joints), 3)
        # Relative to the root, the root is at zero; where it was seen, so is its direction known.
        relative = relative - relative[:, self.root : self.root + 1]
        direction = centre + (1 - rooted) * values[:, -3:-1]
        return Lifted(relative, torch.cat((direction, torch.exp(values[:, -1:])), dim=1))


def _layer(inputs: int, outputs: int, dropout: float) -> tuple[nn.Module, ...]:
    return nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.ReLU(), nn.Dropout(dropout)
