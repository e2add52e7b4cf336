"""Training of the segmentation."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from cabinpose.core import class_table
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.unet.model import Segments, Unet


def loss(network: Unet, batch: Batch) -> dict[str, Tensor]:
    """The terms of the loss and their sum, `loss`.

    person: cross entropy of person and background over all pixels · parts: cross entropy of the parts over the pixels of people ·
    dice: 1 minus the mean Dice coefficient of person and parts, if its weight is not 0.
    """
    if batch.labels is None:
        raise ValueError("the segmentation learns from pixel classes")
    table = torch.from_numpy(class_table(network.config.parts)).to(batch.labels.device)
    classes = table[batch.labels.long()].long()  # 0 = nobody
    segments: Segments = network(batch.depth)
    person = classes > 0
    each = functional.cross_entropy(segments.parts, (classes - 1).clamp(min=0), reduction="none")
    terms = {
        "person": functional.binary_cross_entropy_with_logits(segments.person, person.to(segments.person.dtype)),
        "parts": (each * person).sum() / person.sum().clamp(min=1),
    }
    terms["loss"] = terms["person"] + terms["parts"]
    if network.config.dice:
        terms["dice"] = _dice(segments, classes)
        terms["loss"] = terms["loss"] + network.config.dice * terms["dice"]
    return terms


def _dice(segments: Segments, classes: Tensor) -> Tensor:
    """1 minus the mean soft Dice coefficient (Milletari et al. 2016) over person and the parts that the batch shows."""
    person = (classes > 0).unsqueeze(1)
    truth = functional.one_hot(classes, segments.parts.shape[1] + 1).movedim(-1, 1)[:, 1:]
    truth = torch.cat((person, truth), dim=1).to(segments.parts.dtype)
    said = torch.cat((torch.sigmoid(segments.person).unsqueeze(1), torch.softmax(segments.parts, dim=1) * person), dim=1)
    both, sum_ = (truth * said).sum((0, 2, 3)), (truth + said).sum((0, 2, 3))
    shown = truth.sum((0, 2, 3)) > 0
    return 1 - (2 * both / sum_.clamp(min=1e-6) * shown).sum() / shown.sum().clamp(min=1)
