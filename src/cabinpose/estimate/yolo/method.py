"""The grid regression as a method."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from cabinpose.estimate.found import Found
from cabinpose.estimate.methods import Arrays, Layout, NetworkMethod
from cabinpose.estimate.paf.decode import surface_depth
from cabinpose.estimate.yolo.config import OFFSET_M, YoloConfig

if TYPE_CHECKING:
    from torch import Tensor

    from cabinpose.estimate.batch import Batch
    from cabinpose.estimate.yolo.model import Yolo


class YoloMethod(NetworkMethod[YoloConfig]):
    """Each cell of a grid answers with boxes and classes, a class being a joint of a place, see `model.py`."""

    name = "yolo"
    task = "joints"
    settings_type = YoloConfig
    outputs = ("boxes", "classes")

    def network(self, settings: YoloConfig) -> Yolo:
        from cabinpose.estimate.yolo.model import Yolo  # noqa: PLC0415 - torch

        return Yolo(settings)

    def layout(self, settings: YoloConfig) -> Layout:
        """Rows of the classes, see `model.Grid`."""
        classes = {0: [*product(settings.slots, settings.shared_joints)]}
        return {"classes.weight": classes, "classes.bias": classes}

    def loss(self, network: Yolo, batch: Batch) -> dict[str, Tensor]:
        from cabinpose.estimate.yolo.fit import loss  # noqa: PLC0415 - torch

        return loss(network, batch)

    def decode(self, outputs: Arrays, settings: YoloConfig, seen: Arrays) -> Found:
        """The best box of each class, in N frames.

        outputs: boxes (N, B, 6, h, w) and classes (N, C, h, w), see `model.Grid` · seen: depth (N, H, W) of the view, m, 0 =
        invalid. A box's score for a class is its confidence times the class' probability in its cell, and half of the presence is
        the least score. A joint's depth is that of the surface at the box's centre and what the box says lies behind it; where
        nothing was measured, that at which a joint's box is as large as this one.
        """
        boxes, classes = (np.asarray(outputs[name], dtype=np.float64) for name in ("boxes", "classes"))
        n, count, _, h, w = boxes.shape
        boxes, classes = boxes.reshape(n, count, 6, h * w), classes.reshape(n, -1, h * w)
        frame = np.arange(n)[:, None]
        sure = np.clip(boxes[:, :, 4], 0, 1)
        best = sure.argmax(axis=1)  # (N, cells): of the boxes of a cell
        scores = np.take_along_axis(sure, best[:, None], axis=1) * np.clip(classes, 0, 1)  # (N, C, cells)
        cell = scores.argmax(axis=2)  # (N, C)
        score = np.take_along_axis(scores, cell[..., None], axis=2)[..., 0]
        x, y, root_w, root_h, _, offset = np.moveaxis(boxes[frame, best[frame, cell], :, cell], -1, 0)
        uv = np.stack((cell % w + x, cell // w + y), axis=-1) * settings.cell_px - 0.5
        side = 0.5 * (root_w**2 * settings.width + root_h**2 * settings.height)
        surface = surface_depth(np.asarray(seen["depth"]), uv)
        by_size = settings.view.focal * settings.box_m / np.maximum(side, 1e-3)
        depth = np.where(np.isfinite(surface), surface + OFFSET_M * offset, by_size)
        uvz = np.concatenate((uv, depth[..., None]), axis=-1)
        uvz[score < settings.least] = np.nan
        shape = (n, len(settings.slots), len(settings.joints))
        uvz, score = uvz.reshape(*shape, 3), score.reshape(shape)
        presence = np.clip(0.5 * score / settings.least, 0, 1)
        return Found(uvz[..., :2], settings.view.from_view(uvz), score, presence)


METHOD = YoloMethod()
