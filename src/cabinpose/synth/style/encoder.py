"""What style is measured by: an encoder with VGG-19's layers, and losses between what it sees of two depth frames.

The roles of the layers are those of the thesis: content conv2_1 and conv3_1, style conv2_2, conv3_4 and conv4_4. Style is
compared in each region by itself, by guided Gram matrices (Gatys et al. 2017, "Controlling perceptual factors in neural style
transfer").
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from zipfile import is_zipfile

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from cabinpose.core import ModelError, check_archive

CONTENT = ("conv2_1", "conv3_1")
STYLE = MappingProxyType({"conv2_2": 0.7, "conv3_4": 0.25, "conv4_4": 0.05})  # weights: noise and edges are fine, scenes coarse
_BLOCKS = (2, 2, 4, 4)  # convolutions of each block, up to conv4_4
VGG_WIDTHS, OWN_WIDTHS = (64, 128, 256, 512), (16, 32, 64, 96)
DETAIL_M = 0.02  # deviation from a local mean that shows as half of the range
DETAIL_PX, COARSE_PX = 5, 15
_NOTHING = 1e-12  # square of what a Gram matrix of no pixels may be
_LEAST_SHARE = 0.005  # of a frame's pixels that a region has to have, to be judged
_IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))


class Encoder(nn.Module):
    """VGG-19 without its last block and classifier, on three channels of depth; average pooling, as Gatys et al. have it."""

    def __init__(
        self, widths: tuple[int, ...], mean: tuple[float, ...] = (0.5,) * 3, std: tuple[float, ...] = (0.08, 0.08, 0.25)
    ) -> None:
        super().__init__()
        self.convolutions = nn.ModuleDict()
        before = 3
        for block, (count, width) in enumerate(zip(_BLOCKS, widths, strict=True), 1):
            for k in range(1, count + 1):
                self.convolutions[f"conv{block}_{k}"] = nn.Conv2d(before, width, 3, padding=1)
                before = width
        self.mean: Tensor
        self.std: Tensor
        self.register_buffer("mean", torch.tensor(mean).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(std).view(1, 3, 1, 1), persistent=False)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """Features by layer, after its ReLU, of (N, 3, H, W) in 0..1."""
        value, features = (image - self.mean) / self.std, {}
        for name, convolution in self.convolutions.items():
            if name.endswith("_1") and name != "conv1_1":
                value = functional.avg_pool2d(value, 2)
            value = features[name] = functional.relu(convolution(value))
        return features


def own_encoder() -> Encoder:
    """The package's encoder, trained on generated depth by `tools/train_style_encoder.py`."""
    encoder = Encoder(OWN_WIDTHS)
    with (
        (resources.files("cabinpose.synth.style") / "encoder.npz").open("rb") as file,
        np.load(file, allow_pickle=False) as weights,
    ):
        encoder.load_state_dict({name: torch.from_numpy(weights[name].astype(np.float32)) for name in weights})
    return encoder.eval().requires_grad_(False)


def vgg19(path: Path) -> Encoder:
    """VGG-19 with torchvision's weights in a local file, whose state dict has `features.N.weight` and `.bias`.

    Raises ModelError where there is no such file, or other weights in it.
    """
    hint = "give torchvision's vgg19 weights, a state dict saved by torch (vgg19-*.pth)"
    if not path.is_file():
        raise ModelError(f"there are no weights of VGG-19 at {path}", hint=hint)
    try:
        if is_zipfile(path):
            check_archive(path)
        state: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever its unpickler does
        raise ModelError(f"{path} holds no weights that torch can read", hint=hint) from error
    encoder, number, ours = Encoder(VGG_WIDTHS, *_IMAGENET), 0, {}
    for name in encoder.convolutions:
        if name.endswith("_1") and name != "conv1_1":
            number += 1  # the pooling before it
        for what in ("weight", "bias"):
            ours[f"convolutions.{name}.{what}"] = f"features.{number}.{what}"
        number += 2  # itself and its ReLU
    wanted = encoder.state_dict()
    for key, theirs in ours.items():
        found = state.get(theirs) if isinstance(state, Mapping) else None
        if not isinstance(found, Tensor) or found.shape != wanted[key].shape:
            says = "is not there" if not isinstance(found, Tensor) else f"is {tuple(found.shape)}, not {tuple(wanted[key].shape)}"
            raise ModelError(f"{path} does not hold VGG-19: {theirs} {says}", hint=hint)
    encoder.load_state_dict({key: state[theirs].float() for key, theirs in ours.items()})
    return encoder.eval().requires_grad_(False)


