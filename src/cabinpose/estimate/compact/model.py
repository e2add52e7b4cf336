"""The compact detector: every cell of a coarse grid votes for every joint of every place, and each joint is looked at again.

A light depthwise backbone sees depth, cloud and amplitude in the model's view and ends in features at stride 8. From them
each cell gives, for each joint of each place, a weight, an offset in the image and a depth; a joint is the mean of the votes
under the softmax of their weights. Voting by informative anchors follows A2J (Xiong et al., "A2J: Anchor-to-joint regression
network for 3D articulated pose estimation from a single depth image", ICCV 2019). It reaches joints that are hidden
or outside the image, and the depth of a joint is learnt, not read off the skin that covers it. `refine` then looks at a finer
resolution around each joint, knowing all others, and corrects it.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor, nn

from cabinpose.estimate.batch import ray_tensor
from cabinpose.estimate.compact.config import BackboneConfig, CompactConfig
from cabinpose.estimate.compact.refine import Refine
from cabinpose.estimate.found import mirrored_slots
from cabinpose.estimate.methods import Layout

STRIDE = 8
_CHANNELS = {("depth",): 4, ("depth", "amplitude"): 5, ("amplitude",): 2, ("rgb",): 3}  # by the images that are read
_VALUES = 6  # of a vote: weight, offset in u and v, depth, inside, visible
_CLOUD_M = 1.5  # half width of the cloud that is mapped to [-1, 1]


class Votes(NamedTuple):
    """The network's answers for N frames, S places and J joints.

    joints: (N, S, J, 3) u, v (px of the view) and depth (m) · inside, visible: (N, S, J) logits of the joint being in the
    image, and seen there · present: (N, S) logit of somebody being there · wheel: (N,) logit of the wheel being on
    the left; whose place is whose does not depend on it: driver is the left place of the front row · spreads: (N, S, J, C) m,
    standard deviation of the votes about their mean, and of a `Mirrored` network how far apart its two answers are · weights:
    (N, S, J, cells) log-probability of each cell, and earlier: the joints (N, S, J, 3) before each look that refined them, both
    for training.
    """

    joints: Tensor
    inside: Tensor
    visible: Tensor
    present: Tensor
    wheel: Tensor
    spreads: Tensor
    weights: Tensor
    earlier: tuple[Tensor, ...]


class Features(NamedTuple):
    """What the backbone sees: fine at stride 4, joined at stride 8 with what is known at stride 16, and deep at stride 16."""

    fine: Tensor
    joined: Tensor
    deep: Tensor


class Backbone(nn.Module):
    """The layers below a head: from images to features."""

    rays: Tensor

    def __init__(self, config: BackboneConfig) -> None:
        super().__init__()
        self.config = config
        c2, c4, c8, c16 = config.channels
        b4, b8, b16 = config.blocks
        self.stem = nn.Sequential(
            nn.Conv2d(_CHANNELS[config.inputs], c2, 3, 2, 1, bias=False), nn.BatchNorm2d(c2), nn.ReLU(inplace=True),
            *_stage(c2, c4, b4),
        )  # fmt: skip
        self.middle = nn.Sequential(*_stage(c4, c8, b8))
        self.deep = nn.Sequential(*_stage(c8, c16, b16), Attention(c16))
        self.lateral = unit(c8, c8)
        self.top = unit(c16, c8)
        self.merge = Block(c8, c8)
        self.register_buffer("rays", ray_tensor(config.view), persistent=False)

    def channels(self, *images: Tensor) -> Tensor:
        """Channels (N, C, h, w) of the images that the settings' `inputs` name.

        depth (N, h, w), m, 0 = invalid: valid or not, its distance from half of the greatest, and the cloud · amplitude
        (N, h, w): lit or not, and its logarithm, about 0 at `exp(5)` · rgb (N, 3, h, w): from 0..255 to -1..1.
        """
        seen = dict(zip(self.config.inputs, images, strict=True))
        if "rgb" in seen:
            return seen["rgb"] / 127.5 - 1.0
        if "depth" not in seen:
            light = seen["amplitude"].unsqueeze(1)
            lit = (light > 0).to(light.dtype)
            return torch.cat((lit, torch.log1p(light) / 5.0 - lit), dim=1)
        z = seen["depth"].unsqueeze(1)
        valid = (z > 0).to(z.dtype)
        centre = 0.5 * self.config.max_depth_m
        channels = [valid, (z / centre - 1.0) * valid, z * self.rays / _CLOUD_M]
        if "amplitude" in seen:
            # Light returned falls with the square of the distance: times z squared, what is left is the surface.
            channels.append(torch.log1p(seen["amplitude"].unsqueeze(1) * z * z) / 5.0 - valid)
        return torch.cat(channels, dim=1)

    def features(self, x: Tensor) -> Features:
        """Features of channels (N, C, h, w)."""
        fine = self.stem(x.contiguous(memory_format=torch.channels_last) if self.training else x)
        middle = self.middle(fine)
        deep = self.deep(middle)
        top = nn.functional.interpolate(self.top(deep), scale_factor=2.0, mode="nearest")
        return Features(fine, self.merge(self.lateral(middle) + top), deep)


class Compact(Backbone):
    """The network of the compact detector."""

    config: CompactConfig
    cells: Tensor

    def __init__(self, config: CompactConfig) -> None:
        super().__init__(config)
        _, c4, c8, c16 = config.channels
        count = len(config.slots) * len(config.joints)
        self.votes = nn.Conv2d(c8 + 2, _VALUES * count, 1)
        size = config.width, config.height
        self.looks = nn.ModuleList(
            Refine(size, len(config.slots), len(config.joints), c4, c8, pitch) for pitch in config.looks_px
        )
        self.present = nn.Sequential(nn.Linear(2 * c16, c8), nn.ReLU(inplace=True), nn.Linear(c8, len(config.slots)))
        self.wheel = nn.Sequential(nn.Linear(4 * c16, c8), nn.ReLU(inplace=True), nn.Linear(c8, 1))
        rows, columns = torch.meshgrid(
            torch.arange(config.height // STRIDE), torch.arange(config.width // STRIDE), indexing="ij"
        )  # pixel centre of each cell
        cells = torch.stack((columns.flatten(), rows.flatten())) * STRIDE + (STRIDE - 1) / 2
        self.register_buffer("cells", cells.float(), persistent=False)

    def forward(self, *images: Tensor) -> Votes:
        """Votes from the images of the settings' `inputs`, see `channels`. Without depth, looks see one without a surface."""
        x = self.channels(*images)
        depth = images[0] if self.config.inputs[0] == "depth" else torch.zeros_like(x[:, 0])
        fine, features, deep = self.features(x)
        n, s, j = depth.shape[0], len(self.config.slots), len(self.config.joints)
        near = nn.functional.avg_pool2d(x[:, :2], STRIDE)  # the surface of the cell, for votes relative to it
        votes = self.votes(torch.cat((features, near), dim=1)).reshape(n, s, j, _VALUES, -1)
        weights = torch.log_softmax(votes[:, :, :, 0], dim=-1)
        p = weights.exp()
        cell_u, cell_v = (self.cells[i] + STRIDE * votes[:, :, :, 1 + i] for i in range(2))
        u, v = (p * cell_u).sum(-1), (p * cell_v).sum(-1)
        z = 0.5 * self.config.max_depth_m * (1.0 + (p * votes[:, :, :, 3]).sum(-1))
        with torch.no_grad():
            cell_z = 0.5 * self.config.max_depth_m * (1.0 + votes[:, :, :, 3])
            apart = torch.stack((cell_u - u[..., None], cell_v - v[..., None], cell_z - z[..., None]), dim=-1)
            spread = (p * squared_m(apart, z[..., None], self.config.view.focal)).sum(-1).sqrt()
        inside, visible = (p.unsqueeze(3) * votes[:, :, :, 4:]).sum(-1).unbind(-1)
        half = (deep.shape[-1] + 1) // 2
        sides = torch.cat((_pooled(deep[..., :half]), _pooled(deep[..., -half:])), dim=1)
        joints, earlier = torch.stack((u, v, z), dim=-1), []
        for look in self.looks:  # detached: each learns to correct its input, and does not change what came before
            earlier.append(joints)
            start = joints.detach()
            more = look(depth.unsqueeze(1), fine, features, start, inside.detach(), visible.detach())
            joints, inside, visible = start + more.joints, inside + more.inside, visible + more.visible
        return Votes(
            joints,
            inside,
            visible,
            self.present(_pooled(deep)),
            self.wheel(sides)[:, 0],
            spread[..., None],
            weights,
            tuple(earlier),
        )


