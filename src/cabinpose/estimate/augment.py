"""Training augmentation in 3D, on batches: the cloud is moved and seen again by the same camera.

The thesis' augmentation (section 6.2) shifts the cloud of a frame and projects it anew. Here a small rotation comes
with it, the nearest of the points that fall on one pixel wins, and pixels that nothing falls on between neighbours that are hit
are filled from the nearest of them: a surface that comes closer must not fall apart. Flips, sensor noise, lost pixels, a change
of gain and random occluders follow. Everything runs on whole batches of tensors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn import functional

from cabinpose.estimate.batch import Batch

_FILL_NEIGHBOURS = 5  # of 8 that have to be hit for an empty pixel between them to be filled
Probability = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0)]


class AugmentConfig(BaseModel):
    """How training frames are varied. Probabilities are per frame; shifts are those of the thesis' best setting."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    shift: Annotated[Probability, Field(description="Probability that the cloud is moved at all.")] = 0.8
    shift_axes: Annotated[tuple[float, float, float], Field(description="Probability of a shift along x, y, z.")] = (
        0.5,
        0.5,
        0.8,
    )
    shift_m: Annotated[NotNegative, Field(description="Standard deviation of the shift (m).")] = 0.15
    rotate_deg: Annotated[NotNegative, Field(description="Standard deviation of the rotation about each axis (deg).")] = 4.0
    flip: Annotated[Probability, Field(description="Probability of a mirror image, sides swapped.")] = 0.5
    noise_m: Annotated[NotNegative, Field(description="Greatest standard deviation of added depth noise (m).")] = 0.008
    lost: Annotated[Probability, Field(description="Greatest share of pixels that are lost.")] = 0.03
    gain: Annotated[float, Field(ge=1, description="Amplitudes are multiplied by up to this factor, or divided.")] = 2.0
    occluder: Annotated[Probability, Field(description="Probability of an object in front of the scene.")] = 0.2


def augment(
    batch: Batch, config: AugmentConfig, rays: Tensor, focal: float, swap: Sequence[int], swap_slots: Sequence[int],
    *, generator: torch.Generator,
) -> Batch:  # fmt: skip
    """A varied batch. rays: (2, h, w) x/z, y/z of the view's pixels · swap: index of each joint's mirror joint · swap_slots:
    of each place's mirror place.
    """
    batch = move(batch, *_motion(len(batch.depth), config, batch.depth, generator), rays, focal)
    batch = flip(batch, _chance(config.flip, batch.depth, generator), swap, swap_slots)
    depth, amplitude = batch.depth, batch.amplitude
    n = len(depth)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=depth.device)

    valid = depth > 0
    noise = torch.randn(depth.shape, generator=generator, device=depth.device) * (uniform(n, 1, 1) * config.noise_m)
    depth = torch.where(valid, (depth + noise).clamp(min=0.05), depth)
    depth = torch.where(uniform(*depth.shape) < uniform(n, 1, 1) * config.lost, depth.new_zeros(()), depth)
    amplitude = amplitude * torch.exp((2 * uniform(n, 1, 1) - 1) * math.log(config.gain))
    return occlude(
        batch._replace(depth=depth, amplitude=amplitude), _chance(config.occluder, depth, generator), generator=generator
    )


def _chance(probability: float, like: Tensor, generator: torch.Generator) -> Tensor:
    return torch.rand(len(like), generator=generator, device=like.device) < probability


