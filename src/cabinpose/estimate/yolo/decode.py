"""From the grid's boxes to joints; numpy, the same for torch and ONNX Runtime."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.found import Found
from cabinpose.estimate.paf.decode import surface_depth
from cabinpose.estimate.yolo.config import YoloConfig

OFFSET_M = 0.1  # unit of the depth behind the surface


def decode(outputs: Mapping[str, NDArray[Any]], config: YoloConfig, seen: Mapping[str, NDArray[Any]]) -> Found:
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
    uv = np.stack((cell % w + x, cell // w + y), axis=-1) * config.cell_px - 0.5
    side = 0.5 * (root_w**2 * config.width + root_h**2 * config.height)
    surface = surface_depth(np.asarray(seen["depth"]), uv)
    depth = np.where(np.isfinite(surface), surface + OFFSET_M * offset, config.view.focal * config.box_m / np.maximum(side, 1e-3))
    uvz = np.concatenate((uv, depth[..., None]), axis=-1)
    uvz[score < config.least] = np.nan
    shape = (n, len(config.slots), len(config.joints))
    uvz, score = uvz.reshape(*shape, 3), score.reshape(shape)
    presence = np.clip(0.5 * score / config.least, 0, 1)
    return Found(uvz[..., :2], config.view.from_view(uvz), score, presence)
