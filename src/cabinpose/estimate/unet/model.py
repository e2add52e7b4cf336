"""Two U-Nets in a row (thesis, figure 5.17): people in the point cloud, then their parts in the cloud weighted by the first.

O. Ronneberger, P. Fischer, T. Brox, "U-Net: convolutional networks for biomedical image segmentation", MICCAI 2015; with padded
convolutions, so that the output has the size of the input, and batch normalisation.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from cabinpose.estimate.batch import ray_tensor
from cabinpose.estimate.unet.config import UnetConfig

_CLOUD_M = 1.5  # half width of the cloud that is mapped to 0..1


class Segments(NamedTuple):
    """The networks' answers for N frames: person (N, h, w) logit, parts (N, P, h, w) logits for pixels of people."""

    person: Tensor
    parts: Tensor


class Unet(nn.Module):
    """Both networks of the segmentation."""

    rays: Tensor

    def __init__(self, config: UnetConfig) -> None:
        super().__init__()
        self.config = config
        self.person = Stage(3, 1, config.channels, config.levels)
        self.parts = Stage(3, len(config.parts), config.channels, config.levels)
        self.register_buffer("rays", ray_tensor(config.view), persistent=False)

    def cloud(self, depth: Tensor) -> Tensor:
        """The normalised cloud (N, 3, h, w) of depths (N, h, w), m; 0 where invalid."""
        z = depth.unsqueeze(1)
        across = ((z * self.rays + _CLOUD_M) / (2 * _CLOUD_M)).clamp(0, 1) * (z > 0).to(z.dtype)
        return torch.cat((across, z / self.config.max_depth_m), dim=1)

    def forward(self, depth: Tensor) -> Segments:
        """Logits from depth (N, h, w), m, 0 = invalid."""
        cloud = self.cloud(depth)
        person = self.person(cloud)
        return Segments(person[:, 0], self.parts(cloud * torch.sigmoid(person)))


class Stage(nn.Module):
    """One U-Net: `levels` halvings, each with twice the channels, and back with what was seen on the way down."""

    def __init__(self, inputs: int, outputs: int, channels: int, levels: int) -> None:
        super().__init__()
        sizes = [channels * 2**level for level in range(levels + 1)]
        self.down = nn.ModuleList(_double(a, b) for a, b in zip([inputs, *sizes[:-1]], sizes, strict=True))
        self.up = nn.ModuleList(nn.ConvTranspose2d(2 * c, c, 2, 2) for c in reversed(sizes[:-1]))
        self.merge = nn.ModuleList(_double(2 * c, c) for c in reversed(sizes[:-1]))
        self.last = nn.Conv2d(channels, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(N, inputs, h, w) to logits (N, outputs, h, w)."""
        seen = []
        for level, layer in enumerate(self.down):
            x = layer(x if level == 0 else nn.functional.max_pool2d(x, 2))
            seen.append(x)
        for up, merge, beside in zip(self.up, self.merge, reversed(seen[:-1]), strict=True):
            x = merge(torch.cat((beside, up(x)), dim=1))
        return self.last(x)


def _double(inputs: int, outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before in (inputs, outputs):
        layers += [nn.Conv2d(before, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)
