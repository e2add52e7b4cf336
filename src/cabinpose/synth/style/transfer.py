"""Style transfer: by optimising one frame (Gatys et al. 2016), or by a network trained for one style (Johnson et al. 2016).

Both seek a change of the depth and which pixels are lost, so that what comes out is the same frame, seen by another camera. The
change is at most `MOST_M`, and has no part that is slower than `SLOW_PX`; pixels are lost at silhouettes alone.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn
from torch.nn import functional

from cabinpose.core import Bools, Floats32, make_folder, whole_file
from cabinpose.synth.style.encoder import Encoder, Loss, StyleLoss, encoder_of, shown, without_slow
from cabinpose.synth.style.frame import StyleFrame
from cabinpose.synth.style.settings import METADATA_KEY

MOST_M = 0.08
SLOW_PX = 7
KEPT = 2.0  # logit at which a pixel starts; below 0 it is lost
_STYLE_WEIGHT, _CONTENT_WEIGHT = 1.0, 0.1
_STEP_SIZE = {"frame": 0.05, "network": 2e-3}


@dataclass(frozen=True)
class Content:
    """Frames to be styled. depth, valid: (N, 1, H, W), m, 0 where invalid · guides: (N, 4, H, W) · noise: (N, 1, H, W), unit."""

    depth: Tensor
    valid: Tensor
    guides: Tensor
    noise: Tensor

    @classmethod
    def of(cls, inputs: Mapping[str, Floats32]) -> Content:
        """Of arrays by these names."""
        return cls(**{name: torch.from_numpy(array) for name, array in inputs.items()})

    def shown(self) -> Tensor:
        """The frames as an encoder sees them."""
        return shown(self.depth, self.valid)

    def regions(self) -> Tensor:
        """(N, 4, H, W) where their look is judged: in pixels that were valid."""
        return self.guides * self.valid


def changed(content: Content, raw: Tensor) -> tuple[Tensor, Tensor]:
    """The change of depth (m) and the logit of being kept that unbounded values (N, 2, H, W) stand for, (N, 1, H, W) each."""
    change = without_slow(MOST_M / 2 * torch.tanh(raw[:, :1]), content.valid, SLOW_PX)
    return change, KEPT + raw[:, 1:] * content.guides[:, -1:]


def seen(content: Content, change: Tensor, logit: Tensor) -> Tensor:
    """A styled frame as an encoder sees it. A pixel is kept or not: a step, through which gradients go as through a sigmoid."""
    soft = torch.sigmoid(logit)
    kept = content.valid * ((logit > 0).to(soft) + soft - soft.detach())
    return shown(content.depth + change, kept)


def style_loss(style: StyleFrame, encoder: Encoder) -> StyleLoss:
    """The loss against a style frame."""
    depth, valid = (torch.from_numpy(a).float()[None, None] for a in (style.depth_m, style.valid))
    with torch.no_grad():
        return StyleLoss(encoder, shown(depth, valid), torch.from_numpy(style.guides)[None])


class FrameOptimiser:
    """Styles frames by optimising each of them."""

    def __init__(self, style: StyleFrame, vgg19: str | None, steps: int) -> None:
        self._loss, self._steps = style_loss(style, encoder_of(vgg19)), steps

    def __call__(self, inputs: Mapping[str, Floats32]) -> tuple[Floats32, Bools]:
        """The change (H, W), m, of one frame as `inputs_of` has it, and the pixels that are kept."""
        torch.set_num_threads(1)  # sums, and with them the bytes of a dataset, depend on their number
        content = Content.of(inputs)
        raw = torch.cat([0.1 * content.noise, torch.zeros_like(content.noise)], dim=1).requires_grad_()
        optimiser = torch.optim.Adam([raw], lr=_STEP_SIZE["frame"])
        with torch.no_grad():
            kept = self._loss.content(content.shown())
        for _ in range(self._steps):
            optimiser.zero_grad()
            found = self._loss(seen(content, *changed(content, raw)), content.regions(), kept)
            _weighed(found).backward()  # type: ignore[no-untyped-call]
            optimiser.step()
        with torch.no_grad():
            change, logit = changed(content, raw)
        return change[0, 0].numpy(), logit[0, 0].numpy() > 0


class StyleNetwork(nn.Module):
    """The feed-forward network: depth, its detail, validity, noise and regions in, `changed` out.

    Instance normalisation as Ulyanov et al. 2016 have it, noise as in their texture networks: a camera's noise cannot be made
    of the frame alone. Height and width are multiples of 4.
    """

    def __init__(self) -> None:
        super().__init__()
        self.at_1 = _layer(8, 16)
        self.at_2 = _layer(16, 32, stride=2)
        self.at_4 = _layer(32, 48, stride=2)
        self.residuals = nn.ModuleList(nn.Sequential(_layer(48, 48), _layer(48, 48)) for _ in range(2))
        self.up_2 = _layer(48, 32)
        self.up_1 = nn.Conv2d(32, 16, 1)
        self.out = nn.Sequential(_layer(32, 16), nn.Conv2d(16, 2, 3, padding=1))

    def forward(self, depth: Tensor, valid: Tensor, guides: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """The change and the logit of being kept, (N, 1, H, W) each, of what `Content` holds."""
        content = Content(depth, valid, guides, noise)
        full = self.at_1(torch.cat([content.shown(), noise, guides], dim=1))
        half = self.at_2(full)
        value = self.at_4(half)
        for block in self.residuals:
            value = value + block(value)
        value = self.up_2(functional.interpolate(value, scale_factor=2.0)) + half
        value = functional.interpolate(self.up_1(value), scale_factor=2.0)
        return changed(content, self.out(torch.cat([value, full], dim=1)))


def _layer(before: int, after: int, *, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, stride, padding=1), nn.InstanceNorm2d(after, affine=True), nn.ReLU(inplace=True)
    )


def train(
    frames: Iterable[Content], steps: int, loss: StyleLoss, *, seed: int, report: Callable[[int, Loss], None]
) -> StyleNetwork:
    """Train a network for the style of a loss.

    Parameters
    ----------
    frames
        Content, one for each step.
    steps
        How many there are.
    loss
        Of the style.
    seed
        Of the network's first weights.
    report
        Called with each step and its loss.
    """
    torch.manual_seed(seed)
    network = StyleNetwork()
    optimiser = torch.optim.Adam(network.parameters(), lr=_STEP_SIZE["network"])
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step, content in enumerate(frames, 1):
        with torch.no_grad():
            kept = loss.content(content.shown())
        outputs = network(content.depth, content.valid, content.guides, content.noise)
        found = loss(seen(content, *outputs), content.regions(), kept)
        optimiser.zero_grad()
        _weighed(found).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        falling.step()
        report(step, Loss(found.style.detach(), found.content.detach()))
    return network.eval()


def _weighed(loss: Loss) -> Tensor:
    return _STYLE_WEIGHT * loss.style + _CONTENT_WEIGHT * loss.content


def write_network(network: StyleNetwork, path: Path, card: Mapping[str, Any]) -> None:
    """Write a network as ONNX, for frames of any size that is a multiple of `MULTIPLE`; the card goes into its metadata."""
    examples = {name: torch.zeros(1, count, 64, 64) for name, count in (("depth", 1), ("valid", 1), ("guides", 4), ("noise", 1))}
    size = {2: "height", 3: "width"}
    make_folder(path.parent)
    with whole_file(path) as partial:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the exporter that traces is deprecated, and needs nothing beside onnx
            torch.onnx.export(
                network, tuple(examples.values()), str(partial), input_names=list(examples), output_names=["change", "logit"],
                dynamo=False, opset_version=18, dynamic_axes=dict.fromkeys((*examples, "change", "logit"), size),
            )  # fmt: skip
        model = onnx.load(str(partial))
        onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(dict(card))})
        onnx.save(model, str(partial))