def encoder_of(path: str | None) -> Encoder:
    """VGG-19 from a file, or the encoder of the package."""
    return own_encoder() if path is None else vgg19(Path(path))


def shown(depth: Tensor, valid: Tensor) -> Tensor:
    """Depth (N, 1, H, W), m, as an encoder sees it: (N, 3, H, W) in 0..1.

    Red is what the depth's mean over `DETAIL_PX` pixels deviates from that over `COARSE_PX`, green what the depth deviates from
    the former, blue whether it is valid; half of the range is `DETAIL_M`. In grey values of the depth itself, as networks for
    colour pictures would have it, a camera's noise is less than one step. What is not valid is black.
    """
    fine, coarse = (_box(depth * valid, size) / _box(valid, size).clamp_min(1e-3) for size in (DETAIL_PX, COARSE_PX))
    detail = 0.5 + 0.5 * torch.tanh(torch.cat([fine - coarse, depth - fine], dim=1) / (2 * DETAIL_M))
    return torch.cat([detail * valid, valid], dim=1)


def _box(value: Tensor, size: int) -> Tensor:
    """Mean over a square, zeros around the image."""
    half = size // 2
    along = functional.avg_pool2d(value, (1, size), 1, (0, half))
    return functional.avg_pool2d(along, (size, 1), 1, (half, 0))


def without_slow(value: Tensor, valid: Tensor, size: int) -> Tensor:
    """A change of depth without its mean over a square of valid pixels; 0 where invalid."""
    return (value - _box(value * valid, size) / _box(valid, size).clamp_min(1e-3)) * valid


def gram(features: Tensor, guides: Tensor) -> Tensor:
    """Guided Gram matrices (N, R, C, C) of features (N, C, h, w) in regions (N, R, H, W).

    Each guide is averaged to the layer's size and scaled to squares that sum to 1, so that of a guide of ones the result is the
    plain Gram matrix over the number of pixels; a region without pixels has zeros.
    """
    small = functional.adaptive_avg_pool2d(guides, (features.shape[2], features.shape[3]))
    small = small / small.square().sum(dim=(2, 3), keepdim=True).sqrt().clamp_min(1e-6)
    guided = (features[:, None] * small[:, :, None]).flatten(3)
    return guided @ guided.transpose(2, 3)


def _large(guides: Tensor) -> Tensor:
    """(N, R) whether there is enough of each region to be judged."""
    return guides.mean(dim=(2, 3)) >= _LEAST_SHARE


def _valid(image: Tensor, guides: Tensor) -> Tensor:
    """(N, R) share of valid pixels of each region."""
    return (image[:, 2:] * guides).sum(dim=(2, 3)) / guides.sum(dim=(2, 3)).clamp_min(1)


def _squares(grams: Tensor) -> Tensor:
    return grams.square().sum(dim=(2, 3))


class Loss(NamedTuple):
    """style: weighted mean over layers, mean over regions of |G - S|² / (|G|² + |S|²), S of the style, and the square difference
    of the regions' shares of valid pixels, which Gram matrices say little of · content: mean of the content layers' square
    differences over their squares.
    """

    style: Tensor
    content: Tensor


class StyleLoss:
    """Holds frames against one style frame, which gives each region its Gram matrices.

    A region that the style frame lacks keeps the look that it has.
    """

    def __init__(self, encoder: Encoder, image: Tensor, guides: Tensor) -> None:
        """image: (1, 3, H, W) as `shown` · guides: (1, R, H, W)."""
        self._encoder = encoder
        self._known = _large(guides)
        features = encoder(image)
        self._grams = {name: gram(features[name], guides) for name in STYLE}
        self._valid = _valid(image, guides)

    def content(self, image: Tensor) -> dict[str, Tensor]:
        """Features that a styled frame is to keep."""
        features = self._encoder(image)
        return {name: features[name] for name in CONTENT}

    def __call__(self, image: Tensor, guides: Tensor, content: Mapping[str, Tensor]) -> Loss:
        """Of frames (N, 3, H, W) as `shown`, in their regions (N, R, H, W)."""
        features = self._encoder(image)
        there = (_large(guides) & self._known).to(image.dtype)
        style = ((_valid(image, guides) - self._valid).square() * there).sum() / there.sum().clamp_min(1)
        for name, wanted in self._grams.items():
            found = gram(features[name], guides)
            apart = _squares(found - wanted) / (_squares(found) + _squares(wanted)).clamp_min(_NOTHING)
            style = style + STYLE[name] * (apart * there).sum() / there.sum().clamp_min(1)
        kept = [(features[name] - value).square().mean() / value.square().mean() for name, value in content.items()]
        return Loss(style, torch.stack(kept).mean())
