"""Networks of others as peers in speed: the published architectures with fresh weights, which find nothing.

- Lightweight OpenPose: D. Osokin, "Real-time 2D multi-person pose estimation on CPU: Lightweight OpenPose", arXiv 1811.12004
  (2018): a dilated MobileNet v1 up to conv5_5, 128 channels, an initial stage and one of refinement. Everybody in an image.
- RTMPose: T. Jiang et al., "RTMPose: Real-time multi-person pose estimation based on MMPose", arXiv 2303.07399 (2023): CSPNeXt
  (C. Lyu et al., "RTMDet", arXiv 2212.07784), a 7x7 convolution, a gated attention unit over the joints (W. Hua et al.,
  "Transformer quality in linear time", ICML 2022) and SimCC's one-dimensional answers. One person's crop.

All are trained for 17 or 18 joints of COCO on RGB; sizes and weights of their layers alone decide how long they take.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

import torch
from torch import Tensor, nn

from cabinpose.estimate.export import write_graph


@dataclass(frozen=True)
class Peer:
    """A network to set beside ours. size: (width, height) px of its input · sees: what one run of it answers for ·
    parameters_m, macs_g: published, in 10^6 and, of one run, in 10^9.
    """

    network: Callable[[], nn.Module]
    size: tuple[int, int]
    sees: str
    parameters_m: float
    macs_g: float

    def export(self, path: Path) -> None:
        """Write the network with fresh weights as ONNX: `image` (N, 3, h, w) float32 to two outputs."""
        width, height = self.size
        torch.manual_seed(0)
        write_graph(self.network().eval(), {"image": torch.zeros(1, 3, height, width)}, ("first", "second"), path)


def parameters_of(network: nn.Module) -> int:
    """The number of a network's weights."""
    return sum(p.numel() for p in network.parameters())


