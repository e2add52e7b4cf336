"""Training augmentation in 3D, on batches: the cloud is moved and seen again by the same camera.

The thesis' augmentation (algorithm 6.2.1) shifts the cloud of a frame and projects it anew. Here a small rotation comes
with it by default, the nearest of the points that fall on one pixel wins, and pixels that nothing falls on between neighbours
that are hit are filled from the nearest of them: a surface that comes closer must not fall apart. Flips, sensor noise, lost
pixels, a change of gain and random occluders follow. Everything runs on whole batches of tensors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from cabinpose.estimate.batch import Batch
from cabinpose.estimate.settings import AugmentConfig as AugmentConfig

_BEHIND_M = 0.1  # a pixel farther than that behind its neighbours is seen through a hole in their surface


class Mirror(NamedTuple):
    """What a mirror image swaps: positions of the mirror joints and mirror places, and the (256,) table of pixel classes."""

    joints: Sequence[int]
    slots: Sequence[int]
    labels: Tensor


def augment(
    batch: Batch, config: AugmentConfig, rays: Tensor, focal: float, mirror: Mirror, *, generator: torch.Generator
) -> Batch:
    """Every augmentation of a batch, in this order: motion, mirror image, depth noise, lost pixels, scale, gain, occluder.

    Parameters
    ----------
    batch
        Frames in the model's view.
    config
        Probabilities and sizes.
    rays
        (2, h, w) x/z and y/z of the view's pixels.
    focal
        Focal length of the view (px).
    mirror
        What a mirror image swaps.
    generator
        On the batch's device; everything random comes from it.

    Returns
    -------
    Batch
        Of the same shapes.
    """
    batch = move(batch, *draw_motion(len(batch.depth), config, batch.depth, generator), rays, focal)
    batch = flip(batch, chance(config.flip, batch.depth, generator), mirror, batch.depth.shape[-1])
    depth = batch.depth
    n = len(depth)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=depth.device)

    valid = depth > 0
    noise = torch.randn(depth.shape, generator=generator, device=depth.device) * (uniform(n, 1, 1) * config.noise_m)
    depth = torch.where(valid, (depth + noise).clamp(min=0.05), depth)
    depth = torch.where(uniform(*depth.shape) < uniform(n, 1, 1) * config.lost, depth.new_zeros(()), depth)
    if config.rescale > 0:
        # Frames that were stored scaled to [0, 1] are read with an estimated scale: a model must not trust the depth alone.
        guess = torch.exp(config.rescale_sigma * torch.randn((n, 1, 1), generator=generator, device=depth.device))
        depth = torch.where(uniform(n, 1, 1) < config.rescale, depth * guess, depth)
    factor = torch.exp((2 * uniform(n, 1, 1) - 1) * math.log(config.gain))
    amplitude = None if batch.amplitude is None else batch.amplitude * factor
    rgb = None if batch.rgb is None else (batch.rgb * factor.sqrt()[:, None]).clamp(max=255)
    return occlude(
        batch._replace(depth=depth, amplitude=amplitude, rgb=rgb), chance(config.occluder, depth, generator), generator=generator
    )


def chance(probability: float, like: Tensor, generator: torch.Generator) -> Tensor:
    """(N,) bool: which of the N frames of `like` something happens to."""
    return torch.rand(len(like), generator=generator, device=like.device) < probability


def draw_motion(n: int, config: AugmentConfig, like: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Rotations (n, 3, 3) and translations (n, 3), m; identity and zero where a frame stays."""
    moved = chance(config.shift, like, generator).unsqueeze(1)
    axes = torch.rand((n, 3), generator=generator, device=like.device) < like.new_tensor(config.shift_axes)
    draw = torch.rand if config.shift_law == "uniform" else torch.randn
    shift = draw((n, 3), generator=generator, device=like.device) * config.shift_m * axes * moved
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
    # One integer holds the depth (0.01 mm) in its high digits and the source pixel in its low ones, so that a single minimum over
    # the points of a pixel gives the nearest of them and where it came from.
    source = torch.arange(h * w, device=p.device)
    none = torch.iinfo(torch.int64).max
    key = torch.where(hit, (depth * 1e5).long() * (h * w) + source, none)
    target = torch.where(hit, v * w + u, 0)
    nearest = torch.full((n, h * w), none, device=p.device).scatter_reduce(1, target, key, "amin")
    empty = nearest == none
    source = torch.where(empty, 0, nearest % (h * w))
    moved = torch.where(empty, 0.0, depth.gather(1, source)).reshape(n, h, w)
    source, taken = _fill(source.reshape(n, h, w), moved)
    uvz = move_points(batch.joints, rotation, shift, middle.reshape(n, 1, 1, 3), ((w - 1) / 2, (h - 1) / 2), focal)
    # A frame that stays where it is keeps its very numbers.
    still = (rotation == torch.eye(3, device=p.device)).all(-1).all(-1) & (shift == 0).all(-1)
    keep = still[:, None, None]
    unknown = torch.isnan(batch.joints).any(-1)  # where these are, nothing says that they have left

    def carried(image: Tensor) -> Tensor:
        values = image.reshape(n, -1).gather(1, source.reshape(n, -1)).reshape(n, h, w)
        return torch.where(keep, image, torch.where(taken > 0, values, values.new_zeros(())))

    return batch._replace(
        depth=torch.where(keep, batch.depth, taken),
        joints=torch.where(keep.unsqueeze(-1), batch.joints, uvz),
        visibility=torch.where(keep | unknown, batch.visibility, _states_after(batch.visibility, uvz, w, h)),
        amplitude=None if batch.amplitude is None else carried(batch.amplitude),
        labels=None if batch.labels is None else carried(batch.labels),
        rgb=None if batch.rgb is None else torch.stack([carried(channel) for channel in batch.rgb.unbind(1)], dim=1),
    )


