"""Training of the grid regression: which boxes answer for which joints, and the paper's sum of squared errors."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from cabinpose.estimate.batch import Batch
from cabinpose.estimate.paf.decode import WINDOW
from cabinpose.estimate.yolo.config import OFFSET_M, YoloConfig
from cabinpose.estimate.yolo.model import Grid, Yolo

_OWN_SKIN_M = 0.3  # a surface that far from a joint is not the joint's own


class Truths(NamedTuple):
    """T = slots x joints true joints of N frames.

    known: (N, T) in the image · cell: (N, T) of the grid, row by row · box: (N, T, 4) x, y relative to the cell, width and
    height relative to the view · offset: (N, T) from the surface to the joint in dm, NaN where none of its own skin is seen ·
    labelled: (N, T) whether the joint is somewhere else, or with nobody, where it is not known.
    """

    known: Tensor
    cell: Tensor
    box: Tensor
    offset: Tensor
    labelled: Tensor


def loss(network: Yolo, batch: Batch) -> dict[str, Tensor]:
    """The terms of the loss and their sum, `loss`, as means over the frames (equation 3 of the paper).

    place, size: squared errors of x, y and of the roots of width and height, of the boxes that answer for a joint, times
    `coord` · confidence: of those boxes, from their intersection over union with the joint's box · empty: of all others, from
    0, times `noobj` · classes: of the cells that hold a joint · offset: as place, where the joint's own skin is seen. A joint
    that is not labelled has no class, and might be in any cell, so that none of its frame counts as empty.
    """
    grid: Grid = network(*batch.images(network.config.inputs))
    return grid_loss(grid, truths(batch, network.config), network.config)


def grid_loss(grid: Grid, true: Truths, config: YoloConfig) -> dict[str, Tensor]:
    """As `loss`, of a grid's answers."""
    n, boxes, values, h, w = grid.boxes.shape
    answers = grid.boxes.flatten(3)  # (N, B, 6, cells)
    at = true.cell[:, None, None].expand(n, boxes, values, -1)
    nearby = answers.gather(3, at).permute(0, 3, 1, 2)  # (N, T, B, 6): the boxes of each joint's cell
    overlap = box_iou(sized(nearby[..., :4].detach(), (h, w)), sized_truth(true.box, (h, w)).unsqueeze(2))
    answering, which, taken = responsible(true, overlap, h * w)
    mine = nearby.gather(2, which[..., None, None].expand(-1, -1, 1, values)).squeeze(2)  # (N, T, 6)
    aim = overlap.gather(2, which.unsqueeze(2)).squeeze(2)
    roots = true.box[..., 2:].sqrt()
    sure = answers[:, :, 4]

    def total(error: Tensor, where: Tensor) -> Tensor:
        """Sum of squared errors (N, T, ...) a frame."""
        return torch.where(where, error**2, error.new_zeros(())).sum() / n

    cells = torch.zeros((n, h * w), dtype=torch.bool, device=sure.device)
    cells = cells.scatter_reduce(1, true.cell, true.known, "amax", include_self=True)
    held = torch.zeros((n, true.known.shape[1], h * w), dtype=sure.dtype, device=sure.device)
    held = held.scatter(2, true.cell.unsqueeze(2), true.known.to(sure.dtype).unsqueeze(2))
    skin = answering & torch.isfinite(true.offset)
    both = answering.unsqueeze(2)
    terms = {
        "place": config.coord * total(mine[..., :2] - true.box[..., :2], both),
        "size": config.coord * total(mine[..., 2:4] - roots, both),
        "confidence": total(mine[..., 4] - aim, answering),
        "empty": config.noobj * total(sure, ~taken & true.labelled.all(dim=1)[:, None, None]),
        "classes": total(grid.classes.flatten(2) - held, cells.unsqueeze(1) & true.labelled.unsqueeze(2)),
        "offset": config.coord * total(mine[..., 5] - torch.nan_to_num(true.offset), skin),
    }
    terms["loss"] = sum(terms.values(), start=sure.new_zeros(()))
    return terms


