"""The network of the grid regression: each cell of a grid answers with boxes and with the classes of what it holds.

J. Redmon, S. Divvala, R. Girshick, A. Farhadi, "You only look once: unified, real-time object detection", CVPR 2016, as the
thesis used it: a joint is a class, and its box a square about it. The classes are the joints of every place in the car, so that
several people need no assignment. The backbone is that of the compact detector, whose attention between all cells takes the
place of the paper's fully connected layers. Written from the paper.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from cabinpose.estimate.compact.model import STRIDE, Backbone, Block, unit
from cabinpose.estimate.yolo.config import YoloConfig

VALUES = 6  # of a box: x, y in the cell, square roots of width and height, confidence, and what lies between skin and joint
_SIZE = 0.3  # square root of a box's share of the view before training


class Grid(NamedTuple):
    """The network's answers for N frames, B boxes a cell, C classes and a grid (h, w).

    boxes: (N, B, 6, h, w) x and y of the centre relative to the cell (0 to 1 within it), square roots of width and height
    relative to the view's, confidence, and depth of the joint behind the surface at the centre (dm) · classes: (N, C, h, w)
    probability of each class where a cell holds an object; class = slot x joints + joint.
    """

    boxes: Tensor
    classes: Tensor


class Yolo(Backbone):
    """The network of the grid regression."""

    config: YoloConfig

    def __init__(self, config: YoloConfig) -> None:
        super().__init__(config)
        _, c4, c8, _ = config.channels
        self.fine = config.cell_px < STRIDE
        channels = 2 * c4 if self.fine else c8
        if self.fine:
            self.lower, self.across, self.blend = unit(c8, channels), unit(c4, channels), Block(channels, channels)
        self.boxes = nn.Conv2d(channels, config.boxes * VALUES, 1)
        self.classes = nn.Conv2d(channels, len(config.slots) * len(config.joints), 1)
        for head in (self.boxes, self.classes):
            nn.init.normal_(head.weight, std=0.01)  # large first errors of so many boxes would drown what few joints say
        with torch.no_grad():
            start = torch.tensor([0.5, 0.5, _SIZE, _SIZE, 0.0, 0.0]).repeat(config.boxes)
            self.boxes.bias.copy_(start)  # type: ignore[union-attr]

    def forward(self, *images: Tensor) -> Grid:
        """The grid's answers from the images of the settings' `inputs`, see `Backbone.channels`; linear, as in the paper."""
        fine, features, _ = self.features(self.channels(*images))
        if self.fine:
            lower = nn.functional.interpolate(self.lower(features), scale_factor=STRIDE / self.config.cell_px, mode="nearest")
            features = self.blend(self.across(fine) + lower)
        return Grid(self.boxes(features).unflatten(1, (self.config.boxes, VALUES)), self.classes(features))
