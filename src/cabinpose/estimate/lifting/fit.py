"""The lifting network's training loss."""

from __future__ import annotations

import torch
from torch import Tensor

from cabinpose.estimate.lifting.model import Lifted, Lifting
from cabinpose.estimate.tasks import PeopleBatch

_PER_M = 10.0  # errors count in decimetres, so that they are about one where training begins


def loss(network: Lifting, people: PeopleBatch) -> dict[str, Tensor]:
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
    terms = {"relative": _PER_M**2 * squared.sum() / known.sum().clamp(min=1), "root": _PER_M**2 * (across + along).mean()}
    terms["loss"] = terms["relative"] + terms["root"]
    return terms
