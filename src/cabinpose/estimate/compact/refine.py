"""Refinement of a joint from what lies around it, at twice the resolution of the votes, and at that of the depth image.

A joint's token is what lies around its place (fine features and the depths there, relative to the joint's own), the coarse
features at it, and where it is. The tokens of all joints of all places attend to one another, so that a wrist knows its
elbow; from each its joint's correction is regressed. Cascaded regression of this kind follows Toshev and Szegedy
("DeepPose", CVPR 2014) and, for the sampled features, Sun et al. ("Integral human pose regression", ECCV 2018).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

_SIDE = 5  # samples a side of the patch around a joint
_FINE = 16  # channels of a sample
_HIDDEN = 64
_HEADS = 4
_NEAR_M = 0.1  # unit of the depths around a joint, which are clipped at _FAR of it
_FAR = 3.0
_SAID = 5  # outputs a joint: shift in u, v and depth, and what to add to the logits of inside and visible


class Correction(NamedTuple):
    """By how much each joint moves, in pixels of the view and metres (N, S, J, 3), and the logits to add (N, S, J)."""

    joints: Tensor
    inside: Tensor
    visible: Tensor


class Refine(nn.Module):
    """Corrections of S x J joints; zero before training, since the output layer `say` begins with zeros.

    The names of the layers are those of released checkpoints: `place` is the embedding of slot and joint, `think` the
    feed-forward layer of the attention block, `say` the output layer.
    """

    offsets: Tensor
    size: Tensor

    def __init__(self, size: tuple[int, int], slots: int, joints: int, fine: int, coarse: int, pitch_px: float) -> None:
        """size: width, height of the view (px) · fine, coarse: channels of the two feature maps · pitch_px: between samples."""
        super().__init__()
        self.pitch_px = pitch_px
        self.reduce = nn.Conv2d(fine, _FINE, 1)
        inputs = _SIDE * _SIDE * (_FINE + 2) + coarse + _SAID
        self.embed = nn.Parameter(torch.randn(joints, inputs, _HIDDEN) / inputs**0.5)
        self.place = nn.Parameter(0.1 * torch.randn(slots, joints, _HIDDEN))
        self.before = nn.LayerNorm(_HIDDEN)
        self.qkv = nn.Linear(_HIDDEN, 3 * _HIDDEN, bias=False)
        self.mix = nn.Linear(_HIDDEN, _HIDDEN)
        self.between = nn.LayerNorm(_HIDDEN)
        self.think = nn.Sequential(nn.Linear(_HIDDEN, 2 * _HIDDEN), nn.ReLU(inplace=True), nn.Linear(2 * _HIDDEN, _HIDDEN))
        self.say = nn.Parameter(torch.zeros(joints, _HIDDEN, _SAID))
        step = (torch.arange(_SIDE) - (_SIDE - 1) / 2) * pitch_px
        v, u = torch.meshgrid(step, step, indexing="ij")
        self.register_buffer("offsets", torch.stack((u.flatten(), v.flatten()), dim=-1), persistent=False)
        self.register_buffer("size", torch.tensor(size, dtype=torch.float32), persistent=False)

    def forward(self, depth: Tensor, fine: Tensor, coarse: Tensor, uvz: Tensor, inside: Tensor, visible: Tensor) -> Correction:
        """depth (N, 1, h, w), m, 0 = invalid · fine, coarse (N, C, ., .) · uvz (N, S, J, 3), inside, visible: as found so far."""
        n, s, j = uvz.shape[:3]
        at = uvz[..., :2].reshape(n, s * j, 1, 2)
        around = at + self.offsets
        there = sampled(depth, around, self.size, mode="nearest")
        valid = (there > 0).to(there.dtype)
        relative = ((there - uvz[..., 2].reshape(n, 1, s * j, 1)) / _NEAR_M).clamp(-_FAR, _FAR) * valid
        patch = sampled(self.reduce(fine), around, self.size)
        seen = torch.cat((patch, relative, valid), dim=1).permute(0, 2, 1, 3).reshape(n, s, j, -1)
        local = sampled(coarse, at, self.size).reshape(n, -1, s, j).permute(0, 2, 3, 1)
        where = torch.cat((2 * (uvz[..., :2] + 0.5) / self.size - 1.0, uvz[..., 2:] - 1.0), dim=-1)
        logits = torch.stack((inside, visible), dim=-1).clamp(-_FAR, _FAR)
        tokens = _by_joint(torch.cat((seen, local, where, logits), dim=-1), self.embed) + self.place
        tokens = self._attend(tokens.reshape(n, s * j, _HIDDEN))
        said = _by_joint((tokens + self.think(self.between(tokens))).reshape(n, s, j, _HIDDEN), self.say)
        move = said[..., :3] * said.new_tensor((self.pitch_px, self.pitch_px, _NEAR_M))
        return Correction(move, said[..., 3], said[..., 4])

    def _attend(self, tokens: Tensor) -> Tensor:
        """Self-attention over (N, T, C), with a residual."""
        n, t, c = tokens.shape
        q, k, v = self.qkv(self.before(tokens)).reshape(n, t, 3, _HEADS, c // _HEADS).permute(2, 0, 3, 1, 4).unbind(0)
        mixed = functional.scaled_dot_product_attention(q, k, v)
        return tokens + self.mix(mixed.transpose(1, 2).reshape(n, t, c))


def sampled(image: Tensor, uv: Tensor, size: Tensor, *, mode: str = "bilinear") -> Tensor:
    """(N, C, T, P) values of an image (N, C, ., .) that covers a view of `size` (2,) pixels, at (N, T, P, 2) pixels of the view.

    Beyond the image they are 0.
    """
    return functional.grid_sample(image, 2 * (uv + 0.5) / size - 1.0, mode=mode, align_corners=False)


def _by_joint(x: Tensor, weights: Tensor) -> Tensor:
    """(N, S, J, D) by each joint's own (J, D, K), to (N, S, J, K)."""
    n, s, j, d = x.shape
    return torch.bmm(x.permute(2, 0, 1, 3).reshape(j, n * s, d), weights).reshape(j, n, s, -1).permute(1, 2, 0, 3)
