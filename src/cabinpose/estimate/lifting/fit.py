"""Training of the lifting network: people from a batch's joints, their variation, and the loss."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from cabinpose.estimate.augment import AugmentConfig, Mirror, chance, draw_motion, flip, move_points
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.inputs import InputView
from cabinpose.estimate.lifting.config import LiftingConfig
from cabinpose.estimate.lifting.model import Lifted, Lifting

_PER_M = 10.0  # errors count in decimetres, so that they are about one where training begins


class People(NamedTuple):
    """P people: pose (P, J, 3) x/z, y/z and 1 where the joint is given · joints (P, J, 3) m, camera frame · known (P, J)."""

    pose: Tensor
    joints: Tensor
    known: Tensor


def people_of(batch: Batch, view: InputView) -> People:
    """The people of a batch who are there; given are the joints that are in the image, known those whose place is."""
    at = batch.joints[batch.present]
    finite = torch.isfinite(at).all(-1)
    states = batch.visibility[batch.present]
    uvz = torch.nan_to_num(at)
    centre = uvz.new_tensor((view.camera.cx, view.camera.cy))
    xy = (uvz[..., :2] - centre) / view.focal
    given = (finite & (states > 1)).to(xy.dtype).unsqueeze(-1)
    joints = torch.cat((xy * uvz[..., 2:], uvz[..., 2:]), dim=-1)
    return People(torch.cat((xy * given, given), dim=-1), joints, finite & (states > 0))


def vary(batch: Batch, config: AugmentConfig, settings: LiftingConfig, mirror: Mirror, *, generator: torch.Generator) -> People:
    """People moved and turned about the mean of their joints, mirrored, their 2D joints then noisy and some of them missing."""
    view = settings.view
    rotation, shift = draw_motion(len(batch.joints), config, batch.joints, generator)
    people = people_of(batch, view)
    z = batch.joints[..., 2:]
    at = batch.joints.new_tensor((view.camera.cx, view.camera.cy))
    points = torch.cat(((batch.joints[..., :2] - at) * z / view.focal, z), dim=-1)
    middle = torch.nan_to_num(points.nanmean(dim=2, keepdim=True))
    uvz = move_points(batch.joints, rotation, shift, middle, (view.camera.cx, view.camera.cy), view.focal)
    batch = flip(batch._replace(joints=uvz), chance(config.flip, batch.joints, generator), mirror, view.width)
    people = people_of(batch, view)
    n, j = people.known.shape

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=uvz.device)

    noise = torch.randn((n, j, 2), generator=generator, device=uvz.device) * settings.noise * uniform(n, 1, 1)
    left = (uniform(n, j) >= settings.drop * uniform(n, 1)).to(uvz.dtype).unsqueeze(-1)
    given = people.pose[..., 2:] * left
    return people._replace(pose=torch.cat(((people.pose[..., :2] + noise) * given, given), dim=-1))


def loss(network: Lifting, people: People) -> dict[str, Tensor]:
    """The terms of the loss and their sum, `loss`: mean squared errors of relative joints and root (dm²), over people whose
    root is known and who show enough joints.

    relative: of the joints from the root · root: of the root's direction times its depth, and of its depth's logarithm times
    its depth.
    """
    root = network.root
    use = people.known[:, root] & (people.pose[..., 2].sum(-1) >= network.config.min_joints)
    if int(use.sum()) < 2:  # batch normalisation needs two
        zero = sum((p.sum() * 0.0 for p in network.parameters()), start=people.joints.new_zeros(()))
        return {"relative": zero, "root": zero, "loss": zero}
    joints, known = people.joints[use], people.known[use]
    lifted: Lifted = network(people.pose[use])
    truth = joints - joints[:, root : root + 1]
    squared = ((lifted.relative - truth) ** 2).sum(-1) * known
    z = joints[:, root, 2]
    across = ((lifted.root[:, :2] - joints[:, root, :2] / z.unsqueeze(-1)) * z.unsqueeze(-1)).square().sum(-1)
    along = (torch.log(lifted.root[:, 2] / z) * z).square()
    terms = {
        "relative": _PER_M**2 * squared.sum() / known.sum().clamp(min=1),
        "root": _PER_M**2 * (across + along).mean(),
    }
    terms["loss"] = terms["relative"] + terms["root"]
    return terms