def _fill(source: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """Source pixels and depths (N, h, w) with holes filled from the nearest of their eight neighbours.

    A surface that comes closer is spread over more pixels than it has points. A hole lies between two neighbours on opposite
    sides that were hit, and was not hit itself, or is more than _BEHIND_M behind both.
    """
    n, h, w = depth.shape
    hit = depth > 0
    around = functional.pad(depth, (1, 1, 1, 1))

    def before(dy: int, dx: int) -> Tensor:
        other = around[:, 1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w]
        return (other > 0) & (~hit | (other < depth - _BEHIND_M))

    fill = torch.zeros_like(hit)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        fill |= before(dy, dx) & before(-dy, -dx)
    nearness = torch.where(hit, -depth, -torch.inf)
    nearest, which = functional.max_pool2d(nearness, 3, 1, 1, return_indices=True)
    taken = source.reshape(n, -1).gather(1, which.reshape(n, -1)).reshape(n, h, w)
    return torch.where(fill, taken, source), torch.where(fill, -nearest, depth)


def move_points(
    uvz: Tensor, rotation: Tensor, shift: Tensor, middle: Tensor, centre: tuple[float, float], focal: float
) -> Tensor:
    """Joints (N, S, J, 3) (u, v, z) after a motion: rotation (N, 3, 3) about `middle` (N, 1 or S, 1, 3), then shift (N, 3).

    centre: principal point (px). NaN where a joint comes behind the camera.
    """
    n = len(uvz)
    at = uvz.new_tensor(centre)
    z = uvz[..., 2:]
    p = torch.cat(((uvz[..., :2] - at) * z / focal, z), dim=-1)
    p = torch.einsum("nij,nsaj->nsai", rotation, p - middle) + middle + shift.reshape(n, 1, 1, 3)
    seen = torch.where(p[..., 2] > 0.05, p[..., 2], torch.nan).unsqueeze(-1)
    return torch.cat((focal * p[..., :2] / seen + at, seen), dim=-1)


def _states_after(visibility: Tensor, uvz: Tensor, width: int, height: int) -> Tensor:
    """The states of joints that have moved to (N, S, J, 3): what has left the image is outside."""
    inside = ((uvz[..., :2] >= -0.5) & (uvz[..., :2] < uvz.new_tensor((width - 0.5, height - 0.5)))).all(-1)
    states = torch.where((visibility > 1) & ~inside, 1, visibility)
    # A joint that comes into the image was outside of what was rendered: nothing is known of what hides it.
    return torch.where((visibility == 1) & inside, 2, states).to(visibility.dtype)


def flip(batch: Batch, chosen: Tensor, mirror: Mirror, width: int) -> Batch:
    """Mirror images of the chosen frames (N,) of a view of `width` pixels; left and right joints, places and parts swapped."""
    slots, joints = list(mirror.slots), list(mirror.joints)
    mirrored = batch.joints[:, slots][:, :, joints].clone()
    mirrored[..., 0] = width - 1 - mirrored[..., 0]
    one, two, three = chosen[:, None], chosen[:, None, None], chosen[:, None, None, None]
    labels = None if batch.labels is None else mirror.labels.to(batch.labels.dtype)[batch.labels.long()].flip(-1)
    return batch._replace(
        depth=torch.where(two, batch.depth.flip(-1), batch.depth),
        joints=torch.where(three, mirrored, batch.joints),
        visibility=torch.where(two, batch.visibility[:, slots][:, :, joints], batch.visibility),
        present=torch.where(one, batch.present[:, slots], batch.present),
        amplitude=None if batch.amplitude is None else torch.where(two, batch.amplitude.flip(-1), batch.amplitude),
        labels=None if batch.labels is None or labels is None else torch.where(two, labels, batch.labels),
        wheel=None if batch.wheel is None else torch.where(chosen, -batch.wheel, batch.wheel),
        rgb=None if batch.rgb is None else torch.where(three, batch.rgb.flip(-1), batch.rgb),
    )


def occlude(batch: Batch, chosen: Tensor, *, generator: torch.Generator) -> Batch:
    """A tilted plate in front of the chosen frames (N,); joints behind it count as occluded by something else."""
    n, h, w = batch.depth.shape
    r = torch.rand((n, 7), generator=generator, device=batch.depth.device)
    size = torch.stack((w * (0.05 + 0.25 * r[:, 0]), h * (0.05 + 0.25 * r[:, 1])), dim=1) / 2
    centre = torch.stack((w * r[:, 2], h * r[:, 3]), dim=1)
    v, u = torch.meshgrid(torch.arange(h, device=r.device), torch.arange(w, device=r.device), indexing="ij")
    du, dv = u - centre[:, 0, None, None], v - centre[:, 1, None, None]
    base, tilt = (0.25 + 0.5 * r[:, 4])[:, None, None], (r[:, 5:] - 0.5)[:, :, None, None] / r.new_tensor((w, h))[:, None, None]
    plate = base + tilt[:, 0] * du + tilt[:, 1] * dv
    inside = (du.abs() < size[:, 0, None, None]) & (dv.abs() < size[:, 1, None, None]) & chosen[:, None, None]
    inside &= (batch.depth == 0) | (batch.depth > plate)
    at = torch.nan_to_num(batch.joints[..., :2], nan=-1.0).round()
    within = ((at >= 0) & (at < at.new_tensor((w, h)))).all(-1)
    pixel = torch.where(within, at[..., 1] * w + at[..., 0], 0).long().reshape(n, -1)
    hidden = inside.reshape(n, -1).gather(1, pixel).reshape(within.shape) & within
    behind = hidden & (batch.joints[..., 2] > plate.reshape(n, -1).gather(1, pixel).reshape(within.shape))
    amplitude = batch.amplitude
    if amplitude is not None:
        amplitude = torch.where(inside, amplitude.mean((1, 2), keepdim=True), amplitude)
    labels = None if batch.labels is None else torch.where(inside, 0, batch.labels).to(batch.labels.dtype)
    rgb = batch.rgb
    if rgb is not None:
        rgb = torch.where(inside[:, None], rgb.mean((2, 3), keepdim=True), rgb)
    return batch._replace(
        depth=torch.where(inside, plate, batch.depth),
        amplitude=amplitude,
        labels=labels,
        rgb=rgb,
        visibility=torch.where(behind & (batch.visibility > 2), 2, batch.visibility).to(batch.visibility.dtype),
    )