# ----------------------------------------------------------------------------------------------- Lightweight OpenPose
def _conv(
    inputs: int, outputs: int, size: int = 3, *, stride: int = 1, dilation: int = 1, groups: int = 1, norm: bool = False,
    bias: bool | None = None, active: Callable[..., nn.Module] | None = nn.ReLU, eps: float = 1e-5,
) -> nn.Sequential:  # fmt: skip
    """A convolution that keeps the image's size but for its stride, normalised and activated where asked for."""
    bias = not norm if bias is None else bias
    layers: list[nn.Module] = [nn.Conv2d(inputs, outputs, size, stride, dilation * (size // 2), dilation, groups, bias)]
    layers += [nn.BatchNorm2d(outputs, eps)] if norm else []
    layers += [active(inplace=True)] if active is not None else []
    return nn.Sequential(*layers)


def _separable(inputs: int, outputs: int, *, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """MobileNet's block: 3x3 on each channel, then 1x1, each normalised and rectified."""
    depthwise = _conv(inputs, inputs, stride=stride, dilation=dilation, groups=inputs, norm=True)
    return nn.Sequential(depthwise, _conv(inputs, outputs, 1, norm=True))


def _elu_separable(channels: int) -> nn.Sequential:
    elu = partial(_conv, channels, channels, bias=False, active=nn.ELU)
    return nn.Sequential(elu(3, groups=channels), elu(1))


class _Residual(nn.Module):
    """x + body(x), where `first` has brought x to the body's channels."""

    def __init__(self, first: nn.Module, body: nn.Module) -> None:
        super().__init__()
        self.first, self.body = first, body

    def forward(self, x: Tensor) -> Tensor:
        y = self.first(x)
        return y + self.body(y)


def _heads(trunk: nn.Module, channels: int, hidden: int, outputs: tuple[int, ...]) -> nn.ModuleList:
    branches = (nn.Sequential(_conv(channels, hidden, 1), _conv(hidden, n, 1, active=None)) for n in outputs)
    return nn.ModuleList([trunk, *branches])


class LightweightOpenPose(nn.Module):
    """Heat maps (19) and part affinity fields (38) at stride 8, refined once."""

    def __init__(self, channels: int = 128, outputs: tuple[int, int] = (19, 38)) -> None:
        super().__init__()
        c = channels
        self.features = nn.Sequential(
            _conv(3, 32, stride=2, norm=True),
            _separable(32, 64), _separable(64, 128, stride=2), _separable(128, 128), _separable(128, 256, stride=2),
            _separable(256, 256), _separable(256, 512), _separable(512, 512, dilation=2),
            *(_separable(512, 512) for _ in range(4)),
            _Residual(_conv(512, c, 1), nn.Sequential(*(_elu_separable(c) for _ in range(3)))), _conv(c, c),
        )  # fmt: skip
        self.initial = _heads(nn.Sequential(*(_conv(c, c) for _ in range(3))), c, 512, outputs)
        blocks = (
            _Residual(
                _conv(c + sum(outputs) if i == 0 else c, c, 1),
                nn.Sequential(_conv(c, c, norm=True), _conv(c, c, dilation=2, norm=True)),
            )
            for i in range(5)
        )
        self.refinement = _heads(nn.Sequential(*blocks), c, c, outputs)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3, h, w) to maps (N, 19, h / 8, w / 8) and fields (N, 38, h / 8, w / 8)."""
        features = self.features(image)
        heat, fields = _answers(self.initial, features)
        return _answers(self.refinement, torch.cat((features, heat, fields), dim=1))


def _answers(stage: nn.ModuleList, x: Tensor) -> tuple[Tensor, Tensor]:
    trunk, heat, fields = stage
    y = trunk(x)
    return heat(y), fields(y)


# ----------------------------------------------------------------------------------------------------------- RTMPose
_silu = partial(_conv, norm=True, active=nn.SiLU, eps=1e-3)


class _CrossStage(nn.Module):
    """CSPNeXt's layer: half of the channels through blocks of 3x3 and depthwise 5x5, all of them weighed by attention."""

    def __init__(self, channels: int, blocks: int, *, residual: bool) -> None:
        super().__init__()
        half = channels // 2
        bodies = (
            nn.Sequential(_silu(half, half, 3), _silu(half, half, 5, groups=half), _silu(half, half, 1)) for _ in range(blocks)
        )
        self.main = nn.Sequential(
            _silu(channels, half, 1), *(_Residual(nn.Identity(), body) if residual else body for body in bodies)
        )
        self.short = _silu(channels, half, 1)
        self.attention = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(2 * half, 2 * half, 1), nn.Hardsigmoid(inplace=True))
        self.final = _silu(2 * half, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        both = torch.cat((self.main(x), self.short(x)), dim=1)
        return self.final(both * self.attention(both))


class _Pyramid(nn.Module):
    """Spatial pyramid pooling: the greatest within 5, 9 and 13 pixels beside the value itself."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _silu(channels, channels // 2, 1)
        self.pools = nn.ModuleList(nn.MaxPool2d(size, 1, size // 2) for size in (5, 9, 13))
        self.last = _silu(channels // 2 * 4, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        y = self.first(x)
        return self.last(torch.cat((y, *(pool(y) for pool in self.pools)), dim=1))


class _ScaleNorm(nn.Module):
    """Vectors at the root mean square of 1, times one learnt factor."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.scale, self.gain = width**-0.5, nn.Parameter(torch.ones(1))

    def forward(self, x: Tensor) -> Tensor:
        return x / (x.norm(dim=-1, keepdim=True) * self.scale).clamp(min=1e-5) * self.gain


class _GatedAttention(nn.Module):
    """The gated attention unit over joints: (N, K, width) to the same shape."""

    def __init__(self, width: int = 256, key: int = 128) -> None:
        super().__init__()
        self.sizes = [2 * width, 2 * width, key]
        self.norm, self.enter = _ScaleNorm(width), nn.Linear(width, sum(self.sizes), bias=False)
        self.gamma, self.beta = nn.Parameter(torch.rand(2, key)), nn.Parameter(torch.rand(2, key))
        self.leave, self.shortcut = nn.Linear(2 * width, width, bias=False), nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        gate, value, base = torch.split(nn.functional.silu(self.enter(self.norm(x))), self.sizes, dim=-1)
        query, key = (base * self.gamma[i] + self.beta[i] for i in range(2))
        weights = torch.relu(query @ key.transpose(-1, -2) / self.sizes[-1] ** 0.5) ** 2
        return x * self.shortcut + self.leave(gate * (weights @ value))


class RtmPose(nn.Module):
    """SimCC answers for 17 joints of the person in a crop of 192 x 256; widen, deepen: the factors of the published sizes."""

    def __init__(self, widen: float, deepen: float, joints: int = 17, size: tuple[int, int] = (192, 256)) -> None:
        super().__init__()
        widths = [int(width * widen) for width in (64, 128, 256, 512, 1024)]
        stem = widths[0] // 2
        layers: list[nn.Module] = [_silu(3, stem, 3, stride=2), _silu(stem, stem, 3), _silu(stem, widths[0], 3)]
        for inputs, outputs, blocks in zip(widths, widths[1:], (3, 6, 6, 3), strict=False):
            last = outputs == widths[-1]
            layers.append(_silu(inputs, outputs, 3, stride=2))
            layers += [_Pyramid(outputs)] if last else []
            layers.append(_CrossStage(outputs, max(round(blocks * deepen), 1), residual=not last))
        self.features = nn.Sequential(*layers, nn.Conv2d(widths[-1], joints, 7, padding=3))
        cells = (size[0] // 32) * (size[1] // 32)
        self.mix = nn.Sequential(_ScaleNorm(cells), nn.Linear(cells, 256, bias=False), _GatedAttention(256))
        self.across, self.down = (nn.Linear(256, 2 * length, bias=False) for length in size)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3, 256, 192) to answers (N, 17, 384) along x and (N, 17, 512) along y, two a pixel."""
        x = self.mix(self.features(image).flatten(2))
        return self.across(x), self.down(x)


# Parameters and MACs as published: with OpenVINO's human-pose-estimation-0001, which is Lightweight OpenPose at 456 x 256
# (15.435 GFLOPs, half as many MACs; the paper's 9 are at 368 x 368), and with RTMPose's models in MMPose.
PEERS: Mapping[str, Peer] = MappingProxyType(
    {
        "lightweight_openpose": Peer(LightweightOpenPose, (456, 256), "everybody in the image, in 2D", 4.099, 7.7175),
        "rtmpose_t": Peer(lambda: RtmPose(0.375, 0.167), (192, 256), "the crop of one person, in 2D", 3.34, 0.36),
        "rtmpose_s": Peer(lambda: RtmPose(0.5, 0.33), (192, 256), "the crop of one person, in 2D", 5.47, 0.68),
    }
)