def _motion(n: int, config: AugmentConfig, like: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Rotations (n, 3, 3) about the middle of each cloud, and translations (n, 3), identity where a frame stays."""
    moved = _chance(config.shift, like, generator).unsqueeze(1)
    axes = torch.rand((n, 3), generator=generator, device=like.device) < like.new_tensor(config.shift_axes)
    shift = torch.randn((n, 3), generator=generator, device=like.device) * config.shift_m * axes * moved
    angles = torch.randn((n, 3), generator=generator, device=like.device) * math.radians(config.rotate_deg) * moved
    zero, (x, y, z) = angles.new_zeros(n), angles.unbind(1)
    skew = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=1).reshape(n, 3, 3)
    return torch.linalg.matrix_exp(skew), shift


def move(batch: Batch, rotation: Tensor, shift: Tensor, rays: Tensor, focal: float) -> Batch:
    """The frames seen after their clouds turned about their middle (rotation (N, 3, 3)) and moved by shift (N, 3), m."""
    n, h, w = batch.depth.shape
    z = batch.depth.reshape(n, 1, -1)
    valid = z > 0
    p = torch.cat((rays.reshape(1, 2, -1) * z, z), dim=1)
    middle = (p * valid).sum(-1, keepdim=True) / valid.sum(-1, keepdim=True).clamp(min=1)
    p = rotation @ (p - middle) + middle + shift.unsqueeze(-1)
    near = valid[:, 0] & (p[:, 2] > 0.05)
    depth = torch.where(near, p[:, 2], p.new_ones(()))
    u = torch.round(focal * p[:, 0] / depth + (w - 1) / 2).long()
    v = torch.round(focal * p[:, 1] / depth + (h - 1) / 2).long()
    hit = near & (u >= 0) & (u < w) & (v >= 0) & (v < h)
    # The nearest point of a pixel, and which: depth in the high digits of one integer, the pixel it came from in the low ones.
    source = torch.arange(h * w, device=p.device)
    none = torch.iinfo(torch.int64).max
    key = torch.where(hit, (depth * 1e5).long() * (h * w) + source, none)
    target = torch.where(hit, v * w + u, 0)
    nearest = torch.full((n, h * w), none, device=p.device).scatter_reduce(1, target, key, "amin")
    empty = nearest == none
    source = torch.where(empty, 0, nearest % (h * w))
    moved = torch.where(empty, 0.0, depth.gather(1, source)).reshape(n, h, w)
    still = (rotation == torch.eye(3, device=p.device)).all(-1).all(-1) & (shift == 0).all(-1)
    source, taken = _fill(source.reshape(n, h, w), moved)
    labels = batch.labels
    if labels is not None:
        labels = torch.where(taken > 0, labels.reshape(n, -1).gather(1, source.reshape(n, -1)).reshape(n, h, w), 0).to(
            labels.dtype
        )
        labels = torch.where(still[:, None, None], batch.labels, labels)
    amplitude = torch.where(taken > 0, batch.amplitude.reshape(n, -1).gather(1, source.reshape(n, -1)).reshape(n, h, w), 0.0)
    joints, visibility = _move_joints(batch, rotation, shift, middle, focal)
    keep = still[:, None, None]
    return Batch(
        torch.where(keep, batch.depth, taken),
        torch.where(keep, batch.amplitude, amplitude),
        torch.where(keep.unsqueeze(-1), batch.joints, joints),
        torch.where(keep, batch.visibility, visibility),
        batch.present,
        labels,
    )


def _fill(source: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels without a hit among at least five that have one take the nearest of them, and where that came from."""
    n, h, w = depth.shape
    hit = depth > 0
    nearness = torch.where(hit, -depth, -torch.inf)
    nearest, which = functional.max_pool2d(nearness, 3, 1, 1, return_indices=True)
    around = functional.avg_pool2d(hit.to(depth.dtype), 3, 1, 1, divisor_override=1)
    fill = ~hit & (around >= _FILL_NEIGHBOURS)
    taken = source.reshape(n, -1).gather(1, which.reshape(n, -1)).reshape(n, h, w)
    return torch.where(fill, taken, source), torch.where(fill, -nearest, depth)


def _move_joints(batch: Batch, rotation: Tensor, shift: Tensor, middle: Tensor, focal: float) -> tuple[Tensor, Tensor]:
    """Joints (N, S, J, 3) and visibility after the same motion; what leaves the image is outside."""
    n, h, w = batch.depth.shape
    centre = batch.joints.new_tensor(((w - 1) / 2, (h - 1) / 2))
    uv, z = batch.joints[..., :2], batch.joints[..., 2:]
    p = torch.cat(((uv - centre) * z / focal, z), dim=-1)
    origin = middle.reshape(n, 1, 1, 3)
    p = torch.einsum("nij,nsaj->nsai", rotation, p - origin) + origin + shift.reshape(n, 1, 1, 3)
    ahead = p[..., 2] > 0.05
    seen = torch.where(ahead, p[..., 2], torch.nan).unsqueeze(-1)
    joints = torch.cat((focal * p[..., :2] / seen + centre, seen), dim=-1)
    inside = ((joints[..., :2] >= -0.5) & (joints[..., :2] < joints.new_tensor((w - 0.5, h - 0.5)))).all(-1)
    visibility = torch.where((batch.visibility > 1) & ~inside, 1, batch.visibility)
    # A joint that comes into the image was outside of what was rendered: whether it is seen nobody knows.
    visibility = torch.where((batch.visibility == 1) & inside, 2, visibility)
    return joints, visibility.to(batch.visibility.dtype)


def flip(batch: Batch, chosen: Tensor, swap: Sequence[int], swap_slots: Sequence[int]) -> Batch:
    """Mirror images of the chosen frames (N,), left and right joints and places swapped."""
    width = batch.depth.shape[-1]
    mirrored = batch.joints[:, list(swap_slots)][:, :, list(swap)].clone()
    mirrored[..., 0] = width - 1 - mirrored[..., 0]
    one, two, three = chosen[:, None], chosen[:, None, None], chosen[:, None, None, None]
    return Batch(
        torch.where(two, batch.depth.flip(-1), batch.depth),
        torch.where(two, batch.amplitude.flip(-1), batch.amplitude),
        torch.where(three, mirrored, batch.joints),
        torch.where(two, batch.visibility[:, list(swap_slots)][:, :, list(swap)], batch.visibility),
        torch.where(one, batch.present[:, list(swap_slots)], batch.present),
        None if batch.labels is None else torch.where(two, batch.labels.flip(-1), batch.labels),
    )


def occlude(batch: Batch, chosen: Tensor, *, generator: torch.Generator) -> Batch:
    """A tilted plate in front of the chosen frames (N,); joints behind it count as occluded by something else."""
    n, h, w = batch.depth.shape
    r = torch.rand((n, 7), generator=generator, device=batch.depth.device)
    size = torch.stack((w * (0.05 + 0.25 * r[:, 0]), h * (0.05 + 0.25 * r[:, 1])), dim=1) / 2
    centre = torch.stack((w * r[:, 2], h * r[:, 3]), dim=1)
    v, u = torch.meshgrid(torch.arange(h, device=r.device), torch.arange(w, device=r.device), indexing="ij")
    du, dv = u - centre[:, 0, None, None], v - centre[:, 1, None, None]
    plate = (0.25 + 0.5 * r[:, 4])[:, None, None] + (r[:, 5, None, None] - 0.5) * du / w + (r[:, 6, None, None] - 0.5) * dv / h
    inside = (du.abs() < size[:, 0, None, None]) & (dv.abs() < size[:, 1, None, None]) & chosen[:, None, None]
    inside &= (batch.depth == 0) | (batch.depth > plate)
    at = batch.joints[..., :2] - centre[:, None, None]
    behind = (at.abs() < size[:, None, None]).all(-1) & chosen[:, None, None] & (batch.joints[..., 2] > 0.3)
    return batch._replace(
        depth=torch.where(inside, plate, batch.depth),
        amplitude=torch.where(inside, batch.amplitude.mean((1, 2), keepdim=True), batch.amplitude),
        visibility=torch.where(behind & (batch.visibility > 2), 2, batch.visibility).to(batch.visibility.dtype),
    )