def layout(config: CompactConfig) -> Layout:
    """What rows of the network's tensors stand for: a vote's values are those of a place's joint, in this order."""
    slots, joints = config.slots, config.shared_joints
    found: dict[str, Mapping[int, Sequence[Hashable]]] = {}
    for kind in ("weight", "bias"):
        found |= {f"votes.{kind}": {0: [*product(slots, joints, range(_VALUES))]}, f"present.2.{kind}": {0: slots}}
    for i in range(len(config.looks_px)):
        found |= {f"looks.{i}.place": {0: slots, 1: joints}, f"looks.{i}.embed": {0: joints}, f"looks.{i}.say": {0: joints}}
    return found


def squared_m(apart: Tensor, depth: Tensor, focal: float) -> Tensor:
    """(...) squared length in m² of differences (..., 3) in u, v (px) and depth (m), at depths (...) m."""
    return apart[..., :2].square().sum(-1) * (depth / focal).square() + apart[..., 2].square()


class Block(nn.Module):
    """Depthwise 5x5, then 1x1, with a residual where the shape allows it."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.depthwise = nn.Conv2d(inputs, inputs, 5, stride, 2, groups=inputs)
        hidden = 2 * outputs
        self.mix = nn.Sequential(
            nn.Conv2d(inputs, hidden, 1, bias=False), nn.BatchNorm2d(hidden), nn.ReLU(inplace=True),
            nn.Conv2d(hidden, outputs, 1, bias=False), nn.BatchNorm2d(outputs),
        )  # fmt: skip
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        """(N, inputs, h, w) to (N, outputs, h / stride, w / stride)."""
        y = self.mix(self.depthwise(x))
        return x + y if self.residual else y


class Attention(nn.Module):
    """Self-attention over all cells: far parts of a body, and other bodies, inform each cell."""

    def __init__(self, channels: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.BatchNorm2d(channels)
        self.qkv = nn.Conv2d(channels, 3 * channels, 1, bias=False)
        self.out = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, h, w) to the same shape."""
        n, c, h, w = x.shape
        qkv = self.qkv(self.norm(x)).reshape(n, 3, self.heads, c // self.heads, h * w)
        q, k, v = qkv.transpose(-1, -2).unbind(1)
        mixed = nn.functional.scaled_dot_product_attention(q, k, v)
        return x + self.out(mixed.transpose(-1, -2).reshape(n, c, h, w))


def unit(inputs: int, outputs: int) -> nn.Sequential:
    """A 1x1 convolution, normalised."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1, bias=False), nn.BatchNorm2d(outputs))


def _pooled(x: Tensor) -> Tensor:
    """Means and greatest values (N, 2 C) of features (N, C, h, w)."""
    return torch.cat((x.mean((2, 3)), x.amax((2, 3))), dim=1)


def _stage(inputs: int, outputs: int, count: int) -> list[nn.Module]:
    """Blocks that halve the image at their first."""
    return [Block(inputs, outputs, 2), *(Block(outputs, outputs) for _ in range(count - 1))]


class Mirrored(nn.Module):
    """A trained network that answers with the mean of what it says of a frame and of its mirror image.

    The errors of the two differ, so that their mean is smaller, at twice the time, and how much they differ says how large they
    are. weights and earlier are those of the frame alone.
    """

    def __init__(self, network: Compact) -> None:
        super().__init__()
        self._network = network
        self._joints = list(network.config.joint_set.mirror)
        self._slots = mirrored_slots(network.config.slots)

    def forward(self, *images: Tensor) -> Votes:
        """Votes as the network's own."""
        one = self._network(*images)
        other = self._network(*(image.flip(-1) for image in images))
        width = self._network.config.width
        uvz = other.joints[:, self._slots][:, :, self._joints]
        uvz = torch.cat((width - 1 - uvz[..., :1], uvz[..., 1:]), dim=-1)

        def mean(mine: Tensor, theirs: Tensor) -> Tensor:
            return 0.5 * (mine + theirs[:, self._slots][:, :, self._joints])

        joints = 0.5 * (one.joints + uvz)
        apart = squared_m(one.joints - uvz, joints[..., 2], self._network.config.view.focal).sqrt()
        return Votes(
            joints,
            mean(one.inside, other.inside),
            mean(one.visible, other.visible),
            0.5 * (one.present + other.present[:, self._slots]),
            0.5 * (one.wheel - other.wheel),
            torch.cat((mean(one.spreads, other.spreads), apart[..., None]), dim=-1),
            one.weights,
            one.earlier,
        )