@torch.no_grad()
def truths(batch: Batch, config: YoloConfig) -> Truths:
    """The joints in the image, seen or hidden, of the people who are there."""
    known = batch.present.unsqueeze(-1) & (batch.visibility > 1) & torch.isfinite(batch.joints).all(-1)
    known, uvz = known.flatten(1), torch.nan_to_num(batch.joints).flatten(1, 2)
    across, down = config.width // config.cell_px, config.height // config.cell_px
    place = (uvz[..., :2] + 0.5) / config.cell_px
    cell = torch.minimum(place.floor(), place.new_tensor((across - 1, down - 1))).clamp(min=0)
    side = config.view.focal * config.box_m / uvz[..., 2:].clamp(min=0.1)
    box = torch.cat((place - cell, side / config.width, side / config.height), dim=-1)
    surface = surface_depth(batch.depth, uvz[..., :2])
    offset = uvz[..., 2] - surface
    offset = torch.where(known & (offset.abs() < _OWN_SKIN_M), offset / OFFSET_M, torch.nan)
    labelled = batch.told.flatten(1)
    return Truths(known, (cell[..., 1] * across + cell[..., 0]).long(), box, offset, labelled)


def surface_depth(depth: Tensor, uv: Tensor) -> Tensor:
    """(N, T) median of the valid depths around pixels uv (N, T, 2) of depth images (N, h, w); NaN where there are none."""
    _, h, w = depth.shape
    step = torch.arange(-WINDOW, WINDOW + 1, device=depth.device)
    column = uv[..., 0].round().long()[..., None, None] + step  # (N, T, 1, 5)
    row = uv[..., 1].round().long()[..., None, None] + step[:, None]
    inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    index = row.clamp(0, h - 1) * w + column.clamp(0, w - 1)
    values = depth.flatten(1).gather(1, index.flatten(1)).reshape(index.shape)
    return torch.where(inside & (values > 0), values, torch.nan).flatten(2).nanmedian(dim=2).values


def responsible(true: Truths, overlap: Tensor, cells: int) -> tuple[Tensor, Tensor, Tensor]:
    """Which box answers for each joint: that of its cell with the greatest overlap (N, T, B), one joint a box.

    The paper has one object a cell; here the joints of a cell choose one after the other, in their order, and those beyond its
    boxes have none.

    Returns
    -------
    answering, which, taken
        (N, T) whether a joint has a box, (N, T) which of its cell's boxes, and (N, B, cells) the boxes that answer for a joint.
    """
    n, count, boxes = overlap.shape
    together = (true.cell.unsqueeze(2) == true.cell.unsqueeze(1)) & true.known.unsqueeze(1)  # (N, T, T)
    rank = together.tril(-1).sum(2)
    taken = torch.zeros((n, boxes, cells), dtype=torch.bool, device=overlap.device)
    which = torch.zeros((n, count), dtype=torch.long, device=overlap.device)
    at = true.cell.unsqueeze(1).expand(n, boxes, count)
    for turn in range(boxes):
        mine = true.known & (rank == turn)
        free = ~taken.gather(2, at).transpose(1, 2)
        best = torch.where(free, overlap, -1.0).argmax(2)
        which = torch.where(mine, best, which)
        chosen = mine.unsqueeze(1) & (best.unsqueeze(1) == torch.arange(boxes, device=overlap.device)[:, None])
        taken = taken.scatter_reduce(2, at, chosen, "amax", include_self=True)
    return true.known & (rank < boxes), which, taken


def sized(boxes: Tensor, grid: tuple[int, int]) -> Tensor:
    """Boxes (..., 4) of x, y, roots of width and height as centre and size in cells."""
    return sized_truth(torch.cat((boxes[..., :2], boxes[..., 2:] ** 2), dim=-1), grid)


def sized_truth(boxes: Tensor, grid: tuple[int, int]) -> Tensor:
    """Boxes (..., 4) of x, y in cells and width, height relative to the view as centre and size in cells."""
    return boxes * boxes.new_tensor((1, 1, grid[1], grid[0]))


def box_iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union (...) of boxes (..., 4): centre and size."""
    low = torch.maximum(a[..., :2] - a[..., 2:] / 2, b[..., :2] - b[..., 2:] / 2)
    high = torch.minimum(a[..., :2] + a[..., 2:] / 2, b[..., :2] + b[..., 2:] / 2)
    both = (high - low).clamp(min=0).prod(-1)
    return both / (a[..., 2:].prod(-1) + b[..., 2:].prod(-1) - both).clamp(min=1e-9)
