"""The compact detector's training loss."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from cabinpose.estimate.batch import NOT_LABELLED, Batch
from cabinpose.estimate.compact.model import STRIDE, Compact, Votes

_SPREAD = 1.2  # cells: standard deviation of the target weights around a joint
_WEIGHTS = {
    "image": 1.0,
    "depth": 1.0,
    "earlier_image": 1.0,
    "earlier_depth": 1.0,
    "votes": 0.1,
    "inside": 0.2,
    "visible": 0.2,
    "present": 0.5,
    "wheel": 0.2,
}
_OUTSIDE = 0.2  # weight of a joint outside the image: it is guessed from the rest of the body


def loss(network: Compact, batch: Batch) -> dict[str, Tensor]:
    """The terms of the loss and their weighted sum, `loss`.

    image: smooth L1 of u, v in cells · depth: smooth L1 of z in decimetres · earlier_image, earlier_depth: the
    same of the joints before each look · votes: cross entropy of the weights with a
    Gaussian around the joint · inside, visible, present, wheel: binary cross entropies; where there is no wheel, or nothing says
    where, as likely as not. Only people who are there count for their joints, and of
    them only joints that are labelled.
    """
    votes: Votes = network(*batch.images(network.config.inputs))
    truth = batch.joints
    known = batch.present.unsqueeze(-1) & (batch.visibility > 0) & torch.isfinite(truth).all(-1)
    inside = known & (batch.visibility > 1)
    told = batch.present.unsqueeze(-1) & (batch.visibility != NOT_LABELLED)
    weight = known * torch.where(inside, 1.0, _OUTSIDE)
    # A joint far outside would pull the mean of the votes beyond what the offsets reach.
    limit = truth.new_tensor((network.config.width, network.config.height))
    target = torch.nan_to_num(truth)
    uv = torch.minimum(torch.maximum(target[..., :2], -0.25 * limit), 1.25 * limit)
    total = weight.sum().clamp(min=1.0)

    def place(joints: Tensor) -> tuple[Tensor, Tensor]:
        image = functional.smooth_l1_loss(joints[..., :2] / STRIDE, uv / STRIDE, beta=0.1, reduction="none").sum(-1)
        depth = functional.smooth_l1_loss(joints[..., 2] * 10, target[..., 2] * 10, beta=0.1, reduction="none")
        return (image * weight).sum() / total, (depth * weight).sum() / total

    terms = dict(zip(("image", "depth"), place(votes.joints), strict=True))
    for earlier in votes.earlier:
        image, depth = place(earlier)
        terms["earlier_image"] = terms.get("earlier_image", 0.0) + image
        terms["earlier_depth"] = terms.get("earlier_depth", 0.0) + depth
    terms |= {
        "votes": _cross_entropy(votes.weights, uv, inside, network.cells),
        "inside": _binary(votes.inside, batch.visibility > 1, told),
        "visible": _binary(votes.visible, batch.visibility == 4, told),
        "present": functional.binary_cross_entropy_with_logits(votes.present, batch.present.float()),
        "wheel": functional.binary_cross_entropy_with_logits(votes.wheel, _left(batch.wheel, votes.wheel)),
    }
    terms["loss"] = sum((_WEIGHTS[name] * term for name, term in terms.items()), start=total.new_zeros(()))
    return terms


def _left(wheel: Tensor | None, like: Tensor) -> Tensor:
    """(N,) how likely the wheel is on the left."""
    return torch.full_like(like, 0.5) if wheel is None else 0.5 * (1 + wheel.to(like.dtype))


def _cross_entropy(log_weights: Tensor, uv: Tensor, inside: Tensor, cells: Tensor) -> Tensor:
    """Mean cross entropy of the weights (N, S, J, cells) with a Gaussian around joints (N, S, J, 2) that are inside."""
    squared = (uv[..., :1] - cells[0]) ** 2 + (uv[..., 1:] - cells[1]) ** 2
    aim = torch.softmax(-squared / (2 * (_SPREAD * STRIDE) ** 2), dim=-1)
    return -((aim * log_weights).sum(-1) * inside).sum() / inside.sum().clamp(min=1)


def _binary(logit: Tensor, truth: Tensor, where: Tensor) -> Tensor:
    """Mean binary cross entropy: the logit becomes that of the probability."""
    each = functional.binary_cross_entropy_with_logits(logit, truth.float(), reduction="none")
    return (each * where).sum() / where.sum().clamp(min=1)
