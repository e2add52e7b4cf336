"""The thesis' network of part affinity fields (its table 6.2), with the refinement stages of the original as an option.

The first ten layers of VGG-19 (Simonyan and Zisserman 2015) give features at stride 8; three branches on them give part
affinity fields, heat maps, and the presence of each joint. Hidden convolutions are normalised over the batch while training,
which the thesis' are not; an exported network has the norms folded into them. Z. Cao, T. Simon, S.-E. Wei, Y. Sheikh, "Realtime
multi-person 2D pose estimation using part affinity fields", CVPR 2017; the thesis keeps its first stage and adds the presence
branch.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from cabinpose.estimate.batch import ray_tensor
from cabinpose.estimate.methods import Layout
from cabinpose.estimate.paf.config import PafConfig

STRIDE = 8
_LAST, _LAST_REFINED = 12, 18  # positions of the answering layers in a branch and in a refinement
_CLOUD_M = 1.5  # the cloud's x and y in -1.5 to 1.5 m are mapped to 0..255
_AMPLITUDE = 500.0  # the amplitude that is mapped to 255


class Maps(NamedTuple):
    """The network's answers for N frames, J joints and C limbs, maps at stride 8.

    fields: (N, 2C, h, w) x and y of limb c at 2c and 2c + 1 · heat: (N, J + 1, h, w), the background last · presence: (N, J, K)
    logits of absent and present, of absent, occluded and visible, or zeros without the branch · stages: fields and heat of every
    stage, the last one's among them.
    """

    fields: Tensor
    heat: Tensor
    presence: Tensor
    stages: tuple[tuple[Tensor, Tensor], ...]


class Paf(nn.Module):
    """The network of the part affinity fields."""

    rays: Tensor

    def __init__(self, config: PafConfig) -> None:
        super().__init__()
        self.config = config
        joints, limbs = len(config.joints), len(config.joint_set.limbs)

        def c(channels: int) -> int:
            return max(4, round(config.channels * channels))

        def conv(inputs: int, outputs: int, size: int = 3) -> tuple[nn.Module, ...]:
            """A convolution, normalised over the batch and rectified."""
            layer = nn.Conv2d(inputs, outputs, size, padding=size // 2, bias=False)
            return layer, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)

        self.features = nn.Sequential(
            *conv(3 if config.input in ("cloud", "rgb") else 1, c(64)), *conv(c(64), c(64)), nn.MaxPool2d(2),
            *conv(c(64), c(128)), *conv(c(128), c(128)), nn.MaxPool2d(2),
            *conv(c(128), c(256)), *conv(c(256), c(256)), *conv(c(256), c(256)), *conv(c(256), c(256)), nn.MaxPool2d(2),
            *conv(c(256), c(512)), *conv(c(512), c(512)), *conv(c(512), c(256)), *conv(c(256), c(128)),
        )  # fmt: skip

        def branch(last: int, outputs: int) -> nn.Sequential:
            hidden = (layer for _ in range(3) for layer in conv(c(128), c(128)))
            return nn.Sequential(*hidden, *conv(c(128), c(last), 1), nn.Conv2d(c(last), outputs, 1))

        self.fields = branch(512, 2 * limbs)
        self.heat = branch(512, joints + 1)
        if config.presence_labels:
            self.presence = branch(256, joints)
            cells = (config.height // STRIDE) * (config.width // STRIDE)
            self.classify = Presence(joints, cells, c(100), config.presence_labels)

        def refine(outputs: int) -> nn.Sequential:
            first = c(128) + 2 * limbs + joints + 1
            hidden = (layer for i in range(5) for layer in conv(first if i == 0 else c(128), c(128), 7))
            return nn.Sequential(*hidden, *conv(c(128), c(128), 1), nn.Conv2d(c(128), outputs, 1))

        more = range(config.stages - 1)
        self.refined_fields = nn.ModuleList(refine(2 * limbs) for _ in more)
        self.refined_heat = nn.ModuleList(refine(joints + 1) for _ in more)
        self.register_buffer("rays", ray_tensor(config.view), persistent=False)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        # As in the original, answers begin near zero: large first errors leave the features without variation.
        presence = [self.presence] if config.presence_labels else []
        for answering in (self.fields, self.heat, *presence, *self._refined()):
            nn.init.normal_(cast(nn.Conv2d, answering[-1]).weight, std=0.01)

    def _refined(self) -> list[nn.Sequential]:
        return [cast(nn.Sequential, module) for module in (*self.refined_fields, *self.refined_heat)]

    def scaled(self, image: Tensor) -> Tensor:
        """The input (N, 1 or 3, h, w) in 0..255 as in the thesis, from depth (m, 0 = invalid) or amplitude (N, h, w), or rgb."""
        if self.config.input == "rgb":
            return image
        x = image.unsqueeze(1)
        if self.config.input == "amplitude":
            return (x / _AMPLITUDE).clamp(0, 1) * 255
        z = (x / self.config.depth_scale_m).clamp(0, 1)
        if self.config.input == "depth":
            return z * 255
        across = ((x * self.rays + _CLOUD_M) / (2 * _CLOUD_M)).clamp(0, 1) * (x > 0).to(x.dtype)
        return torch.cat((across, z), dim=1) * 255

    def forward(self, image: Tensor) -> Maps:
        """Maps from depth (N, h, w), m, 0 = invalid, from amplitude (N, h, w) or from rgb (N, 3, h, w), 0 to 255."""
        # As in the original, 0..255 becomes -0.5..0.5 before the first layer.
        features = self.features(self.scaled(image) / 256 - 0.5)
        stages = [(self.fields(features), self.heat(features))]
        for fields, heat in zip(self.refined_fields, self.refined_heat, strict=True):
            x = torch.cat((*stages[-1], features), dim=1)
            stages.append((fields(x), heat(x)))
        if self.config.presence_labels:
            presence = self.classify(self.presence(features))
        else:
            presence = image.new_zeros((image.shape[0], len(self.config.joints), 2))
        return Maps(*stages[-1], presence, tuple(stages))


def layout(config: PafConfig) -> Layout:
    """What rows of the network's tensors stand for, in the order of `Maps`; the joints' own layers know the cells of the view."""
    joints, width, height = config.shared_joints, config.width // STRIDE, config.height // STRIDE
    fields = [*product([(joints[a], joints[b]) for a, b in config.joint_set.limbs], "xy")]
    heat = [*joints, "background"]
    cells = [*product([f"{width} x {height} cells"], range(width * height))]
    features = [*range(max(4, round(config.channels * 128)))]
    found: dict[str, Mapping[int, Sequence[Hashable]]] = {}
    for kind in ("weight", "bias"):  # of the last layers
        found |= {f"fields.{_LAST}.{kind}": {0: fields}, f"heat.{_LAST}.{kind}": {0: heat}}
        for stage in range(config.stages - 1):
            found[f"refined_fields.{stage}.{_LAST_REFINED}.{kind}"] = {0: fields}
            found[f"refined_heat.{stage}.{_LAST_REFINED}.{kind}"] = {0: heat}
    for stage in range(config.stages - 1):
        for name in ("fields", "heat"):
            found[f"refined_{name}.{stage}.0.weight"] = {1: [*fields, *heat, *features]}
    if config.presence_labels:
        own = (f"presence.{_LAST}.weight", f"presence.{_LAST}.bias", "classify.first_bias", "classify.second")
        found |= {name: {0: joints} for name in (*own, "classify.second_bias")} | {"classify.first": {0: joints, 1: cells}}
    return found


class Presence(nn.Module):
    """For each joint two fully connected layers on its own map: `cells` → `hidden` → `labels`. Their size follows the map's."""

    def __init__(self, joints: int, cells: int, hidden: int, labels: int) -> None:
        super().__init__()
        self.first = nn.Parameter(torch.randn(joints, cells, hidden) * (2 / cells) ** 0.5)
        self.first_bias = nn.Parameter(torch.zeros(joints, 1, hidden))
        self.second = nn.Parameter(torch.randn(joints, hidden, labels) * (1 / hidden) ** 0.5)
        self.second_bias = nn.Parameter(torch.zeros(joints, 1, labels))

    def forward(self, maps: Tensor) -> Tensor:
        """(N, J, h, w) to logits (N, J, labels)."""
        x = torch.relu(maps).flatten(2).transpose(0, 1)
        hidden = torch.relu(x @ self.first + self.first_bias)
        return (hidden @ self.second + self.second_bias).transpose(0, 1)
