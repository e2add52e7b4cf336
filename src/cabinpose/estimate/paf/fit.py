"""Training of the part affinity fields: the maps that are asked for, and the thesis' loss (equations 6.7 to 6.11)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from cabinpose.core import Visibility
from cabinpose.estimate.batch import NOT_LABELLED, Batch
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.paf.model import STRIDE, Maps, Paf


def loss(network: Paf, batch: Batch) -> dict[str, Tensor]:
    """The terms of the loss and their sum, `loss`, as means over the frames.

    heat, fields: half the squared L2 norm of the maps' error, all stages (Caffe's Euclidean loss; the thesis prints the norm
    itself) · presence: for each joint the cross entropy of its labels divided by their number, summed over the joints. The
    presence of a joint counts where everybody's is labelled, its maps where everybody's place is known too; fields where both
    ends' are, and the background where all are.
    """
    (image,) = batch.images(network.config.inputs)
    maps: Maps = network(image)
    height, width = maps.heat.shape[-2:]
    heat, fields = targets(batch, network.config, height, width)
    n = len(image)
    labels = network.config.presence_labels
    zero = maps.heat.new_zeros(())
    labelled, told = (batch.visibility != NOT_LABELLED).all(dim=1), batch.told.all(dim=1)  # (N, J)
    of_heat = torch.cat((told, told.all(dim=1, keepdim=True)), dim=1)[..., None, None]
    ends = torch.tensor(network.config.joint_set.limbs, device=told.device)
    of_fields = told[:, ends].all(dim=-1).repeat_interleave(2, dim=1)[..., None, None]
    terms = {
        "fields": sum((0.5 * (of_fields * (f - fields) ** 2).sum() / n for f, _ in maps.stages), start=zero),
        "heat": sum((0.5 * (of_heat * (h - heat) ** 2).sum() / n for _, h in maps.stages), start=zero),
    }
    if labels:
        wrong = functional.cross_entropy(maps.presence.flatten(0, 1), presence_of(batch, labels).flatten(), reduction="none")
        terms["presence"] = (wrong * labelled.flatten()).sum() / labels / n
    terms["loss"] = sum(terms.values(), start=zero)
    return terms


def presence_of(batch: Batch, labels: int) -> Tensor:
    """(N, J) label of each joint over all people: 0 = not in the image, 1 = there; of three labels 1 = occluded, 2 = visible."""
    labelled = batch.present.unsqueeze(-1) & (batch.visibility > 1) & (batch.visibility != NOT_LABELLED)
    seen = (batch.visibility * labelled).amax(dim=1)
    return (seen > 0).long() + (seen == Visibility.VISIBLE).long() * (labels == 3)


def in_image(batch: Batch) -> Tensor:
    """(N, S, J) bool: joints in the image, seen or hidden, of people who are there."""
    return batch.present.unsqueeze(-1) & (batch.visibility > 1) & torch.isfinite(batch.joints).all(-1)


@torch.no_grad()
def targets(batch: Batch, config: PafConfig, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Heat maps (N, J + 1, height, width) and fields (N, 2C, height, width) at stride 8 that the people of a batch ask for.

    heat: Gaussians at the joints, the greatest of all people, and 1 minus the greatest of all joints as background · fields:
    along each limb of which both ends are in the image its unit vector, the mean where people overlap.
    """
    known = in_image(batch)
    uv = torch.nan_to_num(batch.joints[..., :2])
    rows, columns = torch.meshgrid(torch.arange(height, device=uv.device), torch.arange(width, device=uv.device), indexing="ij")
    cells = torch.stack((columns, rows)) * STRIDE + (STRIDE - 1) / 2  # (2, h, w), px of the view
    squared = ((uv[..., None, None] - cells) ** 2).sum(-3)
    peaks = (torch.exp(-squared / (2 * config.sigma_px**2)) * known[..., None, None]).amax(dim=1)
    heat = torch.cat((peaks, 1 - peaks.amax(dim=1, keepdim=True)), dim=1)
    fields = []
    for a, b in config.joint_set.limbs:
        along = uv[:, :, b] - uv[:, :, a]
        length = along.norm(dim=-1)
        unit = along / length.clamp(min=1e-6).unsqueeze(-1)
        offset = cells - uv[:, :, a, :, None, None]  # (N, S, 2, h, w)
        on = (offset * unit[..., None, None]).sum(-3)
        beside = (offset[:, :, 0] * unit[..., 1, None, None] - offset[:, :, 1] * unit[..., 0, None, None]).abs()
        both = (known[:, :, a] & known[:, :, b] & (length > 1e-3))[..., None, None]
        limb = both & (on >= 0) & (on <= length[..., None, None]) & (beside <= config.limb_px)
        count = limb.sum(dim=1).clamp(min=1)
        fields.append((limb.unsqueeze(2) * unit[..., None, None]).sum(dim=1) / count.unsqueeze(1))
    return heat, torch.cat(fields, dim=1)
